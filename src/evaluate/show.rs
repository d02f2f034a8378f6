//! Tables for people, in text.

use std::fmt::{self, Write as _};

use super::distances::{DifferenceRow, DistanceRow};
use super::groups::Grouping;
use super::protocol::{Protocol, ProtocolRow};
use super::subject::Networks;
use super::vehicles::{Boxes, Method};
use super::{Bootstrap, DetectionFigures, Evaluation, PipelineFigures};
use crate::dataset::BoxKind;
use crate::metrics::Interval;

/// Said beneath a table that a baseline reads the answer from.
pub const LABEL_NOTE: &str = "Labelled square boxes have their centres where the vehicle's centre is: \
                              triangulating them reads the label.";

impl fmt::Display for Evaluation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "split {}: {} frames", self.split, self.frames)?;
        match self.networks {
            Networks::Both => writeln!(
                f,
                ", pairing {}, confidence {}",
                self.pairing_mode, self.confidence
            )?,
            Networks::Detector => writeln!(f, ", confidence {}", self.confidence)?,
            Networks::Distance | Networks::None => writeln!(f)?,
        }
        if let Some(left_out) = self.networks.left_out() {
            writeln!(f, "{left_out}")?;
        }
        if self.left_out > 0 {
            writeln!(
                f,
                "{} frames could not be read and are left out",
                self.left_out
            )?;
        }
        let Bootstrap {
            unit, units, draws, ..
        } = &self.bootstrap;
        writeln!(
            f,
            "in brackets: where 95 % of {draws} draws of whole {unit}s (of {units}) lie"
        )?;
        if let Some(detection) = &self.detection {
            detector(f, detection)?;
        }
        for boxes in Boxes::ALL {
            methods(f, boxes, &self.tables.distance)?;
            if boxes == Boxes::True && self.box_kind == BoxKind::Sphere && self.baselines.is_some()
            {
                writeln!(f, "{LABEL_NOTE}")?;
            }
        }
        spread(f, self)?;
        against(f, self.method(), &self.tables.differences)?;
        for grouping in Grouping::ALL {
            if grouping != Grouping::All {
                groups(f, self.method(), grouping, &self.tables.distance)?;
            }
        }
        if let Some(figures) = &self.pipeline {
            pipeline(f, figures)?;
        }
        write!(f, "\ntables: {}", self.folder.display())
    }
}

/// `[0.85, 0.93]`, or as much blank.
fn bounds(interval: Option<Interval>, decimals: usize) -> String {
    let text = |value: f64| format!("{value:.decimals$}");
    interval.map_or_else(String::new, |Interval { low, high }| {
        format!("[{}, {}]", text(low), text(high))
    })
}

/// A number with decimals, or `-`.
pub(crate) fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.decimals$}"))
}

/// A share in percent.
pub(crate) fn percent(share: Option<f64>) -> String {
    number(share.map(|share| share * 100.0), 0)
}

fn interval(low: Option<f64>, high: Option<f64>) -> Option<Interval> {
    Some(Interval {
        low: low?,
        high: high?,
    })
}

fn detector(f: &mut fmt::Formatter<'_>, figures: &DetectionFigures) -> fmt::Result {
    let DetectionFigures {
        images,
        targets,
        precision,
        recall,
        f1,
        map50,
        map50_95,
        ..
    } = figures;
    if *targets == 0 {
        return writeln!(
            f,
            "\ndetector        {images} images with no boxes: nothing to find"
        );
    }
    writeln!(
        f,
        "\ndetector        images  boxes  precision  recall     F1  mAP50                 mAP50-95"
    )?;
    writeln!(
        f,
        "                {images:>6}  {targets:>5}  {precision:>9.3}  {recall:>6.3}  {f1:>5.3}  {map50:>5.3} {:<14}  {map50_95:>8.3} {}",
        bounds(figures.map50_interval, 3),
        bounds(figures.map50_95_interval, 3),
    )
}

fn methods(f: &mut fmt::Formatter<'_>, boxes: Boxes, rows: &[DistanceRow]) -> fmt::Result {
    let of_all = |row: &&DistanceRow| row.grouping == Grouping::All && row.boxes == boxes;
    let mut rows = rows.iter().filter(of_all).peekable();
    if rows.peek().is_none() {
        return Ok(());
    }
    writeln!(
        f,
        "\n{:<14}  answers    MAE m                RMSE m               MRE %               bias m  P95 m  <5 %  d<1.25",
        boxes.name()
    )?;
    for row in rows {
        writeln!(
            f,
            "{:<14}  {:>4}/{:<4} {:>6} {:<14} {:>6} {:<14} {:>5} {:<14} {:>6}  {:>5}  {:>4}  {:>6}",
            row.method,
            row.answered,
            row.vehicles,
            number(row.mae_m, 2),
            bounds(interval(row.mae_low_m, row.mae_high_m), 2),
            number(row.rmse_m, 2),
            bounds(interval(row.rmse_low_m, row.rmse_high_m), 2),
            number(row.mre_percent, 1),
            bounds(interval(row.mre_low_percent, row.mre_high_percent), 1),
            number(row.bias_m, 2),
            number(row.p95_m, 1),
            percent(row.within_5_percent),
            percent(row.delta1),
        )?;
    }
    Ok(())
}

