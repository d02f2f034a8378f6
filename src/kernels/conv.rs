//! Ungrouped convolution on slices: forward and gradient of the input.
//!
//! Both are matrix products whose right-hand side is never stored: row k of it is a run of
//! the padded input planes that starts at an offset (see [`PlaneLayout`]). All parallel splits
//! depend on the shape alone, so results are the same for any number of threads.

use std::cell::RefCell;

use pulp::Simd;
use rayon::prelude::*;

use super::shape::{ConvShape, OutputMap, PlaneLayout, Segment};
use super::simd::{self, MAX_TILE, TILE_VECTORS};

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

/// Positions handled by one parallel task of a product.
const TASK_POSITIONS: usize = 1536;
/// Weights rearranged for [`simd::product_tile`]: blocks of tile rows, each k-major.
#[derive(Debug, Clone)]
pub struct PackedWeights {
    data: Vec<f32>,
    rows: usize,
    depth: usize,
}

impl PackedWeights {
    /// Packs `rows x depth` weights given by `weight(row, k)`.
    pub fn new(rows: usize, depth: usize, weight: impl Fn(usize, usize) -> f32) -> Self {
        let tile = simd::tile_channels();
        let mut data = vec![0.0; rows.div_ceil(tile) * tile * depth];
        for (block, chunk) in data.chunks_exact_mut(tile * depth).enumerate() {
            let used = tile.min(rows - block * tile);
            for (k, column) in chunk.chunks_exact_mut(tile).enumerate() {
                for (m, value) in column[..used].iter_mut().enumerate() {
                    *value = weight(block * tile + m, k);
                }
            }
        }
        Self { data, rows, depth }
    }
}

/// A raw pointer that parallel tasks share; each task writes places of its own.
#[derive(Clone, Copy)]
struct SharedOutput(*mut f32);
// SAFETY: every task derives from its index which elements it writes, and no two indices share one.
unsafe impl Send for SharedOutput {}
// SAFETY: as above.
unsafe impl Sync for SharedOutput {}

impl SharedOutput {
    fn get(self) -> *mut f32 {
        self.0
    }
}

/// `out[m, map(p)] = activation(bias[m] + sum_k weights[m, k] * planes[offsets[k] + p])` for a
/// range of positions.
struct Product<'a> {
    weights: &'a PackedWeights,
    offsets: &'a [usize],
    planes: &'a [f32],
    bias: Option<&'a [f32]>,
    activation: Activation,
    map: &'a OutputMap,
    positions: std::ops::Range<usize>,
    out: SharedOutput,
}

impl pulp::WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F32_LANES {
            16 => self.run::<S, 8>(simd),
            _ => self.run::<S, 4>(simd),
        }
    }
}

impl Product<'_> {
    #[inline(always)]
    fn run<S: Simd, const ROWS: usize>(self, simd: S) {
        let width = TILE_VECTORS * S::F32_LANES;
        let area = self.map.image[0] * self.map.image[1];
        let reach = self
            .offsets
            .iter()
            .max()
            .map_or(0, |&offset| offset + width);
        let mut tile = [0.0_f32; 8 * MAX_TILE];
        let tile = &mut tile[..ROWS * width];
        let mut edge = Vec::new();
        let mut segments = [Segment::default(); MAX_TILE];
        let mut start = self.positions.start;
        while start < self.positions.end {
            let len = width.min(self.positions.end - start);
            let count = self.map.segments(start, len, &mut segments);
            // The last tile of an unpadded input would read past its end: copy what is there.
            let inside = start + reach <= self.planes.len();
            let edge_offsets: Vec<usize>;
            let (planes, offsets) = if inside {
                (self.planes[start..].as_ptr(), self.offsets)
            } else {
                edge.clear();
                edge.resize(self.offsets.len() * width, 0.0);
                for (row, &offset) in edge.chunks_exact_mut(width).zip(self.offsets) {
                    let available = width.min(self.planes.len().saturating_sub(offset + start));
                    row[..available]
                        .copy_from_slice(&self.planes[offset + start..offset + start + available]);
                }
                edge_offsets = (0..self.offsets.len()).map(|k| k * width).collect();
                (edge.as_ptr(), &edge_offsets[..])
            };
            let blocks = self.weights.data.chunks_exact(ROWS * self.weights.depth);
            for (block, weights) in blocks.enumerate() {
                // SAFETY: either `start + offset + width` is inside the planes for every offset,
                // or the rows were copied to `edge`, which holds `width` values for each.
                unsafe { simd::product_tile::<S, ROWS>(simd, weights, offsets, planes, tile) };
                let rows = ROWS.min(self.weights.rows - block * ROWS);
                for (m, values) in tile.chunks_exact_mut(width).take(rows).enumerate() {
                    let channel = block * ROWS + m;
                    finish(
                        values,
                        self.bias.map_or(0.0, |bias| bias[channel]),
                        self.activation,
                    );
                    for segment in &segments[..count] {
                        let source = &values[segment.source..segment.source + segment.len];
                        // SAFETY: the map yields pixels of the plane, tasks own their positions.
                        unsafe {
                            let target = self.out.get().add(channel * area + segment.target);
                            if self.map.step == 1 {
                                target.copy_from_nonoverlapping(source.as_ptr(), source.len());
                            } else {
                                for (i, &value) in source.iter().enumerate() {
                                    target.add(i * self.map.step).write(value);
                                }
                            }
                        }
                    }
                }
            }
            start += len;
        }
    }
}

