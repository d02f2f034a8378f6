//! 3x3 convolution with stride 1 by Winograd's minimal filtering, F(4x4, 3x3).
//!
//! A tile of 6x6 inputs and the kernel are taken to 36 points each, where the convolution is a plain
//! product; summing over input channels at each point is a matrix product, and back come 4x4
//! outputs: 36 multiplications instead of 144 (Lavin and Gray, "Fast Algorithms for Convolutional
//! Neural Networks", 2016). The points are 0, 1, -1, 2, -2 and infinity. In 32-bit floats the result
//! differs from the direct sum by about 1e-6 of the largest output.

use std::cell::RefCell;
use std::ops::Range;

use pulp::Simd;
use rayon::prelude::*;

use super::epilogue::{Epilogue, Place, SharedOutput, panel_bias, part, store};
use super::layout::Pixels;
use super::packed::{Packed, Panel, pack as pack_panels};
use super::shape::ConvShape;
use super::simd::{self, MAX_LANES, Run, TILE_VECTORS};

/// Points at which inputs and kernels are multiplied.
pub const POINTS: usize = 36;
/// Side of a tile of inputs.
pub(super) const SIDE: usize = 6;
/// Side of a tile of outputs.
pub(super) const STEP: usize = 4;
/// Tiles of one task: enough that the weights, which every task reads as a whole, do not
/// dominate.
const TASK_TILES: usize = 28;

/// One row of the kernel's transform: `G` of Lavin and Gray.
pub(super) const KERNEL: [[f64; 3]; SIDE] = [
    [0.25, 0.0, 0.0],
    [-1.0 / 6.0, -1.0 / 6.0, -1.0 / 6.0],
    [-1.0 / 6.0, 1.0 / 6.0, -1.0 / 6.0],
    [1.0 / 24.0, 1.0 / 12.0, 1.0 / 6.0],
    [1.0 / 24.0, -1.0 / 12.0, 1.0 / 6.0],
    [0.0, 0.0, 1.0],
];

thread_local! {
    /// Transformed inputs, and products before the way back.
    static SCRATCH: RefCell<(Vec<f32>, Vec<f32>)> = const { RefCell::new((Vec::new(), Vec::new())) };
}

/// Transforms and packs the kernels `weight(channel_out, channel_in, tap)`.
pub fn pack(
    channels_out: usize,
    channels_in: usize,
    weight: impl Fn(usize, usize, usize) -> f32 + Sync,
) -> Vec<f32> {
    // [channel_out, channel_in, point]
    let mut points = vec![0.0_f32; channels_out * channels_in * POINTS];
    points
        .par_chunks_exact_mut(POINTS)
        .with_min_len(256)
        .enumerate()
        .for_each(|(index, points)| {
            let (channel, c) = (index / channels_in, index % channels_in);
            let mut half = [[0.0_f64; 3]; SIDE];
            for (row, factors) in half.iter_mut().zip(&KERNEL) {
                for (kx, value) in row.iter_mut().enumerate() {
                    for (ky, factor) in factors.iter().enumerate() {
                        *value += factor * f64::from(weight(channel, c, 3 * ky + kx));
                    }
                }
            }
            for (point, value) in points.iter_mut().enumerate() {
                let (row, factors) = (&half[point / SIDE], &KERNEL[point % SIDE]);
                let sum: f64 = row.iter().zip(factors).map(|(a, b)| a * b).sum();
                *value = sum as f32;
            }
        });
    pack_panels(channels_out, POINTS * channels_in, |channel, k| {
        points[(channel * channels_in + k % channels_in) * POINTS + k / channels_in]
    })
}

/// Forward pass; see [`super::conv::forward`].
pub(super) fn forward(
    shape: &ConvShape,
    input: Pixels,
    weights: Packed,
    epilogue: &Epilogue,
) -> Vec<f32> {
    let total = shape.batch * shape.output_len();
    let mut output = Vec::with_capacity(total);
    let shared = SharedOutput::new(&mut output);
    let tiles = Tiles::new(shape);
    let tasks = tiles.tasks(TASK_TILES);
    (0..shape.batch * tasks).into_par_iter().for_each(|task| {
        let range = part(tiles.count(), task % tasks, tasks);
        run_tiles(shape, input, weights, epilogue, task / tasks, range, shared);
    });
    // SAFETY: the tiles cover every image, and all channels of their pixels were written.
    unsafe { output.set_len(total) };
    output
}