fn against(f: &mut fmt::Formatter<'_>, ranger: Method, rows: &[DifferenceRow]) -> fmt::Result {
    if rows.is_empty() {
        return Ok(());
    }
    writeln!(
        f,
        "\n{:<17}  boxes       vehicles  MAE m  difference m (below 0: {ranger} is better)",
        format!("{ranger} against")
    )?;
    for row in rows {
        writeln!(
            f,
            "{:<17}  {:<10}  {:>8}  {:>5.2}  {:>+6.2} {}",
            row.method,
            row.boxes,
            row.vehicles,
            row.method_mae_m,
            row.difference_m,
            bounds(interval(row.low_m, row.high_m), 2),
        )?;
    }
    Ok(())
}

/// How well the intervals hold.
fn spread(f: &mut fmt::Formatter<'_>, evaluation: &Evaluation) -> fmt::Result {
    let of_labels = evaluation.true_boxes.map(|figures| figures.spread);
    let of_pipeline = evaluation.pipeline.as_ref().map(|figures| figures.spread);
    let mut is_first = true;
    for (boxes, figures) in Boxes::ALL.into_iter().zip([of_labels, of_pipeline]) {
        let Some(figures) = figures.filter(|figures| figures.nll.is_some()) else {
            continue;
        };
        if std::mem::take(&mut is_first) {
            writeln!(
                f,
                "\nintervals       answered  68 % holds  95 % holds   NLL"
            )?;
        }
        writeln!(
            f,
            "{:<14}  {:>8}  {:>8} %  {:>8} %  {:>4}",
            boxes.name(),
            figures.answered,
            number(figures.coverage_68, 1),
            number(figures.coverage_95, 1),
            number(figures.nll, 2),
        )?;
    }
    Ok(())
}

/// The ranger in use by groups: from true boxes on the left, the pipeline on the right.
fn groups(
    f: &mut fmt::Formatter<'_>,
    method: Method,
    grouping: Grouping,
    rows: &[DistanceRow],
) -> fmt::Result {
    let of = |boxes: Boxes| {
        rows.iter()
            .filter(move |row| (row.grouping, row.boxes, row.method) == (grouping, boxes, method))
    };
    if of(Boxes::True).next().is_none() {
        return Ok(());
    }
    write!(
        f,
        "\n{:<15}  vehicles   MAE m   MRE %  bias m",
        format!("by {}", grouping.name())
    )?;
    // A run without a detector has no such rows.
    let mut of_pipeline = of(Boxes::Pipeline).peekable();
    if of_pipeline.peek().is_some() {
        write!(f, " | pipeline: found  missed  false   MAE m   MRE %")?;
    }
    writeln!(f)?;
    for row in of(Boxes::True) {
        write!(
            f,
            "{:<15}  {:>8}  {:>6}  {:>6}  {:>6}",
            row.group,
            row.vehicles,
            number(row.mae_m, 2),
            number(row.mre_percent, 1),
            number(row.bias_m, 2),
        )?;
        if let Some(row) = of_pipeline.next() {
            write!(
                f,
                " |           {:>5}  {:>6}  {:>5}  {:>6}  {:>6}",
                row.answered,
                row.unanswered,
                row.false_vehicles
                    .map_or_else(|| "-".to_owned(), |n| n.to_string()),
                number(row.mae_m, 2),
                number(row.mre_percent, 1),
            )?;
        }
        writeln!(f)?;
    }
    Ok(())
}

fn pipeline(f: &mut fmt::Formatter<'_>, figures: &PipelineFigures) -> fmt::Result {
    let PipelineFigures {
        vehicles,
        found,
        missed,
        false_vehicles,
        ..
    } = figures;
    writeln!(
        f,
        "\npipeline found {found} of {vehicles} vehicles, missed {missed}, and saw {false_vehicles} where none is"
    )
}

/// The paper's table beside ours, for people.
pub fn protocol_text(protocol: &Protocol) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    write_protocol(&mut text, protocol).ok();
    text
}

