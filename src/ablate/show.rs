//! The ablation for people, in text.

use std::fmt;

use super::Ablation;
use super::tables::{AblationDifference, AblationRow};
use crate::dataset::BoxKind;
use crate::evaluate::{LABEL_NOTE, Method, number, percent};
use crate::report::parts::bounded;

impl Ablation {
    /// What was compared, and how, in a sentence or two.
    pub(super) fn description(&self) -> String {
        let seeds: Vec<String> = self.seeds.iter().map(ToString::to_string).collect();
        format!(
            "{} vehicles in {} frames of the split {} of {}; {} epochs, seed {}. Boxes are those of the \
             labels, in training moved at random by {} of their sides; no detector has a part in \
             this. In brackets: where 95 % of {} draws of whole {}s (of {}) lie.",
            self.vehicles,
            self.frames,
            self.split,
            self.data.display(),
            self.config.distance.epochs,
            seeds.join(", "),
            self.config.distance.box_jitter,
            self.draws,
            self.unit,
            self.units,
        )
    }

    /// Rows over all vehicles.
    pub(super) fn rows_of_all(&self) -> impl Iterator<Item = &AblationRow> {
        self.rows.iter().filter(|row| row.group == "all")
    }

    /// Differences by what they are against.
    pub(super) fn differences_by_reference(
        &self,
    ) -> impl Iterator<Item = (&str, &[AblationDifference])> {
        let groups = self.differences.chunk_by(|a, b| a.against == b.against);
        groups.filter_map(|rows| Some((rows.first()?.against.as_str(), rows)))
    }

    /// What is to be said of a baseline that reads the label; None where it does not.
    pub(super) fn label_note(&self) -> Option<&'static str> {
        (self.config.box_kind == BoxKind::Sphere && self.baselines.is_some()).then_some(LABEL_NOTE)
    }

    /// Whether a row is arithmetic on the label.
    pub(super) fn reads_label(&self, name: &str) -> bool {
        self.label_note().is_some() && name == Method::Triangulation.name()
    }
}

impl AblationRow {
    /// Header of [`AblationRow::cells`].
    pub(super) const HEADER: [&'static str; 9] = [
        "inputs",
        "answers",
        "MAE m",
        "RMSE m",
        "MRE %",
        "median m",
        "bias m",
        "P95 m",
        "within 5 %",
    ];

    /// The figures as text.
    pub(super) fn cells(&self) -> [String; 9] {
        [
            self.name.clone(),
            format!("{}/{}", self.answered, self.answered + self.unanswered),
            bounded(self.mae_m, [self.mae_low_m, self.mae_high_m], 2),
            bounded(self.rmse_m, [self.rmse_low_m, self.rmse_high_m], 2),
            bounded(
                self.mre_percent,
                [self.mre_low_percent, self.mre_high_percent],
                1,
            ),
            number(self.median_m, 2),
            number(self.bias_m, 2),
            number(self.p95_m, 2),
            percent(self.within_5_percent),
        ]
    }
}

impl AblationDifference {
    /// Header of [`AblationDifference::cells`].
    pub(super) const HEADER: [&'static str; 4] = ["inputs", "vehicles", "MAE m less", "MRE % less"];

    /// The figures as text.
    pub(super) fn cells(&self) -> [String; 4] {
        [
            self.name.clone(),
            self.vehicles.to_string(),
            bounded(Some(self.mae_m), [self.mae_low_m, self.mae_high_m], 2),
            bounded(
                Some(self.mre_percent),
                [self.mre_low_percent, self.mre_high_percent],
                1,
            ),
        ]
    }
}

impl fmt::Display for Ablation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}\n", self.description())?;
        let rows: Vec<_> = self.rows_of_all().map(AblationRow::cells).collect();
        columns(f, &AblationRow::HEADER, &rows)?;
        if let Some(note) = self.label_note() {
            writeln!(f, "{note}")?;
        }
        for (against, rows) in self.differences_by_reference() {
            writeln!(
                f,
                "\nagainst {against} on the same vehicles; below 0 is better, and bounds that hold 0 may \
                 be chance"
            )?;
            let rows: Vec<_> = rows.iter().map(AblationDifference::cells).collect();
            columns(f, &AblationDifference::HEADER, &rows)?;
        }
        if self.left_out > 0 {
            writeln!(
                f,
                "\n{} frames could not be read and are left out",
                self.left_out
            )?;
        }
        write!(f, "\npage: {}", self.out.join("ablation.html").display())
    }
}

/// A table of text: the first column to the left, the others to the right.
fn columns<const N: usize>(
    f: &mut fmt::Formatter<'_>,
    header: &[&str; N],
    rows: &[[String; N]],
) -> fmt::Result {
    let widths: [usize; N] = std::array::from_fn(|i| {
        let cells = rows.iter().map(|row| row[i].len());
        cells.fold(header[i].len(), usize::max)
    });
    let header = header.map(str::to_owned);
    for row in std::iter::once(&header).chain(rows) {
        for (i, (cell, width)) in row.iter().zip(widths).enumerate() {
            if i == 0 {
                write!(f, "{cell:<width$}")?;
            } else {
                write!(f, "  {cell:>width$}")?;
            }
        }
        writeln!(f)?;
    }
    Ok(())
}