/// Computes one image on this thread.
pub(super) fn run_image(
    shape: &ConvShape,
    input: Pixels,
    weights: Packed,
    epilogue: &Epilogue,
    output: SharedOutput,
) {
    let tiles = Tiles::new(shape);
    let parts = tiles.count().div_ceil(TASK_TILES);
    for index in 0..parts {
        let range = part(tiles.count(), index, parts);
        run_tiles(shape, input, weights, epilogue, 0, range, output);
    }
}

/// Computes some tiles of one image.
fn run_tiles(
    shape: &ConvShape,
    input: Pixels,
    weights: Packed,
    epilogue: &Epilogue,
    image: usize,
    range: Range<usize>,
    output: SharedOutput,
) {
    let (mut points, mut products) = SCRATCH.take();
    simd::dispatch(Forward {
        shape,
        tiles: Tiles::new(shape),
        input,
        weights,
        epilogue,
        image,
        range,
        points: &mut points,
        products: &mut products,
        output,
    });
    SCRATCH.set((points, products));
}

/// How an output is cut into tiles.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tiles {
    /// Tiles along each axis.
    pub(super) grid: [usize; 2],
    padding: usize,
}

impl Tiles {
    pub(super) fn new(shape: &ConvShape) -> Self {
        Self {
            grid: [shape.height_out(), shape.width_out()].map(|side| side.div_ceil(STEP)),
            padding: shape.padding,
        }
    }

    pub(super) fn count(&self) -> usize {
        self.grid[0] * self.grid[1]
    }

    /// Tasks of about so many tiles: an even number, so that two threads end together.
    pub(super) fn tasks(&self, tiles: usize) -> usize {
        match self.count().div_ceil(tiles) {
            1 if self.count() < 4 => 1,
            count => count.next_multiple_of(2),
        }
    }

    /// First output pixel of a tile.
    pub(super) fn corner(&self, tile: usize) -> [usize; 2] {
        [tile / self.grid[1] * STEP, tile % self.grid[1] * STEP]
    }

    /// First input pixel of a tile; may lie outside.
    pub(super) fn input_corner(&self, tile: usize) -> [isize; 2] {
        self.corner(tile)
            .map(|side| side as isize - self.padding as isize)
    }
}

/// Takes `N` neighbouring values of a tile to the points, along one axis.
pub(super) trait ToPoints<const N: usize> {
    /// The transform of vectors.
    fn points<S: Simd>(simd: S, values: [S::f32s; N]) -> [S::f32s; SIDE];
}

/// `B^T d`: six inputs to six points.
pub(super) struct InputPoints;

impl ToPoints<SIDE> for InputPoints {
    #[inline(always)]
    fn points<S: Simd>(simd: S, d: [S::f32s; SIDE]) -> [S::f32s; SIDE] {
        let two = simd.splat_f32s(2.0);
        let four = simd.splat_f32s(4.0);
        let minus_four = simd.splat_f32s(-4.0);
        let minus_five = simd.splat_f32s(-5.0);
        let a = simd.mul_add_f32s(minus_four, d[2], d[4]);
        let b = simd.mul_add_f32s(minus_four, d[1], d[3]);
        let e = simd.sub_f32s(d[4], d[2]);
        let f = simd.mul_f32s(two, simd.sub_f32s(d[3], d[1]));
        [
            simd.mul_add_f32s(four, d[0], simd.mul_add_f32s(minus_five, d[2], d[4])),
            simd.add_f32s(a, b),
            simd.sub_f32s(a, b),
            simd.add_f32s(e, f),
            simd.sub_f32s(e, f),
            simd.mul_add_f32s(four, d[1], simd.mul_add_f32s(minus_five, d[3], d[5])),
        ]
    }
}

