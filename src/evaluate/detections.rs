//! Tables of the detector's figures.

use serde::{Deserialize, Serialize};

use crate::metrics::{CocoSummary, Confusion, DetectionSummary};

/// One class, or all; a row of `detection.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClassRow {
    /// The class; "all" is the mean over the classes, of counts the sum.
    pub class: String,
    /// Labelled boxes.
    pub targets: usize,
    /// Detections at any confidence.
    pub detections: usize,
    /// The confidence of the best mean F1, to which the next figures belong.
    pub confidence: Option<f64>,
    /// Share of the detections that are right.
    pub precision: f64,
    /// Share of the labelled boxes that are found.
    pub recall: f64,
    /// Harmonic mean of both.
    pub f1: f64,
    /// Right detections.
    pub true_positives: f64,
    /// Wrong detections.
    pub false_positives: f64,
    /// Average precision at an overlap of 0.50.
    pub ap50: f64,
    /// Average precision at an overlap of 0.75.
    pub ap75: f64,
    /// Mean average precision over overlaps of 0.50 to 0.95.
    pub ap50_95: f64,
}

/// One class, or the mean over all, at one confidence; a row of `detection_curves.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CurveRow {
    /// The class, or "all".
    pub class: String,
    /// The confidence.
    pub confidence: f64,
    /// Share of the detections above it that are right.
    pub precision: f64,
    /// Share of the labelled boxes that are found.
    pub recall: f64,
    /// Harmonic mean of both.
    pub f1: f64,
}

/// One figure of the COCO evaluation; a row of `coco.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CocoRow {
    /// "AP" or "AR".
    pub figure: String,
    /// Overlap, or range of overlaps.
    pub iou: String,
    /// "all", "small" (below 32 x 32 pixels of the image), "medium" or "large" (above 96 x 96).
    pub area: String,
    /// Detections per image and class that count.
    pub max_detections: usize,
    /// The figure; empty where no labelled box counts.
    pub value: Option<f64>,
}

/// One cell of the confusion matrix; a row of `confusion.csv`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConfusionRow {
    /// What was found; "background" is nothing.
    pub found: String,
    /// What is there; "background" is nothing.
    pub there: String,
    /// How often.
    pub count: usize,
}

/// Detections per image and class in the COCO evaluation.
pub(super) const COCO_DETECTIONS: usize = 100;

/// The name of what is no class.
const BACKGROUND: &str = "background";

/// The name of all classes together.
const ALL: &str = "all";

fn name(classes: &[String], class: usize) -> String {
    classes
        .get(class)
        .cloned()
        .unwrap_or_else(|| BACKGROUND.to_owned())
}

/// All classes, then, where there are more than one, each.
pub(super) fn class_rows(summary: &DetectionSummary, classes: &[String]) -> Vec<ClassRow> {
    let sum = |value: &dyn Fn(&crate::metrics::ClassMetrics) -> f64| {
        summary.per_class.iter().map(value).sum::<f64>()
    };
    let all = ClassRow {
        class: ALL.to_owned(),
        targets: summary.targets,
        detections: summary.detections,
        confidence: summary.best_confidence,
        precision: summary.precision,
        recall: summary.recall,
        f1: summary.f1,
        true_positives: sum(&|class| class.true_positives),
        false_positives: sum(&|class| class.false_positives),
        ap50: summary.map50,
        ap75: summary.map75,
        ap50_95: summary.map50_95,
    };
    let each = summary.per_class.iter().map(|class| ClassRow {
        class: name(classes, class.class),
        targets: class.targets,
        detections: class.detections,
        confidence: summary.best_confidence,
        precision: class.precision,
        recall: class.recall,
        f1: class.f1,
        true_positives: class.true_positives,
        false_positives: class.false_positives,
        ap50: class.ap50(),
        ap75: class.ap75(),
        ap50_95: class.ap50_95(),
    });
    let is_one = classes.len() == 1;
    std::iter::once(all)
        .chain(each.filter(|_| !is_one))
        .collect()
}

/// The curves of all classes, then, where there are more than one, of each.
pub(super) fn curve_rows(summary: &DetectionSummary, classes: &[String]) -> Vec<CurveRow> {
    let curves = &summary.curves;
    let count = (summary.per_class.len() as f64).max(1.0);
    let mut rows = Vec::new();
    for (i, &confidence) in curves.confidence.iter().enumerate() {
        let mean = |of: &[Vec<f64>]| of.iter().map(|curve| curve[i]).sum::<f64>() / count;
        rows.push(CurveRow {
            class: ALL.to_owned(),
            confidence,
            precision: mean(&curves.precision),
            recall: mean(&curves.recall),
            f1: mean(&curves.f1),
        });
    }
    if classes.len() == 1 {
        return rows;
    }
    for (place, class) in summary.per_class.iter().enumerate() {
        rows.extend(
            curves
                .confidence
                .iter()
                .enumerate()
                .map(|(i, &confidence)| CurveRow {
                    class: name(classes, class.class),
                    confidence,
                    precision: curves.precision[place][i],
                    recall: curves.recall[place][i],
                    f1: curves.f1[place][i],
                }),
        );
    }
    rows
}

/// The twelve figures in their usual order.
pub(super) fn coco_rows(coco: &CocoSummary) -> Vec<CocoRow> {
    let row = |figure: &str, iou: &str, area: &str, max_detections, value| CocoRow {
        figure: figure.to_owned(),
        iou: iou.to_owned(),
        area: area.to_owned(),
        max_detections,
        value,
    };
    let range = "0.50:0.95";
    let mut rows = vec![
        row("AP", range, ALL, COCO_DETECTIONS, coco.map50_95),
        row("AP", "0.50", ALL, COCO_DETECTIONS, coco.map50),
        row("AP", "0.75", ALL, COCO_DETECTIONS, coco.map75),
    ];
    let areas = ["small", "medium", "large"];
    let by_size = areas.iter().zip(coco.map_by_size);
    rows.extend(by_size.map(|(area, value)| row("AP", range, area, COCO_DETECTIONS, value)));
    let limits = [1, 10, COCO_DETECTIONS]
        .into_iter()
        .zip(coco.recall_by_limit);
    rows.extend(limits.map(|(limit, value)| row("AR", range, ALL, limit, value)));
    let by_size = areas.iter().zip(coco.recall_by_size);
    rows.extend(by_size.map(|(area, value)| row("AR", range, area, COCO_DETECTIONS, value)));
    rows
}

/// Every cell, row by row.
pub(super) fn confusion_rows(confusion: &Confusion, classes: &[String]) -> Vec<ConfusionRow> {
    let cell = |found: usize, there: usize, count: usize| ConfusionRow {
        found: name(classes, found),
        there: name(classes, there),
        count,
    };
    let last = classes.len();
    let rows = confusion.counts.iter().enumerate();
    rows.flat_map(|(found, row)| {
        row.iter()
            .enumerate()
            .map(move |(there, n)| (found, there, *n))
    })
    // Nothing found where nothing is cannot be counted.
    .filter(|(found, there, _)| (*found, *there) != (last, last))
    .map(|(found, there, count)| cell(found, there, count))
    .collect()
}
