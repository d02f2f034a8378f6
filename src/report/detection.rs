//! The detector and the time of one evaluation: tables and charts.

use super::load::Evaluated;
use super::parts::{Chart, Section, Table, number};
use crate::error::Result;
use crate::evaluate::{ConfusionRow, CurveRow, DetectionFigures, LatencyRow};
use crate::page::charts::{Axis, Figure, Rgb, Shape, color, grouped_bars};

/// The class of the curves of all classes together.
const ALL: &str = "all";

/// Every so many of a thousand confidences are drawn.
const EVERY: usize = 5;

/// Adds everything about the detector, and the time of each stage.
pub(super) fn add(section: &mut Section, of: &Evaluated) -> Result<()> {
    let Some(figures) = &of.evaluation.detection else {
        return Ok(());
    };
    section.heading("Detector");
    section.table(classes(of, figures));
    section.charts(curves(of)?);
    section.table(confusion(of));
    section.table(coco(of));
    let latency = &of.evaluation.tables.latency;
    if !latency.is_empty() {
        section.heading("Time of a pair");
        section.table(times(of, latency));
        section.charts(vec![time_chart(of, latency)?]);
    }
    Ok(())
}

fn classes(of: &Evaluated, figures: &DetectionFigures) -> Table {
    let mut table = Table::new(
        "By class",
        &[
            "class",
            "boxes",
            "precision",
            "recall",
            "F1",
            "at confidence",
            "right",
            "wrong",
            "AP50",
            "AP75",
            "AP50-95",
        ],
        of.file("detection.csv"),
    );
    if let (Some(map50), Some(map50_95)) = (figures.map50_interval, figures.map50_95_interval) {
        table.note = format!(
            "Bounds: mAP50 {:.3} to {:.3}, mAP50-95 {:.3} to {:.3} ({} draws; {}).",
            map50.low,
            map50.high,
            map50_95.low,
            map50_95.high,
            of.evaluation.bootstrap.detection_draws,
            of.file("evaluation.json"),
        );
    }
    for row in &of.evaluation.tables.detection {
        table.rows.push(vec![
            row.class.clone(),
            row.targets.to_string(),
            format!("{:.3}", row.precision),
            format!("{:.3}", row.recall),
            format!("{:.3}", row.f1),
            number(row.confidence, 3),
            format!("{:.0}", row.true_positives),
            format!("{:.0}", row.false_positives),
            format!("{:.3}", row.ap50),
            format!("{:.3}", row.ap75),
            format!("{:.3}", row.ap50_95),
        ]);
    }
    table
}

fn curves(of: &Evaluated) -> Result<Vec<Chart>> {
    let rows: Vec<&CurveRow> = of
        .evaluation
        .tables
        .detection_curves
        .iter()
        .filter(|row| row.class == ALL)
        .collect();
    if rows.is_empty() {
        return Ok(Vec::new());
    }
    let source = of.file("detection_curves.csv");
    let line = |x: fn(&CurveRow) -> f64, y: fn(&CurveRow) -> f64| {
        let points = rows.iter().step_by(EVERY).map(|row| [x(row), y(row)]);
        Shape::Line(points.collect())
    };
    // Above the highest score nothing is found: the curve ends there.
    let found: Vec<[f64; 2]> = rows
        .iter()
        .filter(|row| row.recall > 0.0)
        .map(|row| [row.recall, row.precision])
        .collect();
    let precision_recall = Figure {
        x: Axis::new("recall", [0.0, 1.0]),
        y: Axis::new("precision", [0.0, 1.02]),
        shapes: vec![(color(0), Shape::Line(found))],
        square: false,
    };
    let over_confidence = Figure {
        x: Axis::new("confidence", [0.0, 1.0]),
        y: Axis::new("share", [0.0, 1.02]),
        shapes: vec![
            (color(0), line(|row| row.confidence, |row| row.precision)),
            (color(1), line(|row| row.confidence, |row| row.recall)),
            (color(2), line(|row| row.confidence, |row| row.f1)),
        ],
        square: false,
    };
    let legend: Vec<(Rgb, String)> = ["precision", "recall", "F1"]
        .iter()
        .enumerate()
        .map(|(i, name)| (color(i), (*name).to_owned()))
        .collect();
    Ok(vec![
        Chart::new(
            "Precision over recall, overlap 0.5",
            &precision_recall,
            &[],
            &source,
        )?,
        Chart::new(
            "Over the confidence, overlap 0.5",
            &over_confidence,
            &legend,
            &source,
        )?,
    ])
}

