//! The guard of the size network: how far a vehicle is from those that the network was trained on.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::metrics::quantile_of;

/// Share of a feature's own variance in the correlations, so that features that say the same, or
/// hardly vary in training, do not count for everything.
const SHRINKAGE: f64 = 0.05;

/// Share of the vehicles of unseen scenes that are nearer than 1 in each part.
const USUAL: f64 = 0.95;

/// Least spread of a feature.
const LEAST_SPREAD: f64 = 1e-4;

/// The parts of the evidence, and what is kept of each, in the names of tensors.
const PARTS: [&str; 3] = ["angles", "picture", "features"];
const MEAN: &str = "mean";
const SCALE: &str = "scale";
const WHITENING: &str = "whitening";
const UNIT: &str = "unit";

/// Tensors by name: shape and values.
type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// What a guard is told of a vehicle.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GuardEvidence {
    /// Logarithms of the box's angular sides.
    pub angles: Vec<f64>,
    /// Numbers of the picture.
    pub picture: Vec<f64>,
    /// Hidden features of the network.
    pub features: Vec<f64>,
}

impl GuardEvidence {
    fn parts(&self) -> [&[f64]; PARTS.len()] {
        [&self.angles, &self.picture, &self.features]
    }
}

/// What the training vehicles were like: how large in the image, what picture, what features.
///
/// The distance of a vehicle is the largest of the three, each of them Mahalanobis's (K. Lee and others,
/// "A simple unified framework for detecting out-of-distribution samples", 2018) over what most vehicles
/// of unseen scenes stay below. One distance over all numbers was tried and saw little: hundreds of
/// usual features outweigh a few strange numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Guard {
    parts: Vec<Likeness>,
}

/// Mean and correlations of some numbers of training vehicles, and the distance that is one.
#[derive(Debug, Clone, PartialEq)]
struct Likeness {
    mean: Vec<f64>,
    scale: Vec<f64>,
    /// Inverse of the lower Cholesky factor of the correlations, row by row.
    whitening: Vec<f64>,
    unit: f64,
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

/// How unlike the training frames a whole image's vehicles may be: what all of them share, such as the
/// camera and the place, shows better in their mean than in any one of them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameLimits {
    /// Distance of a usual vehicle.
    pub usual: f64,
    /// Limits of the mean over an image, of which `USUAL_VEHICLES` usual ones are a part.
    pub limits: GuardLimits,
}

/// Usual vehicles that every image's mean begins with, so that a single strange one says little of it.
const USUAL_VEHICLES: f64 = 2.0;

/// A single vehicle's distance counts for no more than so many usual ones.
const LARGEST_SHARE: f64 = 3.0;

impl FrameLimits {
    /// Mean distance of an image's vehicles, the usual ones among them.
    pub fn mean(usual: f64, distances: &[f64]) -> f64 {
        let most = LARGEST_SHARE * usual;
        // Not `clamp`: what is no number counts as the largest.
        let capped = |&distance: &f64| if distance < most { distance } else { most };
        let sum: f64 = distances.iter().map(capped).sum();
        (USUAL_VEHICLES * usual + sum) / (USUAL_VEHICLES + distances.len() as f64)
    }

    /// How unknown all vehicles of an image are.
    pub fn unknown(&self, distances: &[f64]) -> f64 {
        self.limits.unknown(Self::mean(self.usual, distances))
    }
}

impl Guard {
    /// Of training vehicles; `unseen` are those of other scenes that say what is usual, without which
    /// the training vehicles do. None of too few vehicles.
    pub fn fit(seen: &[GuardEvidence], unseen: &[GuardEvidence]) -> Option<Self> {
        if seen.len() < 2 {
            return None;
        }
        let judged = if unseen.is_empty() { seen } else { unseen };
        let parts = (0..PARTS.len()).map(|part| {
            let rows: Vec<&[f64]> = seen.iter().map(|vehicle| vehicle.parts()[part]).collect();
            let mut likeness = Likeness::fit(&rows);
            let distances = judged.iter().map(|v| likeness.distance(v.parts()[part]));
            likeness.unit = quantile_of(distances, USUAL).max(1e-6);
            likeness
        });
        Some(Self {
            parts: parts.collect(),
        })
    }

    /// Distance of a vehicle: below 1 for most vehicles of unseen scenes.
    pub fn distance(&self, vehicle: &GuardEvidence) -> f64 {
        self.parts
            .iter()
            .zip(vehicle.parts())
            .map(|(likeness, values)| likeness.distance(values))
            // A distance that is no number counts as the largest.
            .fold(0.0, |largest, distance| {
                if distance.is_nan() || distance > largest {
                    distance
                } else {
                    largest
                }
            })
    }

    /// Adds the guard to a network's tensors.
    pub fn save_into(&self, tensors: &mut Tensors) {
        for (name, part) in PARTS.iter().zip(&self.parts) {
            let width = part.mean.len();
            let mut add = |what: &str, shape: Vec<usize>, values: &[f64]| {
                let values = values.iter().map(|value| *value as f32).collect();
                tensors.insert(format!("guard.{name}.{what}"), (shape, values));
            };
            add(MEAN, vec![width], &part.mean);
            add(SCALE, vec![width], &part.scale);
            add(WHITENING, vec![width, width], &part.whitening);
            add(UNIT, vec![1], &[part.unit]);
        }
    }

