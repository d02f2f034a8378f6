//! The inner loops, written once for every vector width (AVX-512, AVX2 with FMA, NEON, scalar) and
//! chosen at run time by pulp.

use std::sync::OnceLock;

use pulp::Simd;

#[cfg(target_arch = "x86_64")]
use super::avx512;

/// Vectors of output channels in a full tile of a product.
pub const TILE_VECTORS: usize = 2;
/// Positions of the largest tile.
pub const MAX_POSITIONS: usize = 14;
/// Floats in the widest vector.
pub const MAX_LANES: usize = 16;
/// Values of the largest tile.
pub const MAX_TILE: usize = MAX_POSITIONS * TILE_VECTORS * MAX_LANES;

/// Most positions of a tile: sums, weights and one input value fill the register file (32 vectors
/// with AVX-512 and NEON, 16 with AVX2).
#[inline(always)]
pub const fn tile_positions<S: Simd>() -> usize {
    match S::F32_LANES {
        4 | 16 => 14,
        8 => 6,
        _ => 4,
    }
}

/// The widest vectors that are used, in the environment variable [`WIDTH_VARIABLE`] or by what the
/// machine has.
#[derive(Debug, Clone, Copy)]
enum Width {
    /// Whatever pulp finds.
    Widest,
    /// Eight floats and half of the registers: AVX2 with FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2(pulp::x86::V3),
    /// One float.
    Scalar,
}

/// Names the vectors to use: "avx2" or "scalar" instead of the widest there are, to compare and to
/// test. Anything else, or vectors that the machine lacks, means the widest.
pub const WIDTH_VARIABLE: &str = "TWINSIGHT_SIMD";

fn width() -> Width {
    static WIDTH: OnceLock<Width> = OnceLock::new();
    *WIDTH.get_or_init(|| match std::env::var(WIDTH_VARIABLE).as_deref() {
        #[cfg(target_arch = "x86_64")]
        Ok("avx2") => pulp::x86::V3::try_new().map_or(Width::Widest, Width::Avx2),
        Ok("scalar") => Width::Scalar,
        _ => Width::Widest,
    })
}

/// Runs work compiled for the machine's vectors.
#[inline]
pub fn dispatch<W: pulp::WithSimd>(work: W) -> W::Output {
    match width() {
        Width::Widest => pulp::Arch::new().dispatch(work),
        #[cfg(target_arch = "x86_64")]
        Width::Avx2(simd) => Simd::vectorize(simd, work),
        Width::Scalar => Simd::vectorize(pulp::Scalar::new(), work),
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
    dispatch(Lanes)
}

/// Loads a vector; values beyond the slice's end are zero.
#[inline(always)]
pub fn load<S: Simd>(simd: S, values: &[f32]) -> S::f32s {
    if values.len() >= S::F32_LANES {
        // SAFETY: the slice holds a whole vector; the read is unaligned.
        unsafe { values.as_ptr().cast::<S::f32s>().read_unaligned() }
    } else {
        simd.partial_load_f32s(values)
    }
}

/// Stores a vector, or as much of it as the slice has room for.
#[inline(always)]
pub fn store<S: Simd>(simd: S, target: &mut [f32], values: S::f32s) {
    if target.len() >= S::F32_LANES {
        // SAFETY: the slice has room for a whole vector; the write is unaligned.
        unsafe {
            target
                .as_mut_ptr()
                .cast::<S::f32s>()
                .write_unaligned(values);
        }
    } else {
        simd.partial_store_f32s(target, values);
    }
}

/// A run of input values that enter a product one after the other, the same for every position.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct Run {
    /// First value for the tile's first position.
    input: *const f32,
    /// Distance of two positions' values, bytes.
    stride: usize,
    /// Steps.
    len: usize,
}

impl Run {
    /// `len` steps; the values of two positions lie `stride` floats apart.
    pub fn new(input: *const f32, stride: usize, len: usize) -> Self {
        Self {
            input,
            stride: stride * size_of::<f32>(),
            len,
        }
    }

    /// The same run so many positions further on.
    pub fn skip(self, positions: usize) -> Self {
        Self {
            input: self.input.wrapping_byte_add(positions * self.stride),
            ..self
        }
    }
}

impl Default for Run {
    fn default() -> Self {
        Self::new(std::ptr::null(), 0, 0)
    }
}

