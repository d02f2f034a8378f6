//! The tables of an ablation.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::judge::{Trained, baseline_methods};
use super::{AblateRequest, Variant};
use crate::evaluate::{Boxes, Drawing, Grouping, Groups, Method, VehicleRow, row};

/// One variant or baseline in one group of vehicles, a row of `ablation.csv`. Bounds hold in 95 % of
/// the bootstrap's draws. With several seeds every vehicle counts once for each.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AblationRow {
    /// The variant's or the baseline's name.
    pub name: String,
    /// Whether it was trained: a variant, and not a baseline.
    pub trained: bool,
    /// "all", or the bin of true distance.
    pub group: String,
    /// Trainings.
    pub seeds: usize,
    /// Labelled vehicles in the group.
    pub vehicles: usize,
    /// Estimates: of all seeds together.
    pub answered: usize,
    /// Vehicles without an estimate, of all seeds together.
    pub unanswered: usize,
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
    /// Median absolute error, metres.
    pub median_m: Option<f64>,
    /// Mean error, metres: positive when too far.
    pub bias_m: Option<f64>,
    /// Absolute error that 95 % do not exceed, metres.
    pub p95_m: Option<f64>,
    /// Share within 5 % of the truth.
    pub within_5_percent: Option<f64>,
}

/// A variant or baseline against the first variant, or a variant against matching, on the vehicles
/// that both have an estimate of; a row of `differences.csv`. With several seeds, errors are means over them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AblationDifference {
    /// The variant's or the baseline's name.
    pub name: String,
    /// What it is compared with.
    pub against: String,
    /// Vehicles that both have an estimate of.
    pub vehicles: usize,
    /// Difference of the mean absolute errors, metres: negative where `name` is better.
    pub mae_m: f64,
    /// Bound of it: where both are below 0, `name` is better beyond chance.
    pub mae_low_m: Option<f64>,
    /// Bound of it.
    pub mae_high_m: Option<f64>,
    /// Difference of the mean relative errors, percent of the distance.
    pub mre_percent: f64,
    /// Bound of it.
    pub mre_low_percent: Option<f64>,
    /// Bound of it.
    pub mre_high_percent: Option<f64>,
}

/// One estimate, a row of `estimates.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The variant's or the baseline's name.
    pub name: String,
    /// Seed of its training; none for a baseline.
    pub seed: Option<u64>,
    /// The frame's number.
    #[serde(with = "crate::dataset::stamp")]
    pub frame: u64,
    /// The vehicle's number in the frame.
    pub id: u32,
    /// The true distance, metres.
    pub distance_m: f64,
    /// The estimate, metres; none where there is no answer.
    pub estimated_m: Option<f64>,
}

/// A variant or baseline and its estimates.
struct Column {
    name: String,
    is_trained: bool,
    method: Method,
    /// Of each seed the vehicles with their estimates.
    seeds: Vec<(Option<u64>, Vec<VehicleRow>)>,
}

/// Every variant and baseline with its estimates, variants first.
pub(super) struct Measured {
    columns: Vec<Column>,
}

impl Measured {
    /// Puts together what the networks said of the vehicles, one list a trained network, and what
    /// the vehicles' rows say of the baselines.
    pub fn new(
        request: &AblateRequest,
        trained: &[Trained],
        vehicles: &[VehicleRow],
        networks_m: &[Vec<f64>],
    ) -> Self {
        let of_variant = |variant: &Variant| Column {
            name: variant.word().to_owned(),
            is_trained: true,
            method: Method::Network,
            seeds: trained
                .iter()
                .zip(networks_m)
                .filter(|((of, _, _), _)| of == variant)
                .map(|((_, seed, _), distances_m)| {
                    let rows = vehicles.iter().zip(distances_m);
                    let rows = rows.map(|(vehicle, &distance_m)| VehicleRow {
                        network_m: Some(distance_m),
                        ..vehicle.clone()
                    });
                    (Some(*seed), rows.collect())
                })
                .collect(),
        };
        let mut columns: Vec<Column> = request.variants.iter().map(of_variant).collect();
        let answers = |method| {
            let has_one = |v: &VehicleRow| v.estimate(Boxes::True, method).is_some();
            vehicles.iter().any(has_one)
        };
        let baselines = baseline_methods().filter(|&method| answers(method));
        columns.extend(baselines.map(|method| Column {
            name: method.name().to_owned(),
            is_trained: false,
            method,
            seeds: vec![(None, vehicles.to_vec())],
        }));
        Self { columns }
    }
}

/// Every variant and baseline over all vehicles, then by distance.
pub(super) fn rows(
    measured: &Measured,
    vehicles: &[VehicleRow],
    drawing: &Drawing,
) -> Vec<AblationRow> {
    let groups = Groups::new(vehicles);
    [Grouping::All, Grouping::Distance]
        .into_iter()
        .flat_map(|grouping| {
            let groups = &groups;
            measured.columns.iter().flat_map(move |column| {
                let mut members: BTreeMap<_, Vec<&VehicleRow>> = BTreeMap::new();
                for vehicle in column.seeds.iter().flat_map(|(_, vehicles)| vehicles) {
                    let key = groups.of(grouping, vehicle);
                    members.entry(key).or_default().push(vehicle);
                }
                members
                    .into_iter()
                    .map(|((_, group), members)| group_row(column, group, &members, drawing))
            })
        })
        .collect()
}