    /// Takes the guard out of a network's tensors; none where there is none.
    ///
    /// # Errors
    /// Tensors that do not fit together.
    pub fn take_from(tensors: &mut Tensors) -> Result<Option<Self>> {
        let mut parts = Vec::with_capacity(PARTS.len());
        for name in PARTS {
            let mut take = |what: &str| -> Vec<f64> {
                let taken = tensors.remove(&format!("guard.{name}.{what}"));
                let values = taken.map(|(_, values)| values).unwrap_or_default();
                values.into_iter().map(f64::from).collect()
            };
            let (mean, scale) = (take(MEAN), take(SCALE));
            let (whitening, unit) = (take(WHITENING), take(UNIT));
            parts.push((mean, scale, whitening, unit));
        }
        if parts.iter().all(|(mean, ..)| mean.is_empty()) {
            return Ok(None);
        }
        let parts = parts.into_iter().map(|(mean, scale, whitening, unit)| {
            let width = mean.len();
            let fits = width > 0 && scale.len() == width && whitening.len() == width * width;
            match unit[..] {
                [unit] if fits => Ok(Likeness {
                    mean,
                    scale,
                    whitening,
                    unit,
                }),
                _ => Err(Error::value(
                    "the size network's guard",
                    "has tensors that do not fit together",
                    "restore the weights that `train` wrote",
                )),
            }
        });
        Ok(Some(Self {
            parts: parts.collect::<Result<_>>()?,
        }))
    }
}

impl Likeness {
    fn fit(rows: &[&[f64]]) -> Self {
        let width = rows.first().map_or(0, |row| row.len());
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
            for (i, line) in correlations.chunks_exact_mut(width.max(1)).enumerate() {
                for (cell, value) in line[..=i].iter_mut().zip(&values) {
                    *cell += (1.0 - SHRINKAGE) / count * values[i] * value;
                }
            }
        }
        for column in 0..width {
            correlations[column * width + column] += SHRINKAGE;
        }
        Self {
            whitening: inverse_of_factor(correlations, width),
            mean,
            scale,
            unit: 1.0,
        }
    }

    fn distance(&self, values: &[f64]) -> f64 {
        let width = self.mean.len();
        if values.len() != width {
            return f64::INFINITY;
        }
        let values: Vec<f64> = (0..width)
            .map(|column| (values[column] - self.mean[column]) / self.scale[column])
            .collect();
        let squares: f64 = self
            .whitening
            .chunks_exact(width.max(1))
            .map(|line| {
                let sum: f64 = line.iter().zip(&values).map(|(a, b)| a * b).sum();
                sum * sum
            })
            .sum();
        (squares / width.max(1) as f64).sqrt() / self.unit
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

    fn vehicles() -> Vec<GuardEvidence> {
        let rows = rows().into_iter().enumerate();
        rows.map(|(i, row)| GuardEvidence {
            angles: vec![(i % 11) as f64 / 10.0, (i % 13) as f64 / 10.0],
            picture: vec![(i % 3) as f64],
            features: row,
        })
        .collect()
    }

    #[test]
    fn most_vehicles_are_within_one_and_what_breaks_a_correlation_or_a_single_part_is_not() {
        let vehicles = vehicles();
        let guard = Guard::fit(&vehicles, &[]).unwrap();
        let within = vehicles.iter().filter(|v| guard.distance(v) <= 1.0).count();
        assert!(within >= 160, "{within}");
        let like = |change: &dyn Fn(&mut GuardEvidence)| {
            let mut vehicle = GuardEvidence {
                angles: vec![0.5, 0.6],
                picture: vec![1.0],
                features: vec![0.9, 1.8, 10.0],
            };
            change(&mut vehicle);
            guard.distance(&vehicle)
        };
        assert!(like(&|_| {}) < 1.0);
        // Each number is usual, together they are not.
        assert!(like(&|v| v.features[1] = -1.8) > 1.5);
        assert!(like(&|v| v.angles[0] = 4.0) > 1.5);
        assert!(like(&|v| v.picture.clear()).is_infinite());
        assert!(like(&|v| v.picture[0] = f64::NAN).is_nan());
    }

    #[test]
    fn the_guard_comes_back_from_the_tensors() {
        let vehicles = vehicles();
        let guard = Guard::fit(&vehicles, &vehicles[..50]).unwrap();
        let mut tensors = Tensors::new();
        guard.save_into(&mut tensors);
        let mut broken = tensors.clone();
        let back = Guard::take_from(&mut tensors).unwrap().unwrap();
        assert!(tensors.is_empty());
        for vehicle in &vehicles[..9] {
            let difference = back.distance(vehicle) - guard.distance(vehicle);
            assert!(difference.abs() < 1e-4, "{difference}");
        }
        assert!(Guard::take_from(&mut tensors).unwrap().is_none());
        broken.remove("guard.picture.scale");
        assert!(Guard::take_from(&mut broken).is_err());
    }

    #[test]
    fn many_slightly_strange_vehicles_make_a_strange_image_and_a_single_one_does_not() {
        let limits = FrameLimits {
            usual: 0.7,
            limits: GuardLimits {
                near: 0.85,
                far: 1.0,
            },
        };
        assert_eq!(limits.unknown(&[0.7, 0.6, 0.8]), 0.0);
        assert_eq!(limits.unknown(&[1.1]), 0.0);
        assert!(limits.unknown(&[1.1; 6]) > 0.9);
        assert!(limits.unknown(&[f64::NAN, 1.0]) > 0.9);
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