fn write_protocol(text: &mut String, protocol: &Protocol) -> fmt::Result {
    writeln!(
        text,
        "the paper's test: {} of its 108 frames are in this split{}",
        protocol.cells,
        match protocol.other_frames {
            0 => String::new(),
            other => format!("; {other} frames at other distances are judged in rows of their own"),
        }
    )?;
    for boxes in Boxes::ALL {
        let mut rows = protocol
            .rows
            .iter()
            .filter(|row| row.boxes == boxes)
            .peekable();
        if rows.peek().is_none() {
            continue;
        }
        writeln!(
            text,
            "\n{:<10}  mean estimate by sun, m           | of the means, as the paper | single frames |",
            boxes.name()
        )?;
        writeln!(
            text,
            "true m    sunrise morning    noon  aftern. | RMSE m  paper  MRE % paper | RMSE m  MRE % | missed  false"
        )?;
        for row in rows {
            protocol_row(text, row)?;
        }
    }
    methods_by_distance(text, protocol)?;
    missing(text, protocol)
}

/// Distance, estimates, errors and counts of a row: one text a column.
pub(crate) fn protocol_cells(row: &ProtocolRow) -> [String; 14] {
    let distance = row
        .distance_m
        .map_or_else(|| "mean".to_owned(), |m| format!("{m:.0}"));
    [
        distance,
        number(row.sunrise_m, 1),
        number(row.morning_m, 1),
        number(row.noon_m, 1),
        number(row.afternoon_m, 1),
        number(row.rmse_of_means_m, 2),
        number(row.paper_rmse_m, 2),
        number(row.mre_of_means_percent, 1),
        number(row.paper_mre_percent, 1),
        number(row.rmse_m, 2),
        number(row.mre_percent, 1),
        row.missed.to_string(),
        row.false_vehicles
            .map_or_else(|| "-".to_owned(), |count| count.to_string()),
        row.frames.to_string(),
    ]
}

fn protocol_row(text: &mut String, row: &ProtocolRow) -> fmt::Result {
    let [distance, sunrise, morning, noon, afternoon, errors @ ..] = protocol_cells(row);
    let [
        rmse,
        paper_rmse,
        mre,
        paper_mre,
        frames_rmse,
        frames_mre,
        missed,
        made_up,
        frames,
    ] = errors;
    write!(
        text,
        "{distance:<8}  {sunrise:>7} {morning:>7} {noon:>7} {afternoon:>8} | "
    )?;
    write!(text, "{rmse:>6} {paper_rmse:>6} {mre:>6} {paper_mre:>5} | ")?;
    writeln!(
        text,
        "{frames_rmse:>6} {frames_mre:>6} | {missed:>3}/{frames:<3} {made_up:>5}"
    )
}

/// RMSE of every method over single frames.
fn methods_by_distance(text: &mut String, protocol: &Protocol) -> fmt::Result {
    for boxes in Boxes::ALL {
        let of = |method: Method| {
            let rows = protocol.methods.iter();
            rows.filter(move |row| (row.boxes, row.method) == (boxes, method))
        };
        let Some(first) = Method::ALL
            .into_iter()
            .find(|method| of(*method).any(|row| row.answered > 0))
        else {
            continue;
        };
        let others: Vec<Method> = Method::ALL
            .into_iter()
            .filter(|method| of(*method).next().is_some())
            .collect();
        write!(
            text,
            "\n{:<10}  RMSE m over single frames\ntrue m    ",
            boxes.name()
        )?;
        for method in &others {
            write!(text, "{:>15}", method.name())?;
        }
        writeln!(text)?;
        for row in of(first).filter(|row| row.answered > 0) {
            write!(text, "{:<10.0}", row.distance_m)?;
            for method in &others {
                let found = of(*method).find(|other| other.distance_m == row.distance_m);
                write!(text, "{:>15}", number(found.and_then(|row| row.rmse_m), 2))?;
            }
            writeln!(text)?;
        }
    }
    Ok(())
}

/// The missing cells; whole distances in one line.
fn missing(text: &mut String, protocol: &Protocol) -> fmt::Result {
    let mut distances: Vec<f64> = protocol
        .missing
        .iter()
        .map(|cell| cell.distance_m)
        .collect();
    distances.dedup();
    let mut whole = Vec::new();
    let mut single = Vec::new();
    for distance_m in distances {
        let cells = || {
            protocol
                .missing
                .iter()
                .filter(|cell| cell.distance_m == distance_m)
        };
        let is_whole = protocol
            .rows
            .iter()
            .any(|row| row.distance_m == Some(distance_m) && row.frames == 0);
        if is_whole {
            whole.push(format!("{distance_m:.0}"));
        } else {
            single.extend(
                cells().map(|cell| format!("{distance_m:.0} m {} {}", cell.sun, cell.view)),
            );
        }
    }
    if !whole.is_empty() {
        writeln!(
            text,
            "\nwithout any frame in this split: {} m",
            whole.join(", ")
        )?;
    }
    if !single.is_empty() {
        writeln!(text, "\nmissing in this split: {}", single.join("; "))?;
    }
    Ok(())
}
