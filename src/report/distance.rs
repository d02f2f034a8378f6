//! Distances of one evaluation: tables and charts.

use super::load::Evaluated;
use super::parts::{Chart, Section, Table, bounded, number, percent};
use crate::dataset::BoxKind;
use crate::error::Result;
use crate::evaluate::{
    Boxes, DistanceRow, Grouping, LABEL_NOTE, Method, ProtocolRow, Tables, protocol_cells,
};
use crate::page::charts::{Axis, Figure, Rgb, Shape, bar_middle, color, grouped_bars};

/// Beyond this many times the largest true distance, the scatter is cut off.
const SCATTER_REACH: f64 = 1.3;

/// Adds everything about distances.
pub(super) fn add(section: &mut Section, of: &Evaluated) -> Result<()> {
    let tables = &of.evaluation.tables;
    if tables.vehicles.is_empty() {
        return Ok(());
    }
    section.heading("Distances");
    for boxes in Boxes::ALL {
        section.table(methods(of, boxes));
    }
    section.table(differences(of));
    let mut scatters = vec![scatter(of, Boxes::True)?];
    if of.evaluation.pipeline.is_some() {
        scatters.push(scatter(of, Boxes::Pipeline)?);
    }
    scatters.extend(reliability(of)?);
    section.charts(scatters);
    if !of.evaluation.tables.spread.is_empty() {
        section.table(by_spread(of));
    }
    let mut charts = Vec::new();
    for grouping in Grouping::ALL {
        if grouping != Grouping::All {
            charts.extend(by_group(of, grouping)?);
        }
    }
    charts.extend(methods_by_distance(of)?);
    section.charts(charts);
    for grouping in Grouping::ALL {
        if grouping != Grouping::All {
            section.table(groups(of, grouping));
        }
    }
    if let Some(baselines) = &of.evaluation.baselines {
        let mut table = Table::new(
            "Constants of the baselines",
            &["baseline", "constants"],
            of.file("evaluation.json"),
        );
        table.note = format!(
            "Fitted on the training split of {}: {} vehicles, {} of them matched.",
            baselines.fitted_on.display(),
            baselines.vehicles,
            baselines.matched
        );
        table.folded = true;
        table.words = 2;
        table.rows = vec![
            vec![
                "size".to_owned(),
                format!(
                    "distance = {:.4} m / norm_w (a vehicle's box is {:.3} m wide)",
                    baselines.size_constant_m, baselines.size_m
                ),
            ],
            vec!["triangulation".to_owned(), "none".to_owned()],
            vec![
                "matching".to_owned(),
                format!("surface to centre: {:+.3} m", baselines.surface_to_center_m),
            ],
        ];
        section.table(table);
    }
    protocol(section, of);
    Ok(())
}

fn rows(tables: &Tables, grouping: Grouping, boxes: Boxes) -> impl Iterator<Item = &DistanceRow> {
    let rows = tables.distance.iter();
    rows.filter(move |row| row.grouping == grouping && row.boxes == boxes)
}

fn methods(of: &Evaluated, boxes: Boxes) -> Table {
    let mut table = Table::new(
        match boxes {
            Boxes::True => "From the labels' boxes",
            Boxes::Pipeline => "Whole pipeline: detected boxes",
        },
        &[
            "method",
            "answers",
            "MAE m",
            "RMSE m",
            "MRE %",
            "median m",
            "bias m",
            "P95 m",
            "within 5 %",
            "δ<1.25",
            "δ<1.25²",
            "δ<1.25³",
            "SqRel m",
            "RMSE log",
        ],
        of.file("distance.csv"),
    );
    if boxes == Boxes::Pipeline
        && let Some(figures) = &of.evaluation.pipeline
    {
        table.note = format!(
            "{} of {} vehicles found, {} missed; {} seen where none is labelled. Errors are those of \
             the vehicles found.",
            figures.found, figures.vehicles, figures.missed, figures.false_vehicles
        );
    }
    if boxes == Boxes::True && of.evaluation.box_kind == BoxKind::Sphere {
        LABEL_NOTE.clone_into(&mut table.note);
    }
    for row in rows(&of.evaluation.tables, Grouping::All, boxes) {
        table.rows.push(vec![
            row.method.name().to_owned(),
            format!("{} of {}", row.answered, row.vehicles),
            bounded(row.mae_m, [row.mae_low_m, row.mae_high_m], 2),
            bounded(row.rmse_m, [row.rmse_low_m, row.rmse_high_m], 2),
            bounded(
                row.mre_percent,
                [row.mre_low_percent, row.mre_high_percent],
                1,
            ),
            number(row.median_m, 2),
            number(row.bias_m, 2),
            number(row.p95_m, 2),
            percent(row.within_5_percent),
            percent(row.delta1),
            percent(row.delta2),
            percent(row.delta3),
            number(row.sq_rel_m, 3),
            number(row.rmse_log, 3),
        ]);
    }
    table
}

