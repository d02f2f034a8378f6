//! The paper's test (its section 6): one vehicle at nine distances under four suns, seen from three
//! sides; 108 frames.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::vehicles::{Boxes, FalseVehicle, Method, VehicleRow};
use crate::dataset::{Frame, View};
use crate::world::Sun;

/// Distances, metres, with the paper's RMSE, metres, and MRE, percent, for side-by-side crops.
const PAPER: [(f64, f64, f64); 9] = [
    (15.0, 1.96, 13.06),
    (35.0, 3.54, 10.11),
    (55.0, 2.87, 5.02),
    (85.0, 1.55, 1.82),
    (105.0, 3.29, 3.13),
    (135.0, 7.29, 5.40),
    (155.0, 6.85, 4.41),
    (185.0, 10.70, 5.78),
    (200.0, 11.29, 5.60),
];

const SUNS: [Sun; 4] = [Sun::Sunrise, Sun::Morning, Sun::Noon, Sun::Afternoon];

const VIEWS: [(View, &str); 3] = [
    (View::Front, "front"),
    (View::Side, "side"),
    (View::Rear, "rear"),
];

/// A frame belongs to a distance when its own differs by no more than this, metres.
const TOLERANCE_M: f64 = 0.5;

/// What the test came to.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Protocol {
    /// Frames of the 108 that the split holds.
    pub cells: usize,
    /// Frames of the split that are outside of the paper's grid but have a distance, a sun and a
    /// view: they are judged in rows of their own.
    pub other_frames: usize,
    /// Per boxes and distance.
    #[serde(skip)]
    pub rows: Vec<ProtocolRow>,
    /// Per boxes, distance and method.
    #[serde(skip)]
    pub methods: Vec<MethodRow>,
    /// The cells that the split does not hold.
    #[serde(skip)]
    pub missing: Vec<MissingCell>,
}

/// One distance; a row of `protocol.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ProtocolRow {
    /// Where the boxes come from.
    pub boxes: Boxes,
    /// The distance, metres; empty for the mean over the paper's distances, whose counts are those
    /// of all frames.
    pub distance_m: Option<f64>,
    /// Frames of this distance.
    pub frames: usize,
    /// Of these, without an estimate: the vehicle was missed.
    pub missed: usize,
    /// Vehicles that the pipeline made up in these frames; empty for true boxes.
    pub false_vehicles: Option<usize>,
    /// Mean estimate at sunrise, metres.
    pub sunrise_m: Option<f64>,
    /// In the morning.
    pub morning_m: Option<f64>,
    /// At noon.
    pub noon_m: Option<f64>,
    /// In the afternoon.
    pub afternoon_m: Option<f64>,
    /// RMSE of the suns' means, as the paper's, metres.
    pub rmse_of_means_m: Option<f64>,
    /// MRE of the suns' means, as the paper's, percent.
    pub mre_of_means_percent: Option<f64>,
    /// RMSE over single frames, metres.
    pub rmse_m: Option<f64>,
    /// MRE over single frames, percent.
    pub mre_percent: Option<f64>,
    /// The paper's RMSE, metres.
    pub paper_rmse_m: Option<f64>,
    /// The paper's MRE, percent.
    pub paper_mre_percent: Option<f64>,
}

/// One way to a distance at one distance, over single frames; a row of `protocol_methods.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MethodRow {
    /// Where the boxes come from.
    pub boxes: Boxes,
    /// The distance, metres.
    pub distance_m: f64,
    /// The way to the distance.
    pub method: Method,
    /// Frames with an estimate.
    pub answered: usize,
    /// RMSE over them, metres.
    pub rmse_m: Option<f64>,
    /// MRE over them, percent.
    pub mre_percent: Option<f64>,
}

/// A frame of the test that the split does not hold, or whose vehicle is not labelled in both
/// images; a row of `protocol_missing.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MissingCell {
    /// Distance, metres.
    pub distance_m: f64,
    /// Sun.
    pub sun: String,
    /// View.
    pub view: String,
}

/// A judged vehicle in its place.
struct Cell<'a> {
    sun: Sun,
    view: &'static str,
    vehicle: &'a VehicleRow,
}

