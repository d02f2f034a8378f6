//! The runs at a glance, and against each other.

use std::collections::BTreeMap;

use super::load::{Evaluated, Run};
use super::parts::{Chart, Section, Table, bounded, number};
use crate::error::Result;
use crate::evaluate::{Boxes, DistanceRow, Grouping, Method, VehicleRow, paired_difference};
use crate::metrics::Interval;
use crate::page::charts::{Axis, Figure, Rgb, Shape, bar_middle, color, grouped_bars};

/// Every evaluation of every run in one table; with several runs, charts and differences too.
pub(super) fn section(runs: &[Run]) -> Result<Section> {
    let mut section = Section::new(if runs.len() > 1 {
        "Comparison"
    } else {
        "Summary"
    });
    section.table(detectors(runs));
    section.table(distances(runs));
    if runs.len() > 1 {
        let mut names: Vec<&str> = evaluations(runs).map(|(_, of)| of.name.as_str()).collect();
        names.sort_unstable();
        names.dedup();
        let mut charts = Vec::new();
        for name in names {
            let same: Vec<(&Run, &Evaluated)> = evaluations(runs)
                .filter(|(_, of)| of.name == name)
                .collect();
            if same.len() > 1 {
                charts.push(chart(name, &same)?);
                section.table(differences(name, &same));
            }
        }
        section.charts(charts);
    }
    Ok(section)
}

fn evaluations(runs: &[Run]) -> impl Iterator<Item = (&Run, &Evaluated)> {
    runs.iter()
        .flat_map(|run| run.evaluations.iter().map(move |of| (run, of)))
}

/// A file of every evaluation.
fn sources(runs: &[Run], name: &str) -> String {
    let files: Vec<String> = evaluations(runs).map(|(_, of)| of.file(name)).collect();
    files.join(", ")
}

fn ends(interval: Option<Interval>) -> [Option<f64>; 2] {
    [interval.map(|i| i.low), interval.map(|i| i.high)]
}

fn detectors(runs: &[Run]) -> Table {
    let source = sources(runs, "evaluation.json");
    let mut table = Table::new(
        "Detector",
        &[
            "run",
            "evaluation",
            "images",
            "mAP50",
            "mAP50-95",
            "precision",
            "recall",
            "F1",
        ],
        source,
    );
    table.words = 2;
    for (run, of) in evaluations(runs) {
        let Some(figures) = &of.evaluation.detection else {
            continue;
        };
        table.rows.push(vec![
            run.name.clone(),
            of.name.clone(),
            figures.images.to_string(),
            bounded(Some(figures.map50), ends(figures.map50_interval), 3),
            bounded(Some(figures.map50_95), ends(figures.map50_95_interval), 3),
            format!("{:.3}", figures.precision),
            format!("{:.3}", figures.recall),
            format!("{:.3}", figures.f1),
        ]);
    }
    table
}

/// The ranger in use over all vehicles.
fn ranger(of: &Evaluated, boxes: Boxes) -> Option<&DistanceRow> {
    let rows = &of.evaluation.tables.distance;
    rows.iter().find(|row| {
        (row.grouping, row.boxes, row.method) == (Grouping::All, boxes, of.evaluation.method())
    })
}

fn distances(runs: &[Run]) -> Table {
    let mut table = Table::new(
        "Ranger on true boxes and whole pipeline",
        &[
            "run",
            "evaluation",
            "boxes",
            "vehicles",
            "found",
            "missed",
            "false",
            "MAE m",
            "RMSE m",
            "MRE %",
            "best baseline",
        ],
        sources(runs, "distance.csv"),
    );
    table.words = 3;
    for (run, of) in evaluations(runs) {
        for boxes in Boxes::ALL {
            let Some(row) = ranger(of, boxes) else {
                continue;
            };
            let is_pipeline = boxes == Boxes::Pipeline;
            let counted = |count: usize| {
                if is_pipeline {
                    count.to_string()
                } else {
                    "-".to_owned()
                }
            };
            table.rows.push(vec![
                run.name.clone(),
                of.name.clone(),
                boxes.name().to_owned(),
                row.vehicles.to_string(),
                counted(row.answered),
                counted(row.unanswered),
                row.false_vehicles
                    .map_or_else(|| "-".to_owned(), |count| count.to_string()),
                bounded(row.mae_m, [row.mae_low_m, row.mae_high_m], 2),
                bounded(row.rmse_m, [row.rmse_low_m, row.rmse_high_m], 2),
                bounded(
                    row.mre_percent,
                    [row.mre_low_percent, row.mre_high_percent],
                    1,
                ),
                best_baseline(of, boxes),
            ]);
        }
    }
    table
}

