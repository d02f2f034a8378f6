//! Batch normalisation with activation on slices, in training mode: two passes forward, two backward.
//!
//! Values are `[pixels, channels]`. Few channels are treated as several pixels side by side (a
//! "row"), so that vectors are full whatever the number of channels.

use pulp::Simd;
use rayon::prelude::*;

use super::epilogue::Activation;
use super::simd;

/// Least values of a row, where there are enough pixels.
const ROW_VALUES: usize = 64;
/// Values of one parallel task. The split depends on nothing else, so sums are the same for any
/// number of threads.
const TASK_VALUES: usize = 64 * 1024;

/// Statistics of one batch, one value a channel.
#[derive(Debug, Clone, PartialEq)]
pub struct BatchStatistics {
    /// Mean over images and pixels.
    pub mean: Vec<f32>,
    /// Biased variance over images and pixels.
    pub variance: Vec<f32>,
}

/// The gradients of a batch normalisation.
#[derive(Debug, Clone, PartialEq)]
pub struct NormGradients {
    /// Gradient of the input, in its shape.
    pub input: Vec<f32>,
    /// Gradient of the scale, one a channel.
    pub gamma: Vec<f32>,
    /// Gradient of the shift, one a channel.
    pub beta: Vec<f32>,
}

/// Pixels of a row.
fn row_pixels(channels: usize) -> usize {
    (ROW_VALUES / channels).max(1)
}

/// Values of a task: whole rows.
fn task_values(channels: usize) -> usize {
    let row = row_pixels(channels) * channels;
    (TASK_VALUES / row).max(1) * row
}

/// One value a channel, for all pixels of a row.
fn for_row(values: &[f32]) -> Vec<f32> {
    values.repeat(row_pixels(values.len()))
}

/// Sums over pixels of what `add` adds up for each value of a row, one a channel and sum. `add` is
/// called with the range of values of a task, the values' part of `output`, and the sums.
fn channel_totals<const N: usize>(
    channels: usize,
    output: &mut [f32],
    values: usize,
    add: impl Fn(std::ops::Range<usize>, &mut [f32], &mut [Vec<f32>; N]) + Sync,
) -> [Vec<f64>; N] {
    let task = task_values(channels);
    let row = row_pixels(channels) * channels;
    let run = |index: usize, output: &mut [f32]| {
        let mut sums = [const { Vec::new() }; N];
        for sums in &mut sums {
            sums.resize(row, 0.0);
        }
        add(
            index * task..((index + 1) * task).min(values),
            output,
            &mut sums,
        );
        sums
    };
    let partial: Vec<[Vec<f32>; N]> = if output.is_empty() {
        (0..values.div_ceil(task))
            .into_par_iter()
            .map(|index| run(index, &mut []))
            .collect()
    } else {
        output
            .par_chunks_mut(task)
            .enumerate()
            .map(|(index, output)| run(index, output))
            .collect()
    };
    let mut totals = [const { Vec::new() }; N];
    for (n, totals) in totals.iter_mut().enumerate() {
        totals.resize(channels, 0.0);
        for sums in &partial {
            for (index, &sum) in sums[n].iter().enumerate() {
                totals[index % channels] += f64::from(sum);
            }
        }
    }
    totals
}

/// Adds rows of values, less a value's mean and squared if there are means.
struct AddRows<'a> {
    values: &'a [f32],
    means: Option<&'a [f32]>,
    sums: &'a mut [f32],
}

impl pulp::WithSimd for AddRows<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for row in self.values.chunks(self.sums.len()) {
            for first in (0..row.len()).step_by(S::F32_LANES) {
                let end = row.len().min(first + S::F32_LANES);
                let value = simd::load(simd, &row[first..end]);
                let sum = simd::load(simd, &self.sums[first..end]);
                let sum = match self.means {
                    None => simd.add_f32s(sum, value),
                    Some(means) => {
                        let value = simd.sub_f32s(value, simd::load(simd, &means[first..end]));
                        simd.mul_add_f32s(value, value, sum)
                    }
                };
                simd::store(simd, &mut self.sums[first..end], sum);
            }
        }
    }
}

/// Sum of each channel's values: a bias's gradient.
pub fn channel_sums(channels: usize, values: &[f32]) -> Vec<f32> {
    let [sums] = channel_totals(channels, &mut [], values.len(), |range, _, [sums]| {
        simd::dispatch(AddRows {
            values: &values[range],
            means: None,
            sums,
        });
    });
    sums.into_iter().map(|sum| sum as f32).collect()
}

