//! Gradient of an ungrouped convolution's weights, on slices.
//!
//! Splits of the work depend on the shape alone, so results are the same for any number of
//! threads.

use std::cell::RefCell;

use pulp::Simd;
use rayon::prelude::*;

use super::conv::forward_offsets;
use super::shape::{ConvShape, PlaneLayout};
use super::simd::{self, MAX_TILE, TILE_VECTORS};

/// Independent parts of the work: the most threads it can use.
const TASKS: usize = 4;
/// Positions of a band of output rows, about: keeps its rows in the second-level cache.
const BAND_POSITIONS: usize = 768;
/// Positions of one pass over a band: keeps a tile's values in the first-level cache.
const PASS_POSITIONS: usize = 128;
/// Positions of one pass of dot products.
const DOT_POSITIONS: usize = 1024;

thread_local! {
    static PLANES: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
    static GRADS: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
}

/// Gradient of the weights, `[channels_out, channels_in, kernel_h, kernel_w]`.
pub fn backward_weight(shape: &ConvShape, input: &[f32], grad: &[f32]) -> Vec<f32> {
    if shape.is_pointwise() {
        pointwise(shape, input, grad)
    } else {
        channels_last(shape, input, grad)
    }
}

/// The gradient of any convolution as a product whose depth is the positions.
///
/// The output's gradient takes the place of the weights, and the input is laid out with its
/// channels innermost, so that a row of the kernel reads a contiguous run at every position,
/// whatever the stride.
fn channels_last(shape: &ConvShape, input: &[f32], grad: &[f32]) -> Vec<f32> {
    // Work is split over images first, then over output channels.
    let groups = TASKS.min(shape.batch);
    let per_group = shape.batch.div_ceil(groups);
    let tile = simd::tile_channels();
    let per_split = shape
        .channels_out
        .div_ceil(TASKS / groups)
        .next_multiple_of(tile);
    let splits = shape.channels_out.div_ceil(per_split);
    let partial: Vec<Vec<f32>> = (0..groups * splits)
        .into_par_iter()
        .map(|task| {
            let (group, first) = (task / splits, task % splits * per_split);
            let channels = first..(first + per_split).min(shape.channels_out);
            let mut sums = vec![0.0; channels.len() * shape.fan_in()];
            for image in group * per_group..((group + 1) * per_group).min(shape.batch) {
                let input = &input[image * shape.input_len()..][..shape.input_len()];
                let grad = &grad[image * shape.output_len()..][..shape.output_len()];
                add_weight_gradient(shape, input, grad, channels.clone(), &mut sums);
            }
            sums
        })
        .collect();
    // From [channel_out, ky, kx, channel_in] to the weights' own order.
    let [kernel_h, kernel_w] = shape.kernel;
    let taps = kernel_h * kernel_w;
    let mut total = vec![0.0; shape.channels_out * shape.fan_in()];
    for group in partial.chunks(splits) {
        let rows = group
            .iter()
            .flat_map(|sums| sums.chunks_exact(shape.fan_in()));
        for (total, sums) in total.chunks_exact_mut(shape.fan_in()).zip(rows) {
            for (tap, sums) in sums.chunks_exact(shape.channels_in).enumerate() {
                for (channel, sum) in sums.iter().enumerate() {
                    total[channel * taps + tap] += sum;
                }
            }
        }
    }
    total
}