/// The baseline of the least mean relative error that answers for most vehicles. Triangulating the
/// centres of labelled square boxes is arithmetic on the label, and does not stand here.
fn best_baseline(of: &Evaluated, boxes: Boxes) -> String {
    let rows = of.evaluation.tables.distance.iter().filter(|row| {
        let is_label = row.boxes == Boxes::True && row.method == Method::Triangulation;
        row.grouping == Grouping::All
            && row.boxes == boxes
            && ![Method::Fused, Method::Network].contains(&row.method)
            && !is_label
    });
    let best = rows
        .filter_map(|row| Some((row.mre_percent?, row.method)))
        .min_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or_else(
        || "-".to_owned(),
        |(mre, method)| format!("{method}, {mre:.1} %"),
    )
}

/// Relative error of the runs on the same frames.
fn chart(name: &str, same: &[(&Run, &Evaluated)]) -> Result<Chart> {
    let names = same.iter().map(|(run, _)| run.name.clone()).collect();
    let mut shapes = Vec::new();
    let mut top: f64 = 1.0;
    for (place, boxes) in Boxes::ALL.into_iter().enumerate() {
        let rows: Vec<Option<&DistanceRow>> =
            same.iter().map(|(_, of)| ranger(of, boxes)).collect();
        let values: Vec<Option<f64>> = rows.iter().map(|row| (*row)?.mre_percent).collect();
        let bounds: Vec<[f64; 3]> = rows
            .iter()
            .enumerate()
            .filter_map(|(at, row)| {
                let row = (*row)?;
                Some([
                    bar_middle(at, place, Boxes::ALL.len()),
                    row.mre_low_percent?,
                    row.mre_high_percent?,
                ])
            })
            .collect();
        let highest = values
            .iter()
            .flatten()
            .copied()
            .chain(bounds.iter().map(|b| b[2]));
        top = highest.fold(top, f64::max);
        shapes.push((
            color(boxes as usize),
            Shape::Bars(grouped_bars(&values, place, Boxes::ALL.len())),
        ));
        shapes.push((color(boxes as usize), Shape::Bounds(bounds)));
    }
    let figure = Figure {
        x: Axis::named("run", names),
        y: Axis::new("MRE, percent", [0.0, top * 1.05]),
        shapes,
        square: false,
    };
    let legend: Vec<(Rgb, String)> = Boxes::ALL
        .iter()
        .map(|boxes| (color(*boxes as usize), boxes.name().to_owned()))
        .collect();
    let sources: Vec<String> = same.iter().map(|(_, of)| of.file("distance.csv")).collect();
    Chart::new(
        format!("MRE on {name}"),
        &figure,
        &legend,
        sources.join(", "),
    )
}

/// Vehicles by frame and number.
fn by_key(of: &Evaluated) -> BTreeMap<(u64, u32), VehicleRow> {
    let vehicles = of.evaluation.tables.vehicles.iter();
    vehicles.map(|v| ((v.frame, v.id), v.clone())).collect()
}

/// Every run against the first one on the vehicles that both were asked about.
fn differences(name: &str, same: &[(&Run, &Evaluated)]) -> Table {
    let sources: Vec<String> = same.iter().map(|(_, of)| of.file("vehicles.csv")).collect();
    let (first_run, first) = same[0];
    let mut table = Table::new(
        &format!("Against {} on {name}", first_run.name),
        &["run", "boxes", "common vehicles", "difference of MAE m"],
        sources.join(", "),
    );
    table.note = format!(
        "Below 0 the run is better than {}; where the bounds hold 0, that may be chance.",
        first_run.name
    );
    table.words = 2;
    let reference = by_key(first);
    for (run, of) in &same[1..] {
        let pairs: Vec<(VehicleRow, VehicleRow)> = by_key(of)
            .into_iter()
            .filter_map(|(key, vehicle)| {
                let of_first = reference.get(&key)?;
                // The same vehicle only where the truth is the same.
                (of_first.distance_m == vehicle.distance_m).then(|| (of_first.clone(), vehicle))
            })
            .collect();
        for boxes in Boxes::ALL {
            let methods = [first, of].map(|of| of.evaluation.method());
            let Some(difference) = paired_difference(&pairs, boxes, methods) else {
                continue;
            };
            table.rows.push(vec![
                run.name.clone(),
                boxes.name().to_owned(),
                difference.vehicles.to_string(),
                format!(
                    "{}{}",
                    number(Some(difference.difference_m), 3),
                    match difference.interval {
                        Some(Interval { low, high }) => format!(" [{low:.3}, {high:.3}]"),
                        None => String::new(),
                    }
                ),
            ]);
        }
    }
    table
}