/// Mean and biased variance of each channel.
pub fn statistics(channels: usize, input: &[f32]) -> BatchStatistics {
    let count = (input.len() / channels) as f64;
    let average =
        |sums: &[f64]| -> Vec<f32> { sums.iter().map(|sum| (sum / count) as f32).collect() };
    let totals = |means: Option<&[f32]>| {
        let [sums] = channel_totals(channels, &mut [], input.len(), |range, _, [sums]| {
            simd::dispatch(AddRows {
                values: &input[range],
                means,
                sums,
            });
        });
        average(&sums)
    };
    let mean = totals(None);
    let variance = totals(Some(&for_row(&mean)));
    BatchStatistics { mean, variance }
}

/// `activation(x scale + shift)`, row by row.
struct Activate<'a> {
    input: &'a [f32],
    scale: &'a [f32],
    shift: &'a [f32],
    activation: Activation,
    output: &'a mut [f32],
}

impl pulp::WithSimd for Activate<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let zero = simd.splat_f32s(0.0);
        let row = self.scale.len();
        for (output, input) in self.output.chunks_mut(row).zip(self.input.chunks(row)) {
            for first in (0..input.len()).step_by(S::F32_LANES) {
                let end = input.len().min(first + S::F32_LANES);
                let u = simd.mul_add_f32s(
                    simd::load(simd, &input[first..end]),
                    simd::load(simd, &self.scale[first..end]),
                    simd::load(simd, &self.shift[first..end]),
                );
                let y = match self.activation {
                    Activation::None => u,
                    Activation::Relu => simd.max_f32s(u, zero),
                    Activation::Silu => simd.mul_f32s(u, simd::sigmoid_vector(simd, u)),
                };
                simd::store(simd, &mut output[first..end], y);
            }
        }
    }
}

/// `activation(gamma (x - mean) / sqrt(variance + epsilon) + beta)`.
pub fn forward(
    input: &[f32],
    gamma: &[f32],
    beta: &[f32],
    statistics: &BatchStatistics,
    epsilon: f32,
    activation: Activation,
) -> Vec<f32> {
    let channels = gamma.len();
    let scale: Vec<f32> = (0..channels)
        .map(|channel| gamma[channel] / (statistics.variance[channel] + epsilon).sqrt())
        .collect();
    let shift: Vec<f32> = (0..channels)
        .map(|channel| beta[channel] - statistics.mean[channel] * scale[channel])
        .collect();
    let (scale, shift) = (for_row(&scale), for_row(&shift));
    let mut output = vec![0.0; input.len()];
    let task = task_values(channels);
    output
        .par_chunks_mut(task)
        .zip(input.par_chunks(task))
        .for_each(|(output, input)| {
            simd::dispatch(Activate {
                input,
                scale: &scale,
                shift: &shift,
                activation,
                output,
            });
        });
    output
}

/// The gradient before the activation and its two sums: `d` itself, and `d (x - mean)`.
struct ActivateGrad<'a> {
    input: &'a [f32],
    grad: &'a [f32],
    scale: &'a [f32],
    shift: &'a [f32],
    means: &'a [f32],
    activation: Activation,
    output: &'a mut [f32],
    sums: &'a mut [f32],
    dots: &'a mut [f32],
}

impl pulp::WithSimd for ActivateGrad<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let row = self.scale.len();
        let rows = self
            .output
            .chunks_mut(row)
            .zip(self.input.chunks(row).zip(self.grad.chunks(row)));
        for (output, (input, grad)) in rows {
            for first in (0..input.len()).step_by(S::F32_LANES) {
                let end = input.len().min(first + S::F32_LANES);
                let (x, g) = (
                    simd::load(simd, &input[first..end]),
                    simd::load(simd, &grad[first..end]),
                );
                let d = if self.activation == Activation::None {
                    g
                } else {
                    let u = simd.mul_add_f32s(
                        x,
                        simd::load(simd, &self.scale[first..end]),
                        simd::load(simd, &self.shift[first..end]),
                    );
                    if self.activation == Activation::Relu {
                        simd.select_f32s(simd.greater_than_f32s(u, zero), g, zero)
                    } else {
                        // d(u s)/du = s (1 + u (1 - s)) with s = sigmoid(u)
                        let s = simd::sigmoid_vector(simd, u);
                        let slope = simd.mul_add_f32s(u, simd.sub_f32s(one, s), one);
                        simd.mul_f32s(simd.mul_f32s(g, s), slope)
                    }
                };
                simd::store(simd, &mut output[first..end], d);
                let sum = simd.add_f32s(simd::load(simd, &self.sums[first..end]), d);
                let dot = simd.mul_add_f32s(
                    d,
                    simd.sub_f32s(x, simd::load(simd, &self.means[first..end])),
                    simd::load(simd, &self.dots[first..end]),
                );
                simd::store(simd, &mut self.sums[first..end], sum);
                simd::store(simd, &mut self.dots[first..end], dot);
            }
        }
    }
}

