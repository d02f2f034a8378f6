//! The constant of the disparity error from vehicles as rulers.
//!
//! A vehicle whose size and disparity contradict each other says that the disparity is off. Many of
//! them say by how much, trusting that vehicles are as large on average as the ranger takes them to
//! be: three centimetres of mean height more look like three hundredths of disparity more. No number
//! of vehicles makes that error smaller.

use serde::Serialize;

use crate::error::{Error, Result};

/// Fewest vehicles that are asked.
pub const LEAST_VEHICLES: usize = 20;

/// Standard deviation of the constant before any vehicle is asked, pixels.
const PRIOR_STD_PX: f64 = 1.0;

/// How far the mean height of the vehicles met may be from the one they are measured with, part of
/// the spread of a single vehicle's size: 4 cm of 12.
const MEAN_HEIGHT: f64 = 1.0 / 3.0;

/// A constant and how well it is known.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Offset {
    /// What disparities are too large by, pixels.
    pub mean_px: f64,
    /// Standard deviation, pixels; with what the vehicles' mean size is uncertain by.
    pub std_px: f64,
    /// The part of it that more vehicles would make smaller, pixels.
    pub scatter_px: f64,
}

/// The constant that vehicles agree on best: `log_evidence[i][j]` is the logarithm of the probability
/// of what is seen of vehicle `i` if disparities are too large by `deltas[j]` pixels (up to a constant
/// for each vehicle); `deltas` rise evenly.
///
/// # Errors
/// [`Error::Value`] for fewer than 20 vehicles, tables that do not fit together or hold no numbers,
/// and vehicles whose best constant lies at the end of what was tried.
pub fn constant_from_evidence(log_evidence: &[Vec<f64>], deltas: &[f64]) -> Result<Offset> {
    check(log_evidence, deltas)?;
    let prior = |delta: f64| -0.5 * (delta / PRIOR_STD_PX).powi(2);
    let sums: Vec<f64> = deltas
        .iter()
        .enumerate()
        .map(|(j, delta)| prior(*delta) + log_evidence.iter().map(|row| row[j]).sum::<f64>())
        .collect();
    let [mean_px, scatter_px] = moments(&sums, deltas);
    let step = deltas[1] - deltas[0];
    let reach = 2.0 * scatter_px.max(step);
    if mean_px - deltas[0] < reach || deltas[deltas.len() - 1] - mean_px < reach {
        return Err(Error::value(
            format!("a constant of {mean_px:.1} px"),
            "is what the vehicles' sizes say, no small error of a calibrated rig",
            "check the calibration and that the vehicles are cars, or give known distances",
        ));
    }
    // A vehicle's own table is as wide as its size is spread; a mean that is off by a part of that
    // moves each of them by that part of its width, and all of them by the mean.
    let (mut information, mut shift) = (0.0, 0.0);
    for row in log_evidence {
        let alone: Vec<f64> = row.iter().zip(deltas).map(|(l, d)| l + prior(*d)).collect();
        let [_, std_px] = moments(&alone, deltas);
        // What the prior says is not the vehicle's word.
        let own = 1.0 / (std_px * std_px).max(step * step / 12.0) - 1.0 / PRIOR_STD_PX.powi(2);
        if own > 0.0 {
            information += own;
            shift += own.sqrt();
        }
    }
    let common_px = if information > 0.0 {
        MEAN_HEIGHT * shift / (information + 1.0 / PRIOR_STD_PX.powi(2))
    } else {
        PRIOR_STD_PX
    };
    Ok(Offset {
        mean_px,
        std_px: scatter_px.hypot(common_px),
        scatter_px,
    })
}

fn check(log_evidence: &[Vec<f64>], deltas: &[f64]) -> Result<()> {
    if log_evidence.len() < LEAST_VEHICLES {
        return Err(Error::value(
            format!("{} vehicles", log_evidence.len()),
            format!("are too few to be rulers; {LEAST_VEHICLES} are needed"),
            "give more pairs with vehicles, or known distances",
        ));
    }
    let rises = deltas.windows(2).all(|pair| pair[1] > pair[0]);
    let fits = log_evidence.iter().all(|row| row.len() == deltas.len());
    let finite = log_evidence
        .iter()
        .flatten()
        .chain(deltas)
        .all(|value| value.is_finite());
    if deltas.len() < 3 || !(rises && fits && finite) {
        return Err(Error::value(
            "evidence",
            "is no table of finite numbers over rising constants",
            "report this as a bug",
        ));
    }
    Ok(())
}

