//! The main figures of an evaluation.

use serde::{Deserialize, Serialize};

use super::distances::Drawing;
use super::judge::Judged;
use super::vehicles::{Boxes, Method, Spread};
use crate::metrics::{DetectionSummary, DistanceErrors, DistanceSummary, Interval};

/// Draws for average precision, each of which walks through every detection.
pub(super) const DETECTION_DRAWS: usize = 200;

/// The detector's figures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DetectionFigures {
    /// Images, left and right.
    pub images: usize,
    /// Labelled boxes.
    pub targets: usize,
    /// At the confidence of the best F1.
    pub precision: f64,
    /// At the confidence of the best F1.
    pub recall: f64,
    /// The best F1.
    pub f1: f64,
    /// Its confidence.
    pub best_confidence: Option<f64>,
    /// Mean average precision at IoU 0.50.
    pub map50: f64,
    /// Bounds of it.
    pub map50_interval: Option<Interval>,
    /// Mean average precision over IoU 0.50 to 0.95.
    pub map50_95: f64,
    /// Bounds of it.
    pub map50_95_interval: Option<Interval>,
}

/// The pipeline's figures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PipelineFigures {
    /// Vehicles labelled in both images and ignored in neither.
    pub vehicles: usize,
    /// Of these, found.
    pub found: usize,
    /// Of these, missed.
    pub missed: usize,
    /// Found where none is labelled, not even an ignored one or one that a single camera sees.
    pub false_vehicles: usize,
    /// Bounds of the share that is found.
    pub found_interval: Option<Interval>,
    /// Bounds of the share of what the pipeline sees that is there.
    pub precision_interval: Option<Interval>,
    /// Mean absolute error of the found ones, metres.
    pub mae_m: Option<f64>,
    /// Root of their mean squared error, metres.
    pub rmse_m: Option<f64>,
    /// Their mean relative error, percent.
    pub mre_percent: Option<f64>,
    /// How well the intervals hold.
    #[serde(flatten)]
    pub spread: SpreadFigures,
    /// All distance errors of the found ones.
    pub distance: Option<DistanceSummary>,
}

/// The distances of labelled boxes by the ranger in use.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrueBoxFigures {
    /// How well the intervals hold.
    #[serde(flatten)]
    pub spread: SpreadFigures,
    /// All distance errors.
    #[serde(flatten)]
    pub distance: DistanceSummary,
}

/// How many vehicles have a distance, and how well the intervals that come with it hold; none of the
/// latter where the ranger has no intervals.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SpreadFigures {
    /// Vehicles with a distance.
    pub answered: usize,
    /// Part of them whose distance the 68 % interval holds, percent.
    pub coverage_68: Option<f64>,
    /// Part of them whose distance the 95 % interval holds, percent.
    pub coverage_95: Option<f64>,
    /// Mean negative logarithm of the density at the true distance, per metre.
    pub nll: Option<f64>,
}

/// The figures of the detector, of which each draw of the bootstrap takes a while.
pub(super) fn detection_figures(
    judged: &Judged,
    summary: &DetectionSummary,
    drawing: &Drawing,
) -> DetectionFigures {
    let stamps = judged.image_stamps.iter();
    let groups: Vec<usize> = stamps.map(|&stamp| drawing.group(stamp)).collect();
    let draws = drawing.resamples.first(DETECTION_DRAWS);
    let intervals = judged.detection.map_intervals(&draws, &groups);
    DetectionFigures {
        images: summary.images,
        targets: summary.targets,
        precision: summary.precision,
        recall: summary.recall,
        f1: summary.f1,
        best_confidence: summary.best_confidence,
        map50: summary.map50,
        map50_interval: intervals.map(|[map50, _]| map50),
        map50_95: summary.map50_95,
        map50_95_interval: intervals.map(|[_, map50_95]| map50_95),
    }
}

/// The figures of the whole pipeline.
pub(super) fn pipeline_figures(
    judged: &Judged,
    drawing: &Drawing,
    method: Method,
) -> PipelineFigures {
    let distance = errors(judged, Boxes::Pipeline, method);
    let found = judged
        .vehicles
        .iter()
        .filter(|vehicle| vehicle.found)
        .count();
    let labelled = judged
        .vehicles
        .iter()
        .map(|v| (v.frame, [1.0, f64::from(u8::from(v.found)), 0.0]));
    let made_up = judged
        .false_vehicles
        .iter()
        .map(|v| (v.frame, [0.0, 0.0, 1.0]));
    let sums = drawing.sums(labelled.chain(made_up));
    let share = |part: f64, whole: f64| (whole > 0.0).then(|| [part / whole]);
    let found_interval = drawing.intervals(&sums, |[vehicles, found, _]| share(found, vehicles));
    let precision_interval =
        drawing.intervals(&sums, |[_, found, made_up]| share(found, found + made_up));
    PipelineFigures {
        vehicles: judged.vehicles.len(),
        found,
        missed: judged.vehicles.len() - found,
        false_vehicles: judged.false_vehicles.len(),
        found_interval: found_interval.map(|[interval]| interval),
        precision_interval: precision_interval.map(|[interval]| interval),
        mae_m: distance.map(|d| d.mae_m),
        rmse_m: distance.map(|d| d.rmse_m),
        mre_percent: distance.map(|d| d.mre_percent),
        spread: spread(judged, Boxes::Pipeline, method),
        distance,
    }
}

/// The figures of labelled boxes.
pub(super) fn true_box_figures(judged: &Judged, method: Method) -> Option<TrueBoxFigures> {
    Some(TrueBoxFigures {
        distance: errors(judged, Boxes::True, method)?,
        spread: spread(judged, Boxes::True, method),
    })
}

/// A method's errors.
fn errors(judged: &Judged, boxes: Boxes, method: Method) -> Option<DistanceSummary> {
    let mut errors = DistanceErrors::new();
    for vehicle in &judged.vehicles {
        if let Some(estimate) = vehicle.estimate(boxes, method) {
            errors.add(estimate, vehicle.distance_m);
        }
    }
    errors.summary()
}

/// How well a method's intervals hold.
fn spread(judged: &Judged, boxes: Boxes, method: Method) -> SpreadFigures {
    let answered = judged
        .vehicles
        .iter()
        .filter(|vehicle| vehicle.estimate(boxes, method).is_some())
        .count();
    let spreads: Vec<(f64, Spread)> = judged
        .vehicles
        .iter()
        .filter(|_| method == Method::Fused)
        .filter_map(|vehicle| Some((vehicle.distance_m, vehicle.spread(boxes)?)))
        .collect();
    let mean = |of: &dyn Fn(&(f64, Spread)) -> f64| {
        let sum: f64 = spreads.iter().map(of).sum();
        (!spreads.is_empty()).then(|| sum / spreads.len() as f64)
    };
    let percent = |held: bool| if held { 100.0 } else { 0.0 };
    SpreadFigures {
        answered,
        coverage_68: mean(&|(true_m, spread)| percent(holds(spread.within_68_m, *true_m))),
        coverage_95: mean(&|(true_m, spread)| percent(holds(spread.within_95_m, *true_m))),
        nll: mean(&|(_, spread)| spread.nll),
    }
}

fn holds([low, high]: [f64; 2], value: f64) -> bool {
    (low..=high).contains(&value)
}
