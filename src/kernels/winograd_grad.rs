//! Gradient of a 3x3 convolution's weights through Winograd's points.
//!
//! The gradient at the points is the product of the transformed inputs with the transformed
//! gradients of the outputs, summed over all tiles; the kernel's transform takes it back to nine
//! taps. It is the exact transpose of [`super::winograd`]'s forward pass.

use std::cell::RefCell;
use std::ops::Range;

use pulp::Simd;
use rayon::prelude::*;

use super::epilogue::part;
use super::layout::Pixels;
use super::shape::ConvShape;
use super::simd::{self, MAX_LANES, TILE_VECTORS};
use super::weight_grad::{by_image, partial_sums};
use super::winograd::{InputPoints, KERNEL, POINTS, SIDE, STEP, Tiles, ToPoints, grow, transform};

/// Tiles that are summed at a time.
const TASK_TILES: usize = 32;

thread_local! {
    /// Transformed inputs and transformed gradients.
    static SCRATCH: RefCell<(Vec<f32>, Vec<f32>)> = const { RefCell::new((Vec::new(), Vec::new())) };
}

/// Gradient of the weights, `[channels_out, channels_in, 3, 3]`.
pub(super) fn backward_weight(shape: &ConvShape, input: Pixels, grad: Pixels) -> Vec<f32> {
    let (channels_in, channels_out) = (shape.channels_in, shape.channels_out);
    let width = channels_out.next_multiple_of(MAX_LANES);
    let tiles = Tiles::new(shape);
    let per_image = tiles.count();
    let partial = partial_sums(shape.batch * per_image, |tiles_of_all| {
        let mut sums = vec![0.0; POINTS * channels_in * width];
        let (mut inputs, mut grads) = SCRATCH.take();
        for (image, range) in by_image(tiles_of_all, per_image) {
            let parts = range.len().div_ceil(TASK_TILES);
            for index in 0..parts {
                let part = part(range.len(), index, parts);
                simd::dispatch(Block {
                    shape,
                    tiles,
                    input,
                    grad,
                    image,
                    range: range.start + part.start..range.start + part.end,
                    inputs: &mut inputs,
                    grads: &mut grads,
                    sums: &mut sums,
                });
            }
        }
        SCRATCH.set((inputs, grads));
        sums
    });
    let mut gradient = vec![0.0; channels_out * channels_in * 9];
    gradient
        .par_chunks_exact_mut(9)
        .with_min_len(64)
        .enumerate()
        .for_each(|(index, taps)| {
            let (channel_out, channel) = (index / channels_in, index % channels_in);
            let point = |point: usize| -> f64 {
                let start = (point * channels_in + channel) * width + channel_out;
                partial.iter().map(|sums| f64::from(sums[start])).sum()
            };
            let mut half = [[0.0_f64; SIDE]; 3];
            for index in 0..POINTS {
                let value = point(index);
                for (row, factor) in half.iter_mut().zip(KERNEL[index / SIDE]) {
                    row[index % SIDE] += factor * value;
                }
            }
            for (tap, value) in taps.iter_mut().enumerate() {
                let sum: f64 = (0..SIDE)
                    .map(|column| half[tap / 3][column] * KERNEL[column][tap % 3])
                    .sum();
                *value = sum as f32;
            }
        });
    gradient
}

/// `A g`: the gradients of four outputs to six points.
struct GradPoints;

impl ToPoints<STEP> for GradPoints {
    #[inline(always)]
    fn points<S: Simd>(simd: S, g: [S::f32s; STEP]) -> [S::f32s; SIDE] {
        let two = simd.splat_f32s(2.0);
        let four = simd.splat_f32s(4.0);
        let even = simd.add_f32s(g[0], g[2]);
        let odd = simd.add_f32s(g[1], g[3]);
        let far_even = simd.mul_add_f32s(four, g[2], g[0]);
        let far_odd = simd.mul_f32s(two, simd.mul_add_f32s(four, g[3], g[1]));
        [
            g[0],
            simd.add_f32s(even, odd),
            simd.sub_f32s(even, odd),
            simd.add_f32s(far_even, far_odd),
            simd.sub_f32s(far_even, far_odd),
            g[3],
        ]
    }
}

/// Some tiles of one image.
struct Block<'a> {
    shape: &'a ConvShape,
    tiles: Tiles,
    input: Pixels<'a>,
    grad: Pixels<'a>,
    image: usize,
    range: Range<usize>,
    inputs: &'a mut Vec<f32>,
    grads: &'a mut Vec<f32>,
    sums: &'a mut [f32],
}

impl pulp::WithSimd for Block<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let lanes = S::F32_LANES;
        let count = self.range.len();
        let channels_in = self.shape.channels_in;
        let input_width = channels_in.next_multiple_of(lanes);
        let grad_width = self.shape.channels_out.next_multiple_of(lanes);
        let width = self.shape.channels_out.next_multiple_of(MAX_LANES);
        grow(self.inputs, POINTS * count * input_width);
        grow(self.grads, POINTS * count * grad_width);
        let (tiles, image) = (self.tiles, self.image);
        let corners = self.range.clone().map(|tile| tiles.input_corner(tile));
        transform::<S, SIDE, InputPoints>(simd, &self.input, image, corners, self.inputs);
        let corners = self
            .range
            .map(|tile| tiles.corner(tile).map(|side| side as isize));
        transform::<S, STEP, GradPoints>(simd, &self.grad, image, corners, self.grads);
        let parts = channels_in.div_ceil(simd::tile_positions::<S>());
        for point in 0..POINTS {
            let inputs = &self.inputs[point * count * input_width..];
            let grads = &self.grads[point * count * grad_width..];
            for channel in (0..grad_width).step_by(TILE_VECTORS * lanes) {
                let single = grad_width - channel <= lanes;
                for index in 0..parts {
                    let part = part(channels_in, index, parts);
                    let start = (point * channels_in + part.start) * width + channel;
                    let sums = self.sums[start..].as_mut_ptr();
                    let inputs = inputs[part.start..].as_ptr();
                    let grads = grads[channel..].as_ptr();
                    let rows = part.len();
                    // SAFETY: every tile has `input_width >= channels_in` inputs and whole
                    // vectors of gradients at this point; the sums hold whole vectors too.
                    unsafe {
                        if single {
                            simd::add_outer::<S, 1>(
                                simd,
                                rows,
                                inputs,
                                input_width,
                                grads,
                                grad_width,
                                count,
                                sums,
                                width,
                            );
                        } else {
                            simd::add_outer::<S, TILE_VECTORS>(
                                simd,
                                rows,
                                inputs,
                                input_width,
                                grads,
                                grad_width,
                                count,
                                sums,
                                width,
                            );
                        }
                    }
                }
            }
        }
    }
}
