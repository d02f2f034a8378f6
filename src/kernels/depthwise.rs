//! Depthwise convolution on slices: one small kernel per channel, no sums over channels.

use std::cell::RefCell;
use std::ops::Range;

use pulp::Simd;
use rayon::prelude::*;

use super::epilogue::{Activation, Epilogue, SharedOutput, part};
use super::layout::Pixels;
use super::packed::{Algorithm, pack_weights};
use super::shape::ConvShape;
use super::simd::{self, MAX_LANES};
use super::weight_grad::{by_image, partial_sums};
use super::windows::Windows;

/// Values of a band of input rows.
const BAND_VALUES: usize = 64 * 1024;

thread_local! {
    static BAND: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
}

/// `y = activation(depthwise_conv(x, w) + b) + residual`, `[batch, height_out, width_out,
/// channels]`; `weights` are packed: a row of channels for every tap.
pub fn forward(shape: &ConvShape, input: Pixels, weights: &[f32], epilogue: &Epilogue) -> Vec<f32> {
    let [rows, columns] = [shape.height_out(), shape.width_out()];
    let mut output = vec![0.0; shape.batch * shape.output_len()];
    let shared = SharedOutput::new(&mut output);
    let pitch = (columns - 1) * shape.stride + shape.kernel[1];
    let per_band = (BAND_VALUES / (pitch * shape.channels_in * shape.stride)).clamp(1, rows);
    let bands = rows.div_ceil(per_band);
    (0..shape.batch * bands).into_par_iter().for_each(|task| {
        let (image, rows) = (task / bands, part(rows, task % bands, bands));
        let mut band = BAND.take();
        copy_band(shape, &input, image, &rows, &mut band);
        let row_values = columns * shape.channels_out;
        // SAFETY: the bands are disjoint ranges of the output's rows.
        let output = unsafe {
            let start = (image * shape.height_out() + rows.start) * row_values;
            std::slice::from_raw_parts_mut(shared.get().add(start), rows.len() * row_values)
        };
        simd::dispatch(Forward {
            shape,
            band: &band,
            weights,
            epilogue,
            image,
            first_row: rows.start,
            output,
        });
        BAND.set(band);
    });
    output
}

/// The input pixels that some output rows see.
fn copy_band(
    shape: &ConvShape,
    input: &Pixels,
    image: usize,
    rows: &Range<usize>,
    band: &mut Vec<f32>,
) {
    let windows = Windows::forward(shape);
    let pitch = (windows.positions[1] - 1) * shape.stride + shape.kernel[1];
    let height = (rows.len() - 1) * shape.stride + shape.kernel[0];
    band.resize(height * pitch * shape.channels_in, 0.0);
    let top = windows.corner[0] + (rows.start * shape.stride) as isize;
    input.copy_window(image, [top, windows.corner[1]], [height, pitch], band);
}

struct Forward<'a> {
    shape: &'a ConvShape,
    band: &'a [f32],
    weights: &'a [f32],
    epilogue: &'a Epilogue<'a>,
    image: usize,
    first_row: usize,
    output: &'a mut [f32],
}

/// Neighbouring positions that are worked on together, so that their sums do not wait for one
/// another.
const POSITIONS: usize = 4;

impl pulp::WithSimd for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let ConvShape {
            channels_out: channels,
            kernel: [kernel_h, kernel_w],
            stride,
            ..
        } = *self.shape;
        let columns = self.shape.width_out();
        let pitch = (columns - 1) * stride + kernel_w;
        // Where each tap lies behind a window's first value.
        let taps: Vec<usize> = (0..kernel_h * kernel_w)
            .map(|tap| (tap / kernel_w * pitch + tap % kernel_w) * channels)
            .collect();
        for row in 0..self.output.len() / (columns * channels) {
            let mut column = 0;
            while column < columns {
                let window = (row * pitch + column) * stride * channels;
                if columns - column >= POSITIONS {
                    self.positions::<S, POSITIONS>(simd, row, column, window, &taps);
                    column += POSITIONS;
                } else {
                    self.positions::<S, 1>(simd, row, column, window, &taps);
                    column += 1;
                }
            }
        }
    }
}

impl Forward<'_> {
    /// All channels of `P` neighbouring positions, the first one's window starting at `window`.
    #[inline(always)]
    fn positions<S: Simd, const P: usize>(
        &mut self,
        simd: S,
        row: usize,
        column: usize,
        window: usize,
        taps: &[usize],
    ) {
        let channels = self.shape.channels_out;
        let step = self.shape.stride * channels;
        let width = channels.next_multiple_of(MAX_LANES);
        let zero = simd.splat_f32s(0.0);
        let pixel = row * self.shape.width_out() + column;
        for first in (0..channels).step_by(S::F32_LANES) {
            let count = S::F32_LANES.min(channels - first);
            let mut sums = [zero; P];
            if let Some(bias) = self.epilogue.bias {
                sums = [simd::load(simd, &bias[first..first + count]); P];
            }
            for (tap, &offset) in taps.iter().enumerate() {
                let weights = &self.weights[tap * width + first..][..count];
                let weights = simd::load(simd, weights);
                for (p, sum) in sums.iter_mut().enumerate() {
                    let start = window + offset + p * step + first;
                    let values = simd::load(simd, &self.band[start..start + count]);
                    *sum = simd.mul_add_f32s(values, weights, *sum);
                }
            }
            for (p, mut x) in sums.into_iter().enumerate() {
                match self.epilogue.activation {
                    Activation::None => {}
                    Activation::Relu => x = simd.max_f32s(x, zero),
                    Activation::Silu => x = simd.mul_f32s(x, simd::sigmoid_vector(simd, x)),
                }
                if let Some(residual) = &self.epilogue.residual {
                    let pixel = residual.pixel(self.image, self.first_row + row, column + p);
                    let values = simd::load(simd, &pixel[first..first + count]);
                    x = simd.add_f32s(x, values);
                }
                let start = (pixel + p) * channels + first;
                simd::store(simd, &mut self.output[start..start + count], x);
            }
        }
    }
}

