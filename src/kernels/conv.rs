//! Ungrouped convolution on slices: forward and gradient of the input.
//!
//! A tile holds a few neighbouring positions and two vectors of output channels; its sums stay in
//! registers while all taps and input channels pass by. Input values are broadcast straight from
//! the images, so a pointwise convolution rearranges nothing; larger kernels copy a band of
//! input rows with its zeros into the second-level cache first. How work is split never changes the
//! order of a sum: results are the same for any number of threads.

use std::cell::RefCell;
use std::ops::Range;

use pulp::Simd;
use rayon::prelude::*;

use super::depthwise;
use super::layout::Pixels;
use super::packed::{self, Algorithm, Packed, Panel};
use super::shape::ConvShape;
use super::simd::{self, MAX_TILE, Run, TILE_VECTORS};
use super::winograd;

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

/// Some of the input channels of a convolution.
#[derive(Debug, Clone, Copy)]
pub struct Source<'a> {
    /// Where they are.
    pub pixels: Pixels<'a>,
    /// Every pixel stands for 2x2 pixels of the input (nearest-neighbour enlarging).
    pub doubled: bool,
}

impl<'a> From<Pixels<'a>> for Source<'a> {
    fn from(pixels: Pixels<'a>) -> Self {
        Self {
            pixels,
            doubled: false,
        }
    }
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

    pub(super) fn get(self) -> *mut f32 {
        self.0
    }
}

/// Most sources that are read where they lie; more are joined first.
const MAX_SOURCES: usize = 8;
/// Values of a block of positions: leaves room for weights in the second-level cache.
const BLOCK_VALUES: usize = 48 * 1024;
/// Positions of a block: at least a few tiles, at most what keeps the threads evenly busy.
const BLOCK_POSITIONS: Range<usize> = 28..336;
/// Values of a band of input rows.
const BAND_VALUES: usize = 96 * 1024;

thread_local! {
    /// Values that a task rearranges before it computes.
    static SCRATCH: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
}

/// `y = activation(conv(x, w) + b) + residual`, with the sources' channels in sequence as `x`;
/// returns `[batch, height_out, width_out, channels_out]`.
///
/// `weights` are packed by [`packed::pack_weights`] for `algorithm`.
pub fn forward(
    shape: &ConvShape,
    algorithm: Algorithm,
    sources: &[Source],
    weights: &[f32],
    epilogue: &Epilogue,
) -> Vec<f32> {
    let packed = |depth| Packed {
        data: weights,
        channels: shape.channels_out,
        depth,
    };
    if shape.is_pointwise() && algorithm == Algorithm::Direct && sources.len() <= MAX_SOURCES {
        return pointwise(shape, sources, packed(shape.channels_in), epilogue);
    }
    let joined: Vec<f32>;
    let pixels = if let [
        Source {
            pixels,
            doubled: false,
        },
    ] = sources
    {
        *pixels
    } else {
        joined = join(sources, shape.height_in, shape.width_in);
        let dims = [
            shape.batch,
            shape.height_in,
            shape.width_in,
            shape.channels_in,
        ];
        Pixels::dense(&joined, dims)
    };
    match algorithm {
        Algorithm::Depthwise => depthwise::forward(shape, pixels, weights, epilogue),
        Algorithm::Winograd => {
            let depth = winograd::POINTS * shape.channels_in;
            winograd::forward(shape, pixels, packed(depth), epilogue)
        }
        Algorithm::Direct => {
            let windows = Windows::forward(shape);
            let mut output = Vec::with_capacity(shape.batch * shape.output_len());
            windows.run(
                pixels,
                packed(shape.fan_in()),
                epilogue,
                SharedOutput::new(&mut output),
            );
            // SAFETY: the windows' positions are all pixels of the output, which was reserved.
            unsafe { output.set_len(shape.batch * shape.output_len()) };
            output
        }
    }
}

