//! A posterior over the distance of one vehicle.

/// Cells of the grid of an unknown distance.
const UNKNOWN_CELLS: u32 = 200;

/// Least share of the probability that a mode must hold to be told.
const LEAST_MODE: f64 = 0.1;

/// A valley between two modes must be this much lower than the lower one of their peaks: below it
/// the two are one wide peak.
const VALLEY: f64 = 0.35;

/// How probable each distance of a vehicle is: a density on a grid, which integrates to one.
///
/// Between the points of the grid the density is linear.
#[derive(Debug, Clone, PartialEq)]
pub struct Posterior {
    distance_m: Vec<f64>,
    density: Vec<f64>,
    /// Probability up to each point of the grid.
    cumulative: Vec<f64>,
}

/// A separate peak of a posterior.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mode {
    /// Where the peak is, metres.
    pub distance_m: f64,
    /// Probability between the valleys on both of its sides, 0 to 1.
    pub probability: f64,
}

impl Posterior {
    /// The density that is proportional to the exponential of `log_density`, per metre, at distances
    /// in metres that ascend. None where there are fewer than two, or where nothing is finite.
    pub fn new(distance_m: Vec<f64>, log_density: &[f64]) -> Option<Self> {
        let usable = distance_m.len() >= 2
            && distance_m.len() == log_density.len()
            && distance_m.windows(2).all(|pair| pair[0] < pair[1]);
        let most = log_density
            .iter()
            .copied()
            .filter(|value| !value.is_nan())
            .fold(f64::NEG_INFINITY, f64::max);
        if !usable || !most.is_finite() {
            return None;
        }
        let relative = |log: &f64| {
            let value = libm::exp(log - most);
            if value.is_nan() { 0.0 } else { value }
        };
        let density = log_density.iter().map(relative).collect();
        Some(Self::normalised(distance_m, density))
    }

    /// A density that is above 0 somewhere, made to integrate to one.
    fn normalised(distance_m: Vec<f64>, mut density: Vec<f64>) -> Self {
        let mut cumulative = Vec::with_capacity(density.len());
        let mut total = 0.0;
        cumulative.push(0.0);
        for (distance, density) in distance_m.windows(2).zip(density.windows(2)) {
            total += (distance[1] - distance[0]) * f64::midpoint(density[0], density[1]);
            cumulative.push(total);
        }
        for value in density.iter_mut().chain(&mut cumulative) {
            *value /= total;
        }
        Self {
            distance_m,
            density,
            cumulative,
        }
    }

    /// Every logarithm of a distance between two as probable as any other: nothing is known. The nearer
    /// one must be above 0 and below the farther one; else it is the first metre.
    pub fn unknown(nearest_m: f64, farthest_m: f64) -> Self {
        let is_usable = nearest_m > 0.0 && nearest_m < farthest_m && farthest_m.is_finite();
        let [nearest_m, farthest_m] = if is_usable {
            [nearest_m, farthest_m]
        } else {
            [1.0, 2.0]
        };
        let step = libm::log(farthest_m / nearest_m) / f64::from(UNKNOWN_CELLS);
        let distance_m: Vec<f64> = (0..=UNKNOWN_CELLS)
            .map(|i| nearest_m * libm::exp(step * f64::from(i)))
            .collect();
        let weight: Vec<f64> = distance_m
            .iter()
            .map(|distance_m| 1.0 / distance_m)
            .collect();
        Self::normalised(distance_m, weight)
    }

    /// The grid: distances in metres, ascending.
    pub fn distances_m(&self) -> &[f64] {
        &self.distance_m
    }

    /// The density at each point of the grid, per metre.
    pub fn density(&self) -> &[f64] {
        &self.density
    }

    /// The density at a distance, per metre; 0 outside the grid.
    pub fn density_at(&self, distance_m: f64) -> f64 {
        let last = self.distance_m.len() - 1;
        if !(self.distance_m[0]..=self.distance_m[last]).contains(&distance_m) {
            return 0.0;
        }
        let i = self.cell(&self.distance_m, distance_m);
        let part =
            (distance_m - self.distance_m[i]) / (self.distance_m[i + 1] - self.distance_m[i]);
        self.density[i] + part * (self.density[i + 1] - self.density[i])
    }