fn confusion(of: &Evaluated) -> Table {
    let rows = &of.evaluation.tables.confusion;
    let mut there: Vec<&str> = Vec::new();
    let mut found: Vec<&str> = Vec::new();
    for row in rows {
        if !there.contains(&row.there.as_str()) {
            there.push(&row.there);
        }
        if !found.contains(&row.found.as_str()) {
            found.push(&row.found);
        }
    }
    let mut header = vec!["found \\ there"];
    header.extend(&there);
    let mut table = Table::new("Confusion", &header, of.file("confusion.csv"));
    table.note = format!(
        "All images, confidence above {}, overlap 0.5. Background: nothing found, or nothing there.",
        of.evaluation.confidence
    );
    let count = |found: &str, there: &str| {
        let is_cell = |row: &&ConfusionRow| row.found == found && row.there == there;
        rows.iter()
            .find(is_cell)
            .map_or_else(|| "-".to_owned(), |row| row.count.to_string())
    };
    for found in found {
        let mut cells = vec![found.to_owned()];
        cells.extend(there.iter().map(|there| count(found, there)));
        table.rows.push(cells);
    }
    table
}

fn coco(of: &Evaluated) -> Table {
    let mut table = Table::new(
        "COCO evaluation",
        &["figure", "overlap", "area", "detections", "value"],
        of.file("coco.csv"),
    );
    "Small is below 32 x 32 pixels of the image, large above 96 x 96.".clone_into(&mut table.note);
    table.folded = true;
    table.words = 3;
    for row in &of.evaluation.tables.coco {
        table.rows.push(vec![
            row.figure.clone(),
            row.iou.clone(),
            row.area.clone(),
            row.max_detections.to_string(),
            number(row.value, 3),
        ]);
    }
    table
}

fn times(of: &Evaluated, rows: &[LatencyRow]) -> Table {
    let mut table = Table::new(
        "From two files to metres",
        &["stage", "least ms", "median ms", "mean ms", "P95 ms"],
        of.file("latency.csv"),
    );
    if let Some(row) = rows.first() {
        table.note = format!(
            "{} pairs one after the other, {} vehicles seen in them.",
            row.pairs, row.vehicles
        );
    }
    for row in rows {
        table.rows.push(vec![
            row.stage.clone(),
            format!("{:.1}", row.least_ms),
            format!("{:.1}", row.median_ms),
            format!("{:.1}", row.mean_ms),
            format!("{:.1}", row.p95_ms),
        ]);
    }
    table
}

fn time_chart(of: &Evaluated, rows: &[LatencyRow]) -> Result<Chart> {
    let names = rows.iter().map(|row| row.stage.clone()).collect();
    let medians: Vec<Option<f64>> = rows.iter().map(|row| Some(row.median_ms)).collect();
    let top = rows.iter().map(|row| row.median_ms).fold(0.1, f64::max);
    let figure = Figure {
        x: Axis::named("stage", names),
        y: Axis::new("median, ms", [0.0, top * 1.05]),
        shapes: vec![(color(0), Shape::Bars(grouped_bars(&medians, 0, 1)))],
        square: false,
    };
    Chart::new(
        "Median time of each stage",
        &figure,
        &[],
        of.file("latency.csv"),
    )
}