#[inline(always)]
fn finish(values: &mut [f32], bias: f32, activation: Activation) {
    match activation {
        Activation::None if bias == 0.0 => {}
        Activation::None => values.iter_mut().for_each(|v| *v += bias),
        Activation::Relu => values.iter_mut().for_each(|v| *v = (*v + bias).max(0.0)),
        Activation::Silu => values.iter_mut().for_each(|v| {
            let x = *v + bias;
            *v = x * simd::sigmoid(x);
        }),
    }
}

thread_local! {
    static PLANES: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
}

/// Runs a product for every image: over images where there are several, else over positions.
#[allow(
    clippy::too_many_arguments,
    reason = "the parts of one product, named at every call"
)]
fn products(
    batch: usize,
    input: &[f32],
    channels: usize,
    layout: Option<&PlaneLayout>,
    weights: &PackedWeights,
    offsets: &[usize],
    bias: Option<&[f32]>,
    activation: Activation,
    map: &OutputMap,
    output: &mut [f32],
) {
    let input_len = input.len() / batch;
    let output_len = output.len() / batch;
    let shared = SharedOutput(output.as_mut_ptr());
    let run = |planes: &[f32], image: usize, positions: std::ops::Range<usize>| {
        pulp::Arch::new().dispatch(Product {
            weights,
            offsets,
            planes,
            bias,
            activation,
            map,
            positions,
            // SAFETY: image < batch, so the pointer stays inside `output`.
            out: SharedOutput(unsafe { shared.get().add(image * output_len) }),
        });
    };
    let total = map.positions();
    if batch > 1 {
        (0..batch).into_par_iter().for_each(|image| {
            let image_input = &input[image * input_len..(image + 1) * input_len];
            match layout {
                None => run(image_input, image, 0..total),
                Some(layout) => PLANES.with_borrow_mut(|planes| {
                    layout.fill(image_input, channels, planes);
                    run(planes, image, 0..total);
                }),
            }
        });
        return;
    }
    let tasks = total.div_ceil(TASK_POSITIONS);
    let split = |planes: &[f32]| {
        (0..tasks).into_par_iter().for_each(|task| {
            let start = task * TASK_POSITIONS;
            run(planes, 0, start..(start + TASK_POSITIONS).min(total));
        });
    };
    match layout {
        None => split(input),
        Some(layout) => {
            let area = layout.image[0] * layout.image[1];
            let used = layout.channel_len() * channels;
            let mut planes = PLANES.take();
            planes.resize(layout.buffer_len(channels), 0.0);
            planes[..used]
                .par_chunks_exact_mut(layout.channel_len())
                .zip(input.par_chunks_exact(area))
                .with_min_len(4)
                .for_each(|(target, source)| layout.fill_channel(source, 0, target));
            planes[used..].fill(0.0);
            split(&planes);
            PLANES.set(planes);
        }
    }
}