fn differences(of: &Evaluated) -> Table {
    let mut table = Table::new(
        "The ranger in use against other methods",
        &[
            "method",
            "boxes",
            "vehicles",
            "ranger MAE m",
            "its MAE m",
            "difference m",
        ],
        of.file("differences.csv"),
    );
    "On the vehicles that both have an answer for. Below 0 the ranger is better; where the bounds \
     hold 0, that may be chance."
        .clone_into(&mut table.note);
    table.words = 2;
    for row in &of.evaluation.tables.differences {
        table.rows.push(vec![
            row.method.name().to_owned(),
            row.boxes.name().to_owned(),
            row.vehicles.to_string(),
            format!("{:.2}", row.ranger_mae_m),
            format!("{:.2}", row.method_mae_m),
            bounded(Some(row.difference_m), [row.low_m, row.high_m], 2),
        ]);
    }
    table
}

fn groups(of: &Evaluated, grouping: Grouping) -> Table {
    let mut table = Table::new(
        &format!(
            "{} by {}",
            capital(of.evaluation.method().name()),
            grouping.name()
        ),
        &[
            grouping.name(),
            "vehicles",
            "MAE m",
            "RMSE m",
            "MRE %",
            "bias m",
            "within 5 %",
            "found",
            "missed",
            "false",
            "pipeline MAE m",
            "pipeline MRE %",
        ],
        of.file("distance.csv"),
    );
    table.folded = true;
    let tables = &of.evaluation.tables;
    let method = of.evaluation.method();
    let of_ranger = |boxes| rows(tables, grouping, boxes).filter(|row| row.method == method);
    // A run without a detector has no such rows.
    let mut of_pipeline = of_ranger(Boxes::Pipeline);
    for row in of_ranger(Boxes::True) {
        let pipeline = of_pipeline.next();
        let count = |value: Option<usize>| value.map_or_else(|| "-".to_owned(), |n| n.to_string());
        table.rows.push(vec![
            row.group.clone(),
            row.vehicles.to_string(),
            bounded(row.mae_m, [row.mae_low_m, row.mae_high_m], 2),
            number(row.rmse_m, 2),
            bounded(
                row.mre_percent,
                [row.mre_low_percent, row.mre_high_percent],
                1,
            ),
            number(row.bias_m, 2),
            percent(row.within_5_percent),
            count(pipeline.map(|row| row.answered)),
            count(pipeline.map(|row| row.unanswered)),
            count(pipeline.and_then(|row| row.false_vehicles)),
            number(pipeline.and_then(|row| row.mae_m), 2),
            number(pipeline.and_then(|row| row.mre_percent), 1),
        ]);
    }
    table
}