/// `A^T m`: six points to four outputs.
#[inline(always)]
fn outputs<S: Simd>(simd: S, m: [S::f32s; SIDE]) -> [S::f32s; STEP] {
    let four = simd.splat_f32s(4.0);
    let p = simd.add_f32s(m[1], m[2]);
    let q = simd.sub_f32s(m[1], m[2]);
    let r = simd.add_f32s(m[3], m[4]);
    let s = simd.sub_f32s(m[3], m[4]);
    let s = simd.add_f32s(s, s);
    [
        simd.add_f32s(simd.add_f32s(m[0], p), r),
        simd.add_f32s(q, s),
        simd.mul_add_f32s(four, r, p),
        simd.add_f32s(simd.mul_add_f32s(four, s, q), m[5]),
    ]
}

/// Takes tiles of an image to their points, `points[point][tile][channel]`; channels are padded to
/// whole vectors. A tile has `N x N` pixels from its corner on; those outside
/// of the image are zero.
#[inline(always)]
pub(super) fn transform<S: Simd, const N: usize, T: ToPoints<N>>(
    simd: S,
    input: &Pixels,
    image: usize,
    corners: impl ExactSizeIterator<Item = [isize; 2]>,
    points: &mut [f32],
) {
    let lanes = S::F32_LANES;
    let zero = simd.splat_f32s(0.0);
    let count = corners.len();
    let width = input.channels.next_multiple_of(lanes);
    assert!(points.len() >= POINTS * count * width);
    let size = [input.height as isize, input.width as isize];
    for (index, [top, left]) in corners.enumerate() {
        for first in (0..input.channels).step_by(lanes) {
            let channels = lanes.min(input.channels - first);
            let mut half = [[zero; N]; SIDE];
            for column in 0..N {
                let x = left + column as isize;
                let mut values = [zero; N];
                if x >= 0 && x < size[1] {
                    for (row, value) in values.iter_mut().enumerate() {
                        let y = top + row as isize;
                        if y >= 0 && y < size[0] {
                            let start =
                                input.offset(image, y.unsigned_abs(), x.unsigned_abs()) + first;
                            *value = simd::load(simd, &input.data[start..start + channels]);
                        }
                    }
                }
                let values = T::points(simd, values);
                for row in 0..SIDE {
                    half[row][column] = values[row];
                }
            }
            for (row, half) in half.iter().enumerate() {
                let values = T::points(simd, *half);
                for (column, &value) in values.iter().enumerate() {
                    let start = ((row * SIDE + column) * count + index) * width + first;
                    // SAFETY: `points` holds `width` values for every point and tile (checked
                    // above), and `first + lanes <= width`.
                    unsafe {
                        points
                            .as_mut_ptr()
                            .add(start)
                            .cast::<S::f32s>()
                            .write_unaligned(value);
                    }
                }
            }
        }
    }
}

/// Some tiles of one image.
struct Forward<'a> {
    shape: &'a ConvShape,
    tiles: Tiles,
    input: Pixels<'a>,
    weights: Packed<'a>,
    epilogue: &'a Epilogue<'a>,
    image: usize,
    range: Range<usize>,
    points: &'a mut Vec<f32>,
    products: &'a mut Vec<f32>,
    output: SharedOutput,
}

impl pulp::WithSimd for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let count = self.range.len();
        let width = self.input.channels.next_multiple_of(S::F32_LANES);
        grow(self.points, POINTS * count * width);
        grow(self.products, POINTS * count * TILE_VECTORS * MAX_LANES);
        let points = &mut self.points[..];
        let tiles = self.tiles;
        let corners = self.range.clone().map(|tile| tiles.input_corner(tile));
        transform::<S, SIDE, InputPoints>(simd, &self.input, self.image, corners, points);
        let work = Panels {
            shape: self.shape,
            tiles: self.tiles,
            epilogue: self.epilogue,
            image: self.image,
            range: self.range,
            points,
            width,
            output: self.output,
        };
        for panel in self.weights.panels() {
            if panel.vectors == TILE_VECTORS {
                work.panel::<S, TILE_VECTORS>(simd, &panel, self.products);
            } else {
                work.panel::<S, 1>(simd, &panel, self.products);
            }
        }
    }
}

