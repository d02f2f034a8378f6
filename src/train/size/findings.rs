//! Errors of witnesses, and whether their spreads hold what they promise.

use serde::Serialize;

use crate::metrics::quantile_of;
use crate::ranging::SizeWitness;

/// Standard deviations that hold 68 and 95 % of a normal distribution.
const SIGMAS: [f64; 2] = [0.994_457_9, 1.959_964];

/// Errors of one number, each with the standard deviation that was told with it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SpreadErrors {
    errors: Vec<[f64; 2]>,
}

/// What errors and spreads add up to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SpreadSummary {
    /// Number of vehicles.
    pub count: usize,
    /// Mean error.
    pub bias: f64,
    /// Root mean squared error.
    pub rms: f64,
    /// Median absolute error.
    pub median: f64,
    /// Median of the spreads that were told.
    pub spread: f64,
    /// Shares within the 68 % and the 95 % interval.
    pub within: [f64; 2],
    /// Mean negative logarithm of the likelihood, once the spreads are corrected.
    pub nll: f64,
}

impl SpreadErrors {
    /// Adds an error and its standard deviation.
    pub fn add(&mut self, error: f64, std: f64) {
        self.errors.push([error, std]);
    }

    fn merge(&mut self, other: &Self) {
        self.errors.extend(&other.errors);
    }

    /// What they add up to; none of none.
    pub fn summary(&self) -> Option<SpreadSummary> {
        if self.errors.is_empty() {
            return None;
        }
        let count = self.errors.len();
        let mean = |value: &dyn Fn(&[f64; 2]) -> f64| {
            self.errors.iter().map(value).sum::<f64>() / count as f64
        };
        let within = SIGMAS
            .map(|sigmas| mean(&|[error, std]| f64::from(u8::from(error.abs() <= sigmas * std))));
        let factor = self.factor();
        Some(SpreadSummary {
            count,
            bias: mean(&|[error, _]| *error),
            rms: mean(&|[error, _]| error * error).sqrt(),
            median: quantile_of(self.errors.iter().map(|[error, _]| error.abs()), 0.5),
            spread: quantile_of(self.errors.iter().map(|[_, std]| *std), 0.5),
            within,
            nll: mean(&|[error, std]| 0.5 * (error / (factor * std)).powi(2) + (factor * std).ln())
                + 0.5 * (2.0 * std::f64::consts::PI).ln(),
        })
    }

    /// The factor that makes the spreads hold what they promise: the larger of those that the 68 % and the
    /// 95 % interval want, since a spread that is too wide only wastes evidence. 1 of too few errors to
    /// tell.
    pub fn factor(&self) -> f64 {
        const FEWEST: usize = 20;
        if self.errors.len() < FEWEST {
            return 1.0;
        }
        let ratios = || self.errors.iter().map(|[error, std]| error.abs() / std);
        let wanted = [0.68, 0.95]
            .into_iter()
            .zip(SIGMAS)
            .map(|(share, sigmas)| quantile_of(ratios(), share) / sigmas);
        wanted.fold(0.2, f64::max).min(5.0)
    }
}

/// Errors of witnesses.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SizeErrors {
    /// Of the log-size.
    pub log_size: SpreadErrors,
    /// Of the extent, metres, where it is known.
    pub extent: SpreadErrors,
}

impl SizeErrors {
    /// Adds what was said of a vehicle, and its truth.
    pub fn add(&mut self, said: &SizeWitness, log_size: f64, extent_m: Option<f64>) {
        self.log_size
            .add(said.log_size_mean - log_size, said.log_size_std);
        if let Some(extent_m) = extent_m {
            self.extent
                .add(said.extent_mean_m - extent_m, said.extent_std_m);
        }
    }

    /// Adds others.
    pub fn merge(&mut self, other: &Self) {
        self.log_size.merge(&other.log_size);
        self.extent.merge(&other.extent);
    }

    /// Both summaries.
    pub fn summary(&self) -> SizeSummary {
        SizeSummary {
            log_size: self.log_size.summary(),
            extent: self.extent.summary(),
        }
    }
}

/// What the errors of witnesses add up to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SizeSummary {
    /// Of the log-size: 0.05 is 5 % of size, and of distance.
    pub log_size: Option<SpreadSummary>,
    /// Of the extent, metres.
    pub extent: Option<SpreadSummary>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spreads_that_are_half_of_what_they_should_be_are_doubled_and_then_hold_what_they_promise() {
        // The quantiles of a normal distribution, by its logistic stand-in.
        let errors: Vec<f64> = (1..400)
            .map(|i| {
                let p = f64::from(i) / 400.0;
                (p / (1.0 - p)).ln() / 1.702
            })
            .collect();
        let mut narrow = SpreadErrors::default();
        for error in &errors {
            narrow.add(0.1 * error, 0.05);
        }
        let factor = narrow.factor();
        assert!((1.85..2.15).contains(&factor), "{factor}");
        let mut honest = SpreadErrors::default();
        for error in &errors {
            honest.add(0.1 * error, 0.05 * factor);
        }
        let [most, nearly_all] = honest.summary().unwrap().within;
        assert!((0.66..0.72).contains(&most), "{most}");
        assert!((0.93..0.97).contains(&nearly_all), "{nearly_all}");
    }
}
