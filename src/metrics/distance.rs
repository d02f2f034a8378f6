//! How far estimated distances are from the true ones.

use serde::{Deserialize, Serialize};

/// Collects pairs of estimated and true distance.
///
/// ```
/// use twinsight::metrics::DistanceErrors;
///
/// let mut errors = DistanceErrors::new();
/// errors.add(22.0, 20.0);
/// errors.add(98.0, 100.0);
/// let summary = errors.summary().unwrap();
/// assert_eq!(summary.mae_m, 2.0);
/// assert!((summary.mre_percent - 6.0).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct DistanceErrors {
    /// (estimated, true), metres.
    pairs: Vec<(f64, f64)>,
    skipped: usize,
}

/// The errors of many distances.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DistanceSummary {
    /// Number of pairs.
    pub count: usize,
    /// Pairs left out because a value was not finite or the true distance not above 0.
    pub skipped: usize,
    /// Mean absolute error, metres.
    pub mae_m: f64,
    /// Root of the mean squared error, metres.
    pub rmse_m: f64,
    /// Mean relative error, percent of the true distance.
    pub mre_percent: f64,
    /// Mean of the relative error as a fraction: `mre_percent / 100`, as depth papers write it.
    pub abs_rel: f64,
    /// Mean of the squared error over the true distance, metres.
    pub sq_rel_m: f64,
    /// Root of the mean squared difference of the natural logarithms; None where an estimate is not
    /// above 0.
    pub rmse_log: Option<f64>,
    /// Share of the pairs of which the larger value is less than 1.25 times the smaller one.
    pub delta1: f64,
    /// The same for 1.25 squared.
    pub delta2: f64,
    /// The same for 1.25 cubed.
    pub delta3: f64,
    /// Mean squared error, square metres (paper, equation 3).
    pub mse_m2: f64,
    /// Mean squared relative error, square percent (paper, equation 4).
    pub msre_percent2: f64,
    /// Mean of estimated minus true distance, metres: positive when too far.
    pub bias_m: f64,
    /// Median absolute error, metres.
    pub median_m: f64,
    /// Absolute error that 95 % of the pairs do not exceed, metres.
    pub p95_m: f64,
    /// Largest absolute error, metres.
    pub max_m: f64,
    /// Share of the pairs whose error is at most 5 % of the true distance.
    pub within_5_percent: f64,
    /// Share of the pairs whose error is at most 10 % of the true distance.
    pub within_10_percent: f64,
    /// Share of the pairs whose error is at most 20 % of the true distance.
    pub within_20_percent: f64,
}

impl DistanceErrors {
    /// Nothing collected yet.
    pub const fn new() -> Self {
        Self {
            pairs: Vec::new(),
            skipped: 0,
        }
    }

    /// Adds an estimate and the truth, metres.
    ///
    /// A pair with a value that is not finite, or with a truth that is not above 0, is only
    /// counted as skipped.
    pub fn add(&mut self, estimated_m: f64, true_m: f64) {
        if estimated_m.is_finite() && true_m.is_finite() && true_m > 0.0 {
            self.pairs.push((estimated_m, true_m));
        } else {
            self.skipped += 1;
        }
    }

    /// Adds everything that another collection holds.
    pub fn merge(&mut self, other: &Self) {
        self.pairs.extend(&other.pairs);
        self.skipped += other.skipped;
    }

    /// Number of usable pairs.
    pub const fn len(&self) -> usize {
        self.pairs.len()
    }

    /// Whether there is no usable pair.
    pub const fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// All figures; None without a usable pair.
    pub fn summary(&self) -> Option<DistanceSummary> {
        if self.pairs.is_empty() {
            return None;
        }
        let count = self.pairs.len() as f64;
        let mean = |value: &dyn Fn(f64, f64) -> f64| {
            self.pairs
                .iter()
                .map(|&(error, truth)| value(error - truth, truth))
                .sum::<f64>()
                / count
        };
        let mut absolute: Vec<f64> = self.pairs.iter().map(|(e, t)| (e - t).abs()).collect();
        absolute.sort_by(f64::total_cmp);
        // The error itself, not the quotient, is compared: 10.5 for 10 is within 5 %.
        let share = |percent: f64| {
            mean(&|error, truth| f64::from(u8::from(error.abs() * 100.0 <= truth * percent)))
        };
        // An estimate that is not above 0 is in no ratio to the truth.
        let delta = |power: i32| {
            let within = |error: f64, truth: f64| {
                let ratio = (truth + error) / truth;
                ratio > 0.0 && ratio.max(1.0 / ratio) < 1.25_f64.powi(power)
            };
            mean(&|error, truth| f64::from(u8::from(within(error, truth))))
        };
        let squared_log = |error: f64, truth: f64| libm::log((truth + error) / truth).powi(2);
        let has_logs = self.pairs.iter().all(|&(estimate, _)| estimate > 0.0);
        let abs_rel = mean(&|error, truth| error.abs() / truth);
        let mse_m2 = mean(&|error, _| error * error);
        Some(DistanceSummary {
            count: self.pairs.len(),
            skipped: self.skipped,
            mae_m: mean(&|error, _| error.abs()),
            rmse_m: mse_m2.sqrt(),
            mre_percent: abs_rel * 100.0,
            abs_rel,
            sq_rel_m: mean(&|error, truth| error * error / truth),
            rmse_log: has_logs.then(|| mean(&squared_log).sqrt()),
            delta1: delta(1),
            delta2: delta(2),
            delta3: delta(3),
            mse_m2,
            msre_percent2: mean(&|error, truth| (error / truth * 100.0).powi(2)),
            bias_m: mean(&|error, _| error),
            median_m: quantile(&absolute, 0.5),
            p95_m: quantile(&absolute, 0.95),
            max_m: quantile(&absolute, 1.0),
            within_5_percent: share(5.0),
            within_10_percent: share(10.0),
            within_20_percent: share(20.0),
        })
    }
}