/// Arranges the vehicles of a split by the test's distances, suns and views.
pub(super) fn protocol(
    frames: &[&Frame],
    vehicles: &[VehicleRow],
    false_vehicles: &[FalseVehicle],
    ranger: Method,
) -> Protocol {
    let mut by_distance: BTreeMap<i64, Vec<Cell>> = BTreeMap::new();
    for (distance_m, _, _) in PAPER {
        by_distance.insert(tenths(distance_m), Vec::new());
    }
    let mut other_frames = 0;
    for frame in frames {
        let Some((distance_m, cell)) = cell(frame, vehicles) else {
            continue;
        };
        let of_paper = PAPER
            .iter()
            .find(|(nominal, _, _)| (nominal - distance_m).abs() <= TOLERANCE_M);
        let nominal_m = of_paper.map_or(distance_m.round(), |(nominal, _, _)| *nominal);
        other_frames += usize::from(of_paper.is_none());
        by_distance.entry(tenths(nominal_m)).or_default().push(cell);
    }
    let mut protocol = Protocol {
        cells: 0,
        other_frames,
        rows: Vec::new(),
        methods: Vec::new(),
        missing: Vec::new(),
    };
    for (distance_m, _, _) in PAPER {
        let cells = &by_distance[&tenths(distance_m)];
        let there: BTreeSet<(Sun, &str)> = cells.iter().map(|cell| (cell.sun, cell.view)).collect();
        protocol.cells += there.len();
        for sun in SUNS {
            for (_, view) in VIEWS
                .iter()
                .filter(|(_, view)| !there.contains(&(sun, *view)))
            {
                protocol.missing.push(MissingCell {
                    distance_m,
                    sun: sun.name().to_owned(),
                    view: (*view).to_owned(),
                });
            }
        }
    }
    for boxes in Boxes::ALL {
        let mut rows: Vec<ProtocolRow> = Vec::new();
        for (&tenths, cells) in &by_distance {
            let distance_m = tenths as f64 / 10.0;
            rows.push(row(boxes, ranger, distance_m, cells, false_vehicles));
            for method in Method::ALL {
                let row = method_row(boxes, distance_m, method, cells);
                if method == ranger || row.answered > 0 {
                    protocol.methods.push(row);
                }
            }
        }
        rows.push(mean_row(boxes, &rows));
        protocol.rows.extend(rows);
    }
    protocol
}

/// A key that orders distances.
fn tenths(distance_m: f64) -> i64 {
    (distance_m * 10.0).round() as i64
}

/// The frame's distance, and its orbited vehicle; None for a frame that says nothing of it.
fn cell<'a>(frame: &Frame, vehicles: &'a [VehicleRow]) -> Option<(f64, Cell<'a>)> {
    let row = &frame.row;
    let (distance_m, view) = (row.distance_m?, row.view?);
    let sun = SUNS
        .into_iter()
        .find(|sun| Some(sun.name()) == row.sun.as_deref())?;
    let (_, view) = *VIEWS.iter().find(|(of, _)| *of == view)?;
    let apart = |vehicle: &&VehicleRow| (vehicle.distance_m - distance_m).abs();
    let vehicle = vehicles
        .iter()
        .filter(|vehicle| vehicle.frame == row.stamp)
        .min_by(|a, b| apart(a).total_cmp(&apart(b)).then(a.id.cmp(&b.id)))?;
    (apart(&vehicle) <= TOLERANCE_M).then_some((distance_m, Cell { sun, view, vehicle }))
}

