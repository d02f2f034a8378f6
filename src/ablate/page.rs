//! The ablation as a page, and its plot.

use super::tables::{AblationDifference, AblationRow};
use super::{Ablation, Variant};
use crate::error::{Error, Result};
use crate::files;
use crate::page;
use crate::page::charts::{Axis, Figure, Rgb, Shape, color};
use crate::report::TEMPLATE;
use crate::report::parts::{Block, Chart, Page, Section, Table};

/// Colours of trained networks and of baselines.
const KINDS: [(usize, &str); 2] = [(0, "trained"), (6, "arithmetic")];

/// Writes `ablation.svg` and `ablation.html`.
pub(super) fn write(ablation: &Ablation) -> Result<()> {
    let bars = bars(ablation);
    files::write_atomically(ablation.out.join("ablation.svg"), bars.svg()?.as_bytes())?;
    let mut section = Section::new("Inputs compared");
    section.notes.push(ablation.description());
    section.notes.push(explanations(ablation));
    section.table(figures(ablation));
    for (against, rows) in ablation.differences_by_reference() {
        section.table(differences(ablation, against, rows));
    }
    let source = ablation.out.join("ablation.csv").display().to_string();
    let legend = KINDS.map(|(series, name)| (color(series), name.to_owned()));
    let (by_distance, lines) = by_distance(ablation);
    section.charts(vec![
        Chart::new("MRE over all vehicles", &bars, &legend, source.clone())?,
        Chart::new("MRE by true distance", &by_distance, &lines, source)?,
    ]);
    let mut settings = Section::new("Settings");
    let json = serde_json::to_string_pretty(&ablation.config)
        .map_err(|error| Error::value("settings", error.to_string(), "report this as a bug"))?;
    settings.blocks.push(Block::Text {
        title: "What all trainings have in common".to_owned(),
        text: json,
        source: ablation.out.join("settings.json").display().to_string(),
    });
    let content = Page {
        title: "Ablation: what the distance network owes to its inputs".to_owned(),
        facts: vec![
            [
                "program".to_owned(),
                format!("twinsight {}", env!("CARGO_PKG_VERSION")),
            ],
            ["dataset".to_owned(), ablation.data.display().to_string()],
        ],
        missing: Vec::new(),
        sections: vec![section, settings],
    };
    let text = page::render(TEMPLATE, &content)?;
    files::write_atomically(ablation.out.join("ablation.html"), text.as_bytes())
}

fn figures(ablation: &Ablation) -> Table {
    let source = ablation.out.join("ablation.csv").display().to_string();
    let mut table = Table::new("Distance errors", &AblationRow::HEADER, source);
    table.note = ablation
        .label_note()
        .map_or_else(String::new, str::to_owned);
    let rows = ablation.rows_of_all();
    table.rows = rows.map(|row| row.cells().to_vec()).collect();
    table
}

/// What the variants are; everything else in the tables is arithmetic.
fn explanations(ablation: &Ablation) -> String {
    let trained = ablation.rows_of_all().filter(|row| row.trained);
    let words: Vec<String> = trained
        .filter_map(|row| row.name.parse::<Variant>().ok())
        .map(|variant| format!("{variant}: {}", variant.explanation()))
        .collect();
    format!("Trained: {}. The others are arithmetic.", words.join("; "))
}

fn differences(ablation: &Ablation, against: &str, rows: &[AblationDifference]) -> Table {
    let title = format!("Against {against} on the same vehicles");
    let source = ablation.out.join("differences.csv").display().to_string();
    let mut table = Table::new(&title, &AblationDifference::HEADER, source);
    table.note = String::from("Below 0 is better; where the bounds hold 0, that may be chance.");
    table.rows = rows.iter().map(|row| row.cells().to_vec()).collect();
    table
}

/// Relative errors of all vehicles as lying bars, the first on top.
fn bars(ablation: &Ablation) -> Figure {
    let rows: Vec<&AblationRow> = ablation
        .rows_of_all()
        .filter(|row| !ablation.reads_label(&row.name))
        .collect();
    let middle = |i: usize| rows.len() as f64 - i as f64 - 0.5;
    let mut shapes = Vec::new();
    for (is_trained, (series, _)) in [true, false].into_iter().zip(KINDS) {
        let of_kind = || {
            let rows = rows.iter().enumerate();
            rows.filter(move |(_, row)| row.trained == is_trained)
        };
        let bars = of_kind().filter_map(|(i, row)| {
            let y = middle(i);
            Some([0.0, y - 0.36, row.mre_percent?, y + 0.36])
        });
        shapes.push((color(series), Shape::Bars(bars.collect())));
        let spans = of_kind()
            .filter_map(|(i, row)| Some([middle(i), row.mre_low_percent?, row.mre_high_percent?]));
        shapes.push((color(series), Shape::Spans(spans.collect())));
    }
    let ends = rows
        .iter()
        .filter_map(|row| row.mre_high_percent.or(row.mre_percent));
    Figure {
        x: Axis::new("MRE, percent", [0.0, 1.05 * ends.fold(1.0, f64::max)]),
        y: Axis::named("", rows.iter().rev().map(|row| row.name.clone()).collect()),
        shapes,
        square: false,
    }
}

/// Relative errors over the true distance.
fn by_distance(ablation: &Ablation) -> (Figure, Vec<(Rgb, String)>) {
    let rows = || ablation.rows.iter().filter(|row| row.group != "all");
    let mut names: Vec<&str> = Vec::new();
    let mut groups: Vec<&str> = Vec::new();
    for row in rows().filter(|row| !ablation.reads_label(&row.name)) {
        if !names.contains(&row.name.as_str()) {
            names.push(&row.name);
        }
        if !groups.contains(&row.group.as_str()) {
            groups.push(&row.group);
        }
    }
    let mut shapes = Vec::new();
    let mut legend = Vec::new();
    let mut top: f64 = 1.0;
    for (series, name) in names.iter().enumerate() {
        let points = groups.iter().enumerate().filter_map(|(place, group)| {
            let is_here = |row: &&AblationRow| row.name == *name && row.group == *group;
            let mre = rows().find(is_here)?.mre_percent?;
            Some([place as f64 + 0.5, mre])
        });
        let points: Vec<[f64; 2]> = points.collect();
        top = points.iter().map(|point| point[1]).fold(top, f64::max);
        shapes.push((color(series), Shape::Line(points.clone())));
        shapes.push((color(series), Shape::Dots(points)));
        legend.push((color(series), (*name).to_owned()));
    }
    let figure = Figure {
        x: Axis::named(
            "true distance",
            groups.iter().map(|group| (*group).to_owned()).collect(),
        ),
        y: Axis::new("MRE, percent", [0.0, 1.05 * top]),
        shapes,
        square: false,
    };
    (figure, legend)
}
