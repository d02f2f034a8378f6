//! Pooling on slices: the twin pooling of the ranging network (2x2 windows, by maximum for one
//! pathway and by average for the other, then ReLU), maxima of square windows, and doubling.

use pulp::Simd;
use rayon::prelude::*;

use super::layout::Pixels;
use super::simd;

/// Where the two pathways take their input from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TwinInput {
    /// Both pool the same `[batch, ..]`.
    Shared,
    /// The first half of `[2 batch, ..]` is pooled by maximum, the second by average.
    Stacked,
}

/// Pools both pathways, `[2 batch, height / 2, width / 2, channels]`: the maximum pathway's images,
/// then the average pathway's. Incomplete windows are dropped.
pub fn forward(input: Pixels, kind: TwinInput) -> Vec<f32> {
    let (rows, columns) = (input.height / 2, input.width / 2);
    let pathway = pathway_images(&input, kind);
    let row_values = columns * input.channels;
    let mut output = vec![0.0; 2 * pathway * rows * row_values];
    if output.is_empty() {
        return output;
    }
    let half = output.len() / 2;
    let (maxima, means) = output.split_at_mut(half);
    match kind {
        // Both from one look at the input, which is the largest tensor of the network.
        TwinInput::Shared => maxima
            .par_chunks_exact_mut(row_values)
            .zip(means.par_chunks_exact_mut(row_values))
            .with_min_len(4)
            .enumerate()
            .for_each(|(row, (maxima, means))| {
                self::row(&input, row / rows, row % rows, maxima, means);
            }),
        TwinInput::Stacked => maxima
            .par_chunks_exact_mut(row_values)
            .chain(means.par_chunks_exact_mut(row_values))
            .with_min_len(4)
            .enumerate()
            .for_each(|(row, output)| {
                let image = row / rows;
                let (maxima, means): (&mut [f32], &mut [f32]) = if image < pathway {
                    (output, &mut [])
                } else {
                    (&mut [], output)
                };
                self::row(&input, image, row % rows, maxima, means);
            }),
    }
    output
}

/// Images of one pathway.
pub(super) fn pathway_images(input: &Pixels, kind: TwinInput) -> usize {
    match kind {
        TwinInput::Shared => input.images,
        TwinInput::Stacked => input.images / 2,
    }
}

/// Pools row `y` of an image's windows; an output that is empty is not wanted.
pub(super) fn row(input: &Pixels, image: usize, y: usize, maxima: &mut [f32], means: &mut [f32]) {
    simd::dispatch(PoolRow {
        input,
        image,
        y,
        maxima,
        means,
    });
}

/// A row of windows; an empty output is not wanted.
struct PoolRow<'a> {
    input: &'a Pixels<'a>,
    image: usize,
    y: usize,
    maxima: &'a mut [f32],
    means: &'a mut [f32],
}

/// The four pixels of a window.
#[inline(always)]
fn window<'a>(input: &Pixels<'a>, image: usize, y: usize, x: usize) -> [&'a [f32]; 4] {
    let (y, x) = (2 * y, 2 * x);
    [
        input.pixel(image, y, x),
        input.pixel(image, y, x + 1),
        input.pixel(image, y + 1, x),
        input.pixel(image, y + 1, x + 1),
    ]
}

impl pulp::WithSimd for PoolRow<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let zero = simd.splat_f32s(0.0);
        let quarter = simd.splat_f32s(0.25);
        let channels = self.input.channels;
        for x in 0..self.input.width / 2 {
            let window = window(self.input, self.image, self.y, x);
            for first in (0..channels).step_by(S::F32_LANES) {
                let end = channels.min(first + S::F32_LANES);
                let mut values = [zero; 4];
                for (value, pixel) in values.iter_mut().zip(window) {
                    *value = simd::load(simd, &pixel[first..end]);
                }
                let [a, b, c, d] = values;
                let target = x * channels + first..x * channels + end;
                if !self.maxima.is_empty() {
                    let largest = simd.max_f32s(simd.max_f32s(a, b), simd.max_f32s(c, d));
                    let largest = simd.max_f32s(largest, zero);
                    simd::store(simd, &mut self.maxima[target.clone()], largest);
                }
                if !self.means.is_empty() {
                    let sum = simd.add_f32s(simd.add_f32s(a, b), simd.add_f32s(c, d));
                    let mean = simd.max_f32s(simd.mul_f32s(quarter, sum), zero);
                    simd::store(simd, &mut self.means[target], mean);
                }
            }
        }
    }
}

