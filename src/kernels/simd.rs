//! The inner loops, written once for every vector width (AVX-512, AVX2 with FMA, scalar) and
//! chosen at run time by pulp.

use pulp::Simd;

/// Vectors of positions in one tile of a product.
pub const TILE_VECTORS: usize = 3;
/// Values in the widest tile.
pub const MAX_TILE: usize = TILE_VECTORS * 16;

/// Output channels of one tile: what fits the register file of the machine's vectors.
pub fn tile_channels() -> usize {
    match vector_lanes() {
        16 => 8,
        _ => 4,
    }
}

/// Floats in a vector of this machine.
pub fn vector_lanes() -> usize {
    struct Lanes;
    impl pulp::WithSimd for Lanes {
        type Output = usize;
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> usize {
            S::F32_LANES
        }
    }
    pulp::Arch::new().dispatch(Lanes)
}

/// Runs a closure compiled for the machine's vectors: its plain loops vectorise to full width.
pub fn vectorized<R>(work: impl FnOnce() -> R) -> R {
    struct Run<F>(F);
    impl<R, F: FnOnce() -> R> pulp::WithSimd for Run<F> {
        type Output = R;
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> R {
            (self.0)()
        }
    }
    pulp::Arch::new().dispatch(Run(work))
}

/// One tile of `out[m, p] = sum_k weights[k, m] * planes[offsets[k] + p]`, for `ROWS` channels
/// and `TILE_VECTORS` vectors of positions, into `tile` (row-major, `ROWS` rows).
///
/// # Safety
/// For every k, `planes + offsets[k]` must be readable for `TILE_VECTORS * F32_LANES` floats.
#[inline(always)]
pub unsafe fn product_tile<S: Simd, const ROWS: usize>(
    simd: S,
    weights: &[f32],
    offsets: &[usize],
    planes: *const f32,
    tile: &mut [f32],
) {
    let mut sums = [[simd.splat_f32s(0.0); TILE_VECTORS]; ROWS];
    for (weights, &offset) in weights.chunks_exact(ROWS).zip(offsets) {
        // SAFETY: in bounds by the caller's promise; the read is unaligned.
        let values: [S::f32s; TILE_VECTORS] = unsafe {
            std::array::from_fn(|v| {
                planes
                    .add(offset + v * S::F32_LANES)
                    .cast::<S::f32s>()
                    .read_unaligned()
            })
        };
        for m in 0..ROWS {
            let weight = simd.splat_f32s(weights[m]);
            for v in 0..TILE_VECTORS {
                sums[m][v] = simd.mul_add_f32s(weight, values[v], sums[m][v]);
            }
        }
    }
    let width = TILE_VECTORS * S::F32_LANES;
    for (row, sums) in tile.chunks_exact_mut(width).zip(&sums) {
        row.copy_from_slice(bytemuck::cast_slice(sums));
    }
}

/// `ROWS x COLUMNS` dot products over `len` (a multiple of the vector length) positions:
/// `sums[m][k] = sum_p grads[m * grad_stride + p] * planes[offsets[k] + p]`.
///
/// # Safety
/// Every row of `grads` and every `planes + offsets[k]` must be readable for `len` floats.
#[inline(always)]
pub unsafe fn dot_tile<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    grads: *const f32,
    grad_stride: usize,
    planes: *const f32,
    offsets: &[usize; COLUMNS],
    len: usize,
) -> [[f32; COLUMNS]; ROWS] {
    let mut sums = [[simd.splat_f32s(0.0); COLUMNS]; ROWS];
    let mut position = 0;
    while position < len {
        // SAFETY: in bounds by the caller's promise; the reads are unaligned.
        unsafe {
            let grads: [S::f32s; ROWS] = std::array::from_fn(|m| {
                grads
                    .add(m * grad_stride + position)
                    .cast::<S::f32s>()
                    .read_unaligned()
            });
            for k in 0..COLUMNS {
                let value = planes
                    .add(offsets[k] + position)
                    .cast::<S::f32s>()
                    .read_unaligned();
                for m in 0..ROWS {
                    sums[m][k] = simd.mul_add_f32s(grads[m], value, sums[m][k]);
                }
            }
        }
        position += S::F32_LANES;
    }
    sums.map(|row| row.map(|sum| simd.reduce_sum_f32s(sum)))
}

/// `e^x` to about 2 units in the last place, in arithmetic that vectorises.
///
/// Cody-Waite reduction and the degree-6 polynomial of the Cephes library's `expf`. Arguments
/// beyond the range of `f32` saturate.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    const ROUND: f32 = 12_582_912.0; // 1.5 * 2^23: adding it rounds to an integer
    let x = x.clamp(-87.3, 88.3);
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (x - n * 0.693_359_4) + n * 2.121_944_4e-4;
    let mut p = 1.987_569_1e-4;
    p = p * r + 1.398_2e-3;
    p = p * r + 8.333_452e-3;
    p = p * r + 4.166_579_6e-2;
    p = p * r + 1.666_666_5e-1;
    p = p * r + 0.5;
    let e = p * r * r + r + 1.0;
    // The low bits of `shifted` hold n; moved to the exponent they are a factor 2^n.
    e * f32::from_bits((shifted.to_bits() << 23).wrapping_add(0x3f80_0000))
}

/// `1 / (1 + e^-x)`, vectorisable.
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_is_within_three_units_in_the_last_place_over_its_range() {
        for i in -8700..8800_i16 {
            let x = f32::from(i) / 100.0;
            let exact = f64::from(x).exp();
            assert!(
                (f64::from(exp(x)) - exact).abs() <= 3.6e-7 * exact,
                "exp({x})"
            );
        }
        assert!(exp(1e30).is_finite() && exp(-1e30) >= 0.0);
    }

    #[test]
    fn sigmoid_of_x_and_minus_x_sum_to_one() {
        for i in -2000..2000_i16 {
            let x = f32::from(i) / 50.0;
            assert!((sigmoid(x) + sigmoid(-x) - 1.0).abs() < 3e-7);
        }
    }
}
