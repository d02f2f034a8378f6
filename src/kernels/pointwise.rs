//! 1x1 convolution, of several inputs at once: their pixels are read where they lie.

use std::cell::RefCell;
use std::ops::Range;

use pulp::Simd;
use rayon::prelude::*;

use super::epilogue::{Epilogue, Place, SharedOutput, panel_bias, part, store};
use super::layout::Pixels;
use super::packed::{Packed, Panel};
use super::shape::ConvShape;
use super::simd::{self, MAX_TILE, Run, TILE_VECTORS};

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

/// Most sources that are read where they lie; more are joined first.
pub(super) const MAX_SOURCES: usize = 8;
/// Values of a block of positions: leaves room for weights in the second-level cache.
const BLOCK_VALUES: usize = 48 * 1024;
/// Positions of a block: at least a few tiles, at most what keeps the threads evenly busy.
const BLOCK_POSITIONS: Range<usize> = 28..336;
thread_local! {
    /// Doubled pixels of a block.
    static SCRATCH: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
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

/// `activation(sources w + b) + residual`, `[batch, height, width, channels_out]`; see
/// [`super::conv::forward`].
pub(super) fn forward(
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