/// Adds one image's weight gradient for some output channels to `sums`, in the order
/// `[channel_out, ky, kx, channel_in]`: band after band of output rows, each small enough for the
/// second-level cache.
fn add_weight_gradient(
    shape: &ConvShape,
    input: &[f32],
    grad: &[f32],
    channels: std::ops::Range<usize>,
    sums: &mut [f32],
) {
    let ConvShape {
        channels_in,
        stride,
        padding,
        height_in,
        width_in,
        ..
    } = *shape;
    let (height_out, width_out) = (shape.height_out(), shape.width_out());
    let pitch = width_in + 2 * padding;
    let tile = simd::tile_channels();
    let band = BAND_POSITIONS.div_ceil(width_out).min(height_out);
    let offsets: Vec<usize> = (0..band * width_out)
        .map(|p| (p / width_out * stride * pitch + p % width_out * stride) * channels_in)
        .collect();
    PLANES.with_borrow_mut(|planes| {
        GRADS.with_borrow_mut(|grads| {
            for first in (0..height_out).step_by(band) {
                let rows_out = band.min(height_out - first);
                let positions = rows_out * width_out;
                // Padded input rows that these output rows see.
                let top = first * stride;
                let rows = (rows_out - 1) * stride + shape.kernel[0];
                planes.clear();
                planes.resize(rows * pitch * channels_in + MAX_TILE, 0.0);
                for y in top.max(padding)..(top + rows).min(height_in + padding) {
                    let start = ((y - top) * pitch + padding) * channels_in;
                    let target = &mut planes[start..start + width_in * channels_in];
                    for channel in 0..channels_in {
                        let row =
                            &input[(channel * height_in + y - padding) * width_in..][..width_in];
                        let pixels = target[channel..].iter_mut().step_by(channels_in);
                        for (value, pixel) in pixels.zip(row) {
                            *value = *pixel;
                        }
                    }
                }
                grads.clear();
                grads.resize(channels.len().div_ceil(tile) * tile * positions, 0.0);
                for (index, channel) in channels.clone().enumerate() {
                    let start = index / tile * tile * positions + index % tile;
                    let plane = &grad[(channel * height_out + first) * width_out..][..positions];
                    for (value, pixel) in grads[start..].iter_mut().step_by(tile).zip(plane) {
                        *value = *pixel;
                    }
                }
                pulp::Arch::new().dispatch(BandGradient {
                    grads,
                    planes,
                    offsets: &offsets[..positions],
                    row: pitch * channels_in,
                    kernel_rows: shape.kernel[0],
                    width: shape.kernel[1] * channels_in,
                    sums,
                });
            }
        });
    });
}

/// `sums[m, ky, n] += sum_p grads[m, p] * planes[offsets[p] + ky * row + n]`.
struct BandGradient<'a> {
    grads: &'a [f32],
    planes: &'a [f32],
    offsets: &'a [usize],
    row: usize,
    kernel_rows: usize,
    width: usize,
    sums: &'a mut [f32],
}

impl pulp::WithSimd for BandGradient<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F32_LANES {
            16 => self.run::<S, 8>(simd),
            _ => self.run::<S, 4>(simd),
        }
    }
}

impl BandGradient<'_> {
    #[inline(always)]
    fn run<S: Simd, const ROWS: usize>(self, simd: S) {
        let step = TILE_VECTORS * S::F32_LANES;
        let positions = self.offsets.len();
        let mut tile = [0.0_f32; 8 * MAX_TILE];
        let tile = &mut tile[..ROWS * step];
        for start in (0..positions).step_by(PASS_POSITIONS) {
            let end = (start + PASS_POSITIONS).min(positions);
            let offsets = &self.offsets[start..end];
            for ky in 0..self.kernel_rows {
                for n in (0..self.width).step_by(step) {
                    let columns = step.min(self.width - n);
                    let planes = self.planes[ky * self.row + n..].as_ptr();
                    let rows = self.sums.chunks_mut(ROWS * self.kernel_rows * self.width);
                    for (sums, grads) in rows.zip(self.grads.chunks_exact(ROWS * positions)) {
                        let grads = &grads[start * ROWS..end * ROWS];
                        // SAFETY: position p's run of the kernel's row ends within the padded
                        // image, and `step` more floats past the image are readable.
                        unsafe {
                            simd::product_tile::<S, ROWS>(simd, grads, offsets, planes, tile);
                        }
                        let sums = sums.chunks_exact_mut(self.kernel_rows * self.width);
                        for (sums, tile) in sums.zip(tile.chunks_exact(step)) {
                            let sums = &mut sums[ky * self.width + n..][..columns];
                            for (sum, value) in sums.iter_mut().zip(tile) {
                                *sum += value;
                            }
                        }
                    }
                }
            }
        }
    }
}

/// The gradient of a 1x1 convolution: dot products of the planes as they lie. Small images are laid
/// out several at a time, because long dot products cost less a position.
fn pointwise(shape: &ConvShape, input: &[f32], grad: &[f32]) -> Vec<f32> {
    let single = PlaneLayout::new(shape);
    // Work is split over images as long as each part keeps dot products long, then over channels.
    let long = 4 * DOT_POSITIONS;
    let groups = (shape.batch * single.plane_len() / long).clamp(1, TASKS.min(shape.batch));
    let per_group = shape.batch.div_ceil(groups);
    let per_split = shape
        .channels_out
        .div_ceil(TASKS / groups)
        .next_multiple_of(4);
    let splits = shape.channels_out.div_ceil(per_split);
    let at_once = long.div_ceil(single.plane_len()).clamp(1, per_group);
    let partial: Vec<Vec<f32>> = (0..groups * splits)
        .into_par_iter()
        .map(|task| {
            let (group, first) = (task / splits, task % splits * per_split);
            let channels = first..(first + per_split).min(shape.channels_out);
            let mut sums = vec![0.0; channels.len() * shape.fan_in()];
            let end = ((group + 1) * per_group).min(shape.batch);
            let mut image = group * per_group;
            while image < end {
                let images = at_once.min(end - image);
                let input = &input[image * shape.input_len()..][..images * shape.input_len()];
                let grad = &grad[image * shape.output_len()..][..images * shape.output_len()];
                let layout = PlaneLayout { images, ..single };
                add_dots(shape, &layout, input, grad, channels.clone(), &mut sums);
                image += images;
            }
            sums
        })
        .collect();
    let mut total = vec![0.0; shape.channels_out * shape.fan_in()];
    for group in partial.chunks(splits) {
        total
            .iter_mut()
            .zip(group.iter().flatten())
            .for_each(|(a, b)| *a += b);
    }
    total
}