/// Mean and standard deviation of a distribution by its logarithms.
fn moments(logs: &[f64], values: &[f64]) -> [f64; 2] {
    let greatest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = logs.iter().map(|l| libm::exp(l - greatest)).collect();
    let total: f64 = weights.iter().sum();
    let mean = |of: &dyn Fn(f64) -> f64| -> f64 {
        let products = weights.iter().zip(values).map(|(w, v)| w * of(*v));
        products.sum::<f64>() / total
    };
    let middle = mean(&|v| v);
    [middle, mean(&|v| (v - middle) * (v - middle)).sqrt()]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn deltas() -> Vec<f64> {
        (-40..=40).map(|i| f64::from(i) * 0.1).collect()
    }

    /// A vehicle whose size says this, within a spread, with a floor as for wrong matches.
    fn vehicle(says_px: f64, spread_px: f64) -> Vec<f64> {
        let log = |delta: &f64| {
            libm::log(libm::exp(-0.5 * ((delta - says_px) / spread_px).powi(2)) + 0.005)
        };
        deltas().iter().map(log).collect()
    }

    /// Numbers that scatter evenly around 0 with a standard deviation of about 1.
    fn scatter(i: usize) -> f64 {
        ((i * 37 % 101) as f64 / 100.0 - 0.5) * 3.46
    }

    #[test]
    fn vehicles_that_agree_tell_the_constant_within_its_error() {
        let spread_px = 0.8;
        let vehicles: Vec<_> = (0..101)
            .map(|i| vehicle(-0.5 + spread_px * scatter(i), spread_px))
            .collect();
        let offset = constant_from_evidence(&vehicles, &deltas()).unwrap();
        assert!((offset.mean_px + 0.5).abs() < 0.05, "{offset:?}");
        assert!((0.05..0.15).contains(&offset.scatter_px), "{offset:?}");
        // A third of a single vehicle's spread stays.
        assert!((0.2..0.35).contains(&offset.std_px), "{offset:?}");
    }

    #[test]
    fn more_vehicles_lessen_the_scatter_and_not_what_their_mean_size_leaves_open() {
        let of = |count: usize| {
            let vehicles: Vec<_> = (0..count).map(|i| vehicle(0.3 + scatter(i), 1.0)).collect();
            constant_from_evidence(&vehicles, &deltas()).unwrap()
        };
        let [few, many] = [of(30), of(303)];
        assert!(many.scatter_px < 0.5 * few.scatter_px, "{few:?} {many:?}");
        assert!(many.std_px > 0.7 * few.std_px, "{few:?} {many:?}");
    }

    #[test]
    fn a_few_wrong_vehicles_do_not_move_the_constant() {
        let mut vehicles: Vec<_> = (0..40)
            .map(|i| vehicle(0.2 + 0.3 * scatter(i), 0.5))
            .collect();
        vehicles.extend((0..4).map(|_| vehicle(3.5, 0.5)));
        let offset = constant_from_evidence(&vehicles, &deltas()).unwrap();
        assert!((offset.mean_px - 0.2).abs() < 0.15, "{offset:?}");
    }

    #[test]
    fn vehicles_that_know_nothing_leave_what_was_known_before() {
        let vehicles = vec![vec![-3.0; 81]; 25];
        let offset = constant_from_evidence(&vehicles, &deltas()).unwrap();
        assert!(
            offset.mean_px.abs() < 1e-9 && offset.std_px > 0.9,
            "{offset:?}"
        );
    }

    #[test]
    fn too_few_vehicles_and_tables_that_are_none_are_refused() {
        let text = |vehicles: &[Vec<f64>], deltas: &[f64]| {
            constant_from_evidence(vehicles, deltas)
                .unwrap_err()
                .to_string()
        };
        let good = vec![vehicle(0.0, 1.0); 25];
        assert!(text(&good[..19], &deltas()).contains("19 vehicles"));
        assert!(text(&good, &deltas()[1..]).contains("no table"));
        let mut broken = good.clone();
        broken[3][7] = f64::NAN;
        assert!(text(&broken, &deltas()).contains("finite"));
        let far = vec![vehicle(3.9, 0.3); 25];
        assert!(text(&far, &deltas()).contains("no small error"));
    }
}