/// Estimated over true distance.
fn scatter(of: &Evaluated, boxes: Boxes) -> Result<Chart> {
    let vehicles = &of.evaluation.tables.vehicles;
    let farthest = vehicles.iter().map(|v| v.distance_m).fold(1.0, f64::max);
    let reach = farthest * SCATTER_REACH;
    let dots: Vec<[f64; 2]> = vehicles
        .iter()
        .filter_map(|v| {
            let estimate = v.estimate(boxes, of.evaluation.method())?;
            Some([v.distance_m, estimate.clamp(0.0, reach)])
        })
        .collect();
    let end = farthest * 1.05;
    let line = |factor: f64| Shape::Guide(vec![[0.0, 0.0], [end, end * factor]]);
    let figure = Figure {
        x: Axis::new("true distance, m", [0.0, end]),
        y: Axis::new("estimated, m", [0.0, reach]),
        shapes: vec![
            (color(0), line(1.0)),
            (color(0), line(1.1)),
            (color(0), line(0.9)),
            (color(boxes as usize), Shape::Dots(dots)),
        ],
        square: true,
    };
    let title = format!(
        "{}, {}: estimated over true distance, lines at ±10 %",
        capital(of.evaluation.method().name()),
        boxes.name()
    );
    Chart::new(title, &figure, &[], of.file("vehicles.csv"))
}

/// A word that begins a title.
fn capital(word: &str) -> String {
    let mut letters = word.chars();
    let first = letters.next().map(|first| first.to_ascii_uppercase());
    first.into_iter().chain(letters).collect()
}

/// What intervals hold over their probability.
fn reliability(of: &Evaluated) -> Result<Option<Chart>> {
    let rows = &of.evaluation.tables.reliability;
    if rows.is_empty() {
        return Ok(None);
    }
    let mut shapes = vec![(color(0), Shape::Guide(vec![[0.0, 0.0], [100.0, 100.0]]))];
    let mut legend = Vec::new();
    for boxes in Boxes::ALL {
        let line: Vec<[f64; 2]> = rows
            .iter()
            .filter(|row| row.boxes == boxes)
            .map(|row| [row.probability_percent, row.held_percent])
            .collect();
        if line.is_empty() {
            continue;
        }
        shapes.push((color(boxes as usize), Shape::Dots(line.clone())));
        shapes.push((color(boxes as usize), Shape::Line(line)));
        legend.push((color(boxes as usize), boxes.name().to_owned()));
    }
    let figure = Figure {
        x: Axis::new("probability of the interval, percent", [0.0, 100.0]),
        y: Axis::new("intervals that hold the distance, percent", [0.0, 100.0]),
        shapes,
        square: true,
    };
    let title = "Reliability of the posterior: below the line intervals are too narrow";
    Chart::new(
        title.to_owned(),
        &figure,
        &legend,
        of.file("reliability.csv"),
    )
    .map(Some)
}

/// Errors beside the spread that was predicted.
fn by_spread(of: &Evaluated) -> Table {
    let mut table = Table::new(
        "Error by predicted spread",
        &[
            "predicted spread",
            "boxes",
            "vehicles",
            "predicted %",
            "RMSE %",
            "MRE %",
            "95 % interval holds %",
        ],
        of.file("spread.csv"),
    );
    table.words = 2;
    table.folded = true;
    for row in &of.evaluation.tables.spread {
        table.rows.push(vec![
            row.group.clone(),
            row.boxes.name().to_owned(),
            row.vehicles.to_string(),
            format!("{:.1}", row.predicted_percent),
            format!("{:.1}", row.rmse_percent),
            format!("{:.1}", row.mre_percent),
            format!("{:.0}", row.coverage_95),
        ]);
    }
    table
}

/// The unit goes to the axis.
fn short(group: &str) -> String {
    let group = group.trim_end_matches(" m").trim_end_matches(" px");
    group.replace("below ", "<").replace(" px and more", "+")
}

/// Relative error of the network by group, from both kinds of boxes.
fn by_group(of: &Evaluated, grouping: Grouping) -> Result<Option<Chart>> {
    let series: Vec<(Rgb, String, Vec<&DistanceRow>)> = Boxes::ALL
        .iter()
        .map(|&boxes| {
            let rows = rows(&of.evaluation.tables, grouping, boxes)
                .filter(|row| row.method == of.evaluation.method() && row.vehicles > 0);
            (
                color(boxes as usize),
                boxes.name().to_owned(),
                rows.collect::<Vec<_>>(),
            )
        })
        .filter(|(_, _, rows)| !rows.is_empty())
        .collect();
    let unit = match grouping {
        Grouping::Distance => "true distance, m",
        Grouping::Box => "longer side of the box, px",
        _ => grouping.name(),
    };
    bars(
        of,
        &format!("MRE of {} by {}", of.evaluation.method(), grouping.name()),
        unit,
        &series,
    )
}

