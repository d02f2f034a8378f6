//! `twinsight inspect`.

use std::path::PathBuf;

use clap::Args;
use twinsight::Result;
use twinsight::dataset::{BoxKind, StereoDataset};
use twinsight::inspect::{Inspection, inspect};

use super::{stdout, terminal, values};

/// Show a dataset: a sheet of samples, and a page with samples, counts and histograms
///
/// Writes `inspect.png` and `inspect.html`. Samples are arranged by sun, or by split where suns are
/// unknown, and by distance; boxes have their metres beside them, and small vehicles are shown once
/// more, enlarged. The page is a single file and needs no network.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct InspectArgs {
    /// Folder of the dataset
    data: PathBuf,
    /// Folder to write into [default: the dataset's]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Which boxes are shown [default: tight where the dataset has them]
    #[arg(long, value_parser = values::box_kind())]
    box_kind: Option<BoxKind>,
}

const EXAMPLES: &str = "\
Examples:
  Look at a dataset before training on it:

    twinsight inspect datasets/quick

  The paper's square boxes, written elsewhere:

    twinsight inspect datasets/quick --box-kind sphere --out look";

impl InspectArgs {
    /// Writes the sheet and the page.
    pub fn run(&self, quiet: bool) -> Result<()> {
        let out = self.out.as_ref().unwrap_or(&self.data);
        let Inspection { sheet, page, .. } = terminal::with_progress(quiet, |progress| {
            let dataset = StereoDataset::open(&self.data)?;
            let kind = self
                .box_kind
                .unwrap_or_else(|| values::shown_kind(&dataset));
            inspect(&dataset, kind, out, progress)
        })?;
        stdout::print(&format!("{}\n{}\n", sheet.display(), page.display()))
    }
}
