//! Tables of distance errors: every method, from labelled and from detected boxes, over all vehicles
//! and over groups of them.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::groups::{Grouping, Groups};
use super::vehicles::{Boxes, FalseVehicle, Method, VehicleRow};
use crate::metrics::{DistanceErrors, Interval, Resamples};

/// One method in one group of vehicles; a row of `distance.csv`. Bounds hold in 95 % of the
/// bootstrap's draws.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DistanceRow {
    /// Where the boxes come from.
    pub boxes: Boxes,
    /// The way to the distance.
    pub method: Method,
    /// What the vehicles are grouped by.
    pub grouping: Grouping,
    /// The group.
    pub group: String,
    /// Labelled vehicles in the group.
    pub vehicles: usize,
    /// Of these, with an estimate: the figures are theirs.
    pub answered: usize,
    /// Of these, without: missed by the pipeline, or the method has no answer.
    pub unanswered: usize,
    /// Vehicles that the pipeline made up; empty for true boxes and for views.
    pub false_vehicles: Option<usize>,
    /// Mean absolute error, metres.
    pub mae_m: Option<f64>,
    /// Bound of the mean absolute error.
    pub mae_low_m: Option<f64>,
    /// Bound of the mean absolute error.
    pub mae_high_m: Option<f64>,
    /// Root of the mean squared error, metres.
    pub rmse_m: Option<f64>,
    /// Bound of the root of the mean squared error.
    pub rmse_low_m: Option<f64>,
    /// Bound of the root of the mean squared error.
    pub rmse_high_m: Option<f64>,
    /// Mean relative error, percent.
    pub mre_percent: Option<f64>,
    /// Bound of the mean relative error.
    pub mre_low_percent: Option<f64>,
    /// Bound of the mean relative error.
    pub mre_high_percent: Option<f64>,
    /// Mean relative error as a fraction.
    pub abs_rel: Option<f64>,
    /// Mean squared error over distance, metres.
    pub sq_rel_m: Option<f64>,
    /// Root of the mean squared logarithmic error.
    pub rmse_log: Option<f64>,
    /// Share with a ratio below 1.25.
    pub delta1: Option<f64>,
    /// Share with a ratio below 1.25 squared.
    pub delta2: Option<f64>,
    /// Share with a ratio below 1.25 cubed.
    pub delta3: Option<f64>,
    /// Median absolute error, metres.
    pub median_m: Option<f64>,
    /// Mean error, metres: positive when too far.
    pub bias_m: Option<f64>,
    /// Absolute error that 95 % do not exceed, metres.
    pub p95_m: Option<f64>,
    /// Largest absolute error, metres.
    pub max_m: Option<f64>,
    /// Share within 5 % of the truth.
    pub within_5_percent: Option<f64>,
}

/// The ranger in use against another method on the vehicles that both have an estimate of; a row of
/// `differences.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DifferenceRow {
    /// Where the boxes come from.
    pub boxes: Boxes,
    /// The other method.
    pub method: Method,
    /// Vehicles that both have an estimate of.
    pub vehicles: usize,
    /// The ranger's mean absolute error on them, metres.
    pub ranger_mae_m: f64,
    /// The other method's.
    pub method_mae_m: f64,
    /// The ranger's less the other method's: negative where the ranger is better.
    pub difference_m: f64,
    /// Bound of the difference.
    pub low_m: Option<f64>,
    /// Bound of the difference: below 0, the ranger is better beyond chance.
    pub high_m: Option<f64>,
}

/// Which vehicles are drawn together, see [`Resamples`].
#[derive(Debug, Clone)]
pub(crate) struct Drawing {
    pub resamples: Resamples,
    /// "scene" or "frame".
    pub unit: &'static str,
    /// The group of each frame, by stamp.
    group_of_frame: BTreeMap<u64, usize>,
}

/// Scenes are drawn whole where there are at least this many: fewer make hardly any draws.
const LEAST_SCENES: usize = 5;

impl Drawing {
    /// Draws scenes where every frame has one and there are enough, frames otherwise.
    pub fn new(frames: &[(u64, Option<u32>)], draws: usize) -> Self {
        let scenes: BTreeSet<u32> = frames.iter().filter_map(|(_, scene)| *scene).collect();
        let by_scene =
            scenes.len() >= LEAST_SCENES && frames.iter().all(|(_, scene)| scene.is_some());
        let number: BTreeMap<u32, usize> = scenes.into_iter().zip(0..).collect();
        let group_of_frame: BTreeMap<u64, usize> = frames
            .iter()
            .enumerate()
            .map(|(i, (stamp, scene))| {
                let of_scene = scene.and_then(|scene| number.get(&scene).copied());
                (*stamp, of_scene.filter(|_| by_scene).unwrap_or(i))
            })
            .collect();
        let groups = if by_scene { number.len() } else { frames.len() };
        Self {
            resamples: Resamples::new(groups, draws),
            unit: if by_scene { "scene" } else { "frame" },
            group_of_frame,
        }
    }