/// Relative error of every method by distance, from labelled boxes.
fn methods_by_distance(of: &Evaluated) -> Result<Option<Chart>> {
    let series: Vec<(Rgb, String, Vec<&DistanceRow>)> = Method::ALL
        .iter()
        .map(|&method| {
            let rows = rows(&of.evaluation.tables, Grouping::Distance, Boxes::True)
                .filter(|row| row.method == method && row.vehicles > 0);
            (
                color(method as usize),
                method.name().to_owned(),
                rows.collect::<Vec<_>>(),
            )
        })
        .filter(|(_, _, rows)| !rows.is_empty())
        .collect();
    let title = "MRE of every method by distance, labels' boxes";
    bars(of, title, "true distance, m", &series)
}

/// Groups in which vehicles were only made up have no error to draw.
fn bars(
    of: &Evaluated,
    title: &str,
    unit: &str,
    series: &[(Rgb, String, Vec<&DistanceRow>)],
) -> Result<Option<Chart>> {
    let names: Vec<String> = match series.first() {
        Some((_, _, rows)) if !rows.is_empty() => {
            rows.iter().map(|row| short(&row.group)).collect()
        }
        _ => return Ok(None),
    };
    let mut shapes = Vec::new();
    let mut top: f64 = 0.0;
    for (place, (color, _, rows)) in series.iter().enumerate() {
        let values: Vec<Option<f64>> = rows.iter().map(|row| row.mre_percent).collect();
        top = values.iter().flatten().copied().fold(top, f64::max);
        shapes.push((
            *color,
            Shape::Bars(grouped_bars(&values, place, series.len())),
        ));
        let bounds = rows.iter().enumerate().filter_map(|(group, row)| {
            let middle = bar_middle(group, place, series.len());
            Some([middle, row.mre_low_percent?, row.mre_high_percent?])
        });
        shapes.push((*color, Shape::Bounds(bounds.collect())));
    }
    let ceiling = top * 1.5;
    for (_, shape) in &mut shapes {
        if let Shape::Bounds(bounds) = shape {
            for [_, low, high] in bounds {
                top = top.max(high.min(ceiling));
                *low = low.min(ceiling);
                *high = high.min(ceiling);
            }
        }
    }
    let figure = Figure {
        x: Axis::named(unit, names),
        y: Axis::new("MRE, percent", [0.0, (top * 1.05).max(1.0)]),
        shapes,
        square: false,
    };
    let legend: Vec<(Rgb, String)> = series
        .iter()
        .map(|(color, name, _)| (*color, name.clone()))
        .collect();
    Chart::new(title, &figure, &legend, of.file("distance.csv")).map(Some)
}

/// The paper's table beside ours.
fn protocol(section: &mut Section, of: &Evaluated) {
    let Some(protocol) = &of.evaluation.tables.protocol else {
        return;
    };
    section.heading("The paper's test");
    let missing = format!(
        "Of the paper's 108 test frames this split holds {}; those that it lacks are listed in {}. {} \
         frames at other distances have rows of their own.",
        protocol.cells,
        of.file("protocol_missing.csv"),
        protocol.other_frames
    );
    for boxes in Boxes::ALL {
        let mut table = Table::new(
            &format!("Mean estimate by sun, {}", boxes.name()),
            &[
                "true m",
                "sunrise",
                "morning",
                "noon",
                "afternoon",
                "RMSE m of means",
                "paper",
                "MRE % of means",
                "paper",
                "RMSE m of frames",
                "MRE % of frames",
                "missed",
                "false",
                "frames",
            ],
            of.file("protocol.csv"),
        );
        if boxes == Boxes::True && !protocol.missing.is_empty() {
            table.note.clone_from(&missing);
        }
        let is_shown = |row: &&ProtocolRow| row.boxes == boxes && row.frames > 0;
        for row in protocol.rows.iter().filter(is_shown) {
            table.rows.push(protocol_cells(row).to_vec());
        }
        section.table(table);
    }
}
