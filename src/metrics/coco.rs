//! The COCO evaluation of the same detections: step-wise interpolation, limits per image and
//! class, and figures by size of the target.

use serde::{Deserialize, Serialize};

use super::Target;
use super::curves::{equally_spaced, make_non_increasing};
use super::matching::{AT_50, AT_75, IOU_THRESHOLDS};
use crate::detector::detection::Detection;

/// Number of recalls at which precision is averaged.
const RECALL_STEPS: usize = 101;

/// Areas in square pixels: all, small, medium, large.
const AREAS: [(f64, f64); 4] = [
    (0.0, 1e10),
    (0.0, 32.0 * 32.0),
    (32.0 * 32.0, 96.0 * 96.0),
    (96.0 * 96.0, 1e10),
];

/// The figures of the COCO evaluation; None where no target counts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CocoSummary {
    /// Mean average precision over the overlaps 0.50 to 0.95.
    pub map50_95: Option<f64>,
    /// Mean average precision at an overlap of 0.50.
    pub map50: Option<f64>,
    /// Mean average precision at an overlap of 0.75.
    pub map75: Option<f64>,
    /// Mean average precision of small (below 32 x 32 pixels), medium and large (above 96 x 96)
    /// targets.
    pub map_by_size: [Option<f64>; 3],
    /// Mean recall with 1, 10 and the largest number of detections per image and class.
    pub recall_by_limit: [Option<f64>; 3],
    /// Mean recall of small, medium and large targets.
    pub recall_by_size: [Option<f64>; 3],
    /// Average precision per overlap and class.
    pub average_precision: Vec<Vec<Option<f64>>>,
    /// Largest recall per overlap and class.
    pub recall: Vec<Vec<Option<f64>>>,
}

/// Average precision and largest recall per overlap and class for one range of areas.
#[derive(Default)]
struct Table {
    precision: Vec<Vec<Option<f64>>>,
    recall: Vec<Vec<Option<f64>>>,
}

/// What became of one detection at one overlap.
#[derive(Clone, Copy, PartialEq)]
enum Outcome {
    Right,
    Wrong,
    /// It belongs to a target outside the range of areas, or is itself outside and unmatched.
    Ignored,
}

/// Evaluates images whose detections stand in descending order of their scores.
pub(super) fn evaluate(
    images: &[(Vec<Detection>, Vec<Target>)],
    classes: usize,
    max_detections: usize,
) -> CocoSummary {
    let table = |area, limit| Table::new(images, classes, area, limit, max_detections);
    let [few, some] = [1, 10].map(|limit| table(AREAS[0], limit));
    let [all, small, medium, large] = AREAS.map(|area| table(area, max_detections));
    let sizes = [&small, &medium, &large];
    CocoSummary {
        map50_95: mean(all.precision.iter().flatten()),
        map50: mean(&all.precision[AT_50]),
        map75: mean(&all.precision[AT_75]),
        map_by_size: sizes.map(|table| mean(table.precision.iter().flatten())),
        recall_by_limit: [&few, &some, &all].map(|table| mean(table.recall.iter().flatten())),
        recall_by_size: sizes.map(|table| mean(table.recall.iter().flatten())),
        average_precision: all.precision,
        recall: all.recall,
    }
}