/// The sources' channels side by side: `[batch, height, width, channels]`.
pub fn join(sources: &[Source], height: usize, width: usize) -> Vec<f32> {
    let channels: usize = sources.iter().map(|source| source.pixels.channels).sum();
    let images = sources.first().map_or(0, |source| source.pixels.images);
    let mut output = vec![0.0; images * height * width * channels];
    output
        .par_chunks_exact_mut((width * channels).max(1))
        .enumerate()
        .for_each(|(row, output)| {
            let (image, y) = (row / height, row % height);
            let mut first = 0;
            for source in sources {
                let pixels = &source.pixels;
                let shift = usize::from(source.doubled);
                for (x, target) in output.chunks_exact_mut(channels).enumerate() {
                    target[first..first + pixels.channels].copy_from_slice(pixels.pixel(
                        image,
                        y >> shift,
                        x >> shift,
                    ));
                }
                first += pixels.channels;
            }
        });
    output
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

fn pointwise(
    shape: &ConvShape,
    sources: &[Source],
    weights: Packed,
    epilogue: &Epilogue,
) -> Vec<f32> {
    let area = shape.height_in * shape.width_in;
    let total = shape.batch * shape.output_len();
    let mut output = Vec::with_capacity(total);
    let shared = SharedOutput::new(&mut output);
    let block =
        (BLOCK_VALUES / shape.channels_in).clamp(BLOCK_POSITIONS.start, BLOCK_POSITIONS.end);
    // An even number of blocks keeps two threads busy to the end.
    let blocks = match area.div_ceil(block) {
        1 if area < 2 * BLOCK_POSITIONS.start => 1,
        count => count.next_multiple_of(2),
    };
    (0..shape.batch * blocks).into_par_iter().for_each(|task| {
        let mut scratch = SCRATCH.take();
        simd::dispatch(Pointwise {
            sources,
            weights,
            epilogue,
            image: task / blocks,
            area,
            width: shape.width_in,
            positions: part(area, task % blocks, blocks),
            scratch: &mut scratch,
            output: shared,
        });
        SCRATCH.set(scratch);
    });
    // SAFETY: the tasks' positions cover every image, and each wrote all channels.
    unsafe { output.set_len(total) };
    output
}

/// A block of positions of one image through a 1x1 convolution.
struct Pointwise<'a> {
    sources: &'a [Source<'a>],
    weights: Packed<'a>,
    epilogue: &'a Epilogue<'a>,
    image: usize,
    area: usize,
    width: usize,
    positions: Range<usize>,
    scratch: &'a mut Vec<f32>,
    output: SharedOutput,
}

impl pulp::WithSimd for Pointwise<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let runs = self.runs();
        for panel in self.weights.panels() {
            if panel.vectors == TILE_VECTORS {
                self.panel::<S, TILE_VECTORS>(simd, &panel, &runs);
            } else {
                self.panel::<S, 1>(simd, &panel, &runs);
            }
        }
    }
}

