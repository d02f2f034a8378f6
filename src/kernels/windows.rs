//! Convolution as windows that slide over an image, with any kernel and stride.

use std::cell::RefCell;
use std::ops::Range;

use pulp::Simd;
use rayon::prelude::*;

use super::epilogue::{Epilogue, Place, SharedOutput, panel_bias, part, store};
use super::layout::Pixels;
use super::packed::{Packed, Panel};
use super::shape::ConvShape;
use super::simd::{self, MAX_TILE, Run, TILE_VECTORS};

/// Values of a band of input rows.
const BAND_VALUES: usize = 96 * 1024;

thread_local! {
    /// Input rows with the zeros around them.
    static SCRATCH: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
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
        (0..pixels.images * bands).into_par_iter().for_each(|task| {
            let (image, rows) = (task / bands, part(rows, task % bands, bands));
            self.run_rows(pixels, weights, epilogue, image, rows, output);
        });
    }

    /// Computes some rows of positions of one image.
    pub(super) fn run_rows(
        &self,
        pixels: Pixels,
        weights: Packed,
        epilogue: &Epilogue,
        image: usize,
        rows: Range<usize>,
        output: SharedOutput,
    ) {
        let top = self.corner[0] + (rows.start * self.stride) as isize;
        let mut scratch = SCRATCH.take();
        let direct = pixels.pixel_stride == pixels.channels && self.inside(&pixels);
        let (input, pitch) = if direct {
            let start = pixels.offset(image, top.unsigned_abs(), self.corner[1].unsigned_abs());
            (&pixels.data[start..], pixels.width)
        } else {
            let pitch = (self.positions[1] - 1) * self.stride + self.kernel[1];
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