fn group_row(
    column: &Column,
    group: String,
    members: &[&VehicleRow],
    drawing: &Drawing,
) -> AblationRow {
    let of = row(Boxes::True, column.method, members, drawing);
    AblationRow {
        name: column.name.clone(),
        trained: column.is_trained,
        group,
        seeds: column.seeds.len(),
        vehicles: of.vehicles / column.seeds.len().max(1),
        answered: of.answered,
        unanswered: of.unanswered,
        mae_m: of.mae_m,
        mae_low_m: of.mae_low_m,
        mae_high_m: of.mae_high_m,
        rmse_m: of.rmse_m,
        rmse_low_m: of.rmse_low_m,
        rmse_high_m: of.rmse_high_m,
        mre_percent: of.mre_percent,
        mre_low_percent: of.mre_low_percent,
        mre_high_percent: of.mre_high_percent,
        median_m: of.median_m,
        bias_m: of.bias_m,
        p95_m: of.p95_m,
        within_5_percent: of.within_5_percent,
    }
}

/// Mean absolute error of each vehicle over the seeds, metres; None where a seed has no answer.
fn errors_m(column: &Column) -> Vec<Option<f64>> {
    let count = column
        .seeds
        .first()
        .map_or(0, |(_, vehicles)| vehicles.len());
    let error = |vehicle: &VehicleRow| {
        let estimated_m = vehicle.estimate(Boxes::True, column.method)?;
        let error = (estimated_m - vehicle.distance_m).abs();
        error.is_finite().then_some(error)
    };
    (0..count)
        .map(|i| {
            let of_seeds = column.seeds.iter().map(|(_, vehicles)| error(&vehicles[i]));
            let sum: f64 = of_seeds.sum::<Option<f64>>()?;
            Some(sum / column.seeds.len() as f64)
        })
        .collect()
}

/// Everything against the first variant, and every variant against matching.
pub(super) fn differences(measured: &Measured, drawing: &Drawing) -> Vec<AblationDifference> {
    let columns = &measured.columns;
    let Some((first, others)) = columns.split_first() else {
        return Vec::new();
    };
    let of_first = others.iter().map(|column| (column, first));
    let is_matching = |column: &&Column| column.method == Method::Matching;
    let of_matching = columns
        .iter()
        .find(is_matching)
        .into_iter()
        .flat_map(|matching| {
            let trained = columns.iter().filter(|column| column.is_trained);
            trained.map(move |column| (column, matching))
        });
    of_first
        .chain(of_matching)
        .filter_map(|(column, reference)| difference(column, reference, drawing))
        .collect()
}

/// One against another; None where no vehicle has an estimate of both.
fn difference(
    column: &Column,
    reference: &Column,
    drawing: &Drawing,
) -> Option<AblationDifference> {
    let (_, vehicles) = column.seeds.first()?;
    let pairs: Vec<(u64, [f64; 3])> = vehicles
        .iter()
        .zip(errors_m(column).into_iter().zip(errors_m(reference)))
        .filter_map(|(vehicle, (error, reference))| {
            let difference_m = error? - reference?;
            let relative = 100.0 * difference_m / vehicle.distance_m;
            Some((vehicle.frame, [1.0, difference_m, relative]))
        })
        .collect();
    let count = pairs.len();
    let mean = |i: usize| pairs.iter().map(|(_, v)| v[i]).sum::<f64>() / count as f64;
    let sums = drawing.sums(pairs.iter().copied());
    let intervals = drawing.intervals(&sums, |[count, metres, percent]| {
        (count > 0.0).then_some([metres / count, percent / count])
    });
    let low = |i: usize| intervals.map(|intervals| intervals[i].low);
    let high = |i: usize| intervals.map(|intervals| intervals[i].high);
    (count > 0).then(|| AblationDifference {
        name: column.name.clone(),
        against: reference.name.clone(),
        vehicles: count,
        mae_m: mean(1),
        mae_low_m: low(0),
        mae_high_m: high(0),
        mre_percent: mean(2),
        mre_low_percent: low(1),
        mre_high_percent: high(1),
    })
}

/// Every single estimate.
pub(super) fn estimates(measured: &Measured) -> Vec<Estimate> {
    let mut estimates = Vec::new();
    for column in &measured.columns {
        for (seed, vehicles) in &column.seeds {
            estimates.extend(vehicles.iter().map(|vehicle| Estimate {
                name: column.name.clone(),
                seed: *seed,
                frame: vehicle.frame,
                id: vehicle.id,
                distance_m: vehicle.distance_m,
                estimated_m: vehicle.estimate(Boxes::True, column.method),
            }));
        }
    }
    estimates
}