impl Pointwise<'_> {
    /// A run for every source, at the block's first position.
    fn runs(&mut self) -> [Run; MAX_SOURCES] {
        let mut runs = [Run::default(); MAX_SOURCES];
        let len = self.positions.len();
        let doubled = self.sources.iter().filter(|source| source.doubled);
        let values: usize = doubled.map(|source| source.pixels.channels * len).sum();
        self.scratch.resize(values, 0.0);
        let mut free = &mut self.scratch[..];
        for (run, source) in runs.iter_mut().zip(self.sources) {
            let pixels = &source.pixels;
            let channels = pixels.channels;
            if source.doubled {
                let (taken, rest) = free.split_at_mut(len * channels);
                free = rest;
                for (target, position) in
                    taken.chunks_exact_mut(channels).zip(self.positions.clone())
                {
                    let (y, x) = (position / self.width, position % self.width);
                    target.copy_from_slice(pixels.pixel(self.image, y / 2, x / 2));
                }
                *run = Run::new(taken.as_ptr(), channels, channels);
            } else {
                let start = pixels.offset(self.image, 0, self.positions.start);
                *run = Run::new(pixels.data[start..].as_ptr(), pixels.pixel_stride, channels);
            }
        }
        runs
    }

    #[inline(always)]
    fn panel<S: Simd, const V: usize>(&self, simd: S, panel: &Panel, runs: &[Run; MAX_SOURCES]) {
        let mut tile = [0.0_f32; MAX_TILE];
        let bias = panel_bias::<S, V>(simd, panel, self.epilogue);
        let len = self.positions.len();
        let tiles = len.div_ceil(simd::tile_positions::<S>());
        let channels_out = self.weights.channels;
        for index in 0..tiles {
            let part = part(len, index, tiles);
            let mut runs = *runs;
            for run in &mut runs[..self.sources.len()] {
                *run = run.skip(part.start);
            }
            let position = self.positions.start + part.start;
            let first = (self.image * self.area + position) * channels_out + panel.first;
            let residual = self.epilogue.residual.map(|pixels| {
                let start = pixels.offset(self.image, 0, position) + panel.first;
                (pixels.data[start..].as_ptr(), pixels.pixel_stride)
            });
            // SAFETY: the runs lie inside their images (or the scratch) for all positions of the
            // block, the panel has a row for each of their values, and the output's pixels of
            // this block belong to this task.
            unsafe {
                let place = Place {
                    output: self.output.get().add(first),
                    output_stride: channels_out,
                    residual,
                };
                let runs = &runs[..self.sources.len()];
                let weights = panel.weights.as_ptr();
                let step = V * S::F32_LANES;
                simd::product::<S, V>(simd, part.len(), runs, 1, weights, step, &mut tile);
                let activation = self.epilogue.activation;
                store(
                    simd,
                    &tile,
                    part.len(),
                    panel.channels,
                    &bias,
                    activation,
                    place,
                );
            }
        }
    }
}

/// A convolution as windows that slide over an image: position (row, column) sees the `kernel`
/// pixels from `corner + stride * (row, column)` on and becomes pixel `origin + step * (row,
/// column)` of the output.
#[derive(Debug, Clone, Copy)]
pub(super) struct Windows {
    pub(super) kernel: [usize; 2],
    pub(super) stride: usize,
    /// First input pixel of the first position; may lie outside.
    pub(super) corner: [isize; 2],
    /// Rows and columns of positions.
    pub(super) positions: [usize; 2],
    pub(super) origin: [usize; 2],
    pub(super) step: usize,
    /// Size of the output.
    pub(super) output: [usize; 2],
}

impl Windows {
    pub(super) fn forward(shape: &ConvShape) -> Self {
        let output = [shape.height_out(), shape.width_out()];
        Self {
            kernel: shape.kernel,
            stride: shape.stride,
            corner: [-(shape.padding as isize); 2],
            positions: output,
            origin: [0, 0],
            step: 1,
            output,
        }
    }

    /// No position sees anything outside of the image.
    fn inside(&self, pixels: &Pixels) -> bool {
        let size = [pixels.height, pixels.width];
        (0..2).all(|axis| {
            let reach = (self.positions[axis] - 1) * self.stride + self.kernel[axis];
            self.corner[axis] >= 0 && self.corner[axis].unsigned_abs() + reach <= size[axis]
        })
    }

