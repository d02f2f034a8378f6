//! Procedural texture: hashes, value noise and box-filtered patterns.
//!
//! Stereo matching needs texture at every scale that a pixel can see, and no more: a pattern finer
//! than a pixel would flicker between the two cameras. Every function here therefore takes the
//! pixel's footprint in metres and fades or averages what lies below it.

/// A well-mixed hash of a lattice cell.
pub(crate) fn hash(x: i32, y: i32, seed: u32) -> u32 {
    let mut h = x.cast_unsigned().wrapping_mul(0x8da6_b343)
        ^ y.cast_unsigned().wrapping_mul(0xd816_3841)
        ^ seed.wrapping_mul(0xcb1a_b31f);
    h ^= h >> 16;
    h = h.wrapping_mul(0x7feb_352d);
    h ^= h >> 15;
    h = h.wrapping_mul(0x846c_a68b);
    h ^ (h >> 16)
}

/// A number in 0..1 from a hash.
pub(crate) fn unit(hash: u32) -> f32 {
    (hash >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Mixes a seed with a stream and an index, so that each gets unrelated random numbers.
pub(crate) fn derive_seed(seed: u64, stream: u64, index: u64) -> u64 {
    let mut z = seed
        .wrapping_add(stream.wrapping_mul(0x9e37_79b9_7f4a_7c15))
        .wrapping_add(index.wrapping_mul(0xd1b5_4a32_d192_ed03));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Smooth noise in 0..1 with features one unit wide.
pub(crate) fn value(x: f32, y: f32, seed: u32) -> f32 {
    let (x0, y0) = (x.floor(), y.floor());
    let (ix, iy) = (x0 as i32, y0 as i32);
    let (fx, fy) = (x - x0, y - y0);
    let (sx, sy) = (fx * fx * (3.0 - 2.0 * fx), fy * fy * (3.0 - 2.0 * fy));
    let corner = |dx: i32, dy: i32| unit(hash(ix + dx, iy + dy, seed));
    let lower = mix(corner(0, 0), corner(1, 0), sx);
    let upper = mix(corner(0, 1), corner(1, 1), sx);
    mix(lower, upper, sy)
}

/// Noise of several scales, mean 0, within -1..1: features from `coarse_m` down by powers of 3, each
/// of 0.7 times the strength of the one before; features below the footprint fade out.
pub(crate) fn fractal(
    x: f32,
    y: f32,
    coarse_m: f32,
    octaves: u32,
    footprint_m: f32,
    seed: u32,
) -> f32 {
    let (mut sum, mut strength, mut size_m) = (0.0, 0.6, coarse_m);
    for octave in 0..octaves {
        let fade = (1.6 - footprint_m / size_m).clamp(0.0, 1.0);
        if fade <= 0.0 {
            break;
        }
        // Lattices of neighbouring octaves are shifted apart so that their corners do not meet.
        let shift = octave as f32 * 17.31;
        sum += strength
            * fade
            * (2.0
                * value(
                    x / size_m + shift,
                    y / size_m - shift,
                    seed.wrapping_add(octave),
                )
                - 1.0);
        strength *= 0.7;
        size_m /= 3.0;
    }
    sum
}

/// The share of a pixel at `x` that an interval around `center` covers.
pub(crate) fn stripe(x: f32, center: f32, half_width: f32, footprint_m: f32) -> f32 {
    let half_pixel = (footprint_m * 0.5).max(1e-4);
    let low = (x - half_pixel).max(center - half_width);
    let high = (x + half_pixel).min(center + half_width);
    ((high - low) / (2.0 * half_pixel)).clamp(0.0, 1.0)
}

/// The share of a pixel at `x` covered by intervals `start..start + width` repeated every `period`.
pub(crate) fn stripes(x: f32, period: f32, start: f32, width: f32, footprint_m: f32) -> f32 {
    let duty = width / period;
    let integral = |x: f32| {
        let cycles = (x - start) / period;
        let whole = cycles.floor();
        whole * duty + (cycles - whole).min(duty)
    };
    let half_pixel = (footprint_m * 0.5).max(1e-3 * period);
    (integral(x + half_pixel) - integral(x - half_pixel)) * period / (2.0 * half_pixel)
}

/// Linear interpolation.
pub(crate) fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// 0 below `low`, 1 above `high`, smooth between.
pub(crate) fn smooth_step(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stripe_wider_than_the_pixel_covers_it_and_a_fine_pattern_averages_to_its_duty() {
        assert_eq!(stripe(0.0, 0.0, 1.0, 0.1), 1.0);
        assert_eq!(stripe(5.0, 0.0, 1.0, 0.1), 0.0);
        assert!((stripe(1.0, 0.0, 1.0, 0.1) - 0.5).abs() < 1e-5);
        assert!((stripes(3.7, 1.0, 0.2, 0.25, 20.0) - 0.25).abs() < 1e-4);
    }

    #[test]
    fn noise_stays_in_range_and_fades_below_the_footprint() {
        for i in 0..500 {
            let (x, y) = (i as f32 * 0.37, i as f32 * -0.91);
            assert!((0.0..=1.0).contains(&value(x, y, 7)));
            assert!(fractal(x, y, 2.0, 4, 0.0, 7).abs() <= 2.0);
            assert_eq!(fractal(x, y, 2.0, 4, 10.0, 7), 0.0);
        }
    }
}
