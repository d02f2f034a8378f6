//! The main figures of an evaluation.

use serde::{Deserialize, Serialize};

use super::distances::Drawing;
use super::judge::Judged;
use super::vehicles::{Boxes, Method};
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
    /// Distance errors of the found ones.
    pub distance: Option<DistanceSummary>,
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
pub(super) fn pipeline_figures(judged: &Judged, drawing: &Drawing) -> PipelineFigures {
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
        distance: errors(judged, Boxes::Pipeline),
    }
}

/// The network's errors.
pub(super) fn errors(judged: &Judged, boxes: Boxes) -> Option<DistanceSummary> {
    let mut errors = DistanceErrors::new();
    for vehicle in &judged.vehicles {
        if let Some(estimate) = vehicle.estimate(boxes, Method::Network) {
            errors.add(estimate, vehicle.distance_m);
        }
    }
    errors.summary()
}
