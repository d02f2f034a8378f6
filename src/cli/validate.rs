//! `twinsight validate`.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use twinsight::validate::{Validation, validate};
use twinsight::{Error, Result};

use super::{stdout, terminal};

/// Exit code of a dataset with findings.
const FOUND: u8 = 1;

/// Check a dataset and name everything that is wrong with it
///
/// Looks at every file: rows and labels, images, whether boxes lie in the image, whether the
/// disparity of each labelled vehicle is that of its distance and both boxes are on the same rows,
/// vehicles that one image shows without a label, scenes and near-duplicate pictures that two splits share, composites, and files that belong to
/// nothing.
///
/// Exit code 0: nothing was found. 1: something was. 2: the folder is no dataset, or no frame of it
/// is usable.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct ValidateArgs {
    /// Folder of the dataset
    data: PathBuf,
    /// Print the findings as JSON
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  Before a long training:

    twinsight validate datasets/quick && twinsight train --data datasets/quick

  For another program:

    twinsight validate datasets/quick --json";

impl ValidateArgs {
    /// Checks the dataset.
    pub fn run(&self, quiet: bool) -> Result<ExitCode> {
        let validation = terminal::with_progress(quiet, |progress| validate(&self.data, progress))?;
        let text = if self.json {
            serde_json::to_string_pretty(&validation).map_err(|error| {
                Error::value("--json", error.to_string(), "report this as a bug")
            })? + "\n"
        } else {
            report(&validation)
        };
        stdout::print(&text)?;
        Ok(if validation.findings.is_empty() {
            ExitCode::SUCCESS
        } else {
            ExitCode::from(FOUND)
        })
    }
}

fn report(validation: &Validation) -> String {
    let mut text = String::new();
    for finding in &validation.findings {
        // Writing to a String cannot fail.
        writeln!(text, "{finding}").ok();
    }
    for note in &validation.notes {
        writeln!(text, "note: {note}").ok();
    }
    let (frames, images) = (validation.frames, validation.images);
    let dataset = validation.dataset.display();
    write!(
        text,
        "dataset {dataset}: {frames} frames, {images} images, "
    )
    .ok();
    let counts: Vec<String> = validation
        .counts
        .iter()
        .map(|(kind, count)| format!("{count} {kind}"))
        .collect();
    if counts.is_empty() {
        text += "nothing wrong\n";
    } else {
        let total = validation.findings.len();
        writeln!(text, "{total} findings: {}", counts.join(", ")).ok();
    }
    text
}
