//! How far a figure could be off by chance: percentile bootstrap over groups.
//!
//! Vehicles of one frame, and frames of one scene, are alike: their errors are not independent, and
//! drawing them one by one would promise more certainty than there is. What is drawn, with
//! replacement, is whole groups.

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::distance::quantile;

/// Draws are the same in every evaluation, so that the same figures have the same intervals.
const SEED: u64 = 0x7715_1647;

/// Fewer groups than this say nothing about chance.
const LEAST_GROUPS: usize = 2;

/// Bounds between which a figure lies in 95 % of the draws.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// 2.5 % of the draws are below.
    pub low: f64,
    /// 2.5 % of the draws are above.
    pub high: f64,
}

impl Interval {
    /// Whether a value lies between the bounds.
    pub fn contains(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }
}

/// Draws with replacement of as many groups as there are.
///
/// ```
/// use twinsight::metrics::Resamples;
///
/// let errors = [1.0, 2.0, 3.0, 2.0, 2.0, 1.0, 3.0, 2.0];
/// let draws = Resamples::new(errors.len(), 500);
/// let mean = draws.interval(|counts| {
///     let sum: f64 = errors.iter().zip(counts).map(|(e, &k)| e * k as f64).sum();
///     Some(sum / errors.len() as f64)
/// });
/// assert!(mean.unwrap().contains(2.0));
/// ```
#[derive(Debug, Clone)]
pub struct Resamples {
    groups: usize,
    /// How often each draw holds each group.
    counts: Vec<Vec<usize>>,
}

impl Resamples {
    /// Makes the draws.
    pub fn new(groups: usize, draws: usize) -> Self {
        let mut rng = Pcg64::seed_from_u64(SEED);
        let counts = (0..draws)
            .map(|_| {
                let mut counts = vec![0; groups];
                for _ in 0..groups {
                    counts[rng.random_range(0..groups)] += 1;
                }
                counts
            })
            .collect();
        Self { groups, counts }
    }

    /// Number of groups.
    pub const fn groups(&self) -> usize {
        self.groups
    }

    /// Number of draws.
    pub const fn draws(&self) -> usize {
        self.counts.len()
    }

    /// The first few draws alone, for figures that are dear to compute.
    #[must_use]
    pub fn first(&self, draws: usize) -> Self {
        Self {
            groups: self.groups,
            counts: self.counts.iter().take(draws).cloned().collect(),
        }
    }

    /// The interval of a figure that is computed from how often each group counts. None with fewer
    /// than two groups, and where more than half of the draws have no figure.
    pub fn interval(&self, figure: impl Fn(&[usize]) -> Option<f64> + Sync) -> Option<Interval> {
        let [interval] = self.intervals(|counts| figure(counts).map(|figure| [figure]))?;
        Some(interval)
    }

    /// [`Resamples::interval`] of several figures of the same draws.
    pub fn intervals<const N: usize>(
        &self,
        figures: impl Fn(&[usize]) -> Option<[f64; N]> + Sync,
    ) -> Option<[Interval; N]> {
        if self.groups < LEAST_GROUPS {
            return None;
        }
        let drawn: Vec<[f64; N]> = self
            .counts
            .par_iter()
            .filter_map(|counts| figures(counts))
            .collect();
        if drawn.is_empty() || 2 * drawn.len() < self.counts.len() {
            return None;
        }
        Some(std::array::from_fn(|i| {
            let mut values: Vec<f64> = drawn.iter().map(|figures| figures[i]).collect();
            values.sort_by(f64::total_cmp);
            Interval {
                low: quantile(&values, 0.025),
                high: quantile(&values, 0.975),
            }
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean(values: &[f64]) -> impl Fn(&[usize]) -> Option<f64> + Sync {
        move |counts| {
            let sum: f64 = values.iter().zip(counts).map(|(v, &k)| v * k as f64).sum();
            let count: usize = counts.iter().sum();
            Some(sum / count as f64)
        }
    }

    #[test]
    fn every_draw_holds_as_many_groups_as_there_are_and_the_same_ones_every_time() {
        let draws = Resamples::new(7, 100);
        assert!(draws.counts.iter().all(|c| c.iter().sum::<usize>() == 7));
        assert_eq!(draws.counts, Resamples::new(7, 100).counts);
    }

    #[test]
    fn the_interval_of_a_mean_is_about_two_standard_errors_wide_on_each_side() {
        let values: Vec<f64> = (0..400).map(|i| f64::from(i % 2)).collect();
        let interval = Resamples::new(400, 2000).interval(mean(&values)).unwrap();
        // The standard error is 0.5 / 20.
        assert!((interval.low - 0.45).abs() < 0.01 && (interval.high - 0.55).abs() < 0.01);
        assert!(interval.contains(0.5));
    }

    #[test]
    fn values_that_are_equal_leave_no_doubt() {
        let interval = Resamples::new(5, 50).interval(mean(&[3.0; 5])).unwrap();
        assert_eq!((interval.low, interval.high), (3.0, 3.0));
    }

    #[test]
    fn one_group_and_figures_that_are_mostly_absent_have_no_interval() {
        assert_eq!(Resamples::new(1, 50).interval(mean(&[3.0])), None);
        assert_eq!(Resamples::new(0, 50).interval(|_| Some(1.0)), None);
        assert_eq!(Resamples::new(5, 50).interval(|_| None), None);
    }
}
