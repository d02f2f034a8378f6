//! `twinsight report`.

use std::path::PathBuf;

use clap::Args;
use twinsight::Result;
use twinsight::report::report;

use super::{files, stderr, stdout};

/// Make a page about one or several runs: training curves, tables, charts, best and worst pictures
///
/// Writes one HTML file that needs no network. It shows what `train` and `evaluate` left in the
/// folders of the runs; beneath every table and chart stands the file that its numbers come from.
/// Several runs are compared, on the frames that all were evaluated on.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct ReportArgs {
    /// Folders of training runs
    #[arg(required = true, value_name = "RUN")]
    runs: Vec<PathBuf>,
    /// The page [default: report.html in the folder of the first run]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

const EXAMPLES: &str = "\
Examples:
  A page about a run, its test frames included:

    twinsight evaluate --run checkpoints/quick --data datasets/quick
    twinsight report checkpoints/quick

  Two runs against each other:

    twinsight report checkpoints/first checkpoints/second --out compared.html";

impl ReportArgs {
    /// Writes the page.
    pub fn run(&self, quiet: bool) -> Result<()> {
        let out = match (&self.out, self.runs.first()) {
            (Some(out), _) => out.clone(),
            (None, Some(run)) => run.join("report.html"),
            (None, None) => PathBuf::from("report.html"),
        };
        if self.out.is_some() {
            let inputs: Vec<_> = self
                .runs
                .iter()
                .flat_map(|run| files::of_run(run))
                .collect();
            files::check_target(&out, files::Kind::PAGE, &inputs)?;
        }
        let missing = report(&self.runs, &out)?;
        if !quiet {
            for text in missing {
                stderr::line(&format!("note: {text}"));
            }
        }
        stdout::print(&format!("{}\n", out.display()))
    }
}
