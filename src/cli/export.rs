//! `twinsight export`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use twinsight::Result;
use twinsight::dataset::{BoxKind, StereoDataset};
use twinsight::formats::{coco, kitti, yolo};

use super::import::left_out;
use super::{stderr, stdout, terminal, values};

/// Turn a dataset into one for other programs
///
/// `import` of the same format brings back what the format can hold; `datasets/README.md` says what
/// that is.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct ExportArgs {
    /// The format to write
    format: Format,
    /// Folder of the dataset
    data: PathBuf,
    /// Folder to write into; it must be empty or missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Which boxes are written [default: tight where the dataset has them]
    #[arg(long, value_parser = values::box_kind())]
    box_kind: Option<BoxKind>,
    /// YOLO only: write the distance in metres as a sixth number on every line
    #[arg(long)]
    distance: bool,
}

const EXAMPLES: &str = "\
Examples:
  For training a detector with other programs, with the distance on every line:

    twinsight export yolo datasets/quick --out exports/quick-yolo --distance

  The paper's square boxes as COCO annotations:

    twinsight export coco datasets/quick --out exports/quick-coco --box-kind sphere";

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    Yolo,
    Coco,
    Kitti,
}

impl ExportArgs {
    /// Exports a dataset.
    pub fn run(&self, quiet: bool) -> Result<()> {
        if self.distance && self.format != Format::Yolo {
            return Err(twinsight::Error::value(
                "--distance",
                "is for yolo alone",
                "leave it out: coco and kitti always hold the distance",
            ));
        }
        let report = terminal::with_progress(quiet, |progress| {
            let dataset = StereoDataset::open(&self.data)?;
            for problem in &dataset.problems {
                progress.note(&format!("left out {problem}"));
            }
            let kind = self
                .box_kind
                .unwrap_or_else(|| values::shown_kind(&dataset));
            match self.format {
                Format::Yolo => yolo::export(&dataset, kind, self.distance, &self.out, progress),
                Format::Coco => coco::export(&dataset, kind, &self.out, progress),
                Format::Kitti => kitti::export(&dataset, kind, &self.out, progress),
            }
        })?;
        if !quiet {
            for line in left_out(&report.left_out) {
                stderr::line(&line);
            }
        }
        let out = self.out.display();
        stdout::print(&format!(
            "export {out}: {} images, {} boxes\n",
            report.images, report.boxes
        ))
    }
}
