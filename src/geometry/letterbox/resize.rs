//! Bilinear resizing of 8-bit RGB images in integers, the same on every machine.
//!
//! Half-pixel centres, `src = (dst + 0.5) * in / out - 0.5`, neighbours clamped to the image, no
//! antialiasing when shrinking. Weights have 11 bits and the sums are cut to 16 bits between the
//! two directions, as common 8-bit implementations do, so the grey levels equal theirs exactly.

use image::RgbImage;

use super::Size;

/// One: weights are whole numbers of 1/2048.
const WEIGHT_ONE: f32 = 2048.0;

/// Two neighbours along one axis and their weights.
#[derive(Clone, Copy)]
struct Tap {
    near: usize,
    far: usize,
    near_weight: i32,
    far_weight: i32,
}

/// Resizes an image to `size`, both with at least one pixel.
///
/// An image that already has this size, or has no pixels, comes back unchanged.
pub fn resize_bilinear(image: &RgbImage, size: Size) -> RgbImage {
    let original = Size::of(image);
    if original == size || original.area() == 0 || size.area() == 0 {
        return image.clone();
    }
    let mut pixels = Vec::with_capacity(3 * size.area());
    for_each_row(image.as_raw(), original, size, |_, row| {
        pixels.extend_from_slice(row);
    });
    // The length fits by construction.
    RgbImage::from_raw(size.width, size.height, pixels).unwrap_or_default()
}

/// Hands every row of the resized image, three bytes a pixel, to `use_row` from top to bottom.
///
/// `pixels` are the bytes of an image of size `original`; no size may have a side of 0.
pub(super) fn for_each_row(
    pixels: &[u8],
    original: Size,
    resized: Size,
    mut use_row: impl FnMut(usize, &[u8]),
) {
    let original_row = 3 * original.width as usize;
    if original == resized {
        // Counted by height: an image's buffer may be longer than its pixels.
        let rows = pixels.chunks_exact(original_row);
        for (y, row) in rows.take(original.height as usize).enumerate() {
            use_row(y, row);
        }
        return;
    }
    let columns = taps(original.width, resized.width);
    let rows = taps(original.height, resized.height);
    let row_length = 3 * resized.width as usize;
    let mut output = vec![0u8; row_length];
    // Horizontal sums of the two source rows at hand, kept while the next output row needs them.
    let mut near = (usize::MAX, vec![0i32; row_length]);
    let mut far = (usize::MAX, vec![0i32; row_length]);
    let source = |y: usize| &pixels[y * original_row..(y + 1) * original_row];
    for (y, tap) in rows.iter().enumerate() {
        if near.0 != tap.near {
            if far.0 == tap.near {
                std::mem::swap(&mut near, &mut far);
            } else {
                sum_row(source(tap.near), &columns, &mut near.1);
                near.0 = tap.near;
            }
        }
        if far.0 != tap.far {
            if tap.far == tap.near {
                far.1.copy_from_slice(&near.1);
            } else {
                sum_row(source(tap.far), &columns, &mut far.1);
            }
            far.0 = tap.far;
        }
        for ((level, &a), &b) in output.iter_mut().zip(&near.1).zip(&far.1) {
            let sum = ((tap.near_weight * a) >> 16) + ((tap.far_weight * b) >> 16);
            *level = ((sum + 2) >> 2) as u8;
        }
        use_row(y, &output);
    }
}

/// Weighted sums of horizontal neighbours, already without the four bits that the vertical step
/// does not use.
fn sum_row(row: &[u8], columns: &[Tap], sums: &mut [i32]) {
    let (pixels, _) = row.as_chunks::<3>();
    let (sums, _) = sums.as_chunks_mut::<3>();
    for (sum, tap) in sums.iter_mut().zip(columns) {
        let (near, far) = (pixels[tap.near], pixels[tap.far]);
        for c in 0..3 {
            let weighted =
                i32::from(near[c]) * tap.near_weight + i32::from(far[c]) * tap.far_weight;
            sum[c] = weighted >> 4;
        }
    }
}

/// Neighbours and weights of every output position along one axis.
fn taps(original: u32, resized: u32) -> Vec<Tap> {
    let step = f64::from(original) / f64::from(resized);
    let last = i64::from(original) - 1;
    (0..resized)
        .map(|position| {
            // Single precision from here on: the weights' last bit depends on it.
            let source = ((f64::from(position) + 0.5) * step - 0.5) as f32;
            let floor = source.floor();
            let fraction = source - floor;
            let clamp = |index: i64| index.clamp(0, last) as usize;
            Tap {
                near: clamp(floor as i64),
                far: clamp(floor as i64 + 1),
                near_weight: ((1.0 - fraction) * WEIGHT_ONE).round_ties_even() as i32,
                far_weight: (fraction * WEIGHT_ONE).round_ties_even() as i32,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_of_two_neighbours_sum_to_one() {
        for (original, resized) in [(2048, 640), (53, 64), (3, 1000), (1000, 3), (1, 7)] {
            for tap in taps(original, resized) {
                assert_eq!(tap.near_weight + tap.far_weight, 2048);
                assert!(tap.far < original as usize && tap.near <= tap.far);
            }
        }
    }

    #[test]
    fn a_plain_image_stays_plain_at_every_size() {
        let image = RgbImage::from_pixel(13, 7, image::Rgb([255, 114, 1]));
        for size in [Size::new(1, 1), Size::new(5, 40), Size::new(64, 3)] {
            let resized = resize_bilinear(&image, size);
            assert_eq!(Size::of(&resized), size);
            for pixel in resized.pixels() {
                // The cut between the two directions may cost one grey level.
                for (level, expected) in pixel.0.iter().zip([255i32, 114, 1]) {
                    assert!((i32::from(*level) - expected).abs() <= 1);
                }
            }
        }
    }

    #[test]
    fn halving_takes_the_mean_of_four_pixels() {
        let image = RgbImage::from_fn(4, 2, |x, y| image::Rgb([(x * 10 + y * 2) as u8; 3]));
        let half = resize_bilinear(&image, Size::new(2, 1));
        assert_eq!(half.get_pixel(0, 0).0, [6; 3]);
        assert_eq!(half.get_pixel(1, 0).0, [26; 3]);
    }

    #[test]
    fn a_ramp_stays_a_ramp_when_enlarged() {
        let image = RgbImage::from_fn(5, 1, |x, _| image::Rgb([(x * 40) as u8; 3]));
        let large = resize_bilinear(&image, Size::new(20, 1));
        for x in 2..18 {
            let expected = (f64::from(x) + 0.5) / 4.0 * 40.0 - 20.0;
            let level = f64::from(large.get_pixel(x, 0)[0]);
            assert!(
                (level - expected).abs() <= 1.0,
                "{level} at {x}, not {expected}"
            );
        }
    }
}
