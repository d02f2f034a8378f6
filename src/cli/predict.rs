//! `twinsight predict`.

mod output;
mod report;

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use image::RgbImage;
use twinsight::calibration::CalibratedRig;
use twinsight::device::DeviceName;
use twinsight::geometry::{Polygon, StereoCalibration};
use twinsight::pairing::PairingMode;
use twinsight::pipeline::{PredictOptions, SingleSided, StereoRanger, VehicleFilter};
use twinsight::predict::{Sink, predict};
use twinsight::ranging::{PairDoubt, RangerKind};
use twinsight::sources::{FrameSource, Layout, StereoFrame};
use twinsight::{Error, Result, files};

use super::calibration::{CalibrationArgs, say};
use super::files::of_run;
use super::{terminal, values};
use output::Outputs;

/// Find the vehicles in stereo pairs and measure their distances
///
/// Prints JSON on standard output: for every vehicle its box in both images (pixels), the
/// detector's score, its class and its distance in metres, from the middle between the cameras to
/// the centre of the vehicle. One pair makes one JSON object; folders, sequences and videos make
/// JSON Lines, one object a frame, and a summary with the time of each stage on standard error.
///
/// A frame that cannot be used is named with its reason and the next one follows. Exit code: 0 if
/// any frame could be used, 2 if none could (or any could not, with --strict), 130 after Ctrl-C,
/// with the results of the frames so far.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct PredictArgs {
    /// Folder of a finished training run
    #[arg(long, value_name = "DIR")]
    run: PathBuf,
    /// Left and right: two images (PNG, JPEG, BMP, WebP or TIFF), two folders, two patterns of numbered images
    /// (`left_%05d.png`) or two videos. Or one folder of both sides: with folders `left` and `right` or
    /// `image_2` and `image_3`, or names like `left_1` and `right_1`, `1_left` and `1_right`, `1_L`
    /// and `1_R`. Or, with --layout, one image, folder, pattern or video
    #[arg(value_name = "INPUT", required = true, num_args = 1..=2)]
    inputs: Vec<PathBuf>,
    /// Each picture shows both images: the left one in the left half (`side-by-side`) or in the
    /// upper half (`top-bottom`)
    #[arg(long, value_name = "HOW", value_parser = values::layout())]
    layout: Option<Layout>,
    /// What to compute on; `twinsight devices` lists the choices
    #[arg(long, default_value_t = DeviceName::FLEX)]
    device: DeviceName,
    /// Frames that are measured at once
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=64), default_value_t = 1)]
    batch: u16,
    /// Least score of a vehicle, 0 to 1
    #[arg(long, value_parser = values::share::<f32>, default_value_t = PredictOptions::default().confidence, help_heading = "Filters")]
    confidence: f32,
    /// Boxes that overlap a better one by more than this intersection over union are dropped
    #[arg(long, value_parser = values::share::<f64>, default_value_t = PredictOptions::default().iou, help_heading = "Filters")]
    iou: f64,
    /// At most this many vehicles a frame, those of the highest scores
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), help_heading = "Filters")]
    max_detections: Option<u32>,
    /// Only these classes, as in car,truck
    #[arg(
        long,
        value_name = "NAMES",
        value_delimiter = ',',
        help_heading = "Filters"
    )]
    classes: Vec<String>,
    /// Only vehicles whose box in the left image has its centre in this polygon: corners "x,y x,y
    /// x,y" in pixels, or a file of them
    #[arg(
        long,
        value_name = "POLYGON",
        allow_hyphen_values = true,
        help_heading = "Filters"
    )]
    roi: Option<String>,
    /// How boxes of the right image are found: `detect` runs the detector on both images and assigns
    /// its boxes to each other, `search` runs it on the left image and looks for each box's pixels
    /// in the right one, at half the detector's cost
    #[arg(long, value_name = "HOW", value_parser = values::pairing_mode(), default_value_t = PredictOptions::default().pairing_mode)]
    pairing: PairingMode,
    /// What becomes of a vehicle that the detector sees in one image only: `search` looks for its
    /// box in the other image and leaves it out where that is not found, `keep` reports it without
    /// a distance then, `drop` leaves it out at once (with --pairing detect)
    #[arg(long, value_name = "HOW", value_parser = values::single_sided(), default_value_t = PredictOptions::default().single_sided)]
    single_sided: SingleSided,
    /// Which answer `distance_m` is: `fused` weighs size, disparity and, where it was trained for
    /// such views, the size network, and says how sure it is; `paper` is the twin-branch network
    #[arg(long, value_name = "WHICH", value_parser = values::ranger(), default_value_t = PredictOptions::default().ranger)]
    ranger: RangerKind,
    /// How far all disparities of a frame may be off, pixels, standard deviation
    /// [default: what the calibration file says of it, or 0.5]
    #[arg(long, value_name = "PX", value_parser = values::not_negative)]
    disparity_std: Option<f64>,
    /// Write JSON Lines there; - is standard output, as without this option
    #[arg(long, value_name = "FILE", help_heading = "Results")]
    jsonl: Option<PathBuf>,
    /// Write a table with one row a vehicle; - is standard output, in place of JSON
    #[arg(long, value_name = "FILE", help_heading = "Results")]
    csv: Option<PathBuf>,
    /// Draw boxes and distances: a PNG or JPEG file for one pair, a folder of PNG files for many
    #[arg(long, value_name = "PATH", help_heading = "Results")]
    annotate: Option<PathBuf>,
    /// Write the drawings as a video (mp4, mkv, mov, webm or avi); needs the program ffmpeg
    #[arg(long, value_name = "FILE", help_heading = "Results")]
    video: Option<PathBuf>,
    /// Frames a second of --video [default: those of the input video, or 10]
    #[arg(
        long,
        value_name = "RATE",
        requires = "video",
        help_heading = "Results"
    )]
    fps: Option<f64>,
    /// Exit with 2 if any frame could not be used
    #[arg(long)]
    strict: bool,
    #[command(flatten)]
    calibration: CalibrationArgs,
}