/// `scale (d - offset - (x - mean) slope)` in place of `d`.
struct Center<'a> {
    input: &'a [f32],
    scale: &'a [f32],
    offset: &'a [f32],
    means: &'a [f32],
    slope: &'a [f32],
    output: &'a mut [f32],
}

impl pulp::WithSimd for Center<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let row = self.scale.len();
        for (output, input) in self.output.chunks_mut(row).zip(self.input.chunks(row)) {
            for first in (0..input.len()).step_by(S::F32_LANES) {
                let end = input.len().min(first + S::F32_LANES);
                let centered = simd.sub_f32s(
                    simd::load(simd, &input[first..end]),
                    simd::load(simd, &self.means[first..end]),
                );
                let carried = simd.mul_add_f32s(
                    centered,
                    simd::load(simd, &self.slope[first..end]),
                    simd::load(simd, &self.offset[first..end]),
                );
                let value = simd.mul_f32s(
                    simd::load(simd, &self.scale[first..end]),
                    simd.sub_f32s(simd::load(simd, &output[first..end]), carried),
                );
                simd::store(simd, &mut output[first..end], value);
            }
        }
    }
}

/// Gradients of [`forward`] through the batch's own statistics.
pub fn backward(
    input: &[f32],
    gamma: &[f32],
    beta: &[f32],
    statistics: &BatchStatistics,
    epsilon: f32,
    activation: Activation,
    grad: &[f32],
) -> NormGradients {
    let channels = gamma.len();
    let count = (input.len() / channels) as f64;
    let inverse: Vec<f32> = statistics
        .variance
        .iter()
        .map(|variance| 1.0 / (variance + epsilon).sqrt())
        .collect();
    let per_row = |value: &dyn Fn(usize) -> f64| -> Vec<f32> {
        for_row(
            &(0..channels)
                .map(|channel| value(channel) as f32)
                .collect::<Vec<_>>(),
        )
    };
    let means = for_row(&statistics.mean);
    let scale = |c: usize| f64::from(gamma[c] * inverse[c]);
    let scales = per_row(&scale);
    let shifts = per_row(&|c| f64::from(beta[c]) - f64::from(statistics.mean[c]) * scale(c));
    let mut output = vec![0.0; input.len()];
    // First pass: the gradient before the activation, and its two sums a channel.
    let [beta_grad, dots] = channel_totals(
        channels,
        &mut output,
        input.len(),
        |range, output, [sums, dots]| {
            simd::dispatch(ActivateGrad {
                input: &input[range.clone()],
                grad: &grad[range],
                scale: &scales,
                shift: &shifts,
                means: &means,
                activation,
                output,
                sums,
                dots,
            });
        },
    );
    let gamma_grad: Vec<f64> = dots
        .iter()
        .zip(&inverse)
        .map(|(dot, inverse)| dot * f64::from(*inverse))
        .collect();
    // Second pass: take out the parts that the statistics carry.
    let offsets = per_row(&|c| beta_grad[c] / count);
    let slopes = per_row(&|c| gamma_grad[c] / count * f64::from(inverse[c]));
    let task = task_values(channels);
    output
        .par_chunks_mut(task)
        .zip(input.par_chunks(task))
        .for_each(|(output, input)| {
            simd::dispatch(Center {
                input,
                scale: &scales,
                offset: &offsets,
                means: &means,
                slope: &slopes,
                output,
            });
        });
    NormGradients {
        input: output,
        gamma: gamma_grad.iter().map(|&sum| sum as f32).collect(),
        beta: beta_grad.iter().map(|&sum| sum as f32).collect(),
    }
}