    /// Computes all positions of all images.
    pub(super) fn run(
        &self,
        pixels: Pixels,
        weights: Packed,
        epilogue: &Epilogue,
        output: SharedOutput,
    ) {
        let [rows, columns] = self.positions;
        if rows * columns == 0 {
            return;
        }
        let pitch = (columns - 1) * self.stride + self.kernel[1];
        let row_values = pitch * pixels.channels * self.stride;
        // Bands of nearly equal height, an even number of them where possible.
        let bands = match rows.div_ceil((BAND_VALUES / row_values).clamp(1, rows)) {
            1 if rows == 1 => 1,
            count => count.next_multiple_of(2).min(rows),
        };
        let direct = pixels.pixel_stride == pixels.channels && self.inside(&pixels);
        (0..pixels.images * bands).into_par_iter().for_each(|task| {
            let mut scratch = SCRATCH.take();
            let (image, rows) = (task / bands, part(rows, task % bands, bands));
            let top = self.corner[0] + (rows.start * self.stride) as isize;
            let (input, pitch) = if direct {
                let start = pixels.offset(image, top.unsigned_abs(), self.corner[1].unsigned_abs());
                (&pixels.data[start..], pixels.width)
            } else {
                let height = (rows.len() - 1) * self.stride + self.kernel[0];
                scratch.resize(height * pitch * pixels.channels, 0.0);
                let corner = [top, self.corner[1]];
                pixels.copy_window(image, corner, [height, pitch], &mut scratch);
                (&scratch[..], pitch)
            };
            simd::dispatch(Band {
                windows: self,
                input,
                pitch,
                channels: pixels.channels,
                weights,
                epilogue,
                image,
                rows,
                output,
            });
            SCRATCH.set(scratch);
        });
    }
}

/// Most rows of a kernel that is computed as windows.
pub(super) const MAX_KERNEL: usize = 16;

/// A band of rows of positions.
struct Band<'a> {
    windows: &'a Windows,
    /// Input from the first position's first pixel on.
    input: &'a [f32],
    /// Distance of two input rows, pixels.
    pitch: usize,
    channels: usize,
    weights: Packed<'a>,
    epilogue: &'a Epilogue<'a>,
    image: usize,
    rows: Range<usize>,
    output: SharedOutput,
}

impl pulp::WithSimd for Band<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for panel in self.weights.panels() {
            if panel.vectors == TILE_VECTORS {
                self.panel::<S, TILE_VECTORS>(simd, &panel);
            } else {
                self.panel::<S, 1>(simd, &panel);
            }
        }
    }
}

impl Band<'_> {
    #[inline(always)]
    fn panel<S: Simd, const V: usize>(&self, simd: S, panel: &Panel) {
        let Windows {
            kernel: [kernel_h, kernel_w],
            stride,
            positions: [_, columns],
            origin,
            step,
            output: [height, width],
            ..
        } = *self.windows;
        assert!(
            kernel_h <= MAX_KERNEL,
            "kernels have at most {MAX_KERNEL} rows"
        );
        let mut tile = [0.0_f32; MAX_TILE];
        let bias = panel_bias::<S, V>(simd, panel, self.epilogue);
        let tiles = columns.div_ceil(simd::tile_positions::<S>());
        let channels_out = self.weights.channels;
        for row in 0..self.rows.len() {
            let y = origin[0] + step * (self.rows.start + row);
            for index in 0..tiles {
                let part = part(columns, index, tiles);
                let mut runs = [Run::default(); MAX_KERNEL];
                for (ky, run) in runs[..kernel_h].iter_mut().enumerate() {
                    let pixel = (row * stride + ky) * self.pitch + part.start * stride;
                    let input = self.input[pixel * self.channels..].as_ptr();
                    *run = Run::new(input, stride * self.channels, kernel_w * self.channels);
                }
                let x = origin[1] + step * part.start;
                let pixel = (self.image * height + y) * width + x;
                let residual = self.epilogue.residual.map(|pixels| {
                    let start = pixels.offset(self.image, y, x) + panel.first;
                    (pixels.data[start..].as_ptr(), step * pixels.pixel_stride)
                });
                // SAFETY: the windows of these positions lie inside the band, the panel has a row
                // for each of their values, and the output's pixels belong to this task.
                unsafe {
                    let place = Place {
                        output: self.output.get().add(pixel * channels_out + panel.first),
                        output_stride: step * channels_out,
                        residual,
                    };
                    let (runs, weights) = (&runs[..kernel_h], panel.weights.as_ptr());
                    let step = V * S::F32_LANES;
                    simd::product::<S, V>(simd, part.len(), runs, 1, weights, step, &mut tile);
                    let activation = self.epilogue.activation;
                    store(
                        simd,
                        &tile,
                        part.len(),
                        panel.channels,
                        &bias,
                        activation,
                        place,
                    );
                }
            }
        }
    }
}

