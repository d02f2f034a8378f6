//! Expected values of distributions given by logits, and probabilities: how detections are decoded.

use pulp::Simd;
use rayon::prelude::*;

use super::layout::Pixels;
use super::simd::{self, exp_vector, load, sigmoid_vector, store};

/// Pixels of a task.
const TASK: usize = 256;

/// Expected bin of each distribution: `sum_i i * softmax(logits)_i`, for `groups` distributions of
/// `bins` logits in the first channels of every pixel; returns `[images, height, width, groups]`.
///
/// # Panics
/// When pixels have fewer channels.
pub fn expected_bins(logits: Pixels, groups: usize, bins: usize) -> Vec<f32> {
    assert!(
        groups * bins <= logits.channels,
        "{groups} distributions of {bins} bins need as many channels"
    );
    let area = logits.height * logits.width;
    let numbers: Vec<f32> = (0..bins).map(|bin| bin as f32).collect();
    let mut output = vec![0.0; logits.images * area * groups];
    output
        .par_chunks_mut((TASK * groups).max(1))
        .enumerate()
        .for_each(|(task, output)| {
            simd::dispatch(Expect {
                logits: &logits,
                first: task * TASK,
                groups,
                numbers: &numbers,
                output,
            });
        });
    output
}

/// Some pixels, counted through all images.
struct Expect<'a> {
    logits: &'a Pixels<'a>,
    first: usize,
    groups: usize,
    /// The number of each bin.
    numbers: &'a [f32],
    output: &'a mut [f32],
}

impl pulp::WithSimd for Expect<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let bins = self.numbers.len();
        let (height, width) = (self.logits.height, self.logits.width);
        for (index, output) in self.output.chunks_exact_mut(self.groups).enumerate() {
            let (row, x) = ((self.first + index) / width, (self.first + index) % width);
            let pixel = self.logits.pixel(row / height, row % height, x);
            for (logits, output) in pixel.chunks_exact(bins).zip(output) {
                *output = expected(simd, logits, self.numbers);
            }
        }
    }
}

/// Expected number of one distribution.
#[inline(always)]
fn expected<S: Simd>(simd: S, logits: &[f32], numbers: &[f32]) -> f32 {
    // Exponents are taken relative to the largest, as in every softmax.
    let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let largest = simd.splat_f32s(largest);
    let mut weights = simd.splat_f32s(0.0);
    let mut sums = simd.splat_f32s(0.0);
    let parts = logits
        .chunks(S::F32_LANES)
        .zip(numbers.chunks(S::F32_LANES));
    for (logits, numbers) in parts {
        let e = exp_vector(simd, simd.sub_f32s(load(simd, logits), largest));
        let e = if logits.len() < S::F32_LANES {
            // What a short vector is filled up with has no part in the sum.
            let mut values = [0.0; simd::MAX_LANES];
            store(simd, &mut values[..logits.len()], e);
            load(simd, &values)
        } else {
            e
        };
        weights = simd.add_f32s(weights, e);
        sums = simd.mul_add_f32s(e, load(simd, numbers), sums);
    }
    simd.reduce_sum_f32s(sums) / simd.reduce_sum_f32s(weights)
}

/// `1 / (1 + e^-x)` of every value, in place.
pub fn sigmoids(values: &mut [f32]) {
    simd::dispatch(Sigmoids { values });
}

struct Sigmoids<'a> {
    values: &'a mut [f32],
}

impl pulp::WithSimd for Sigmoids<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for values in self.values.chunks_mut(S::F32_LANES) {
            let sigmoids = sigmoid_vector(simd, load(simd, values));
            store(simd, values, sigmoids);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expected_bins_are_those_of_a_softmax_for_any_number_of_bins() {
        for bins in [1, 5, 16, 21] {
            let channels = 3 * bins + 2;
            let values: Vec<f32> = (0..2 * 3 * 5 * channels)
                .map(|i| ((i * 37) % 101) as f32 / 7.0 - 6.0)
                .collect();
            let pixels = Pixels::dense(&values, [2, 3, 5, channels]);
            let actual = expected_bins(pixels, 3, bins);
            assert_eq!(actual.len(), 2 * 3 * 5 * 3);
            for (index, actual) in actual.iter().enumerate() {
                let start = index / 3 * channels + index % 3 * bins;
                let weights: Vec<f64> = values[start..start + bins]
                    .iter()
                    .map(|&logit| f64::from(logit).exp())
                    .collect();
                let sum: f64 = weights.iter().sum();
                let mean: f64 = weights.iter().zip(0..).map(|(w, i)| w * f64::from(i)).sum();
                let error = (f64::from(*actual) - mean / sum).abs();
                assert!(
                    error < 1e-5 * bins as f64,
                    "{actual} against {}",
                    mean / sum
                );
            }
        }
    }

    #[test]
    fn a_certain_bin_is_the_expected_one_however_large_its_logit() {
        let mut values = vec![-1000.0; 16];
        values[7] = 1e30;
        let pixels = Pixels::dense(&values, [1, 1, 1, 16]);
        assert_eq!(expected_bins(pixels, 1, 16), vec![7.0]);
    }
}
