//! Gradient of an ungrouped convolution's weights, on slices.
//!
//! A tile of sums holds a few neighbouring inputs of the kernel's rows and two vectors of output
//! channels; all positions pass by. The work is always cut into the same parts, so results are the
//! same for any number of threads.

use std::cell::RefCell;
use std::ops::Range;

use pulp::Simd;
use rayon::prelude::*;

use super::epilogue::part;
use super::layout::Pixels;
use super::packed::Algorithm;
use super::shape::ConvShape;
use super::simd::{self, MAX_LANES, TILE_VECTORS};
use super::windows::Windows;
use super::winograd::grow;
use super::winograd_grad;

/// Independent parts of the work: the most threads it can use.
pub(super) const TASKS: usize = 4;
/// Values of a band of input rows.
const BAND_VALUES: usize = 64 * 1024;
/// Positions of one pass over a band: their values stay in the first-level cache.
const PASS_POSITIONS: usize = 128;

thread_local! {
    /// A band of inputs, and one of gradients.
    static SCRATCH: RefCell<(Vec<f32>, Vec<f32>)> = const { RefCell::new((Vec::new(), Vec::new())) };
}

/// Gradient of the weights, `[channels_out, channels_in, kernel_h, kernel_w]`.
pub fn backward_weight(shape: &ConvShape, input: Pixels, grad: Pixels) -> Vec<f32> {
    if Algorithm::of(shape) == Algorithm::Winograd {
        return winograd_grad::backward_weight(shape, input, grad);
    }
    let width = shape.channels_out.next_multiple_of(MAX_LANES);
    let rows = shape.height_out();
    let windows = Windows::forward(shape);
    let partial = partial_sums(shape.batch * rows, |rows_of_all| {
        let mut sums = vec![0.0; shape.fan_in() * width];
        let mut scratch = SCRATCH.take();
        for (image, rows) in by_image(rows_of_all, rows) {
            add_rows(
                shape,
                &windows,
                input,
                grad,
                image,
                rows,
                &mut scratch,
                &mut sums,
            );
        }
        SCRATCH.set(scratch);
        sums
    });
    // From [ky, kx, channel_in, channel_out] to the weights' own order.
    let taps = shape.kernel[0] * shape.kernel[1];
    let mut gradient = vec![0.0; shape.channels_out * shape.fan_in()];
    gradient
        .par_chunks_exact_mut(shape.fan_in())
        .enumerate()
        .for_each(|(channel_out, gradient)| {
            for (index, value) in gradient.iter_mut().enumerate() {
                let (channel, tap) = (index / taps, index % taps);
                let start = (tap * shape.channels_in + channel) * width + channel_out;
                *value = partial.iter().map(|sums| sums[start]).sum();
            }
        });
    gradient
}

/// Cuts `units` into [`TASKS`] parts that are summed independently.
pub(super) fn partial_sums(
    units: usize,
    sums: impl Fn(Range<usize>) -> Vec<f32> + Sync,
) -> Vec<Vec<f32>> {
    let tasks = TASKS.min(units);
    (0..tasks)
        .into_par_iter()
        .map(|task| sums(part(units, task, tasks)))
        .collect()
}

/// Rows counted through all images, image by image.
pub(super) fn by_image(
    rows: Range<usize>,
    per_image: usize,
) -> impl Iterator<Item = (usize, Range<usize>)> {
    let first = rows.start / per_image;
    let last = rows.end.div_ceil(per_image);
    (first..last).map(move |image| {
        let start = rows.start.max(image * per_image) - image * per_image;
        let end = rows.end.min((image + 1) * per_image) - image * per_image;
        (image, start..end)
    })
}

