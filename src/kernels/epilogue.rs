//! What becomes of a tile's sums, and where they go.

use std::ops::Range;

use pulp::Simd;

use super::layout::Pixels;
use super::packed::Panel;
use super::simd;

/// What is done to a convolution's sums before they are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Activation {
    /// Nothing.
    #[default]
    None,
    /// `x * sigmoid(x)`.
    Silu,
    /// `max(x, 0)`.
    Relu,
}

/// What becomes of the sums: `activation(sum + bias) + residual`.
#[derive(Debug, Clone, Copy, Default)]
pub struct Epilogue<'a> {
    /// One value an output channel.
    pub bias: Option<&'a [f32]>,
    /// Applied before the residual is added.
    pub activation: Activation,
    /// Added to the output, of its size.
    pub residual: Option<Pixels<'a>>,
}

/// A raw pointer that parallel tasks share; each task writes places of its own.
#[derive(Clone, Copy)]
pub(super) struct SharedOutput(*mut f32);
// SAFETY: every task derives from its index which elements it writes, and no two indices share one.
unsafe impl Send for SharedOutput {}
// SAFETY: as above.
unsafe impl Sync for SharedOutput {}

impl SharedOutput {
    pub(super) fn new(output: &mut Vec<f32>) -> Self {
        Self(output.as_mut_ptr())
    }

    pub(super) fn of(output: &mut [f32]) -> Self {
        Self(output.as_mut_ptr())
    }

    pub(super) fn get(self) -> *mut f32 {
        self.0
    }
}

/// The bias of a panel's channels.
#[inline(always)]
pub(super) fn panel_bias<S: Simd, const V: usize>(
    simd: S,
    panel: &Panel,
    epilogue: &Epilogue,
) -> [S::f32s; V] {
    let mut bias = [simd.splat_f32s(0.0); V];
    if let Some(values) = epilogue.bias {
        let values = &values[panel.first..panel.first + panel.channels];
        for (bias, values) in bias.iter_mut().zip(values.chunks(S::F32_LANES)) {
            *bias = simd::load(simd, values);
        }
    }
    bias
}

/// Where a tile goes: the first pixel's channels of the panel, and the distance of two pixels.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub(super) output: *mut f32,
    pub(super) output_stride: usize,
    /// What is added, at the same pixels.
    pub(super) residual: Option<(*const f32, usize)>,
}

/// Finishes and stores a tile.
///
/// # Safety
/// The output (and the residual) must be writable (readable) for `channels` values at `positions`
/// pixels.
#[inline(always)]
#[allow(
    clippy::too_many_arguments,
    reason = "a tile, what is done to it, where it goes"
)]
pub(super) unsafe fn store<S: Simd, const V: usize>(
    simd: S,
    tile: &[f32],
    positions: usize,
    channels: usize,
    bias: &[S::f32s; V],
    activation: Activation,
    place: Place,
) {
    let lanes = S::F32_LANES;
    let zero = simd.splat_f32s(0.0);
    for (p, row) in tile.chunks_exact(V * lanes).take(positions).enumerate() {
        for v in 0..V {
            let values = &row[v * lanes..(v + 1) * lanes];
            let mut x = simd.add_f32s(simd::load(simd, values), bias[v]);
            match activation {
                Activation::None => {}
                Activation::Relu => x = simd.max_f32s(x, zero),
                Activation::Silu => x = simd.mul_f32s(x, simd::sigmoid_vector(simd, x)),
            }
            let count = lanes.min(channels - v * lanes);
            // SAFETY: `count` channels of the pixel exist; the accesses are unaligned.
            unsafe {
                if let Some((residual, stride)) = place.residual {
                    let residual = residual.add(p * stride + v * lanes);
                    x = simd.add_f32s(
                        x,
                        simd::load(simd, std::slice::from_raw_parts(residual, count)),
                    );
                }
                let target = place.output.add(p * place.output_stride + v * lanes);
                if count == lanes {
                    target.cast::<S::f32s>().write_unaligned(x);
                } else {
                    simd.partial_store_f32s(std::slice::from_raw_parts_mut(target, count), x);
                }
            }
        }
    }
}

/// Cuts `len` positions into tiles of nearly equal size: tile number `index` of `count`.
#[inline(always)]
pub(super) fn part(len: usize, index: usize, count: usize) -> Range<usize> {
    len * index / count..len * (index + 1) / count
}