/// Adds the dot products of a few images to `sums`.
fn add_dots(
    shape: &ConvShape,
    layout: &PlaneLayout,
    input: &[f32],
    grad: &[f32],
    channels: std::ops::Range<usize>,
    sums: &mut [f32],
) {
    let offsets = forward_offsets(shape, layout);
    let (height_out, width_out) = (shape.height_out(), shape.width_out());
    let positions =
        (layout.images - 1) * layout.plane_len() + layout.positions(height_out, width_out);
    let grad_stride = positions.next_multiple_of(16);
    PLANES.with_borrow_mut(|planes| {
        GRADS.with_borrow_mut(|grads| {
            layout.fill(input, shape.channels_in, planes);
            // Rows with the planes' pitch; zeros in between make those positions count for
            // nothing. Three spare rows of zeros let the last block of channels be a full one.
            grads.clear();
            grads.resize((channels.len() + 3) * grad_stride, 0.0);
            for (index, plane) in grad.chunks_exact(height_out * width_out).enumerate() {
                let (image, channel) = (index / shape.channels_out, index % shape.channels_out);
                if !channels.contains(&channel) {
                    continue;
                }
                let channel = channel - channels.start;
                for (y, row) in plane.chunks_exact(width_out).enumerate() {
                    let at = channel * grad_stride + image * layout.plane_len() + y * layout.pitch;
                    grads[at..at + width_out].copy_from_slice(row);
                }
            }
            pulp::Arch::new().dispatch(Dots {
                grads,
                grad_stride,
                channels: channels.len(),
                planes,
                offsets: &offsets,
                positions,
                sums,
            });
        });
    });
}

/// Sums of the weight gradient for some channels of one image, over one pass of positions.
struct Dots<'a> {
    grads: &'a [f32],
    grad_stride: usize,
    channels: usize,
    planes: &'a [f32],
    offsets: &'a [usize],
    positions: usize,
    sums: &'a mut [f32],
}

impl pulp::WithSimd for Dots<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F32_LANES {
            16 => self.run::<S, 4, 6>(simd),
            _ => self.run::<S, 3, 3>(simd),
        }
    }
}

impl Dots<'_> {
    #[inline(always)]
    fn run<S: Simd, const ROWS: usize, const COLUMNS: usize>(self, simd: S) {
        let depth = self.offsets.len();
        let mut start = 0;
        while start < self.positions {
            let len = DOT_POSITIONS
                .min(self.positions - start)
                .next_multiple_of(S::F32_LANES);
            let mut channel = 0;
            while channel < self.channels {
                let rows = ROWS.min(self.channels - channel);
                let mut k = 0;
                while k < depth {
                    let columns = COLUMNS.min(depth - k);
                    let offsets: [usize; COLUMNS] =
                        std::array::from_fn(|i| self.offsets[(k + i).min(depth - 1)] + start);
                    // SAFETY: `grads` has ROWS - 1 spare rows past the last channel, its rows are
                    // padded to whole vectors, and the planes have slack for a vector past the
                    // last tap.
                    let sums = unsafe {
                        simd::dot_tile::<S, ROWS, COLUMNS>(
                            simd,
                            self.grads[channel * self.grad_stride + start..].as_ptr(),
                            self.grad_stride,
                            self.planes.as_ptr(),
                            &offsets,
                            len,
                        )
                    };
                    for (m, sums) in sums.iter().take(rows).enumerate() {
                        let row = (channel + m) * depth + k;
                        for (total, sum) in self.sums[row..row + columns].iter_mut().zip(sums) {
                            *total += sum;
                        }
                    }
                    k += COLUMNS;
                }
                channel += ROWS;
            }
            start += DOT_POSITIONS;
        }
    }
}
