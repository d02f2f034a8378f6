//! One page about one or several runs: what they learnt, how good they are, and what they get wrong.
//!
//! A single HTML file that needs no network. Every number in it comes from a file of a run's folder,
//! which is named beneath the table or chart: `metrics.csv` and `config.json`, which training wrote,
//! and the folders below `evaluation`, see [`evaluate`](mod@crate::evaluate).

mod compare;
mod detection;
mod distance;
mod load;
pub(crate) mod parts;
mod settings;
mod training;

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::evaluate::Networks;
use crate::files;
use crate::page;
use load::Run;
use parts::{Page, Section};

/// The page without its content.
pub(crate) const TEMPLATE: &str = include_str!("report/page.html");

/// Writes the page of these runs to a file, whose folder is created where it is missing. Returns
/// what the page could not show, in words.
///
/// The same run folders give the same page.
///
/// # Errors
/// A folder that is no run, a file in it that cannot be read, or a page that cannot be written.
pub fn report(runs: &[PathBuf], out: &Path) -> Result<Vec<String>> {
    if runs.is_empty() {
        return Err(Error::value(
            "report",
            "there is no run",
            "give a run's folder",
        ));
    }
    let runs = runs
        .iter()
        .enumerate()
        .map(|(number, folder)| Run::open(folder, number))
        .collect::<Result<Vec<Run>>>()?;
    let mut missing = Vec::new();
    for run in &runs {
        missing.extend(run.without_evaluation());
        if run.epochs.is_empty() {
            missing.push(format!(
                "{} has no metrics.csv: no training curves",
                run.name
            ));
        }
    }
    let names: Vec<&str> = runs.iter().map(|run| run.name.as_str()).collect();
    let mut sections = vec![compare::section(&runs)?];
    sections.extend(training::section(&runs)?);
    for run in &runs {
        for evaluation in &run.evaluations {
            sections.push(evaluation_section(run, evaluation)?);
        }
    }
    sections.push(settings::section(&runs));
    let content = Page {
        title: format!("Report: {}", names.join(", ")),
        facts: vec![
            [
                "program".to_owned(),
                format!("twinsight {}", env!("CARGO_PKG_VERSION")),
            ],
            ["runs".to_owned(), runs.len().to_string()],
        ],
        missing: missing.clone(),
        sections,
    };
    let text = page::render(TEMPLATE, &content)?;
    if let Some(folder) = out.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        files::create_folder(folder)?;
    }
    files::write_atomically(out, text.as_bytes())?;
    Ok(missing)
}

/// Everything about one evaluation.
fn evaluation_section(run: &Run, evaluation: &load::Evaluated) -> Result<Section> {
    let of = &evaluation.evaluation;
    let mut section = Section::new(format!("{}: {}", run.name, evaluation.name));
    let settings = match of.networks {
        Networks::Both => format!(
            ", pairing {}, confidence above {}",
            of.pairing_mode, of.confidence
        ),
        Networks::Detector => format!(", confidence above {}", of.confidence),
        Networks::Distance | Networks::None => String::new(),
    };
    section.notes.push(format!(
        "{} frames of the split {} of {}; boxes of kind {}{settings}. Bounds: 95 % of {} draws, with \
         replacement, of whole {}s, of which there are {}.",
        of.frames,
        of.split,
        of.data.display(),
        of.box_kind,
        of.bootstrap.draws,
        of.bootstrap.unit,
        of.bootstrap.units,
    ));
    if let Some(left_out) = of.networks.left_out() {
        section.notes.push(format!("Judged in part: {left_out}."));
    }
    if of.left_out > 0 {
        section.notes.push(format!(
            "{} frames could not be read and are left out.",
            of.left_out
        ));
    }
    distance::add(&mut section, evaluation)?;
    detection::add(&mut section, evaluation)?;
    evaluation.add_pictures(&mut section)?;
    Ok(section)
}