/// Adds what some output rows of an image contribute to `sums`, `[ky, kx, channel_in,
/// channel_out]`, band after band of rows.
#[allow(
    clippy::too_many_arguments,
    reason = "two stacks of images, a part of them, and where it goes"
)]
fn add_rows(
    shape: &ConvShape,
    windows: &Windows,
    input: Pixels,
    grad: Pixels,
    image: usize,
    rows: Range<usize>,
    (band, grads): &mut (Vec<f32>, Vec<f32>),
    sums: &mut [f32],
) {
    let columns = windows.positions[1];
    let lanes = simd::vector_lanes();
    let pitch = (columns - 1) * shape.stride + shape.kernel[1];
    let per_band = (BAND_VALUES / (pitch * shape.channels_in * shape.stride)).clamp(1, rows.len());
    let bands = rows.len().div_ceil(per_band);
    for index in 0..bands {
        let cut = part(rows.len(), index, bands);
        let cut = rows.start + cut.start..rows.start + cut.end;
        let top = windows.corner[0] + (cut.start * shape.stride) as isize;
        let height = (cut.len() - 1) * shape.stride + shape.kernel[0];
        grow(band, height * pitch * shape.channels_in);
        input.copy_window(image, [top, windows.corner[1]], [height, pitch], band);
        // Vectors of gradients must not reach beyond the last pixel's channels.
        let start = grad.offset(image, cut.start, 0);
        let (values, grad_stride) = if grad.channels.is_multiple_of(lanes) {
            (&grad.data[start..], grad.pixel_stride)
        } else {
            let width = grad.channels.next_multiple_of(lanes);
            grow(grads, cut.len() * columns * width);
            for (p, target) in grads
                .chunks_exact_mut(width)
                .take(cut.len() * columns)
                .enumerate()
            {
                let source = start + p * grad.pixel_stride;
                target[..grad.channels].copy_from_slice(&grad.data[source..source + grad.channels]);
                target[grad.channels..].fill(0.0);
            }
            (&grads[..], width)
        };
        simd::dispatch(Band {
            shape,
            input: band,
            pitch,
            grads: values,
            grad_stride,
            rows: cut.len(),
            columns,
            sums,
        });
    }
}

/// A band of output rows.
struct Band<'a> {
    shape: &'a ConvShape,
    input: &'a [f32],
    pitch: usize,
    grads: &'a [f32],
    grad_stride: usize,
    rows: usize,
    columns: usize,
    sums: &'a mut [f32],
}

impl pulp::WithSimd for Band<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        // Positions of neighbouring rows follow one another where windows do not overlap rows.
        let flat = self.shape.kernel[1] == 1 && self.shape.stride == 1;
        let (rows, columns) = if flat {
            (1, self.rows * self.columns)
        } else {
            (self.rows, self.columns)
        };
        for row in 0..rows {
            for first in (0..columns).step_by(PASS_POSITIONS) {
                let len = PASS_POSITIONS.min(columns - first);
                self.pass(simd, row, first, len);
            }
        }
    }
}

impl Band<'_> {
    #[inline(always)]
    fn pass<S: Simd>(&mut self, simd: S, row: usize, first: usize, len: usize) {
        let lanes = S::F32_LANES;
        let ConvShape {
            channels_in,
            channels_out,
            kernel: [kernel_h, kernel_w],
            stride,
            ..
        } = *self.shape;
        let width = channels_out.next_multiple_of(MAX_LANES);
        let run = kernel_w * channels_in;
        let parts = run.div_ceil(simd::tile_positions::<S>());
        let grads = &self.grads[(row * self.columns + first) * self.grad_stride..];
        for channel in (0..channels_out).step_by(TILE_VECTORS * lanes) {
            let single = channels_out - channel <= lanes;
            for ky in 0..kernel_h {
                for index in 0..parts {
                    let part = part(run, index, parts);
                    let pixel = (row * stride + ky) * self.pitch + first * stride;
                    let input = self.input[pixel * channels_in + part.start..].as_ptr();
                    let start = (ky * run + part.start) * width + channel;
                    let sums = self.sums[start..].as_mut_ptr();
                    let grads = grads[channel..].as_ptr();
                    let step = stride * channels_in;
                    let (rows, stride) = (part.len(), self.grad_stride);
                    // SAFETY: the band holds the windows of all positions; every position has
                    // whole vectors of gradients, and the sums whole vectors of channels.
                    unsafe {
                        if single {
                            simd::add_outer::<S, 1>(
                                simd, rows, input, step, grads, stride, len, sums, width,
                            );
                        } else {
                            simd::add_outer::<S, TILE_VECTORS>(
                                simd, rows, input, step, grads, stride, len, sums, width,
                            );
                        }
                    }
                }
            }
        }
    }
}
