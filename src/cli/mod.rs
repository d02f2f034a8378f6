//! The command line: what was typed becomes the library's settings, its results become text.
//!
//! The only place that knows clap and that prints. Results go to standard output, everything else
//! to standard error.

mod ablate;
mod calibrate;
mod calibration;
mod devices;
mod evaluate;
mod export;
mod files;
mod generate;
mod import;
mod inspect;
mod predict;
mod prepare;
mod presets;
mod report;
pub mod stderr;
pub mod stdout;
mod terminal;
mod train;
mod validate;
mod values;
#[cfg(feature = "remote")]
mod worker;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use twinsight::Result;

/// How many metres away is that vehicle?
///
/// Twinsight finds vehicles in both images of a stereo pair with a YOLO11 detector and measures
/// their distance with a small two-branch network. It makes its own training data, trains both
/// networks, evaluates them and measures new pairs.
#[derive(Debug, Parser)]
#[command(version, after_long_help = EXAMPLES, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Show no progress and no notes; results and errors are still printed
    #[arg(long, short, global = true)]
    quiet: bool,
}

const EXAMPLES: &str = "\
Examples:
  The short way from nothing to a distance: make a small dataset, train both networks on it, measure
  how well they do, and measure a pair:

    twinsight train
    twinsight evaluate --run checkpoints/quick --data datasets/quick
    twinsight report checkpoints/quick
    twinsight predict --run checkpoints/quick left.png right.png

  `twinsight help COMMAND` is the manual of a command.";

#[derive(Debug, Subcommand)]
enum Command {
    Generate(generate::GenerateArgs),
    Import(import::ImportArgs),
    Export(export::ExportArgs),
    Validate(validate::ValidateArgs),
    Inspect(inspect::InspectArgs),
    Prepare(prepare::PrepareArgs),
    Train(Box<train::TrainArgs>),
    Evaluate(evaluate::EvaluateArgs),
    Ablate(ablate::AblateArgs),
    Report(report::ReportArgs),
    Predict(Box<predict::PredictArgs>),
    Calibrate(calibrate::CalibrateArgs),
    Devices(devices::DevicesArgs),
    #[cfg(feature = "remote")]
    Worker(worker::WorkerArgs),
}

impl Cli {
    /// Runs the command; the exit code is not success where a command found something.
    pub fn run(&self) -> Result<ExitCode> {
        let done = match &self.command {
            Command::Generate(args) => args.run(self.quiet),
            Command::Import(args) => args.run(self.quiet),
            Command::Export(args) => args.run(self.quiet),
            Command::Validate(args) => return args.run(self.quiet),
            Command::Inspect(args) => args.run(self.quiet),
            Command::Prepare(args) => args.run(self.quiet),
            Command::Train(args) => args.run(self.quiet),
            Command::Evaluate(args) => args.run(self.quiet),
            Command::Ablate(args) => args.run(self.quiet),
            Command::Report(args) => args.run(self.quiet),
            Command::Predict(args) => args.run(self.quiet),
            Command::Calibrate(args) => args.run(self.quiet),
            Command::Devices(_) => devices::DevicesArgs::run(),
            #[cfg(feature = "remote")]
            Command::Worker(args) => args.run(),
        };
        done.map(|()| ExitCode::SUCCESS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn the_command_line_has_no_contradictions() {
        Cli::command().debug_assert();
    }
}