/// Gradient of the input, `[batch, height_in, width_in, channels_in]`; `grad` has the output's
/// size and `weight` its own order.
pub fn backward_input(shape: &ConvShape, grad: Pixels, weight: &[f32]) -> Vec<f32> {
    let ConvShape {
        channels_in,
        channels_out,
        kernel: [kernel_h, kernel_w],
        stride,
        padding,
        ..
    } = *shape;
    let taps = kernel_h * kernel_w;
    let at =
        |channel: usize, c: usize, tap: usize| weight[(c * channels_in + channel) * taps + tap];
    // With stride 1 it is a convolution itself, with the mirrored kernel.
    if stride == 1 && kernel_h == kernel_w && padding < kernel_h {
        let mirrored = ConvShape {
            channels_in: channels_out,
            channels_out: channels_in,
            height_in: shape.height_out(),
            width_in: shape.width_out(),
            padding: kernel_h - 1 - padding,
            ..*shape
        };
        let algorithm = Algorithm::of(&mirrored);
        let packed = if algorithm == Algorithm::Winograd {
            winograd::pack(channels_in, channels_out, |channel, c, tap| {
                at(channel, c, taps - 1 - tap)
            })
        } else {
            packed::pack(channels_in, taps * channels_out, |channel, k| {
                at(channel, k % channels_out, taps - 1 - k / channels_out)
            })
        };
        return forward(
            &mirrored,
            algorithm,
            &[grad.into()],
            &packed,
            &Epilogue::default(),
        );
    }
    // Otherwise one convolution for every phase of the stride: the pixels of a phase see the same
    // taps. Pixels of a phase without taps, and beyond the last window, stay zero.
    let mut output = vec![0.0; shape.batch * shape.input_len()];
    let shared = SharedOutput::new(&mut output);
    for phase in 0..stride * stride {
        let phases = [phase / stride, phase % stride];
        let size = [shape.height_in, shape.width_in];
        let phase_axis = |axis: usize| {
            let r = phases[axis];
            let taps = shape.kernel[axis].saturating_sub(r).div_ceil(stride);
            // Pixel `stride * m + r - padding` sees outputs `m - (taps - 1) ..= m`.
            let first = padding.saturating_sub(r).div_ceil(stride);
            let origin = first * stride + r - padding;
            let count = size[axis].saturating_sub(origin).div_ceil(stride);
            (taps, first, origin, count)
        };
        let [vertical, horizontal] = [phase_axis(0), phase_axis(1)];
        let (rows, columns) = (vertical.0, horizontal.0);
        if rows * columns == 0 || vertical.3 * horizontal.3 == 0 {
            continue;
        }
        let windows = Windows {
            kernel: [rows, columns],
            stride: 1,
            corner: [vertical, horizontal].map(|axis| axis.1 as isize - (axis.0 as isize - 1)),
            positions: [vertical.3, horizontal.3],
            origin: [vertical.2, horizontal.2],
            step: stride,
            output: size,
        };
        let packed = packed::pack(channels_in, rows * columns * channels_out, |channel, k| {
            let (tap, c) = (k / channels_out, k % channels_out);
            let ky = phases[0] + stride * (rows - 1 - tap / columns);
            let kx = phases[1] + stride * (columns - 1 - tap % columns);
            at(channel, c, ky * kernel_w + kx)
        });
        let weights = Packed {
            data: &packed,
            channels: channels_in,
            depth: rows * columns * channels_out,
        };
        windows.run(grad, weights, &Epilogue::default(), shared);
    }
    output
}