/// Makes room without clearing what is there already.
pub(super) fn grow(values: &mut Vec<f32>, len: usize) {
    if values.len() < len {
        values.resize(len, 0.0);
    }
}

/// Transformed tiles on their way to outputs.
struct Panels<'a> {
    shape: &'a ConvShape,
    tiles: Tiles,
    epilogue: &'a Epilogue<'a>,
    image: usize,
    range: Range<usize>,
    points: &'a [f32],
    /// Values of a tile at one point.
    width: usize,
    output: SharedOutput,
}

impl Panels<'_> {
    #[inline(always)]
    fn panel<S: Simd, const V: usize>(&self, simd: S, panel: &Panel, products: &mut [f32]) {
        let lanes = S::F32_LANES;
        let count = self.range.len();
        let channels_in = self.shape.channels_in;
        let parts = count.div_ceil(simd::tile_positions::<S>());
        assert!(products.len() >= POINTS * count * V * lanes);
        for (point, weights) in panel
            .weights
            .chunks_exact(channels_in * V * lanes)
            .enumerate()
        {
            for index in 0..parts {
                let part = part(count, index, parts);
                let start = point * count + part.start;
                let input = self.points[start * self.width..].as_ptr();
                let runs = [Run::new(input, self.width, channels_in)];
                let products = &mut products[start * V * lanes..][..part.len() * V * lanes];
                // SAFETY: `points` holds `width >= channels_in` values for every tile, and the
                // weights a row for each of them.
                unsafe {
                    let (weights, step) = (weights.as_ptr(), V * lanes);
                    simd::product::<S, V>(simd, part.len(), &runs, 1, weights, step, products);
                }
            }
        }
        let bias = panel_bias::<S, V>(simd, panel, self.epilogue);
        for (index, tile) in self.range.clone().enumerate() {
            for v in 0..V {
                self.finish(simd, panel, products, [count, index, V, v], tile, bias[v]);
            }
        }
    }

    /// Takes one vector of channels of a tile from points to outputs.
    #[inline(always)]
    fn finish<S: Simd>(
        &self,
        simd: S,
        panel: &Panel,
        products: &[f32],
        [count, index, vectors, v]: [usize; 4],
        tile: usize,
        bias: S::f32s,
    ) {
        let lanes = S::F32_LANES;
        let zero = simd.splat_f32s(0.0);
        let mut half = [[zero; SIDE]; STEP];
        for column in 0..SIDE {
            let mut values = [zero; SIDE];
            for (row, value) in values.iter_mut().enumerate() {
                let point = row * SIDE + column;
                let start = ((point * count + index) * vectors + v) * lanes;
                // SAFETY: `products` holds all vectors of all tiles at all points (checked by
                // the caller).
                *value = unsafe {
                    products
                        .as_ptr()
                        .add(start)
                        .cast::<S::f32s>()
                        .read_unaligned()
                };
            }
            let values = outputs(simd, values);
            for row in 0..STEP {
                half[row][column] = values[row];
            }
        }
        let (height, width) = (self.shape.height_out(), self.shape.width_out());
        let [top, left] = self.tiles.corner(tile);
        let first = panel.first + v * lanes;
        let channels = lanes.min(panel.channels - v * lanes);
        let columns = STEP.min(width - left);
        for (row, half) in half.iter().enumerate().take(height - top) {
            let values = outputs(simd, *half);
            let pixel = (self.image * height + top + row) * width + left;
            let residual = self.epilogue.residual.map(|pixels| {
                let start = pixels.offset(self.image, top + row, left) + first;
                (pixels.data[start..].as_ptr(), pixels.pixel_stride)
            });
            // SAFETY: the pixels lie inside the output, and the tile belongs to this task.
            unsafe {
                let place = Place {
                    output: self
                        .output
                        .get()
                        .add(pixel * self.shape.channels_out + first),
                    output_stride: self.shape.channels_out,
                    residual,
                };
                let values: &[f32] = bytemuck::cast_slice(&values);
                let activation = self.epilogue.activation;
                store(simd, values, columns, channels, &[bias], activation, place);
            }
        }
    }
}
