//! Batch normalisation with activation on slices, in training mode: two passes forward, two backward.
//!
//! Values are `[pixels, channels]`. Few channels are treated as several pixels side by side (a
//! "row"), so that vectors are full whatever the number of channels.

use rayon::prelude::*;

use super::conv::Activation;
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

/// Sums over pixels of what `add` adds up for each value of a row, one a channel and sum.
fn channel_totals<const N: usize>(
    channels: usize,
    values: usize,
    add: impl Fn(std::ops::Range<usize>, &mut [Vec<f32>; N]) + Sync,
) -> [Vec<f64>; N] {
    let task = task_values(channels);
    let row = row_pixels(channels) * channels;
    let partial: Vec<[Vec<f32>; N]> = (0..values.div_ceil(task))
        .into_par_iter()
        .map(|index| {
            let mut sums = [const { Vec::new() }; N];
            for sums in &mut sums {
                sums.resize(row, 0.0);
            }
            add(index * task..((index + 1) * task).min(values), &mut sums);
            sums
        })
        .collect();
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

/// Sum of each channel's values: a bias's gradient.
pub fn channel_sums(channels: usize, values: &[f32]) -> Vec<f32> {
    let [sums] = channel_totals(channels, values.len(), |range, [sums]| {
        simd::vectorized(|| {
            for row in values[range].chunks(sums.len()) {
                for (sum, value) in sums.iter_mut().zip(row) {
                    *sum += value;
                }
            }
        });
    });
    sums.into_iter().map(|sum| sum as f32).collect()
}

/// Mean and biased variance of each channel.
pub fn statistics(channels: usize, input: &[f32]) -> BatchStatistics {
    let count = (input.len() / channels) as f64;
    let average =
        |sums: &[f64]| -> Vec<f32> { sums.iter().map(|sum| (sum / count) as f32).collect() };
    let [sums] = channel_totals(channels, input.len(), |range, [sums]| {
        simd::vectorized(|| {
            for row in input[range].chunks(sums.len()) {
                for (sum, value) in sums.iter_mut().zip(row) {
                    *sum += value;
                }
            }
        });
    });
    let mean = average(&sums);
    let means = for_row(&mean);
    let [squares] = channel_totals(channels, input.len(), |range, [sums]| {
        simd::vectorized(|| {
            for row in input[range].chunks(sums.len()) {
                for ((sum, value), mean) in sums.iter_mut().zip(row).zip(&means) {
                    *sum += (value - mean) * (value - mean);
                }
            }
        });
    });
    BatchStatistics {
        mean,
        variance: average(&squares),
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
            simd::vectorized(|| {
                let rows = output
                    .chunks_mut(scale.len())
                    .zip(input.chunks(scale.len()));
                for (output, input) in rows {
                    for (((y, x), scale), shift) in
                        output.iter_mut().zip(input).zip(&scale).zip(&shift)
                    {
                        let u = x * scale + shift;
                        *y = match activation {
                            Activation::None => u,
                            Activation::Relu => u.max(0.0),
                            Activation::Silu => u * simd::sigmoid(u),
                        };
                    }
                }
            });
        });
    output
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
    let (gammas, betas) = (for_row(gamma), for_row(beta));
    let (means, inverses) = (for_row(&statistics.mean), for_row(&inverse));
    // First pass: the gradient before the activation, and its two sums a channel.
    let mut output = vec![0.0; input.len()];
    let task = task_values(channels);
    let row = gammas.len();
    output
        .par_chunks_mut(task)
        .zip(input.par_chunks(task).zip(grad.par_chunks(task)))
        .for_each(|(output, (input, grad))| {
            simd::vectorized(|| {
                let rows = output
                    .chunks_mut(row)
                    .zip(input.chunks(row).zip(grad.chunks(row)));
                for (output, (input, grad)) in rows {
                    let values = output.iter_mut().zip(input).zip(grad);
                    let settings = gammas.iter().zip(&betas).zip(&means).zip(&inverses);
                    for (((d, x), g), (((gamma, beta), mean), inverse)) in values.zip(settings) {
                        let u = gamma * ((x - mean) * inverse) + beta;
                        *d = match activation {
                            Activation::None => *g,
                            Activation::Relu => {
                                if u > 0.0 {
                                    *g
                                } else {
                                    0.0
                                }
                            }
                            Activation::Silu => {
                                let s = simd::sigmoid(u);
                                g * s * (1.0 + u * (1.0 - s))
                            }
                        };
                    }
                }
            });
        });
    let [beta_grad, dots] = channel_totals(channels, input.len(), |range, [sums, dots]| {
        simd::vectorized(|| {
            let rows = output[range.clone()].chunks(row);
            for (output, input) in rows.zip(input[range.clone()].chunks(row)) {
                let totals = sums.iter_mut().zip(dots.iter_mut()).zip(&means);
                for (((sum, dot), mean), (d, x)) in totals.zip(output.iter().zip(input)) {
                    *sum += d;
                    *dot += d * (x - mean);
                }
            }
        });
    });
    let gamma_grad: Vec<f64> = dots
        .iter()
        .zip(&inverse)
        .map(|(dot, inverse)| dot * f64::from(*inverse))
        .collect();
    // Second pass: take out the parts that the statistics carry.
    let per_channel = |value: &dyn Fn(usize) -> f64| -> Vec<f32> {
        for_row(
            &(0..channels)
                .map(|channel| value(channel) as f32)
                .collect::<Vec<_>>(),
        )
    };
    let scales = per_channel(&|c| f64::from(gamma[c] * inverse[c]));
    let offsets = per_channel(&|c| beta_grad[c] / count);
    let slopes = per_channel(&|c| gamma_grad[c] / count * f64::from(inverse[c]));
    output
        .par_chunks_mut(task)
        .zip(input.par_chunks(task))
        .for_each(|(output, input)| {
            simd::vectorized(|| {
                for (output, input) in output.chunks_mut(row).zip(input.chunks(row)) {
                    let settings = scales.iter().zip(&offsets).zip(&means).zip(&slopes);
                    for ((d, x), (((scale, offset), mean), slope)) in
                        output.iter_mut().zip(input).zip(settings)
                    {
                        *d = scale * (*d - offset - (x - mean) * slope);
                    }
                }
            });
        });
    NormGradients {
        input: output,
        gamma: gamma_grad.iter().map(|&sum| sum as f32).collect(),
        beta: beta_grad.iter().map(|&sum| sum as f32).collect(),
    }
}