/// One tile of a product: `tile[p, v] = sum_k input[p, k] * weights[k, v]` for `P` positions and `V`
/// vectors of output channels; `k` counts through the steps of all runs. The tile is stored row
/// by row.
///
/// # Safety
/// As [`product`].
#[inline(always)]
unsafe fn product_tile<S: Simd, const P: usize, const V: usize>(
    simd: S,
    runs: &[Run],
    input_step: usize,
    mut weights: *const f32,
    weight_step: usize,
    tile: &mut [f32],
) {
    let mut sums = [[simd.splat_f32s(0.0); V]; P];
    for run in runs {
        let mut input = run.input;
        for _ in 0..run.len {
            // SAFETY: in bounds by the caller's promise; the reads are unaligned. The last step
            // may lead past the end, where nothing is read any more.
            unsafe {
                let mut row = [simd.splat_f32s(0.0); V];
                for (v, vector) in row.iter_mut().enumerate() {
                    *vector = weights
                        .add(v * S::F32_LANES)
                        .cast::<S::f32s>()
                        .read_unaligned();
                }
                for p in 0..P {
                    let value = simd.splat_f32s(*input.byte_add(p * run.stride));
                    for v in 0..V {
                        sums[p][v] = simd.mul_add_f32s(value, row[v], sums[p][v]);
                    }
                }
            }
            input = input.wrapping_add(input_step);
            weights = weights.wrapping_add(weight_step);
        }
    }
    for (row, sums) in tile.chunks_exact_mut(V * S::F32_LANES).zip(&sums) {
        row.copy_from_slice(bytemuck::cast_slice(sums));
    }
}

/// One tile of a product: `tile[p, v] = sum_k input[p, k] * weights[k, v]` for up to
/// [`tile_positions`] positions and `V` vectors of output channels; `k` counts through the steps of
/// all runs. A step's values lie `input_step` and `weight_step` floats behind the last one's.
///
/// # Safety
/// Every run must be readable for all positions at all its steps, and `weights` for `V` vectors at
/// as many steps as the runs have.
///
/// # Panics
/// Without runs, or when the tile is too small.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "two streams and where they meet")]
pub unsafe fn product<S: Simd, const V: usize>(
    simd: S,
    positions: usize,
    runs: &[Run],
    input_step: usize,
    weights: *const f32,
    weight_step: usize,
    tile: &mut [f32],
) {
    assert!(
        tile.len() >= positions * V * S::F32_LANES && !runs.is_empty(),
        "a tile has room for its sums, and something to sum"
    );
    #[cfg(target_arch = "x86_64")]
    if S::F32_LANES == 16 && V <= TILE_VECTORS {
        // SAFETY: vectors of 16 floats exist with AVX-512 only, which was found at run time; the
        // tile's room was checked, the rest is the caller's promise.
        unsafe {
            avx512::TILES[V - 1][positions - 1](
                runs.as_ptr(),
                runs.len(),
                input_step * size_of::<f32>(),
                weights,
                weight_step * size_of::<f32>(),
                tile.as_mut_ptr(),
            );
        }
        return;
    }
    macro_rules! choose {
        ($($count:literal)*) => {
            match positions {
                // SAFETY: by the caller's promise.
                $($count => unsafe {
                    product_tile::<S, $count, V>(
                        simd, runs, input_step, weights, weight_step, tile,
                    );
                },)*
                _ => unreachable!("tiles have 1 to {MAX_POSITIONS} positions"),
            }
        };
    }
    choose!(1 2 3 4 5 6 7 8 9 10 11 12 13 14);
}

/// One tile of sums of outer products: `sums[r, v] += sum_p input[p * input_step + r] * grads[p *
/// grad_step + v]` for up to [`tile_positions`] neighbouring input values and `V` vectors.
///
/// # Safety
/// `input` must be readable for `rows` values and `grads` for `V` vectors at each of `len`
/// positions; `sums` must be readable and writable for `rows` rows of `V` vectors at distance
/// `sum_stride`.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "two streams and where they meet")]
pub unsafe fn add_outer<S: Simd, const V: usize>(
    simd: S,
    rows: usize,
    input: *const f32,
    input_step: usize,
    grads: *const f32,
    grad_step: usize,
    len: usize,
    sums: *mut f32,
    sum_stride: usize,
) {
    let mut tile = [0.0_f32; MAX_TILE];
    // SAFETY: by the caller's promise: the values of a position are neighbours.
    unsafe {
        let runs = [Run::new(input, 1, len)];
        product::<S, V>(simd, rows, &runs, input_step, grads, grad_step, &mut tile);
    }
    for (r, tile) in tile.chunks_exact(V * S::F32_LANES).take(rows).enumerate() {
        for (v, values) in tile.chunks_exact(S::F32_LANES).enumerate() {
            // SAFETY: in bounds by the caller's promise.
            unsafe {
                let target = sums
                    .add(r * sum_stride + v * S::F32_LANES)
                    .cast::<S::f32s>();
                let sum = simd.add_f32s(target.read_unaligned(), load(simd, values));
                target.write_unaligned(sum);
            }
        }
    }
}