fn row(
    boxes: Boxes,
    ranger: Method,
    distance_m: f64,
    cells: &[Cell],
    false_vehicles: &[FalseVehicle],
) -> ProtocolRow {
    let is_here = |v: &&FalseVehicle| cells.iter().any(|cell| cell.vehicle.frame == v.frame);
    let estimates: Vec<(Sun, f64, f64)> = cells
        .iter()
        .filter_map(|cell| {
            let estimate = cell.vehicle.estimate(boxes, ranger)?;
            Some((cell.sun, estimate, cell.vehicle.distance_m))
        })
        .collect();
    let of_sun = |sun: Sun| -> Vec<(f64, f64)> {
        let of_sun = estimates.iter().filter(|(of, _, _)| *of == sun);
        of_sun
            .map(|&(_, estimate, truth)| (estimate, truth))
            .collect()
    };
    let means = SUNS.map(|sun| {
        let of_sun = of_sun(sun);
        let mean = |values: &dyn Fn(&(f64, f64)) -> f64| {
            of_sun.iter().map(values).sum::<f64>() / of_sun.len() as f64
        };
        (!of_sun.is_empty()).then(|| (mean(&|pair| pair.0), mean(&|pair| pair.1)))
    });
    let over_means = errors(means.iter().flatten().copied());
    let over_frames = errors(
        estimates
            .iter()
            .map(|&(_, estimate, truth)| (estimate, truth)),
    );
    let paper = PAPER.iter().find(|(nominal, _, _)| *nominal == distance_m);
    ProtocolRow {
        boxes,
        distance_m: Some(distance_m),
        frames: cells.len(),
        missed: cells.len() - estimates.len(),
        false_vehicles: (boxes == Boxes::Pipeline)
            .then(|| false_vehicles.iter().filter(is_here).count()),
        sunrise_m: means[0].map(|(mean, _)| mean),
        morning_m: means[1].map(|(mean, _)| mean),
        noon_m: means[2].map(|(mean, _)| mean),
        afternoon_m: means[3].map(|(mean, _)| mean),
        rmse_of_means_m: over_means.map(|(rmse, _)| rmse),
        mre_of_means_percent: over_means.map(|(_, mre)| mre),
        rmse_m: over_frames.map(|(rmse, _)| rmse),
        mre_percent: over_frames.map(|(_, mre)| mre),
        paper_rmse_m: paper.map(|(_, rmse, _)| *rmse),
        paper_mre_percent: paper.map(|(_, _, mre)| *mre),
    }
}

/// Means over the paper's distances, and the paper's own over those that have a figure of ours.
fn mean_row(boxes: Boxes, rows: &[ProtocolRow]) -> ProtocolRow {
    let mean = |value: &dyn Fn(&ProtocolRow) -> Option<f64>| {
        let of_paper = rows.iter().filter(|row| row.paper_rmse_m.is_some());
        let values: Vec<f64> = of_paper.filter_map(value).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    ProtocolRow {
        boxes,
        distance_m: None,
        frames: rows.iter().map(|row| row.frames).sum(),
        missed: rows.iter().map(|row| row.missed).sum(),
        false_vehicles: (boxes == Boxes::Pipeline)
            .then(|| rows.iter().filter_map(|row| row.false_vehicles).sum()),
        sunrise_m: None,
        morning_m: None,
        noon_m: None,
        afternoon_m: None,
        rmse_of_means_m: mean(&|row| row.rmse_of_means_m),
        mre_of_means_percent: mean(&|row| row.mre_of_means_percent),
        rmse_m: mean(&|row| row.rmse_m),
        mre_percent: mean(&|row| row.mre_percent),
        paper_rmse_m: mean(&|row| row.rmse_m.and(row.paper_rmse_m)),
        paper_mre_percent: mean(&|row| row.rmse_m.and(row.paper_mre_percent)),
    }
}

fn method_row(boxes: Boxes, distance_m: f64, method: Method, cells: &[Cell]) -> MethodRow {
    let pairs: Vec<(f64, f64)> = cells
        .iter()
        .filter_map(|cell| {
            Some((
                cell.vehicle.estimate(boxes, method)?,
                cell.vehicle.distance_m,
            ))
        })
        .collect();
    let errors = errors(pairs.iter().copied());
    MethodRow {
        boxes,
        distance_m,
        method,
        answered: pairs.len(),
        rmse_m: errors.map(|(rmse, _)| rmse),
        mre_percent: errors.map(|(_, mre)| mre),
    }
}

/// RMSE, metres, and MRE, percent, of pairs of estimate and truth.
fn errors(pairs: impl Iterator<Item = (f64, f64)>) -> Option<(f64, f64)> {
    let mut errors = crate::metrics::DistanceErrors::new();
    for (estimate, truth) in pairs {
        errors.add(estimate, truth);
    }
    let summary = errors.summary()?;
    Some((summary.rmse_m, summary.mre_percent))
}

#[cfg(test)]
mod tests;