const EXAMPLES: &str = "\
Examples:
  Distances of the vehicles in a pair, and a picture of them:

    twinsight predict --run checkpoints/quick left.png right.png --annotate seen.png

  The distances alone:

    twinsight predict --run checkpoints/quick left.png right.png | jq '.vehicles[].distance_m'

  A folder of pairs, as JSON Lines and as a table:

    twinsight predict --run checkpoints/quick drive/left drive/right --jsonl a.jsonl --csv a.csv

  KITTI's folders, near the middle of the road only:

    twinsight predict --run checkpoints/quick training --roi \"300,375 900,375 650,180 550,180\"

  Images of your own cameras, as they took them, with OpenCV's calibration in millimetres:

    twinsight predict --run checkpoints/quick left.png right.png \\
      --calib intrinsics.yml --calib extrinsics.yml --calib-baseline 0.12

  A stereo video to a video with boxes:

    twinsight predict --run checkpoints/quick zed.mp4 --layout side-by-side --video seen.mp4";

impl PredictArgs {
    /// Measures what was given.
    pub fn run(&self, quiet: bool) -> Result<()> {
        let options = PredictOptions {
            confidence: self.confidence,
            iou: self.iou,
            pairing_mode: self.pairing,
            single_sided: self.single_sided,
            ranger: self.ranger,
            ..PredictOptions::default()
        };
        let filter = VehicleFilter {
            classes: self.classes.clone(),
            region: self.roi.as_deref().map(region).transpose()?,
            max_vehicles: self.max_detections.map(|most| most as usize),
        };
        let load = || {
            StereoRanger::load(&self.run, &self.device.open()?)?
                .with_options(options)
                .with_filter(filter)
        };
        let outputs = self.outputs();
        outputs.check_names()?;
        let source = FrameSource::open(&self.inputs, self.layout)?;
        outputs.check_targets(source.is_single(), &self.files(), source.folders())?;
        if !quiet {
            say(skipped_note(source.skipped()));
        }
        if source.is_single() {
            return self.run_one(source, load, &outputs, quiet);
        }
        self.run_many(source, load, &outputs, quiet)
    }

    /// Everything that is read, but for what is in folders.
    fn files(&self) -> Vec<PathBuf> {
        let roi = self.roi.as_ref().map(PathBuf::from);
        let given = self.inputs.iter().chain(self.calibration.files()).cloned();
        given.chain(roi).chain(of_run(&self.run)).collect()
    }