/// Gradient of the input. The maximum's gradient goes to the first largest value of the window;
/// windows whose result the ReLU cut pass nothing on.
pub fn backward(input: Pixels, grad: Pixels, kind: TwinInput) -> Vec<f32> {
    let (rows, channels) = (input.height / 2, input.channels);
    let pathway = pathway_images(&input, kind);
    let row_values = input.width * channels;
    let image_values = input.height * row_values;
    let mut output = vec![0.0; input.images * image_values];
    // Pairs of rows; an odd last row passes nothing on and stays zero.
    output
        .par_chunks_exact_mut(image_values)
        .enumerate()
        .flat_map(|(image, output)| {
            output
                .par_chunks_exact_mut(2 * row_values)
                .with_min_len(4)
                .enumerate()
                .map(move |(y, output)| (image, y, output))
        })
        .for_each(|(image, y, output)| {
            debug_assert!(y < rows);
            let (maximum, average) = match kind {
                TwinInput::Shared => (Some(image), Some(pathway + image)),
                TwinInput::Stacked if image < pathway => (Some(image), None),
                TwinInput::Stacked => (None, Some(image)),
            };
            simd::dispatch(PoolGradRow {
                input: &input,
                grad: &grad,
                image,
                y,
                maximum,
                average,
                output,
            });
        });
    output
}

/// Gradient of two rows of the input.
struct PoolGradRow<'a> {
    input: &'a Pixels<'a>,
    grad: &'a Pixels<'a>,
    image: usize,
    y: usize,
    /// The image of the gradient that is the maximum's, and the average's.
    maximum: Option<usize>,
    average: Option<usize>,
    output: &'a mut [f32],
}

impl pulp::WithSimd for PoolGradRow<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let zero = simd.splat_f32s(0.0);
        let quarter = simd.splat_f32s(0.25);
        let channels = self.input.channels;
        let (upper, lower) = self.output.split_at_mut(self.input.width * channels);
        for x in 0..self.input.width / 2 {
            let window = window(self.input, self.image, self.y, x);
            for first in (0..channels).step_by(S::F32_LANES) {
                let end = channels.min(first + S::F32_LANES);
                let mut values = [zero; 4];
                for (value, pixel) in values.iter_mut().zip(window) {
                    *value = simd::load(simd, &pixel[first..end]);
                }
                let [a, b, c, d] = values;
                let mut grads = [zero; 4];
                if let Some(image) = self.maximum {
                    let grad = &self.grad.pixel(image, self.y, x)[first..end];
                    let largest = simd.max_f32s(simd.max_f32s(a, b), simd.max_f32s(c, d));
                    let mut left = simd.select_f32s(
                        simd.greater_than_f32s(largest, zero),
                        simd::load(simd, grad),
                        zero,
                    );
                    for (grad, value) in grads.iter_mut().zip(values) {
                        let hit = simd.greater_than_or_equal_f32s(value, largest);
                        *grad = simd.select_f32s(hit, left, zero);
                        left = simd.select_f32s(hit, zero, left);
                    }
                }
                if let Some(image) = self.average {
                    let grad = &self.grad.pixel(image, self.y, x)[first..end];
                    let sum = simd.add_f32s(simd.add_f32s(a, b), simd.add_f32s(c, d));
                    let share = simd.select_f32s(
                        simd.greater_than_f32s(sum, zero),
                        simd.mul_f32s(quarter, simd::load(simd, grad)),
                        zero,
                    );
                    for grad in &mut grads {
                        *grad = simd.add_f32s(*grad, share);
                    }
                }
                for (index, grad) in grads.into_iter().enumerate() {
                    let row = if index < 2 { &mut *upper } else { &mut *lower };
                    let start = (2 * x + index % 2) * channels;
                    simd::store(simd, &mut row[start + first..start + end], grad);
                }
            }
        }
    }
}