/// `y = activation(conv(x, w) + b)`.
///
/// `input` is `[batch, channels_in, height, width]`, `weight` is
/// `[channels_out, channels_in, kernel_h, kernel_w]`; returns `[batch, channels_out, ..]`.
pub fn forward(
    shape: &ConvShape,
    input: &[f32],
    weight: &[f32],
    bias: Option<&[f32]>,
    activation: Activation,
) -> Vec<f32> {
    let depth = shape.fan_in();
    let packed = PackedWeights::new(shape.channels_out, depth, |m, k| weight[m * depth + k]);
    let layout = PlaneLayout::new(shape);
    let offsets = forward_offsets(shape, &layout);
    let map = OutputMap {
        pitch: layout.pitch,
        extent: [shape.height_out(), shape.width_out()],
        origin: [0, 0],
        step: 1,
        image: [shape.height_out(), shape.width_out()],
    };
    let mut output = vec![0.0; shape.batch * shape.output_len()];
    products(
        shape.batch,
        input,
        shape.channels_in,
        (!shape.is_pointwise()).then_some(&layout),
        &packed,
        &offsets,
        bias,
        activation,
        &map,
        &mut output,
    );
    output
}

/// Offsets of all taps in the weights' own order (channel, row, column).
pub(super) fn forward_offsets(shape: &ConvShape, layout: &PlaneLayout) -> Vec<usize> {
    let [kernel_h, kernel_w] = shape.kernel;
    let mut offsets = Vec::with_capacity(shape.fan_in());
    for channel in 0..shape.channels_in {
        for ky in 0..kernel_h {
            for kx in 0..kernel_w {
                offsets.push(layout.offset(channel, ky, kx));
            }
        }
    }
    offsets
}

/// Gradient of the input: for every stride phase of the input's pixels a convolution of the
/// output's gradient with the taps that reach that phase.
pub fn backward_input(shape: &ConvShape, grad: &[f32], weight: &[f32]) -> Vec<f32> {
    let [kernel_h, kernel_w] = shape.kernel;
    let s = shape.stride;
    let (height_out, width_out) = (shape.height_out(), shape.width_out());
    let mut output = vec![0.0; shape.batch * shape.input_len()];
    for phase_y in 0..s.min(kernel_h) {
        for phase_x in 0..s.min(kernel_w) {
            let taps = [
                (kernel_h - phase_y).div_ceil(s),
                (kernel_w - phase_x).div_ceil(s),
            ];
            // Padded rows y = phase + s * j: as many as are needed to reach the image's end.
            let extent = [
                (shape.height_in + shape.padding - phase_y).div_ceil(s),
                (shape.width_in + shape.padding - phase_x).div_ceil(s),
            ];
            // Row j takes gradient rows j - t; rows beyond the gradient are zeros. The gradient is
            // seen as the input of a plain convolution whose padding covers the earliest tap.
            let reach = taps[0].max(taps[1]) - 1;
            let layout = PlaneLayout {
                stride: 1,
                padding: reach,
                rows: extent[0] + 2 * reach,
                pitch: extent[1].max(width_out) + reach,
                image: [height_out, width_out],
                images: 1,
            };
            let mut offsets = Vec::new();
            let mut sources = Vec::new();
            for channel in 0..shape.channels_out {
                for ty in 0..taps[0] {
                    for tx in 0..taps[1] {
                        offsets.push(layout.offset(channel, reach - ty, reach - tx));
                        sources.push((channel, phase_y + s * ty, phase_x + s * tx));
                    }
                }
            }
            let packed = PackedWeights::new(shape.channels_in, offsets.len(), |m, k| {
                let (channel, ky, kx) = sources[k];
                weight[((channel * shape.channels_in + m) * kernel_h + ky) * kernel_w + kx]
            });
            let map = OutputMap {
                pitch: layout.pitch,
                extent,
                origin: [phase_y, phase_x].map(|phase| phase as isize - shape.padding as isize),
                step: s,
                image: [shape.height_in, shape.width_in],
            };
            let in_place = reach == 0 && layout.pitch == width_out && layout.rows == height_out;
            products(
                shape.batch,
                grad,
                shape.channels_out,
                (!in_place).then_some(&layout),
                &packed,
                &offsets,
                None,
                Activation::None,
                &map,
                &mut output,
            );
        }
    }
    output
}

/// A sum in sixteen independent lanes, in an order that does not depend on the machine.
#[inline(always)]
pub fn sum(values: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; 16];
    let chunks = values.chunks_exact(16);
    let rest: f32 = chunks.remainder().iter().sum();
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane += value;
        }
    }
    lanes.iter().sum::<f32>() + rest
}