    /// The group of a frame.
    pub fn group(&self, stamp: u64) -> usize {
        self.group_of_frame.get(&stamp).copied().unwrap_or_default()
    }

    /// Sums of some values of each vehicle, by the group of its frame.
    pub fn sums<const N: usize>(
        &self,
        values: impl Iterator<Item = (u64, [f64; N])>,
    ) -> Vec<[f64; N]> {
        let mut sums = vec![[0.0; N]; self.resamples.groups()];
        for (stamp, values) in values {
            for (sum, value) in sums[self.group(stamp)].iter_mut().zip(values) {
                *sum += value;
            }
        }
        sums
    }

    /// Intervals of figures that are computed from the sums of a draw.
    pub fn intervals<const N: usize, const F: usize>(
        &self,
        sums: &[[f64; N]],
        figures: impl Fn([f64; N]) -> Option<[f64; F]> + Sync,
    ) -> Option<[Interval; F]> {
        self.resamples.intervals(|counts| {
            let mut drawn = [0.0; N];
            for (sums, &count) in sums.iter().zip(counts) {
                for (drawn, sum) in drawn.iter_mut().zip(sums) {
                    *drawn += sum * count as f64;
                }
            }
            figures(drawn)
        })
    }
}

/// Every row: boxes, methods, groupings. A grouping of which nothing is known is left out, and so is
/// a method without any answer but the ranger in use, and the classes of a dataset with one.
pub(super) fn rows(
    vehicles: &[VehicleRow],
    false_vehicles: &[FalseVehicle],
    drawing: &Drawing,
    ranger: Method,
) -> Vec<DistanceRow> {
    let groups = Groups::new(vehicles);
    let mut rows = Vec::new();
    for grouping in Grouping::ALL {
        let mut members: BTreeMap<_, Vec<&VehicleRow>> = BTreeMap::new();
        for vehicle in vehicles {
            members
                .entry(groups.of(grouping, vehicle))
                .or_default()
                .push(vehicle);
        }
        // Where only made up vehicles are, they still count.
        for vehicle in false_vehicles {
            if let Some(key) = groups.of_false(grouping, vehicle) {
                members.entry(key).or_default();
            }
        }
        let known = members
            .keys()
            .filter(|(place, _)| *place != usize::MAX)
            .count();
        if known == 0 || (grouping == Grouping::Class && known == 1) {
            continue;
        }
        // Without a single true distance there are no bins.
        if vehicles.is_empty() && grouping == Grouping::Distance {
            continue;
        }
        let of_false = |key: &(usize, String)| {
            let is_here = |v: &&FalseVehicle| groups.of_false(grouping, v).as_ref() == Some(key);
            (grouping != Grouping::View).then(|| false_vehicles.iter().filter(is_here).count())
        };
        for boxes in Boxes::ALL {
            for method in Method::ALL {
                let answers = |v: &&VehicleRow| v.estimate(boxes, method).is_some();
                if method != ranger && !vehicles.iter().any(|v| answers(&v)) {
                    continue;
                }
                for (key, members) in &members {
                    let mut row = row(boxes, method, members, drawing);
                    row.grouping = grouping;
                    row.group.clone_from(&key.1);
                    if boxes == Boxes::Pipeline {
                        row.false_vehicles = of_false(key);
                    }
                    rows.push(row);
                }
            }
        }
    }
    rows
}