/// Gradient of the input; `weight` is `[channels, 1, kernel_h, kernel_w]`.
pub fn backward_input(shape: &ConvShape, grad: Pixels, weight: &[f32]) -> Vec<f32> {
    let [kernel_h, kernel_w] = shape.kernel;
    let channels = shape.channels_out;
    // The gradient spread out by the stride, with a margin, so that every pixel's window of the
    // mirrored kernel lies inside.
    let size = [
        shape.height_in + kernel_h - 1,
        shape.width_in + kernel_w - 1,
    ];
    let mut spread = vec![0.0; shape.batch * size[0] * size[1] * channels];
    for image in 0..shape.batch {
        for y in 0..grad.height {
            // Output (y, x) lies at input pixel `stride * y - padding` of the kernel's first tap.
            let row = y * shape.stride + kernel_h - 1;
            for x in 0..grad.width {
                let column = x * shape.stride + kernel_w - 1;
                let at = [row, column].map(|at| at.checked_sub(shape.padding));
                let [Some(row), Some(column)] = at else {
                    continue;
                };
                if row < size[0] && column < size[1] {
                    let start = ((image * size[0] + row) * size[1] + column) * channels;
                    spread[start..start + channels].copy_from_slice(grad.pixel(image, y, x));
                }
            }
        }
    }
    let mirrored = ConvShape {
        height_in: size[0],
        width_in: size[1],
        stride: 1,
        padding: 0,
        ..*shape
    };
    let taps = kernel_h * kernel_w;
    let flipped: Vec<f32> = weight
        .chunks_exact(taps)
        .flat_map(|kernel| kernel.iter().rev().copied())
        .collect();
    let packed = pack_weights(&mirrored, Algorithm::Depthwise, &flipped);
    let dims = [shape.batch, size[0], size[1], channels];
    forward(
        &mirrored,
        Pixels::dense(&spread, dims),
        &packed,
        &Epilogue::default(),
    )
}

/// Gradient of the weights, `[channels, 1, kernel_h, kernel_w]`.
pub fn backward_weight(shape: &ConvShape, input: Pixels, grad: Pixels) -> Vec<f32> {
    let taps = shape.kernel[0] * shape.kernel[1];
    let channels = shape.channels_out;
    let rows = shape.height_out();
    let partial = partial_sums(shape.batch * rows, |rows_of_all| {
        let mut sums = vec![0.0; taps * channels];
        let mut band = BAND.take();
        for (image, rows) in by_image(rows_of_all, rows) {
            for row in rows {
                copy_band(shape, &input, image, &(row..row + 1), &mut band);
                simd::dispatch(WeightGrad {
                    shape,
                    band: &band,
                    grad: &grad,
                    image,
                    row,
                    sums: &mut sums,
                });
            }
        }
        BAND.set(band);
        sums
    });
    let mut gradient = vec![0.0; channels * taps];
    for (index, value) in gradient.iter_mut().enumerate() {
        let start = index % taps * channels + index / taps;
        *value = partial.iter().map(|sums| sums[start]).sum();
    }
    gradient
}

/// One output row's share of the weights' gradient, `sums[tap][channel]`.
struct WeightGrad<'a> {
    shape: &'a ConvShape,
    band: &'a [f32],
    grad: &'a Pixels<'a>,
    image: usize,
    row: usize,
    sums: &'a mut [f32],
}

impl pulp::WithSimd for WeightGrad<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let ConvShape {
            channels_out: channels,
            kernel: [kernel_h, kernel_w],
            stride,
            ..
        } = *self.shape;
        let columns = self.grad.width;
        let pitch = (columns - 1) * stride + kernel_w;
        for first in (0..channels).step_by(S::F32_LANES) {
            let count = S::F32_LANES.min(channels - first);
            for ky in 0..kernel_h {
                for kx in 0..kernel_w {
                    let mut sum = simd.splat_f32s(0.0);
                    for column in 0..columns {
                        let source = ky * pitch + column * stride + kx;
                        let values = &self.band[source * channels + first..][..count];
                        let start = self.grad.offset(self.image, self.row, column) + first;
                        let grads = &self.grad.data[start..start + count];
                        sum = simd.mul_add_f32s(
                            simd::load(simd, values),
                            simd::load(simd, grads),
                            sum,
                        );
                    }
                    let tap = ky * kernel_w + kx;
                    let sums = &mut self.sums[tap * channels + first..][..count];
                    let sum = simd.add_f32s(simd::load(simd, sums), sum);
                    simd::store(simd, sums, sum);
                }
            }
        }
    }
}
