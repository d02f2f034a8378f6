//! How far the spread that comes with a distance can be believed.

use serde::{Deserialize, Serialize};

use super::vehicles::{Boxes, VehicleRow};

/// Upper ends of the groups of predicted spread, as a part of the distance.
const SPREADS: [f64; 6] = [0.01, 0.02, 0.04, 0.08, 0.16, f64::INFINITY];

/// Probabilities of the intervals that are compared with what they hold, percent.
const PROBABILITIES: [u32; 11] = [10, 20, 30, 40, 50, 60, 68, 80, 90, 95, 99];

/// What intervals of a probability hold; a row of `reliability.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ReliabilityRow {
    /// Where the boxes come from.
    pub boxes: Boxes,
    /// Vehicles with a posterior.
    pub vehicles: usize,
    /// Probability of the central interval, percent.
    pub probability_percent: f64,
    /// Vehicles whose distance it holds, percent.
    pub held_percent: f64,
}

/// Errors of vehicles of about one predicted spread; a row of `spread.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpreadRow {
    /// Where the boxes come from.
    pub boxes: Boxes,
    /// Predicted standard deviations of the group, as "2-4 %" of the distance.
    pub group: String,
    /// Vehicles in it.
    pub vehicles: usize,
    /// Root of their mean predicted variance, percent of the distance.
    pub predicted_percent: f64,
    /// Root of their mean squared error, percent of the distance.
    pub rmse_percent: f64,
    /// Their mean relative error, percent.
    pub mre_percent: f64,
    /// Of them, those whose 95 % interval holds the distance, percent.
    pub coverage_95: f64,
}

/// What intervals hold, by probability.
pub(super) fn reliability(vehicles: &[VehicleRow]) -> Vec<ReliabilityRow> {
    let mut rows = Vec::new();
    for boxes in Boxes::ALL {
        let below: Vec<f64> = vehicles
            .iter()
            .filter_map(|vehicle| Some(vehicle.spread(boxes)?.below))
            .collect();
        if below.is_empty() {
            continue;
        }
        rows.extend(PROBABILITIES.map(|probability| {
            let part = f64::from(probability) / 100.0;
            let held = below.iter().filter(|&&b| (2.0 * b - 1.0).abs() <= part);
            ReliabilityRow {
                boxes,
                vehicles: below.len(),
                probability_percent: f64::from(probability),
                held_percent: 100.0 * held.count() as f64 / below.len() as f64,
            }
        }));
    }
    rows
}

/// Errors by predicted spread.
pub(super) fn by_spread(vehicles: &[VehicleRow]) -> Vec<SpreadRow> {
    let mut rows = Vec::new();
    for boxes in Boxes::ALL {
        // Predicted spread and error as parts of the distance, and whether the interval holds.
        let all: Vec<(f64, f64, bool)> = vehicles
            .iter()
            .filter_map(|vehicle| {
                let spread = vehicle.spread(boxes)?;
                let estimate = vehicle.estimate(boxes, super::Method::Fused)?;
                let true_m = vehicle.distance_m;
                let [low, high] = spread.within_95_m;
                let held = (low..=high).contains(&true_m);
                Some((spread.std_m / estimate, estimate / true_m - 1.0, held))
            })
            .collect();
        let mut least = 0.0;
        for most in SPREADS {
            let group: Vec<_> = all
                .iter()
                .filter(|(spread, _, _)| (least..most).contains(spread))
                .collect();
            let name = if most.is_finite() {
                format!("{:.0}-{:.0} %", 100.0 * least, 100.0 * most)
            } else {
                format!("above {:.0} %", 100.0 * least)
            };
            least = most;
            if group.is_empty() {
                continue;
            }
            let mean = |of: &dyn Fn(&(f64, f64, bool)) -> f64| {
                group.iter().map(|vehicle| of(vehicle)).sum::<f64>() / group.len() as f64
            };
            rows.push(SpreadRow {
                boxes,
                group: name,
                vehicles: group.len(),
                predicted_percent: 100.0 * mean(&|v| v.0 * v.0).sqrt(),
                rmse_percent: 100.0 * mean(&|v| v.1 * v.1).sqrt(),
                mre_percent: 100.0 * mean(&|v| v.1.abs()),
                coverage_95: 100.0 * mean(&|v| f64::from(u8::from(v.2))),
            });
        }
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vehicle(estimate_m: f64, std_m: f64, below: f64) -> VehicleRow {
        VehicleRow {
            distance_m: 10.0,
            fused_m: Some(estimate_m),
            fused_std_m: Some(std_m),
            fused_low_68_m: Some(estimate_m - std_m),
            fused_high_68_m: Some(estimate_m + std_m),
            fused_low_m: Some(estimate_m - 2.0 * std_m),
            fused_high_m: Some(estimate_m + 2.0 * std_m),
            fused_nll: Some(0.0),
            fused_below: Some(below),
            ..VehicleRow::default()
        }
    }

    #[test]
    fn even_probabilities_lie_on_the_diagonal() {
        let vehicles: Vec<VehicleRow> = (0..1000)
            .map(|i| vehicle(10.0, 0.3, (f64::from(i) + 0.5) / 1000.0))
            .collect();
        let rows = reliability(&vehicles);
        assert_eq!(rows.len(), PROBABILITIES.len());
        for row in rows {
            assert_eq!((row.boxes, row.vehicles), (Boxes::True, 1000));
            assert!((row.held_percent - row.probability_percent).abs() < 0.2);
        }
        assert!(reliability(&[VehicleRow::default()]).is_empty());
    }

    #[test]
    fn errors_stand_beside_the_spread_that_was_predicted() {
        let vehicles = [
            vehicle(10.1, 0.15, 0.3),
            vehicle(9.7, 0.15, 0.9),
            vehicle(12.0, 3.0, 0.2),
        ];
        let rows = by_spread(&vehicles);
        let groups: Vec<&str> = rows.iter().map(|row| row.group.as_str()).collect();
        assert_eq!(groups, ["1-2 %", "above 16 %"]);
        assert!((rows[0].mre_percent - 2.0).abs() < 1e-9, "{rows:?}");
        assert!((rows[0].rmse_percent - 5.0_f64.sqrt()).abs() < 1e-9);
        assert!((rows[1].predicted_percent - 25.0).abs() < 1e-9);
        assert_eq!((rows[0].coverage_95, rows[1].coverage_95), (100.0, 100.0));
    }
}