/// One method over these vehicles, as one group.
pub(crate) fn row(
    boxes: Boxes,
    method: Method,
    vehicles: &[&VehicleRow],
    drawing: &Drawing,
) -> DistanceRow {
    let mut errors = DistanceErrors::new();
    let answers: Vec<(u64, f64, f64)> = vehicles
        .iter()
        .filter_map(|v| Some((v.frame, v.estimate(boxes, method)?, v.distance_m)))
        .filter(|(_, estimate, _)| estimate.is_finite())
        .collect();
    for (_, estimate, truth) in &answers {
        errors.add(*estimate, *truth);
    }
    let sums = drawing.sums(answers.iter().map(|&(frame, estimate, truth)| {
        let error = (estimate - truth).abs();
        (frame, [1.0, error, error * error, error / truth])
    }));
    let intervals = drawing.intervals(&sums, |[count, absolute, squared, relative]| {
        let figures = [
            absolute / count,
            (squared / count).sqrt(),
            100.0 * relative / count,
        ];
        (count > 0.0).then_some(figures)
    });
    let summary = errors.summary();
    let low = |i: usize| intervals.as_ref().map(|intervals| intervals[i].low);
    let high = |i: usize| intervals.as_ref().map(|intervals| intervals[i].high);
    DistanceRow {
        boxes,
        method,
        grouping: Grouping::All,
        group: String::new(),
        vehicles: vehicles.len(),
        answered: errors.len(),
        unanswered: vehicles.len() - errors.len(),
        false_vehicles: None,
        mae_m: summary.map(|s| s.mae_m),
        mae_low_m: low(0),
        mae_high_m: high(0),
        rmse_m: summary.map(|s| s.rmse_m),
        rmse_low_m: low(1),
        rmse_high_m: high(1),
        mre_percent: summary.map(|s| s.mre_percent),
        mre_low_percent: low(2),
        mre_high_percent: high(2),
        abs_rel: summary.map(|s| s.abs_rel),
        sq_rel_m: summary.map(|s| s.sq_rel_m),
        rmse_log: summary.and_then(|s| s.rmse_log),
        delta1: summary.map(|s| s.delta1),
        delta2: summary.map(|s| s.delta2),
        delta3: summary.map(|s| s.delta3),
        median_m: summary.map(|s| s.median_m),
        bias_m: summary.map(|s| s.bias_m),
        p95_m: summary.map(|s| s.p95_m),
        max_m: summary.map(|s| s.max_m),
        within_5_percent: summary.map(|s| s.within_5_percent),
    }
}

/// The ranger in use against every other method.
pub(super) fn differences(
    vehicles: &[VehicleRow],
    drawing: &Drawing,
    ranger: Method,
) -> Vec<DifferenceRow> {
    let mut rows = Vec::new();
    for boxes in Boxes::ALL {
        for method in Method::ALL.into_iter().filter(|method| *method != ranger) {
            let errors: Vec<(u64, [f64; 3])> = vehicles
                .iter()
                .filter_map(|v| {
                    let error = |method| Some((v.estimate(boxes, method)? - v.distance_m).abs());
                    Some((v.frame, [1.0, error(ranger)?, error(method)?]))
                })
                .filter(|(_, values)| values.iter().all(|value| value.is_finite()))
                .collect();
            if errors.is_empty() {
                continue;
            }
            let count = errors.len() as f64;
            let mean = |i: usize| errors.iter().map(|(_, values)| values[i]).sum::<f64>() / count;
            let sums = drawing.sums(errors.iter().copied());
            let interval = drawing.intervals(&sums, |[count, ranger, other]| {
                (count > 0.0).then_some([(ranger - other) / count])
            });
            rows.push(DifferenceRow {
                boxes,
                method,
                vehicles: errors.len(),
                ranger_mae_m: mean(1),
                method_mae_m: mean(2),
                difference_m: mean(1) - mean(2),
                low_m: interval.map(|[interval]| interval.low),
                high_m: interval.map(|[interval]| interval.high),
            });
        }
    }
    rows
}

/// The ranger of one run against that of another on the same vehicles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RunDifference {
    /// Vehicles that both have an estimate of.
    pub vehicles: usize,
    /// Mean absolute error of the second run less that of the first, metres.
    pub difference_m: f64,
    /// Bounds of it.
    pub interval: Option<Interval>,
}

/// Compares a method of two runs on vehicles that both were asked about; None where they have none in
/// common.
pub fn paired_difference(
    pairs: &[(VehicleRow, VehicleRow)],
    boxes: Boxes,
    methods: [Method; 2],
) -> Option<RunDifference> {
    let errors: Vec<(u64, [f64; 2])> = pairs
        .iter()
        .filter_map(|(a, b)| {
            let error = |v: &VehicleRow, method: Method| {
                Some((v.estimate(boxes, method)? - v.distance_m).abs())
            };
            let [of_a, of_b] = methods;
            Some((a.frame, [1.0, error(b, of_b)? - error(a, of_a)?]))
        })
        .filter(|(_, [_, difference])| difference.is_finite())
        .collect();
    let frames: BTreeMap<u64, Option<u32>> =
        pairs.iter().map(|(a, _)| (a.frame, a.scene)).collect();
    let frames: Vec<(u64, Option<u32>)> = frames.into_iter().collect();
    let drawing = Drawing::new(&frames, super::pipeline::DRAWS);
    let sums = drawing.sums(errors.iter().copied());
    let interval = drawing.intervals(&sums, |[count, difference]| {
        (count > 0.0).then_some([difference / count])
    });
    let total: f64 = errors.iter().map(|(_, [_, difference])| difference).sum();
    (!errors.is_empty()).then(|| RunDifference {
        vehicles: errors.len(),
        difference_m: total / errors.len() as f64,
        interval: interval.map(|[interval]| interval),
    })
}

#[cfg(test)]
mod tests;
