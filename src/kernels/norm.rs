//! Batch normalisation with activation on slices, in training mode: two passes forward, two backward.

use rayon::prelude::*;

use super::conv::{Activation, sum};
use super::simd;

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

/// The extent of a batch `[batch, channels, area]`.
#[derive(Debug, Clone, Copy)]
pub struct NormShape {
    /// Channels.
    pub channels: usize,
    /// Pixels of one plane.
    pub area: usize,
}

/// Mean and biased variance of each channel.
pub fn statistics(shape: NormShape, input: &[f32]) -> BatchStatistics {
    let NormShape { channels, area } = shape;
    let count = (input.len() / channels) as f64;
    let (mean, variance) = (0..channels)
        .into_par_iter()
        .map(|channel| {
            let planes = || input.chunks_exact(area).skip(channel).step_by(channels);
            let total: f64 = planes()
                .map(|plane| f64::from(simd::vectorized(|| sum(plane))))
                .sum();
            let mean = (total / count) as f32;
            let squares: f64 = planes()
                .map(|plane| f64::from(simd::vectorized(|| squared_deviations(plane, mean))))
                .sum();
            (mean, (squares / count) as f32)
        })
        .unzip();
    BatchStatistics { mean, variance }
}

/// `activation(gamma (x - mean) / sqrt(variance + epsilon) + beta)`.
pub fn forward(
    shape: NormShape,
    input: &[f32],
    gamma: &[f32],
    beta: &[f32],
    statistics: &BatchStatistics,
    epsilon: f32,
    activation: Activation,
) -> Vec<f32> {
    let NormShape { channels, area } = shape;
    let mut output = vec![0.0; input.len()];
    output
        .par_chunks_exact_mut(area)
        .zip(input.par_chunks_exact(area))
        .with_min_len(4)
        .enumerate()
        .for_each(|(plane, (output, input))| {
            let channel = plane % channels;
            let scale = gamma[channel] / (statistics.variance[channel] + epsilon).sqrt();
            let shift = beta[channel] - statistics.mean[channel] * scale;
            simd::vectorized(|| {
                for (y, x) in output.iter_mut().zip(input) {
                    let u = x * scale + shift;
                    *y = match activation {
                        Activation::None => u,
                        Activation::Relu => u.max(0.0),
                        Activation::Silu => u * simd::sigmoid(u),
                    };
                }
            });
        });
    output
}

/// Gradients of [`forward`] through the batch's own statistics.
#[allow(
    clippy::too_many_arguments,
    reason = "a forward pass and the gradient of its output"
)]
pub fn backward(
    shape: NormShape,
    input: &[f32],
    gamma: &[f32],
    beta: &[f32],
    statistics: &BatchStatistics,
    epsilon: f32,
    activation: Activation,
    grad: &[f32],
) -> NormGradients {
    let NormShape { channels, area } = shape;
    let count = (input.len() / channels) as f64;
    let inverse = |channel: usize| 1.0 / (statistics.variance[channel] + epsilon).sqrt();
    // First pass: the gradient before the activation, and its two sums per plane.
    let mut output = vec![0.0; input.len()];
    let plane_sums: Vec<[f64; 2]> = output
        .par_chunks_exact_mut(area)
        .zip(
            input
                .par_chunks_exact(area)
                .zip(grad.par_chunks_exact(area)),
        )
        .with_min_len(4)
        .enumerate()
        .map(|(plane, (output, (input, grad)))| {
            let channel = plane % channels;
            let (mean, inverse) = (statistics.mean[channel], inverse(channel));
            let (gamma, beta) = (gamma[channel], beta[channel]);
            simd::vectorized(|| {
                for ((d, x), g) in output.iter_mut().zip(input).zip(grad) {
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
                let normalized = dot_deviation(output, input, mean) * inverse;
                [f64::from(sum(output)), f64::from(normalized)]
            })
        })
        .collect();
    let sums: Vec<[f64; 2]> = (0..channels)
        .map(|channel| {
            plane_sums
                .iter()
                .skip(channel)
                .step_by(channels)
                .fold([0.0, 0.0], |total, sums| {
                    [total[0] + sums[0], total[1] + sums[1]]
                })
        })
        .collect();
    // Second pass: take out the parts that the statistics carry.
    output
        .par_chunks_exact_mut(area)
        .zip(input.par_chunks_exact(area))
        .with_min_len(4)
        .enumerate()
        .for_each(|(plane, (output, input))| {
            let channel = plane % channels;
            let inverse = inverse(channel);
            let scale = gamma[channel] * inverse;
            let mean = statistics.mean[channel];
            let mean_grad = (sums[channel][0] / count) as f32;
            let slope = (sums[channel][1] / count) as f32 * inverse;
            simd::vectorized(|| {
                for (d, x) in output.iter_mut().zip(input) {
                    *d = scale * (*d - mean_grad - (x - mean) * slope);
                }
            });
        });
    NormGradients {
        input: output,
        gamma: sums.iter().map(|sums| sums[1] as f32).collect(),
        beta: sums.iter().map(|sums| sums[0] as f32).collect(),
    }
}

/// Sum of each channel's values over a batch `[batch, channels, area]`: a bias's gradient.
pub fn channel_sums(channels: usize, area: usize, values: &[f32]) -> Vec<f32> {
    (0..channels)
        .into_par_iter()
        .map(|channel| {
            let planes = values.chunks_exact(area).skip(channel).step_by(channels);
            planes
                .map(|plane| f64::from(simd::vectorized(|| sum(plane))))
                .sum::<f64>() as f32
        })
        .collect()
}

#[inline(always)]
fn squared_deviations(values: &[f32], mean: f32) -> f32 {
    let mut lanes = [0.0_f32; 16];
    let chunks = values.chunks_exact(16);
    let rest: f32 = chunks
        .remainder()
        .iter()
        .map(|v| (v - mean) * (v - mean))
        .sum();
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane += (value - mean) * (value - mean);
        }
    }
    lanes.iter().sum::<f32>() + rest
}

#[inline(always)]
fn dot_deviation(grads: &[f32], values: &[f32], mean: f32) -> f32 {
    let mut lanes = [0.0_f32; 16];
    let whole = grads.len() / 16 * 16;
    for (grads, values) in grads.chunks_exact(16).zip(values.chunks_exact(16)) {
        for ((lane, grad), value) in lanes.iter_mut().zip(grads).zip(values) {
            *lane += grad * (value - mean);
        }
    }
    let rest: f32 = grads[whole..]
        .iter()
        .zip(&values[whole..])
        .map(|(g, v)| g * (v - mean))
        .sum();
    lanes.iter().sum::<f32>() + rest
}