    /// The distance that the vehicle is nearer than with this probability, metres.
    pub fn quantile(&self, probability: f64) -> f64 {
        let probability = probability.clamp(0.0, 1.0);
        let i = self.cell(&self.cumulative, probability);
        let width = self.distance_m[i + 1] - self.distance_m[i];
        let wanted = probability - self.cumulative[i];
        let (a, b) = (self.density[i], self.density[i + 1]);
        // The density is linear in the cell, so this solves a quadratic; the form without
        // cancellation.
        let slope = (b - a) / width;
        let root = (a * a + 2.0 * slope * wanted).max(0.0).sqrt();
        let way = if a + root > 0.0 {
            2.0 * wanted / (a + root)
        } else {
            0.0
        };
        self.distance_m[i] + way.clamp(0.0, width)
    }

    /// The probability that the vehicle is nearer than this, the inverse of [`Posterior::quantile`].
    pub fn probability_below(&self, distance_m: f64) -> f64 {
        if distance_m <= self.distance_m[0] {
            return 0.0;
        }
        if distance_m >= self.distance_m[self.distance_m.len() - 1] {
            return 1.0;
        }
        let i = self.cell(&self.distance_m, distance_m);
        let way = distance_m - self.distance_m[i];
        self.cumulative[i] + way * f64::midpoint(self.density[i], self.density_at(distance_m))
    }

    /// The middle: as probably nearer as farther, metres.
    pub fn median_m(&self) -> f64 {
        self.quantile(0.5)
    }

    /// The interval that holds the distance with this probability and leaves out as much on either
    /// side, metres.
    pub fn interval_m(&self, probability: f64) -> [f64; 2] {
        let outside = 0.5 * (1.0 - probability.clamp(0.0, 1.0));
        [self.quantile(outside), self.quantile(1.0 - outside)]
    }

    /// The mean, metres.
    pub fn mean_m(&self) -> f64 {
        self.moment(|distance_m| distance_m)
    }

    /// Standard deviation, metres.
    pub fn std_m(&self) -> f64 {
        let mean = self.mean_m();
        self.moment(|distance_m| (distance_m - mean).powi(2))
            .max(0.0)
            .sqrt()
    }

    /// Its separate peaks with at least a tenth of the probability, the most probable one first;
    /// always at least one.
    pub fn modes(&self) -> Vec<Mode> {
        // A peak ends where the density falls below a share of it and rises again.
        let mut modes = Vec::new();
        let (mut begin, mut peak, mut valley) = (0, 0, 0);
        for i in 1..self.density.len() {
            if self.density[i] > self.density[peak] && valley == peak {
                (peak, valley) = (i, i);
            } else if self.density[i] < self.density[valley] {
                valley = i;
            }
            let lower = self.density[peak].min(self.density[i]);
            let is_separate = self.density[valley] < VALLEY * lower && valley > peak;
            if is_separate {
                modes.push(self.mode(begin, peak, valley));
                (begin, peak, valley) = (valley, i, i);
            } else if self.density[i] > self.density[peak] {
                (peak, valley) = (i, i);
            }
        }
        modes.push(self.mode(begin, peak, self.density.len() - 1));
        modes.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        let told = modes
            .iter()
            .take_while(|mode| mode.probability >= LEAST_MODE)
            .count();
        modes.truncate(told.max(1));
        modes
    }

    fn mode(&self, begin: usize, peak: usize, end: usize) -> Mode {
        Mode {
            distance_m: self.distance_m[peak],
            probability: self.cumulative[end] - self.cumulative[begin],
        }
    }

    /// Mean of a function of the distance, by the trapezoidal rule that the density is normalised by.
    fn moment(&self, of: impl Fn(f64) -> f64) -> f64 {
        let cells = self.distance_m.windows(2).zip(self.density.windows(2));
        cells
            .map(|(distance, density)| {
                let [a, b] = [0, 1].map(|i| of(distance[i]) * density[i]);
                (distance[1] - distance[0]) * f64::midpoint(a, b)
            })
            .sum()
    }