    fn outputs(&self) -> Outputs<'_> {
        Outputs {
            jsonl: self.jsonl.as_deref(),
            csv: self.csv.as_deref(),
            annotate: self.annotate.as_deref(),
            video: self.video.as_deref(),
            rate_hz: self.fps,
        }
    }

    /// The ranger for such images, and what rectifies them. The calibration is looked at before the
    /// networks are loaded.
    fn on_rig(
        &self,
        load: impl FnOnce() -> Result<StereoRanger>,
        calibration: Option<&StereoCalibration>,
        [left, right]: [&RgbImage; 2],
        quiet: bool,
    ) -> Result<(StereoRanger, Option<CalibratedRig>)> {
        let calibrated = calibration
            .map(|calibration| self.calibration.rig(calibration, left.dimensions()))
            .transpose()?;
        let mut ranger = load()?;
        if let Some(calibrated) = &calibrated {
            ranger = ranger.with_trusted_rig(calibrated.trusted_rig());
        }
        if let Some(std_px) = self.disparity_std {
            ranger = ranger.with_disparity_std(std_px);
        }
        if let Some(calibrated) = calibrated.as_ref().filter(|_| !quiet) {
            say(calibrated.note());
            // Of the same images that are still the same the ranger will tell.
            if let Some(note) = PairDoubt::of_images([left, right]) {
                let [left, right] = calibrated.rectify([left.clone(), right.clone()])?;
                if PairDoubt::of_images([&left, &right]).is_none() {
                    say([note]);
                }
            }
        }
        Ok((ranger, calibrated))
    }

    /// Measures one pair, which must be usable.
    fn run_one(
        &self,
        source: FrameSource,
        load: impl FnOnce() -> Result<StereoRanger>,
        outputs: &Outputs,
        quiet: bool,
    ) -> Result<()> {
        let Some(frame) = source.read_ahead(1)?.next() else {
            return Ok(());
        };
        let mut images = frame.images?;
        let calibration = self.calibration.load(Some(images[0].dimensions()))?;
        let pair = images.each_ref();
        let (ranger, calibrated) = self.on_rig(load, calibration.as_ref(), pair, quiet)?;
        if let Some(calibrated) = &calibrated {
            images = calibrated.rectify(images)?;
        }
        let [left, right] = images;
        if !quiet {
            say(ranger.rig_notes(left.dimensions()));
        }
        let (mut found, _) = ranger.find(&[[&left, &right]])?;
        let found = found.pop().unwrap_or_default();
        if !quiet {
            say(found.note);
        }
        outputs.write_one(&frame.name, frame.origins, [&left, &right], found)
    }

    /// Frame after frame.
    fn run_many(
        &self,
        source: FrameSource,
        load: impl FnOnce() -> Result<StereoRanger>,
        outputs: &Outputs,
        quiet: bool,
    ) -> Result<()> {
        let batch = usize::from(self.batch);
        let (len, rate_hz) = (source.len(), source.rate_hz());
        let mut frames = source.read_ahead(2 * batch)?;
        // The first usable frame tells the size of all, and with it the rig.
        let mut first: Vec<StereoFrame> = Vec::new();
        while first.last().is_none_or(|frame| frame.images.is_err())
            && let Some(frame) = frames.next()
        {
            first.push(frame);
        }
        let usable = first.last().and_then(|frame| frame.images.as_ref().ok());
        let calibration = match usable {
            Some([left, _]) => self.calibration.load(Some(left.dimensions()))?,
            None => None,
        };
        let (ranger, calibrated) = match usable {
            Some(images) => self.on_rig(load, calibration.as_ref(), images.each_ref(), quiet)?,
            None => (load()?, None),
        };
        let frames = first
            .into_iter()
            .chain(frames)
            .map(|frame| rectified(frame, calibrated.as_ref()));
        let mut sinks: Vec<Box<dyn Sink>> = outputs.sinks(rate_hz)?;
        let outcome = terminal::with_progress(quiet, |progress| {
            progress.begin("predicting", len.unwrap_or(0));
            let outcome = predict(&ranger, frames, batch, &mut sinks, progress);
            progress.end();
            outcome
        });
        // What was done is kept, whatever ended it.
        let finished: Vec<Result<()>> = sinks.into_iter().map(Sink::finish).collect();
        let summary = match outcome {
            Err(error) if output::is_closed_pipe(&error) => return Ok(()),
            outcome => outcome?,
        };
        finished.into_iter().collect::<Result<()>>()?;
        report::show(&summary, quiet);
        if summary.interrupted {
            return Err(Error::Interrupted {
                resume: format!(
                    "the results of {} frames are kept; run the same command again for all of them",
                    summary.frames
                ),
            });
        }
        report::verdict(&summary, self.strict)
    }
}

/// What is said of files that are no images that can be read.
fn skipped_note(skipped: &[PathBuf]) -> Option<String> {
    const NAMED: usize = 5;
    if skipped.is_empty() {
        return None;
    }
    let shown = skipped.iter().take(NAMED);
    let mut names: Vec<String> = shown.map(|path| path.display().to_string()).collect();
    if skipped.len() > NAMED {
        names.push(format!("and {} more", skipped.len() - NAMED));
    }
    Some(format!(
        "left out {} files that are not PNG, JPEG, BMP, WebP or TIFF images: {}",
        skipped.len(),
        names.join(", ")
    ))
}

/// A frame as the calibrated cameras would have taken it; the time that takes counts as reading.
fn rectified(mut frame: StereoFrame, calibrated: Option<&CalibratedRig>) -> StereoFrame {
    let Some(calibrated) = calibrated else {
        return frame;
    };
    let began = Instant::now();
    frame.images = frame.images.and_then(|images| calibrated.rectify(images));
    frame.read += began.elapsed();
    frame
}

/// A polygon as it is typed, or in a file.
fn region(text: &str) -> Result<Polygon> {
    let path = Path::new(text);
    let named = |error: Error| match error {
        Error::Value {
            problem, remedy, ..
        } => Error::value(format!("--roi \"{text}\""), problem, remedy),
        error => error,
    };
    if path.exists() || is_path(text) {
        return files::read_text(path)?.parse().map_err(named);
    }
    text.parse().map_err(named)
}

/// Whether a text that is the name of no file is meant to be one: it has letters, and no comma or the
/// ending of a file.
fn is_path(text: &str) -> bool {
    let has_letters = |text: &str| text.contains(|c: char| c.is_alphabetic());
    let ending = Path::new(text)
        .extension()
        .and_then(|ending| ending.to_str());
    let is_named = ending.is_some_and(|ending| has_letters(ending) && !ending.contains([',', ' ']));
    has_letters(text) && (is_named || !text.contains(','))
}
