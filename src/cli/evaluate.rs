//! `twinsight evaluate`.

use std::path::PathBuf;

use clap::Args;
use twinsight::dataset::Split;
use twinsight::device::DeviceName;
use twinsight::evaluate::{EvaluateRequest, evaluate};
use twinsight::pairing::PairingMode;
use twinsight::pipeline::PredictOptions;
use twinsight::{Error, Result};

use super::{files, stdout, terminal, values};

/// Measure how well trained networks do on frames that they were not trained on
///
/// Prints the detector's precision, recall and mean average precision, and the distance errors MAE,
/// RMSE and MRE: for the labels' boxes, which judges the distance network alone, and for the whole
/// pipeline, with the vehicles that it missed and the ones that it made up.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct EvaluateArgs {
    /// Folder of a finished training run
    #[arg(long, value_name = "DIR")]
    run: PathBuf,
    /// Folder of the dataset
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Which frames: `val` chose the best epoch, `test` was never seen
    #[arg(long, value_parser = values::split(), default_value_t = Split::Test)]
    split: Split,
    /// What to compute on; `twinsight devices` lists the choices
    #[arg(long, default_value_t = DeviceName::FLEX)]
    device: DeviceName,
    /// How the pipeline finds boxes of the right image: `detect` runs the detector on both images,
    /// `search` on the left one alone
    #[arg(long, value_name = "HOW", value_parser = values::pairing_mode(), default_value_t = PredictOptions::default().pairing_mode)]
    pairing: PairingMode,
    /// The pipeline's detections must score above this, 0 to 1
    #[arg(long, value_parser = values::share, default_value_t = PredictOptions::default().confidence)]
    confidence: f32,
    /// Write the figures to a JSON file as well
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

const EXAMPLES: &str = "\
Examples:
  The tables of the test frames:

    twinsight evaluate --run checkpoints/quick --data datasets/quick

  The validation frames, with a file for other programs:

    twinsight evaluate --run checkpoints/quick --data datasets/quick --split val --json val.json";

impl EvaluateArgs {
    /// Evaluates a run.
    pub fn run(&self, quiet: bool) -> Result<()> {
        if let Some(path) = &self.json {
            files::check_target(path)?;
        }
        let request = EvaluateRequest {
            run: &self.run,
            data: &self.data,
            split: self.split,
            device: self.device,
            options: PredictOptions {
                confidence: self.confidence,
                pairing_mode: self.pairing,
                ..PredictOptions::default()
            },
        };
        let evaluation = terminal::with_progress(quiet, |progress| evaluate(&request, progress))?;
        if let Some(path) = &self.json {
            let json = serde_json::to_string_pretty(&evaluation)
                .map_err(|error| Error::io("write", path)(error.into()))?;
            files::write(path, format!("{json}\n").as_bytes())?;
        }
        stdout::print(&format!("{}\n", evaluation.to_string().trim_end()))
    }
}
