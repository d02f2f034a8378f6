//! `twinsight prepare`.

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Args;
use twinsight::Result;
use twinsight::dataset::{
    BoxKind, CompositeSize, CompositeStatistics, Split, StereoDataset, prepare,
};

use super::{stdout, terminal, values};

/// Cut the distance network's training images out of a dataset's frames
///
/// Writes a composite, the right crop above the left one, for every vehicle that is labelled in
/// both images, and the colour statistics of the training composites. Training does this by itself
/// where it is missing; this command is for looking at the composites or for other programs.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct PrepareArgs {
    /// Folder of the dataset
    data: PathBuf,
    /// Size of the composites: two square crops on top of each other. `828x414` is the paper's,
    /// `340x170` is small enough for training on a processor
    #[arg(long, value_name = "HEIGHTxWIDTH", default_value_t = CompositeSize::QUICK)]
    composite: CompositeSize,
    /// Which boxes are cut out: the paper's squares around the bounding sphere, or the exact boxes
    /// of the visible vehicles
    #[arg(long, value_parser = values::box_kind(), default_value_t = BoxKind::Sphere)]
    box_kind: BoxKind,
}

const EXAMPLES: &str = "\
Examples:
  Composites of the paper's size in `datasets/quick/composites`:

    twinsight prepare datasets/quick --composite 828x414

  Small ones of the exact boxes:

    twinsight prepare datasets/quick --composite 340x170 --box-kind tight";

impl PrepareArgs {
    /// Makes the composites.
    pub fn run(&self, quiet: bool) -> Result<()> {
        let report = terminal::with_progress(quiet, |progress| {
            let dataset = StereoDataset::open(&self.data)?;
            let report = prepare(&dataset, self.box_kind, self.composite, progress)?;
            for problem in dataset.problems.iter().chain(&report.problems) {
                progress.note(&format!("left out {problem}"));
            }
            Ok(report)
        })?;
        let folder = self.data.join("composites");
        let summary = summary(&report.statistics);
        stdout::print(&format!("composites {}: {summary}", folder.display()))
    }
}

/// Numbers and colours of the composites, in lines.
fn summary(statistics: &CompositeStatistics) -> String {
    let counts: Vec<String> = Split::ALL
        .iter()
        .map(|&split| format!("{} {split}", statistics.counts.of(split)))
        .collect();
    let (size, kind) = (statistics.size, statistics.kind);
    let mut text = format!("{} of {size} from {kind} boxes\n", counts.join(", "));
    if let Some(colours) = &statistics.train {
        let levels = |levels: [f64; 3]| levels.map(|level| format!("{level:.4}")).join(" ");
        let (mean, std) = (levels(colours.mean), levels(colours.std));
        // Writing to a String cannot fail.
        writeln!(
            text,
            "training colours: mean {mean}, standard deviation {std}"
        )
        .ok();
    }
    text
}
