//! The guard of the size network: how far a vehicle is from those that the network was trained on.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Share of a feature's own variance in the correlations, so that features that say the same, or
/// hardly vary in training, do not count for everything.
const SHRINKAGE: f64 = 0.2;

/// Least spread of a feature.
const LEAST_SPREAD: f64 = 1e-4;

/// Names of the guard's tensors beside the network's.
const MEAN: &str = "guard.mean";
const SCALE: &str = "guard.scale";
const WHITENING: &str = "guard.whitening";

/// Tensors by name: shape and values.
type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// Mean and correlations of the features of training vehicles.
///
/// The distance of a vehicle is Mahalanobis's: of its features, in standard deviations of the training
/// vehicles', after K. Lee and others, "A simple unified framework for detecting out-of-distribution
/// samples" (2018), with the channel means of every layer side by side: a picture of another kind
/// differs in the first layers, a vehicle from another side in the last.
#[derive(Debug, Clone, PartialEq)]
pub struct Guard {
    mean: Vec<f64>,
    scale: Vec<f64>,
    /// Inverse of the lower Cholesky factor of the correlations, row by row.
    whitening: Vec<f64>,
}

/// Distances within which a guard lets vehicles pass, and beyond which it lets none.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GuardLimits {
    /// Most vehicles of scenes that were not trained on are nearer than this.
    pub near: f64,
    /// From here on nothing is known.
    pub far: f64,
}

impl GuardLimits {
    /// How unknown a vehicle is at a distance: 0 within the near limit, 1 beyond the far one.
    pub fn unknown(&self, distance: f64) -> f64 {
        // A distance that is no number is as far as can be.
        if !distance.is_finite() {
            return 1.0;
        }
        let part = ((distance - self.near) / (self.far - self.near).max(1e-9)).clamp(0.0, 1.0);
        part * part * (3.0 - 2.0 * part)
    }
}

impl Guard {
    /// Of the features of training vehicles, all of one length; none of too few vehicles.
    pub fn fit(rows: &[Vec<f64>]) -> Option<Self> {
        let width = rows.first()?.len();
        if rows.len() < 2 {
            return None;
        }
        let count = rows.len() as f64;
        let mean: Vec<f64> = (0..width)
            .map(|column| rows.iter().map(|row| row[column]).sum::<f64>() / count)
            .collect();
        let scale: Vec<f64> = (0..width)
            .map(|column| {
                let squares = rows.iter().map(|row| (row[column] - mean[column]).powi(2));
                (squares.sum::<f64>() / count).sqrt().max(LEAST_SPREAD)
            })
            .collect();
        let mut correlations = vec![0.0; width * width];
        for row in rows {
            let values: Vec<f64> = (0..width)
                .map(|column| (row[column] - mean[column]) / scale[column])
                .collect();
            for (i, line) in correlations.chunks_exact_mut(width).enumerate() {
                for (cell, value) in line[..=i].iter_mut().zip(&values) {
                    *cell += (1.0 - SHRINKAGE) / count * values[i] * value;
                }
            }
        }
        for column in 0..width {
            correlations[column * width + column] += SHRINKAGE;
        }
        Some(Self {
            whitening: inverse_of_factor(correlations, width),
            mean,
            scale,
        })
    }

    /// Distance of a vehicle's features: about 1 for training vehicles.
    pub fn distance(&self, features: &[f64]) -> f64 {
        let width = self.mean.len();
        if features.len() != width {
            return f64::INFINITY;
        }
        let values: Vec<f64> = (0..width)
            .map(|column| (features[column] - self.mean[column]) / self.scale[column])
            .collect();
        let squares: f64 = self
            .whitening
            .chunks_exact(width)
            .map(|line| {
                let sum: f64 = line.iter().zip(&values).map(|(a, b)| a * b).sum();
                sum * sum
            })
            .sum();
        (squares / width as f64).sqrt()
    }

    /// Adds the guard to a network's tensors.
    pub fn save_into(&self, tensors: &mut Tensors) {
        let width = self.mean.len();
        let mut add = |name: &str, shape: Vec<usize>, values: &[f64]| {
            let values = values.iter().map(|value| *value as f32).collect();
            tensors.insert(name.to_owned(), (shape, values));
        };
        add(MEAN, vec![width], &self.mean);
        add(SCALE, vec![width], &self.scale);
        add(WHITENING, vec![width, width], &self.whitening);
    }

