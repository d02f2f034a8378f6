//! `twinsight ablate`.

use std::path::PathBuf;

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use toml::{Table, Value};
use twinsight::Result;
use twinsight::ablate::{AblateRequest, Variant, ablate, plan_ablation};
use twinsight::dataset::Split;
use twinsight::device::DeviceName;
use twinsight::train::TrainConfig;

use super::{presets, stdout, terminal, values};

/// Find out what the distance network owes to its inputs
///
/// Trains the distance network again and again under the same settings, on the same vehicles in the
/// same order, with other inputs: `right-left` is the paper's, `right-right` has the right crop twice,
/// `mono` has it once, `disparity` is also told the disparity that matching finds to a fraction of a
/// pixel, and `surface` counts its output from the surface that this disparity shows. All of them,
/// and arithmetic without a network, then measure the same labelled vehicles.
///
/// No detector is needed: boxes are those of the labels, in training moved at random as a detector's
/// errors do. Each training is a run of its own in the folder `runs`. After Ctrl-C or a power cut the
/// same command goes on; with more variants or seeds it trains what is missing. The tables are written
/// as CSV and JSON, with a plot (SVG) and a page (HTML) that needs no network.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct AblateArgs {
    /// Settings that come with the program
    #[arg(long, value_parser = presets::names(), default_value = presets::DEFAULT)]
    preset: String,
    /// Settings from a TOML file, over the preset; it gives only what it changes
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Folder of the dataset
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Folder for the runs, tables and pages: new, or that of an earlier ablation to go on with
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Passes over the training vehicles
    #[arg(long, value_name = "N")]
    epochs: Option<u32>,
    /// Seeds of the trainings; with several, figures are over all of them [default: the settings' own]
    #[arg(long, value_name = "SEED,..", value_delimiter = ',', value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    seeds: Vec<u64>,
    /// What to train; the first is what the others are compared with [default: all]
    #[arg(long, value_name = "NAME,..", value_delimiter = ',', value_parser = variant())]
    variants: Vec<Variant>,
    /// Which frames are measured: `val` chose the best epoch, `test` was never seen
    #[arg(long, value_parser = values::split(), default_value_t = Split::Test)]
    split: Split,
    /// What to compute on; `twinsight devices` lists the choices. Several, separated by commas, share
    /// every batch
    #[arg(long, value_delimiter = ',', default_value = "flex")]
    device: Vec<DeviceName>,
    /// Train nothing: say how many steps and how long it would take for each seed, measured on a few
    /// steps of every variant
    #[arg(long)]
    dry_run: bool,
}

const EXAMPLES: &str = "\
Examples:
  Every variant under the settings of `quick`:

    twinsight ablate --data datasets/quick --out ablations/quick

  A quick look at two of them, with three seeds each to see what is chance:

    twinsight ablate --data datasets/quick --out ablations/look --epochs 4 --seeds 1,2,3 \\
      --variants right-left,surface";

/// A variant's name.
fn variant() -> impl TypedValueParser<Value = Variant> {
    PossibleValuesParser::new(Variant::ALL.map(Variant::word))
        .try_map(|word| word.parse::<Variant>())
}

impl AblateArgs {
    /// Trains and compares.
    pub fn run(&self, quiet: bool) -> Result<()> {
        let config = self.resolve()?;
        let seeds = or_default(&self.seeds, &[config.seed]);
        let variants = or_default(&self.variants, &Variant::ALL);
        let request = AblateRequest {
            config: &config,
            data: &self.data,
            out: &self.out,
            variants: &variants,
            seeds: &seeds,
            split: self.split,
            devices: &self.device,
        };
        if self.dry_run {
            let plan =
                terminal::with_progress(quiet, |progress| plan_ablation(&request, progress))?;
            return stdout::print(&format!("{plan}\n"));
        }
        let ablation = terminal::with_progress(quiet, |progress| ablate(&request, progress))?;
        stdout::print(&format!("{ablation}\n"))
    }

    fn resolve(&self) -> Result<TrainConfig> {
        let mut flags = Table::new();
        if let Some(epochs) = self.epochs {
            let mut distance = Table::new();
            distance.insert("epochs".to_owned(), i64::from(epochs).into());
            flags.insert("distance".to_owned(), Value::Table(distance));
        }
        TrainConfig::resolve(Some(&self.preset), self.config.as_deref(), &flags)
    }
}

/// What was typed, each once, or the default.
fn or_default<T: Copy + PartialEq>(typed: &[T], default: &[T]) -> Vec<T> {
    let mut values: Vec<T> = Vec::new();
    for &value in if typed.is_empty() { default } else { typed } {
        if !values.contains(&value) {
            values.push(value);
        }
    }
    values
}