/// Maximum of the `size x size` pixels around each pixel (`size` odd), of those inside the image.
pub fn local_maximum(input: Pixels, size: usize) -> Vec<f32> {
    let (height, width, channels) = (input.height, input.width, input.channels);
    let reach = size / 2;
    let row_values = width * channels;
    let mut output = vec![0.0; input.images * height * row_values];
    // The maximum of maxima of rows: along a row first.
    let mut along = vec![0.0; output.len()];
    along
        .par_chunks_exact_mut(row_values)
        .enumerate()
        .for_each(|(row, output)| {
            let (image, y) = (row / height, row % height);
            for (x, target) in output.chunks_exact_mut(channels).enumerate() {
                target.copy_from_slice(input.pixel(image, y, x));
                for other in x.saturating_sub(reach)..(x + reach + 1).min(width) {
                    largest(target, input.pixel(image, y, other));
                }
            }
        });
    output
        .par_chunks_exact_mut(row_values)
        .enumerate()
        .for_each(|(row, output)| {
            let (image, y) = (row / height, row % height);
            output.copy_from_slice(&along[row * row_values..][..row_values]);
            for other in y.saturating_sub(reach)..(y + reach + 1).min(height) {
                largest(
                    output,
                    &along[(image * height + other) * row_values..][..row_values],
                );
            }
        });
    output
}

/// Raises every value to at least the other's.
fn largest(values: &mut [f32], others: &[f32]) {
    simd::dispatch(Largest { values, others });
}

struct Largest<'a> {
    values: &'a mut [f32],
    others: &'a [f32],
}

impl pulp::WithSimd for Largest<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let values = self.values.chunks_mut(S::F32_LANES);
        for (values, others) in values.zip(self.others.chunks(S::F32_LANES)) {
            let larger = simd.max_f32s(simd::load(simd, values), simd::load(simd, others));
            simd::store(simd, values, larger);
        }
    }
}

/// Sum of every 2x2 window, `[images, height / 2, width / 2, channels]`: the gradient of doubling.
pub fn window_sums(input: Pixels) -> Vec<f32> {
    let (rows, columns, channels) = (input.height / 2, input.width / 2, input.channels);
    let mut output = vec![0.0; input.images * rows * columns * channels];
    output
        .par_chunks_exact_mut((columns * channels).max(1))
        .enumerate()
        .for_each(|(row, output)| {
            simd::dispatch(SumRow {
                input: &input,
                image: row / rows,
                y: row % rows,
                output,
            });
        });
    output
}

/// A row of window sums.
struct SumRow<'a> {
    input: &'a Pixels<'a>,
    image: usize,
    y: usize,
    output: &'a mut [f32],
}

impl pulp::WithSimd for SumRow<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let channels = self.input.channels;
        for (x, target) in self.output.chunks_exact_mut(channels).enumerate() {
            let window = window(self.input, self.image, self.y, x);
            for first in (0..channels).step_by(S::F32_LANES) {
                let end = channels.min(first + S::F32_LANES);
                let mut sum = simd.splat_f32s(0.0);
                for pixel in window {
                    sum = simd.add_f32s(sum, simd::load(simd, &pixel[first..end]));
                }
                simd::store(simd, &mut target[first..end], sum);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_gives_its_maximum_and_its_mean_and_odd_edges_are_dropped() {
        let values = [1.0, 4.0, 9.0, -3.0, 2.0, 9.0, 9.0, 9.0, 9.0];
        let input = Pixels::dense(&values, [1, 3, 3, 1]);
        assert_eq!(forward(input, TwinInput::Shared), vec![4.0, 1.0]);
        let grad = [10.0, 4.0];
        let grad = backward(input, Pixels::dense(&grad, [2, 1, 1, 1]), TwinInput::Shared);
        assert_eq!(grad, vec![1.0, 11.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn a_window_below_zero_passes_no_gradient() {
        let values = [-1.0; 8];
        let input = Pixels::dense(&values, [2, 2, 2, 1]);
        assert_eq!(forward(input, TwinInput::Stacked), vec![0.0, 0.0]);
        let grad = Pixels::dense(&[1.0, 1.0], [2, 1, 1, 1]);
        assert_eq!(backward(input, grad, TwinInput::Stacked), vec![0.0; 8]);
    }

    #[test]
    fn a_local_maximum_looks_no_further_than_the_image() {
        let values = [-1.0, -2.0, -3.0, -9.0, -5.0, -6.0];
        let input = Pixels::dense(&values, [1, 2, 3, 1]);
        let expected = vec![-1.0, -1.0, -2.0, -1.0, -1.0, -2.0];
        assert_eq!(local_maximum(input, 3), expected);
        assert_eq!(local_maximum(input, 5), vec![-1.0; 6]);
    }

    #[test]
    fn window_sums_add_four_pixels_channel_by_channel() {
        let values: Vec<f32> = (0..16_u8).map(f32::from).collect();
        let input = Pixels::dense(&values, [1, 2, 4, 2]);
        assert_eq!(window_sums(input), vec![20.0, 24.0, 36.0, 40.0]);
    }
}
