//! `twinsight predict`.

use std::path::PathBuf;

use clap::Args;
use image::RgbImage;
use serde::Serialize;
use twinsight::annotate::{Annotation, annotate_pair};
use twinsight::device::DeviceName;
use twinsight::imaging;
use twinsight::pairing::PairingMode;
use twinsight::pipeline::{PredictOptions, StereoRanger, Vehicle};
use twinsight::{Error, Result};

use super::calibration::{CalibrationArgs, say_notes};
use super::{files, stdout, values};

/// Find the vehicles in a stereo pair and measure their distances
///
/// Prints JSON on standard output: for every vehicle its box in both images (pixels), the
/// detector's score, its class and its distance in metres, from the middle between the cameras to
/// the centre of the vehicle.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct PredictArgs {
    /// Folder of a finished training run
    #[arg(long, value_name = "DIR")]
    run: PathBuf,
    /// Image of the left camera, PNG or JPEG
    left: PathBuf,
    /// Image of the right camera, of the same size
    right: PathBuf,
    /// What to compute on; `twinsight devices` lists the choices
    #[arg(long, default_value_t = DeviceName::FLEX)]
    device: DeviceName,
    /// Least score of a vehicle, 0 to 1
    #[arg(long, value_parser = values::share, default_value_t = PredictOptions::default().confidence)]
    confidence: f32,
    /// How boxes of the right image are found: `detect` runs the detector on both images and assigns
    /// its boxes to each other, `search` runs it on the left image and looks for each box's pixels
    /// in the right one, at half the detector's cost
    #[arg(long, value_name = "HOW", value_parser = values::pairing_mode(), default_value_t = PredictOptions::default().pairing_mode)]
    pairing: PairingMode,
    /// Write a PNG image of the pair with boxes and distances
    #[arg(long, value_name = "FILE")]
    annotate: Option<PathBuf>,
    #[command(flatten)]
    calibration: CalibrationArgs,
}

const EXAMPLES: &str = "\
Examples:
  Distances of the vehicles in a pair, and a picture of them:

    twinsight predict --run checkpoints/quick left.png right.png --annotate seen.png

  The distances alone:

    twinsight predict --run checkpoints/quick left.png right.png | jq '.vehicles[].distance_m'

  Images of your own cameras, as they took them, with OpenCV's calibration in millimetres:

    twinsight predict --run checkpoints/quick left.png right.png \\
      --calib intrinsics.yml --calib extrinsics.yml --calib-baseline 0.12";

/// What is printed.
#[derive(Debug, Serialize)]
struct Prediction {
    left: String,
    right: String,
    vehicles: Vec<Vehicle>,
}

impl PredictArgs {
    /// Measures a pair.
    pub fn run(&self, quiet: bool) -> Result<()> {
        if let Some(path) = &self.annotate {
            files::check_target(path)?;
        }
        let calibration = self.calibration.load()?;
        let mut images = imaging::load_pair(&self.left, &self.right)?;
        let mut calibrated = None;
        if let Some(calibration) = &calibration {
            let rig = self.calibration.rig(calibration, images[0].dimensions())?;
            images = rig.rectify(images)?;
            calibrated = Some(rig);
        }
        let [left, right] = images;
        let options = PredictOptions {
            confidence: self.confidence,
            pairing_mode: self.pairing,
            ..PredictOptions::default()
        };
        let mut ranger = StereoRanger::load(&self.run, &self.device.open()?)?.with_options(options);
        if let Some(calibrated) = &calibrated {
            ranger = ranger.with_rig(*calibrated.rig());
        }
        if !quiet {
            say_notes(&ranger, left.dimensions(), calibrated.as_ref());
        }
        let vehicles = ranger.estimate(&left, &right)?;
        if let Some(path) = &self.annotate {
            let picture = picture(&left, &right, &vehicles);
            files::write(path, &imaging::png_bytes(path, &picture)?)?;
        }
        let prediction = Prediction {
            left: self.left.display().to_string(),
            right: self.right.display().to_string(),
            vehicles,
        };
        let json = serde_json::to_string_pretty(&prediction)
            .map_err(|error| Error::io("write", "standard output")(error.into()))?;
        stdout::print(&format!("{json}\n"))
    }
}

/// Both images with every vehicle's boxes, distance and score.
fn picture(left: &RgbImage, right: &RgbImage, vehicles: &[Vehicle]) -> RgbImage {
    let annotations: Vec<Annotation> = vehicles
        .iter()
        .map(|vehicle| Annotation {
            left: Some(vehicle.left),
            right: Some(vehicle.right),
            text: format!("{:.1} m {:.2}", vehicle.distance_m, vehicle.score),
        })
        .collect();
    annotate_pair(left, right, &annotations)
}
