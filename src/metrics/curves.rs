//! Precision and recall as curves: over confidence, and as the area under one another.

use serde::{Deserialize, Serialize};

/// Number of confidences, equally spaced from 0 to 1, at which curves are sampled.
pub const CONFIDENCE_STEPS: usize = 1000;

/// Number of recalls at which the precision-recall curve is sampled.
const RECALL_STEPS: usize = 101;

/// Width of the box that smooths the mean F1 curve, steps of confidence.
const SMOOTHING_STEPS: usize = 101;

/// Keeps quotients finite where both numbers are 0.
pub(super) const EPSILON: f64 = 1e-16;

/// Precision, recall and F1 at an overlap of 0.5 over the confidence, one row per class with
/// targets.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct DetectionCurves {
    /// The confidences, 0 to 1.
    pub confidence: Vec<f64>,
    /// Precision per class and confidence.
    pub precision: Vec<Vec<f64>>,
    /// Recall per class and confidence.
    pub recall: Vec<Vec<f64>>,
    /// Harmonic mean of precision and recall per class and confidence.
    pub f1: Vec<Vec<f64>>,
}

impl DetectionCurves {
    /// Curves without a class.
    pub(super) fn new() -> Self {
        Self {
            confidence: equally_spaced(CONFIDENCE_STEPS),
            ..Self::default()
        }
    }

    /// Adds a class from its detections' scores in descending order and the running counts.
    pub(super) fn push(&mut self, scores: &[f64], counts: &RunningCounts) {
        let (precision, recall) = if scores.is_empty() {
            (vec![0.0; CONFIDENCE_STEPS], vec![0.0; CONFIDENCE_STEPS])
        } else {
            // Interpolation wants ascending abscissae: everything is mirrored at 0.
            let mirrored: Vec<f64> = scores.iter().map(|score| -score).collect();
            let sample = |values: &[f64], above: f64| -> Vec<f64> {
                let at = |&confidence: &f64| interpolated(-confidence, &mirrored, values, above);
                self.confidence.iter().map(at).collect()
            };
            // Above the highest score nothing is found and nothing is wrong.
            (sample(&counts.precision, 1.0), sample(&counts.recall, 0.0))
        };
        let pairs = precision.iter().zip(&recall);
        self.f1.push(
            pairs
                .map(|(p, r)| 2.0 * p * r / (p + r + EPSILON))
                .collect(),
        );
        self.precision.push(precision);
        self.recall.push(recall);
    }

    /// Index of the confidence where the smoothed mean F1 over the classes is largest.
    pub(super) fn best_index(&self) -> usize {
        let mean: Vec<f64> = (0..CONFIDENCE_STEPS)
            .map(|i| {
                let sum: f64 = self.f1.iter().map(|curve| curve[i]).sum();
                sum / (self.f1.len() as f64).max(1.0)
            })
            .collect();
        let smooth = smoothed(&mean);
        let mut best = 0;
        for (i, &value) in smooth.iter().enumerate() {
            if value > smooth[best] {
                best = i;
            }
        }
        best
    }
}

/// Precision and recall after each detection in descending order of scores.
pub(super) struct RunningCounts {
    pub precision: Vec<f64>,
    pub recall: Vec<f64>,
}

impl RunningCounts {
    /// From true-positive flags in descending order of scores.
    pub(super) fn new(flags: impl Iterator<Item = bool>, targets: usize) -> Self {
        let mut counts = Self {
            precision: Vec::new(),
            recall: Vec::new(),
        };
        let mut correct = 0.0;
        for (i, flag) in flags.enumerate() {
            correct += f64::from(u8::from(flag));
            counts.precision.push(correct / (i + 1) as f64);
            counts.recall.push(correct / (targets as f64 + EPSILON));
        }
        counts
    }

