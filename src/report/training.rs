//! Training curves: loss, and what validation said, epoch by epoch.

use super::load::Run;
use super::parts::{Chart, Section};
use crate::error::Result;
use crate::page::charts::{Axis, Figure, Rgb, Shape, color};
use crate::train::EpochRow;

/// A value of an epoch.
type Value = fn(&EpochRow) -> Option<f64>;

/// What a chart shows: title, unit, stage, one or more values with their names, whether the axis is
/// logarithmic.
struct Plan {
    title: &'static str,
    unit: &'static str,
    stage: &'static str,
    values: &'static [(&'static str, Value)],
    logarithmic: bool,
}

const PLANS: [Plan; 6] = [
    Plan {
        title: "Detector: loss",
        unit: "loss",
        stage: "detector",
        values: &[("loss", |row| Some(row.loss))],
        logarithmic: true,
    },
    Plan {
        title: "Detector: mean average precision, validation",
        unit: "mAP",
        stage: "detector",
        values: &[("mAP50", |row| row.map50), ("mAP50-95", |row| row.map50_95)],
        logarithmic: false,
    },
    Plan {
        title: "Detector: precision and recall, validation",
        unit: "share",
        stage: "detector",
        values: &[
            ("precision", |row| row.precision),
            ("recall", |row| row.recall),
        ],
        logarithmic: false,
    },
    Plan {
        title: "Distance: loss",
        unit: "loss",
        stage: "distance",
        values: &[("loss", |row| Some(row.loss))],
        logarithmic: true,
    },
    Plan {
        title: "Distance: MAE and RMSE, validation",
        unit: "metres",
        stage: "distance",
        values: &[("MAE", |row| row.mae_m), ("RMSE", |row| row.rmse_m)],
        logarithmic: false,
    },
    Plan {
        title: "Distance: MRE, validation",
        unit: "percent",
        stage: "distance",
        values: &[("MRE", |row| row.mre_percent)],
        logarithmic: false,
    },
];

/// The curves of all runs; None where no run has any.
pub(super) fn section(runs: &[Run]) -> Result<Option<Section>> {
    let mut charts = Vec::new();
    for plan in &PLANS {
        charts.extend(chart(plan, runs)?);
    }
    if charts.is_empty() {
        return Ok(None);
    }
    let mut section = Section::new("Training");
    section.charts(charts);
    Ok(Some(section))
}

fn chart(plan: &Plan, runs: &[Run]) -> Result<Option<Chart>> {
    let mut lines: Vec<(Rgb, String, Vec<[f64; 2]>)> = Vec::new();
    let mut sources = Vec::new();
    for run in runs {
        let rows = || run.epochs.iter().filter(|row| row.stage == plan.stage);
        for (place, (name, value)) in plan.values.iter().enumerate() {
            let points: Vec<[f64; 2]> = rows()
                .filter_map(|row| Some([f64::from(row.epoch), value(row)?]))
                .filter(|[_, y]| y.is_finite() && (!plan.logarithmic || *y > 0.0))
                .collect();
            if points.is_empty() {
                continue;
            }
            let series = run.number * plan.values.len() + place;
            let title = if runs.len() > 1 {
                format!("{} {name}", run.name)
            } else {
                (*name).to_owned()
            };
            lines.push((color(series), title, points));
            sources.push(run.file("metrics.csv"));
        }
    }
    if lines.is_empty() {
        return Ok(None);
    }
    sources.dedup();
    let points = || lines.iter().flat_map(|(_, _, points)| points);
    let last = points().map(|[x, _]| *x).fold(1.0, f64::max);
    let low = points().map(|[_, y]| *y).fold(f64::INFINITY, f64::min);
    let high = points().map(|[_, y]| *y).fold(f64::NEG_INFINITY, f64::max);
    let range = if plan.logarithmic {
        [libm::log10(low) - 0.05, libm::log10(high) + 0.05]
    } else {
        [0.0, high.max(f64::MIN_POSITIVE) * 1.05]
    };
    let y_of = |y: f64| if plan.logarithmic { libm::log10(y) } else { y };
    let shapes = lines.iter().flat_map(|(color, _, points)| {
        let points: Vec<[f64; 2]> = points.iter().map(|[x, y]| [*x, y_of(*y)]).collect();
        [
            (*color, Shape::Line(points.clone())),
            (*color, Shape::Dots(points)),
        ]
    });
    let figure = Figure {
        x: Axis::new("epoch", [0.0, last]),
        y: Axis {
            logarithmic: plan.logarithmic,
            ..Axis::new(plan.unit, range)
        },
        shapes: shapes.collect(),
        square: false,
    };
    let legend: Vec<(Rgb, String)> = lines
        .iter()
        .map(|(c, name, _)| (*c, name.clone()))
        .collect();
    Chart::new(plan.title, &figure, &legend, sources.join(", ")).map(Some)
}