/// Quantile of ascending values, of which there must be one; linear between neighbours.
pub(super) fn quantile(sorted: &[f64], share: f64) -> f64 {
    let position = share * (sorted.len() - 1) as f64;
    let below = sorted[position.floor() as usize];
    let above = sorted[position.ceil() as usize];
    below + (above - below) * position.fract()
}

/// Quantile of values in any order, linear between neighbours; no number of none.
pub(crate) fn quantile_of(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    let mut values: Vec<f64> = values.collect();
    if values.is_empty() {
        return f64::NAN;
    }
    values.sort_by(f64::total_cmp);
    quantile(&values, share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_lie_between_the_values() {
        assert_eq!(quantile_of([3.0, 1.0, 2.0].into_iter(), 0.5), 2.0);
        assert_eq!(quantile_of([1.0, 2.0].into_iter(), 0.75), 1.75);
        assert!(quantile_of(std::iter::empty(), 0.5).is_nan());
    }

    fn errors(pairs: &[(f64, f64)]) -> DistanceErrors {
        let mut errors = DistanceErrors::new();
        for &(estimated, truth) in pairs {
            errors.add(estimated, truth);
        }
        errors
    }

    #[test]
    fn nothing_collected_has_no_summary() {
        assert_eq!(DistanceErrors::new().summary(), None);
        assert!(errors(&[(f64::NAN, 3.0), (3.0, 0.0), (f64::INFINITY, 3.0)]).is_empty());
    }

    #[test]
    fn unusable_pairs_are_counted_and_change_nothing() {
        let summary = errors(&[(11.0, 10.0), (f64::NAN, 3.0)]).summary().unwrap();
        assert_eq!((summary.count, summary.skipped, summary.mae_m), (1, 1, 1.0));
    }

    #[test]
    fn bias_has_a_sign_and_quantiles_are_of_absolute_errors() {
        let summary = errors(&[(9.0, 10.0), (12.0, 10.0), (13.0, 10.0)])
            .summary()
            .unwrap();
        assert!((summary.bias_m - 4.0 / 3.0).abs() < 1e-12);
        assert_eq!((summary.median_m, summary.max_m), (2.0, 3.0));
        assert!((summary.p95_m - 2.9).abs() < 1e-12);
    }

    #[test]
    fn shares_count_errors_up_to_the_limit() {
        let summary = errors(&[(10.5, 10.0), (9.0, 10.0), (12.0, 10.0), (20.0, 10.0)])
            .summary()
            .unwrap();
        assert_eq!(summary.within_5_percent, 0.25);
        assert_eq!(summary.within_10_percent, 0.5);
        assert_eq!(summary.within_20_percent, 0.75);
    }

    #[test]
    fn ratios_count_in_both_directions_and_an_estimate_below_zero_fails_them_all() {
        let summary = errors(&[(12.4, 10.0), (8.1, 10.0), (7.9, 10.0), (19.0, 10.0)])
            .summary()
            .unwrap();
        assert_eq!(
            (summary.delta1, summary.delta2, summary.delta3),
            (0.5, 0.75, 1.0)
        );
        assert!(summary.rmse_log.is_some());
        let below = errors(&[(-1.0, 10.0), (10.0, 10.0)]).summary().unwrap();
        assert_eq!((below.delta3, below.rmse_log), (0.5, None));
    }

    #[test]
    fn the_logarithmic_error_of_a_constant_factor_is_its_logarithm() {
        let summary = errors(&[(20.0, 10.0), (60.0, 30.0)]).summary().unwrap();
        assert!((summary.rmse_log.unwrap() - std::f64::consts::LN_2).abs() < 1e-12);
    }

    #[test]
    fn merged_collections_equal_one_collection() {
        let all = [(9.0, 10.0), (55.0, 50.0), (180.0, 200.0), (1.0, 0.0)];
        let mut merged = errors(&all[..1]);
        merged.merge(&errors(&all[1..]));
        assert_eq!(merged, errors(&all));
        assert_eq!(merged.len(), 3);
    }
}