    /// Takes the guard out of a network's tensors; none where there is none.
    ///
    /// # Errors
    /// Tensors that do not fit together.
    pub fn take_from(tensors: &mut Tensors) -> Result<Option<Self>> {
        let mut take = |name: &str| -> Option<Vec<f64>> {
            let (_, values) = tensors.remove(name)?;
            Some(values.into_iter().map(f64::from).collect())
        };
        let (Some(mean), Some(scale), Some(whitening)) = (take(MEAN), take(SCALE), take(WHITENING))
        else {
            return Ok(None);
        };
        if scale.len() != mean.len() || whitening.len() != mean.len() * mean.len() {
            return Err(Error::value(
                "the size network's guard",
                "has tensors that do not fit together",
                "restore the weights that `train` wrote",
            ));
        }
        Ok(Some(Self {
            mean,
            scale,
            whitening,
        }))
    }
}

/// The inverse of the lower Cholesky factor of a symmetric positive definite matrix, of which the
/// lower half is given.
fn inverse_of_factor(mut matrix: Vec<f64>, width: usize) -> Vec<f64> {
    for row in 0..width {
        for column in 0..=row {
            let known: f64 = (0..column)
                .map(|k| matrix[row * width + k] * matrix[column * width + k])
                .sum();
            let rest = matrix[row * width + column] - known;
            matrix[row * width + column] = if row == column {
                rest.max(f64::MIN_POSITIVE).sqrt()
            } else {
                rest / matrix[column * width + column]
            };
        }
    }
    let mut inverse = vec![0.0; width * width];
    for column in 0..width {
        for row in column..width {
            let known: f64 = (column..row)
                .map(|k| matrix[row * width + k] * inverse[k * width + column])
                .sum();
            let unit = f64::from(u8::from(row == column));
            inverse[row * width + column] = (unit - known) / matrix[row * width + row];
        }
    }
    inverse
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two features that move together, and a third of its own.
    fn rows() -> Vec<Vec<f64>> {
        (0..200)
            .map(|i| {
                let a = f64::from(i % 20) / 10.0 - 0.95;
                let b = f64::from(i % 7) - 3.0;
                vec![a, 2.0 * a + 0.02 * b, 10.0 + b]
            })
            .collect()
    }

    #[test]
    fn training_vehicles_are_at_one_and_what_breaks_their_correlation_is_far() {
        let rows = rows();
        let guard = Guard::fit(&rows).unwrap();
        let mean = rows.iter().map(|row| guard.distance(row)).sum::<f64>() / rows.len() as f64;
        assert!((0.7..1.1).contains(&mean), "{mean}");
        // Each number is usual, together they are not.
        let usual = guard.distance(&[0.9, 1.8, 10.0]);
        let unusual = guard.distance(&[0.9, -1.8, 10.0]);
        assert!(unusual > 1.8 * usual, "{unusual} {usual}");
        assert!(guard.distance(&[0.0, 0.0]).is_infinite());
    }

    #[test]
    fn the_guard_comes_back_from_the_tensors() {
        let guard = Guard::fit(&rows()).unwrap();
        let mut tensors = Tensors::new();
        guard.save_into(&mut tensors);
        let back = Guard::take_from(&mut tensors).unwrap().unwrap();
        assert!(tensors.is_empty());
        let point = [0.3, 0.5, 11.0];
        assert!((back.distance(&point) - guard.distance(&point)).abs() < 1e-4);
        assert!(Guard::take_from(&mut tensors).unwrap().is_none());
    }

    #[test]
    fn between_the_limits_it_becomes_unknown_step_by_step() {
        let limits = GuardLimits {
            near: 1.0,
            far: 2.0,
        };
        assert_eq!(limits.unknown(0.5), 0.0);
        assert!((limits.unknown(1.5) - 0.5).abs() < 1e-12);
        assert_eq!(limits.unknown(3.0), 1.0);
        assert_eq!(limits.unknown(f64::NAN), 1.0);
    }
}