/// `e^x` to about 2 units in the last place, for arguments from -87.3 to 88.3 (others count as the
/// nearer end).
///
/// By Cody and Waite's reduction and the degree-6 polynomial of the Cephes library's `expf`.
#[inline(always)]
pub fn exp_vector<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let splat = |value: f32| simd.splat_f32s(value);
    // 1.5 * 2^23: adding it rounds to an integer.
    let round = splat(12_582_912.0);
    let x = simd.min_f32s(simd.max_f32s(x, splat(-87.3)), splat(88.3));
    let shifted = simd.mul_add_f32s(x, splat(std::f32::consts::LOG2_E), round);
    let n = simd.sub_f32s(shifted, round);
    let r = simd.mul_add_f32s(n, splat(-0.693_359_4), x);
    let r = simd.mul_add_f32s(n, splat(2.121_944_4e-4), r);
    let mut p = splat(1.987_569_1e-4);
    for coefficient in [
        1.398_2e-3,
        8.333_452e-3,
        4.166_579_6e-2,
        1.666_666_5e-1,
        0.5,
    ] {
        p = simd.mul_add_f32s(p, r, splat(coefficient));
    }
    let e = simd.add_f32s(simd.mul_add_f32s(simd.mul_f32s(p, r), r, r), splat(1.0));
    // The low bits of `shifted` hold n; moved to the exponent they are a factor 2^n.
    let bits = simd.wrapping_dyn_shl_u32s(simd.transmute_u32s_f32s(shifted), simd.splat_u32s(23));
    let power = simd.transmute_f32s_u32s(simd.add_u32s(bits, simd.splat_u32s(0x3f80_0000)));
    simd.mul_f32s(e, power)
}

/// `1 / (1 + e^-x)` to about 3 units in the last place.
#[inline(always)]
pub fn sigmoid_vector<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let one = simd.splat_f32s(1.0);
    let e = exp_vector(simd, simd.neg_f32s(x));
    simd.div_f32s(one, simd.add_f32s(one, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Sigmoids<'a>(&'a mut [f32]);

    impl pulp::WithSimd for Sigmoids<'_> {
        type Output = ();

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            for values in self.0.chunks_mut(S::F32_LANES) {
                let sigmoids = sigmoid_vector(simd, load(simd, values));
                store(simd, values, sigmoids);
            }
        }
    }

    fn sigmoids(mut values: Vec<f32>) -> Vec<f32> {
        dispatch(Sigmoids(&mut values));
        values
    }

    #[test]
    fn sigmoids_are_exact_to_a_few_units_in_the_last_place_over_their_range() {
        let arguments: Vec<f32> = (-8700..8700_i16).map(|i| f32::from(i) / 100.0).collect();
        for (x, actual) in arguments.iter().zip(sigmoids(arguments.clone())) {
            let exact = 1.0 / (1.0 + f64::from(-x).exp());
            let error = (f64::from(actual) - exact).abs();
            assert!(error <= 5e-7 * exact, "sigmoid({x}) = {actual}");
        }
    }

    #[test]
    fn sigmoids_saturate_and_those_of_x_and_minus_x_sum_to_one() {
        let extremes = sigmoids(vec![1e30, -1e30, f32::INFINITY, f32::NEG_INFINITY]);
        assert_eq!([extremes[0], extremes[2]], [1.0, 1.0]);
        assert!(extremes[1] >= 0.0 && extremes[1] < 1e-30, "{extremes:?}");
        let arguments: Vec<f32> = (0..2000_i16).map(|i| f32::from(i) / 100.0).collect();
        let mirrored: Vec<f32> = arguments.iter().map(|x| -x).collect();
        for (a, b) in sigmoids(arguments).into_iter().zip(sigmoids(mirrored)) {
            assert!((a + b - 1.0).abs() < 2e-7, "{a} + {b}");
        }
    }
}