/// Mean of what counts.
fn mean<'a>(values: impl IntoIterator<Item = &'a Option<f64>>) -> Option<f64> {
    let values: Vec<f64> = values.into_iter().flatten().copied().collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

impl Table {
    fn new(
        images: &[(Vec<Detection>, Vec<Target>)],
        classes: usize,
        area: (f64, f64),
        limit: usize,
        max_detections: usize,
    ) -> Self {
        let mut table = Self::default();
        for threshold in IOU_THRESHOLDS {
            let mut precision = Vec::new();
            let mut recall = Vec::new();
            for class in 0..classes {
                let mut outcomes = Vec::new();
                let mut counted = 0;
                for (detections, targets) in images {
                    let detections: Vec<&Detection> = detections
                        .iter()
                        .filter(|d| d.class == class)
                        .take(limit.min(max_detections))
                        .collect();
                    let targets: Vec<&Target> =
                        targets.iter().filter(|t| t.class == class).collect();
                    counted += targets
                        .iter()
                        .filter(|t| is_within(area, t.box_pixel.area()))
                        .count();
                    outcomes.extend(matched(&detections, &targets, area, threshold));
                }
                let curve = (counted > 0).then(|| curve(outcomes, counted));
                precision.push(curve.map(|(precision, _)| precision));
                recall.push(curve.map(|(_, recall)| recall));
            }
            table.precision.push(precision);
            table.recall.push(recall);
        }
        table
    }
}

fn is_within((least, largest): (f64, f64), area: f64) -> bool {
    (least..=largest).contains(&area)
}

/// Scores and outcomes of one image's detections of one class.
fn matched(
    detections: &[&Detection],
    targets: &[&Target],
    area: (f64, f64),
    threshold: f64,
) -> Vec<(f32, Outcome)> {
    let counts = |target: &Target| is_within(area, target.box_pixel.area());
    let mut claimed = vec![false; targets.len()];
    // The free target of largest overlap; of equal ones the last.
    let best = |detection: &Detection, claimed: &[bool], counted: bool| {
        let mut best: Option<(usize, f64)> = None;
        for (i, target) in targets.iter().enumerate() {
            let iou = detection.box_pixel.iou(&target.box_pixel);
            let least = best.map_or(threshold, |(_, highest)| highest);
            if !claimed[i] && counts(target) == counted && iou >= least {
                best = Some((i, iou));
            }
        }
        best.map(|(i, _)| i)
    };
    detections
        .iter()
        .map(|detection| {
            // Targets outside the range catch a detection only when none inside does.
            let outcome = if let Some(i) = best(detection, &claimed, true) {
                claimed[i] = true;
                Outcome::Right
            } else if let Some(i) = best(detection, &claimed, false) {
                claimed[i] = true;
                Outcome::Ignored
            } else if is_within(area, detection.box_pixel.area()) {
                Outcome::Wrong
            } else {
                Outcome::Ignored
            };
            (detection.score, outcome)
        })
        .collect()
}

/// Average precision and largest recall of one class.
fn curve(mut outcomes: Vec<(f32, Outcome)>, targets: usize) -> (f64, f64) {
    outcomes.retain(|(_, outcome)| *outcome != Outcome::Ignored);
    outcomes.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut right = 0.0;
    let mut precision = Vec::new();
    let mut recall = Vec::new();
    for (i, (_, outcome)) in outcomes.iter().enumerate() {
        right += f64::from(u8::from(*outcome == Outcome::Right));
        precision.push(right / ((i + 1) as f64 + f64::EPSILON));
        recall.push(right / targets as f64);
    }
    make_non_increasing(&mut precision);
    let sum: f64 = equally_spaced(RECALL_STEPS)
        .iter()
        .filter_map(|&wanted| precision.get(recall.partition_point(|&reached| reached < wanted)))
        .sum();
    (
        sum / RECALL_STEPS as f64,
        recall.last().copied().unwrap_or(0.0),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PixelBox;

    fn image(side: f64, score: f32) -> (Vec<Detection>, Vec<Target>) {
        let box_pixel = PixelBox::new(0.0, 0.0, side, side);
        (
            vec![Detection {
                box_pixel,
                score,
                class: 0,
            }],
            vec![Target {
                box_pixel,
                class: 0,
            }],
        )
    }

    #[test]
    fn a_perfect_detector_reaches_one_and_sizes_without_targets_have_no_figure() {
        let summary = evaluate(&[image(50.0, 0.9), image(60.0, 0.8)], 1, 100);
        assert!((summary.map50_95.unwrap() - 1.0).abs() < 1e-9);
        assert_eq!(summary.map_by_size[0], None);
        assert!((summary.map_by_size[1].unwrap() - 1.0).abs() < 1e-9);
        assert_eq!(summary.recall_by_size[2], None);
    }

    #[test]
    fn without_targets_nothing_has_a_figure() {
        let (detections, _) = image(50.0, 0.9);
        let summary = evaluate(&[(detections, Vec::new())], 1, 100);
        assert_eq!(summary.map50_95, None);
        assert_eq!(summary.recall_by_limit, [None; 3]);
    }

    #[test]
    fn targets_without_detections_have_zero() {
        let (_, targets) = image(50.0, 0.9);
        let summary = evaluate(&[(Vec::new(), targets)], 1, 100);
        assert_eq!(summary.map50, Some(0.0));
    }
}
