//! `twinsight evaluate`.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use twinsight::calibration::{CalibratedRig, ImageState, LoadOptions, RigOptions, load};
use twinsight::dataset::{BoxKind, Split, StereoDataset};
use twinsight::device::DeviceName;
use twinsight::evaluate::{EvaluateRequest, evaluate, protocol_text};
use twinsight::pairing::PairingMode;
use twinsight::pipeline::{PredictOptions, SingleSided};
use twinsight::ranging::{RangerKind, TrustedRig};
use twinsight::{Error, Result};

use super::{files, stdout, terminal, values};

/// Measure how well trained networks do on frames that they were not trained on
///
/// Prints the detector's precision, recall and mean average precision, and the distance errors MAE,
/// RMSE and MRE: for the labels' boxes, which judges the distance network alone, and for the whole
/// pipeline, with the vehicles that it missed and the ones that it made up; over all vehicles, and
/// by distance, sun, view and size of the box. How often the intervals hold the distance is counted.
/// Beside both rangers stand three baselines, their constants fitted on the training split: box size,
/// triangulated box centres and sub-pixel matching.
///
/// A run with one network has that one judged: a detector by what it finds, in single images too, a
/// distance network by labelled boxes. The dataset must have the kind of box that the run learnt.
///
/// Every table is written as CSV and as JSON into `evaluation/DATASET-SPLIT` in the run's folder,
/// with pictures of the best and the worst; `twinsight report` makes a page of them. Another
/// `--pairing` or `--confidence` than usual has a folder of its own, such as
/// `quick-val-detect-0.30`.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct EvaluateArgs {
    /// Folder of a finished training run; without one the posterior, which needs no training, is judged
    /// on the labels' boxes
    #[arg(long, value_name = "DIR")]
    run: Option<PathBuf>,
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
    #[arg(long, value_parser = values::share::<f32>, default_value_t = PredictOptions::default().confidence)]
    confidence: f32,
    /// Which distance is judged: `fused` weighs size, disparity and, where it was trained for such
    /// views, the size network; `paper` is the twin-branch network
    #[arg(long, value_name = "WHICH", value_parser = values::ranger(), default_value_t = PredictOptions::default().ranger)]
    ranger: RangerKind,
    /// Which of the labels' boxes are judged without a run [default: tight where there are]
    #[arg(long, value_name = "KIND", value_parser = values::box_kind(), conflicts_with = "run")]
    boxes: Option<BoxKind>,
    /// Cameras as a calibration file has them, in place of the dataset's rig: one that `twinsight
    /// calibrate` wrote corrects what disparities are off by. Images must be rectified
    #[arg(long, value_name = "FILE")]
    calib: Option<PathBuf>,
    /// Print a test's own table as well, of the test frames: `paper` is the published one, 108 frames
    /// at 15 to 200 m under four suns from three sides; frames that the dataset lacks are named
    #[arg(long, value_name = "TEST", value_enum, conflicts_with = "split")]
    protocol: Option<ProtocolName>,
    /// Folder for the tables and pictures [default: evaluation/DATASET-SPLIT in the run's folder,
    /// with the pairing and confidence where they are not the usual ones]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write the figures to a JSON file as well; `-` prints them instead of the tables
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

const EXAMPLES: &str = "\
Examples:
  The tables of the test frames:

    twinsight evaluate --run checkpoints/quick --data datasets/quick

  Distances without anything trained, of labelled boxes of one's own cameras:

    twinsight evaluate --data datasets/mine --calib mine.toml

  The validation frames, with a file for other programs:

    twinsight evaluate --run checkpoints/quick --data datasets/quick --split val --json val.json

  Another way of pairing, in a folder of its own:

    twinsight evaluate --run checkpoints/quick --data datasets/quick --split val --pairing detect --confidence 0.30

  The published test, the published figures beside ours:

    twinsight evaluate --run checkpoints/paper --data datasets/paper --protocol paper";

/// Tests with a table of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ProtocolName {
    /// Nine distances, four suns, three views
    Paper,
}

/// What is said of a test split without a single frame of the test's kind.
const NO_PROTOCOL: &str = "the paper's test: none of its 108 frames are in this split, nor any other \
                           with a distance, a sun and a view in frames.csv";

impl EvaluateArgs {
    /// Evaluates a run.
    pub fn run(&self, quiet: bool) -> Result<()> {
        let is_printed = self
            .json
            .as_ref()
            .is_some_and(|path| path.as_os_str() == "-");
        let json_path = self.json.as_ref().filter(|_| !is_printed);
        if let Some(path) = json_path {
            let inputs: Vec<_> = self.run.iter().flat_map(|run| files::of_run(run)).collect();
            files::check_target(path, files::Kind::JSON, &inputs)?;
        }
        let request = EvaluateRequest {
            run: self.run.as_deref(),
            boxes: self.boxes,
            rig: self
                .calib
                .as_deref()
                .map(|calib| rig(calib, &self.data))
                .transpose()?,
            data: &self.data,
            split: self.split,
            device: self.device.clone(),
            options: PredictOptions {
                confidence: self.confidence,
                pairing_mode: self.pairing,
                // As in the paper: with `detect`, both images must show the vehicle to the detector.
                single_sided: SingleSided::Drop,
                ranger: self.ranger,
                ..PredictOptions::default()
            },
            out: self.out.as_deref(),
        };
        let evaluation = terminal::with_progress(quiet, |progress| evaluate(&request, progress))?;
        if self.json.is_some() {
            let json = serde_json::to_string_pretty(&evaluation).map_err(|error| {
                Error::value("--json", error.to_string(), "report this as a bug")
            })?;
            let json = format!("{json}\n");
            match json_path {
                Some(path) => files::write(path, json.as_bytes())?,
                None => return stdout::print(&json),
            }
        }
        let mut text = evaluation.to_string();
        if self.protocol.is_some() {
            let table = evaluation
                .tables
                .protocol
                .as_ref()
                .map_or_else(|| NO_PROTOCOL.to_owned(), protocol_text);
            text = format!("{}\n\n{table}", text.trim_end());
        }
        stdout::print(&format!("{}\n", text.trim_end()))
    }
}

/// The rig of a calibration file for the images of a dataset, which are rectified.
fn rig(calib: &Path, data: &Path) -> Result<TrustedRig> {
    let camera = StereoDataset::open(data)?.rig().left;
    let size = [camera.width, camera.height];
    let options = LoadOptions {
        image_size: Some(size),
        ..LoadOptions::default()
    };
    let calibration = load(&[calib], &options)?;
    let options = RigOptions {
        images: ImageState::Rectified,
        alpha: None,
    };
    Ok(CalibratedRig::new(&calibration, size, options)?.trusted_rig())
}