    /// Area under the precision-recall curve (YOLO11's rule).
    ///
    /// The curve starts at precision 1 and falls to 0 at the last recall; precision is replaced by
    /// the highest that any larger recall reaches; 101 linearly interpolated samples are
    /// integrated by the trapezoid rule.
    pub(super) fn average_precision(&self) -> f64 {
        let Some(&last_recall) = self.recall.last() else {
            return 0.0;
        };
        let mut recall = vec![0.0];
        recall.extend(&self.recall);
        recall.extend([last_recall, 1.0]);
        let mut envelope = vec![1.0];
        envelope.extend(&self.precision);
        envelope.extend([0.0, 0.0]);
        make_non_increasing(&mut envelope);
        let grid = equally_spaced(RECALL_STEPS);
        let heights: Vec<f64> = grid
            .iter()
            .map(|&r| interpolated(r, &recall, &envelope, 1.0))
            .collect();
        (1..RECALL_STEPS)
            .map(|i| (grid[i] - grid[i - 1]) * (heights[i] + heights[i - 1]) / 2.0)
            .sum()
    }
}

/// Replaces every value by the largest from it to the end.
pub(super) fn make_non_increasing(values: &mut [f64]) {
    for i in (1..values.len()).rev() {
        values[i - 1] = values[i - 1].max(values[i]);
    }
}

/// `steps` numbers from 0 to 1. The products, not quotients, decide on which side of a grid point
/// a recall such as 7/100 falls.
pub(super) fn equally_spaced(steps: usize) -> Vec<f64> {
    let step = 1.0 / (steps - 1) as f64;
    let mut grid: Vec<f64> = (0..steps).map(|i| i as f64 * step).collect();
    grid[steps - 1] = 1.0;
    grid
}

/// Linear interpolation of `ys` over ascending `xs`; `before` on the left of them, the last value
/// on the right. Where `xs` repeats, its last occurrence counts.
fn interpolated(x: f64, xs: &[f64], ys: &[f64], before: f64) -> f64 {
    let right = xs.partition_point(|&known| known <= x);
    if right == 0 {
        return before;
    }
    let left = right - 1;
    if right == xs.len() || xs[left] >= x {
        return ys[left];
    }
    let slope = (ys[right] - ys[left]) / (xs[right] - xs[left]);
    slope * (x - xs[left]) + ys[left]
}

/// Mean over a box around each value; beyond the ends the end values go on.
fn smoothed(values: &[f64]) -> Vec<f64> {
    let [Some(&first), Some(&last)] = [values.first(), values.last()] else {
        return Vec::new();
    };
    let half = SMOOTHING_STEPS / 2;
    let mut padded = vec![first; half];
    padded.extend(values);
    padded.extend(vec![last; half]);
    let weight = 1.0 / SMOOTHING_STEPS as f64;
    padded
        .windows(SMOOTHING_STEPS)
        .map(|window| window.iter().map(|value| value * weight).sum())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_perfect_ranking_has_an_average_precision_of_one_less_the_last_half_step() {
        // The curve falls to 0 at its last point, recall 1, which the last trapezoid sees.
        let counts = RunningCounts::new([true, true, true].into_iter(), 3);
        assert!((counts.average_precision() - 0.995).abs() < 1e-12);
    }

    #[test]
    fn no_detections_have_an_average_precision_of_zero() {
        assert_eq!(
            RunningCounts::new(std::iter::empty(), 3).average_precision(),
            0.0
        );
        let wrong = RunningCounts::new([false, false].into_iter(), 3);
        assert_eq!(wrong.average_precision(), 0.0);
    }

    #[test]
    fn interpolation_takes_the_last_of_repeated_points() {
        let (xs, ys) = ([0.0, 1.0, 1.0, 2.0], [4.0, 2.0, 1.0, 3.0]);
        for (x, y) in [
            (-1.0, 9.0),
            (0.0, 4.0),
            (0.5, 3.0),
            (1.0, 1.0),
            (1.5, 2.0),
            (7.0, 3.0),
        ] {
            assert_eq!(interpolated(x, &xs, &ys, 9.0), y);
        }
    }

    #[test]
    fn smoothing_keeps_a_constant_and_widens_a_peak() {
        assert!(
            smoothed(&[0.5; 300])
                .iter()
                .all(|v| (v - 0.5).abs() < 1e-12)
        );
        let mut peak = vec![0.0; 300];
        peak[150] = 1.0;
        let smooth = smoothed(&peak);
        assert_eq!(smooth.len(), 300);
        assert_eq!(smooth.iter().filter(|&&v| v > 0.0).count(), 101);
    }
}