    /// The cell of ascending values that holds a value: its first index.
    fn cell(&self, values: &[f64], value: f64) -> usize {
        let above = values.partition_point(|&v| v <= value);
        above.saturating_sub(1).min(self.distance_m.len() - 2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Vec<f64> {
        (0..600)
            .map(|i| 3.0 * libm::exp(f64::from(i) * 0.0075))
            .collect()
    }

    fn bell(distance_m: f64, mean: f64, std: f64) -> f64 {
        libm::exp(-0.5 * ((distance_m - mean) / std).powi(2)) / std
    }

    fn posterior(density: impl Fn(f64) -> f64) -> Posterior {
        let grid = grid();
        let log: Vec<f64> = grid.iter().map(|&d| libm::log(density(d))).collect();
        Posterior::new(grid, &log).unwrap()
    }

    #[test]
    fn a_bell_has_its_mean_its_spread_and_its_quantiles() {
        let p = posterior(|d| bell(d, 40.0, 2.0));
        assert!((p.median_m() - 40.0).abs() < 0.01, "{}", p.median_m());
        assert!((p.mean_m() - 40.0).abs() < 0.01);
        assert!((p.std_m() - 2.0).abs() < 0.02, "{}", p.std_m());
        let [low, high] = p.interval_m(0.95);
        assert!((low - 36.08).abs() < 0.03 && (high - 43.92).abs() < 0.03);
        assert_eq!(p.modes().len(), 1);
    }

    #[test]
    fn it_integrates_to_one_and_quantiles_rise() {
        let p = posterior(|d| 0.7 * bell(d, 20.0, 0.6) + 0.3 * bell(d, 60.0, 9.0) + 1e-4);
        let integral: f64 = p
            .distances_m()
            .windows(2)
            .zip(p.density().windows(2))
            .map(|(d, q)| (d[1] - d[0]) * f64::midpoint(q[0], q[1]))
            .sum();
        assert!((integral - 1.0).abs() < 1e-12);
        let quantiles: Vec<f64> = (0..=1000)
            .map(|i| p.quantile(f64::from(i) / 1000.0))
            .collect();
        assert!(quantiles.windows(2).all(|q| q[0] <= q[1]));
        for (i, quantile) in quantiles.iter().enumerate() {
            assert!((p.probability_below(*quantile) - i as f64 / 1000.0).abs() < 1e-9);
        }
        assert_eq!(quantiles[0], 3.0);
        assert!((quantiles[1000] - p.distances_m()[599]).abs() < 1e-9);
    }

    #[test]
    fn two_places_are_two_modes_and_a_shoulder_is_none() {
        let two = posterior(|d| 0.6 * bell(d, 20.0, 0.6) + 0.4 * bell(d, 30.0, 0.6)).modes();
        assert_eq!(two.len(), 2);
        assert!((two[0].distance_m - 20.0).abs() < 0.2 && (two[0].probability - 0.6).abs() < 0.01);
        assert!((two[1].distance_m - 30.0).abs() < 0.2 && (two[1].probability - 0.4).abs() < 0.01);
        let shoulder = posterior(|d| 0.6 * bell(d, 20.0, 0.6) + 0.4 * bell(d, 21.2, 0.6));
        assert_eq!(shoulder.modes().len(), 1);
        let small = posterior(|d| 0.95 * bell(d, 20.0, 0.6) + 0.05 * bell(d, 30.0, 0.6));
        assert_eq!(small.modes().len(), 1);
    }

    #[test]
    fn nothing_known_is_even_in_the_logarithm() {
        let unknown = Posterior::unknown(2.0, 200.0);
        assert!(
            (unknown.median_m() - 20.0).abs() < 0.01,
            "{}",
            unknown.median_m()
        );
        assert_eq!(unknown.quantile(0.0), 2.0);
        assert!(Posterior::unknown(-1.0, f64::NAN).median_m().is_finite());
    }

    #[test]
    fn what_is_no_density_is_refused() {
        assert_eq!(Posterior::new(vec![1.0], &[0.0]), None);
        assert_eq!(Posterior::new(vec![1.0, 1.0], &[0.0, 0.0]), None);
        assert_eq!(Posterior::new(vec![1.0, 2.0], &[f64::NAN, f64::NAN]), None);
        let none = [f64::NEG_INFINITY; 2];
        assert_eq!(Posterior::new(vec![1.0, 2.0], &none), None);
    }
}
