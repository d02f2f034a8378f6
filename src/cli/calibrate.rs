//! `twinsight calibrate`.

mod report;

use std::path::{Path, PathBuf};

use clap::Args;
use twinsight::calibrate::{
    KnownDistance, RectificationFit, Refined, Survey, SurveyOptions, UNKNOWN_CONSTANT_STD_PX,
    constant_from_evidence, offset_from_readings, read_known_distances, rows_picture, survey,
};
use twinsight::calibration::{CalibratedRig, RigOptions, to_toml};
use twinsight::dataset::{Frame, StereoDataset};
use twinsight::geometry::{DisparityCorrection, DisparityTerms, StereoCalibration};
use twinsight::progress::Progress;
use twinsight::ranging::{Ranger, Target, TrustedRig};
use twinsight::sources::{FrameSource, Layout, StereoFrame};
use twinsight::{Error, Result};

use super::calibration::{CalibrationArgs, say};
use super::files::{Kind, check_target, write};
use super::{stdout, terminal, values};
use report::{Constant, Findings};

/// Check the calibration of a stereo rig by its own pairs, and write a better one
///
/// Finds thousands of features again from image to image and says from the rows that they are off how
/// the right camera is turned against what its calibration says, with standard errors; needs neither
/// labels nor a board. Turned cameras change disparities, and with them every distance: the error
/// follows from the turn, all but its constant, which no row shows. --distances finds the constant.
///
/// --out writes a calibration that --calib of other commands takes. Where rows are off by more than a
/// pixel it turns the right camera, so that images are resampled; otherwise it keeps the cameras and
/// only holds the error of disparities.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct CalibrateArgs {
    /// Left and right images of the rig, as `predict` takes them: two files, folders, patterns or
    /// videos, or one folder of both; several different scenes are better than one
    #[arg(value_name = "INPUT", required_unless_present = "data", num_args = 1..=2)]
    inputs: Vec<PathBuf>,
    /// Take the pairs of a dataset, whose rig is known
    #[arg(long, value_name = "DIR", conflicts_with_all = ["inputs", "layout", "calib"])]
    data: Option<PathBuf>,
    /// Each picture shows both images: the left one in the left half (`side-by-side`) or in the
    /// upper half (`top-bottom`)
    #[arg(long, value_name = "HOW", value_parser = values::layout())]
    layout: Option<Layout>,
    /// At most this many pairs, evenly spread
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 100)]
    frames: u32,
    /// Known distances, a table with the columns `image,x,y,distance_m`: a pixel of the left rectified
    /// image and how far the surface that it shows is from the middle between the cameras, metres. Or
    /// `image,x_min,y_min,x_max,y_max,distance_m`: the box of a car and the distance of its centre,
    /// which lies behind the surface by half the car. Points are exacter. A column `distance_std_m`
    /// says how exact the distances are [default: 1 %]. Far places (small disparities) tell most; about
    /// ten of them, from the left border to the right one, also tell how the error changes across the
    /// image
    #[arg(long, value_name = "FILE")]
    distances: Option<PathBuf>,
    /// Take the labelled vehicles of the dataset (--data), at least 20, for rulers: the constant is what
    /// their sizes and disparities agree on best. Needs no distances, but trusts that cars are 1.52 m
    /// high on average; 8 cm more or less move the constant by some tenths of a pixel, which its
    /// standard deviation allows for
    #[arg(long, requires = "data", conflicts_with = "distances")]
    from_vehicles: bool,
    /// Write the calibration there, as TOML
    #[arg(long, value_name = "FILE", help_heading = "Results")]
    out: Option<PathBuf>,
    /// Draw the rows that features are off, before and after, as SVG
    #[arg(long, value_name = "FILE", help_heading = "Results")]
    picture: Option<PathBuf>,
    /// Print the results as JSON
    #[arg(long, help_heading = "Results")]
    json: bool,
    #[command(flatten)]
    calibration: CalibrationArgs,
}

const EXAMPLES: &str = "\
Examples:
  How well KITTI's colour pair is rectified, with a picture:

    twinsight calibrate image_2 image_3 --calib calib/000045.txt --picture rows.svg

  A better calibration from a drive and a few measured distances, and its use:

    twinsight calibrate drive/left drive/right --calib stereo.yml --distances known.csv --out rig.toml
    twinsight predict --run checkpoints/quick left.png right.png --calib rig.toml

  A better calibration of a dataset's cameras from its own vehicles, and what it gives:

    twinsight calibrate --data datasets/mine --from-vehicles --out mine.toml
    twinsight evaluate --data datasets/mine --calib mine.toml

  where known.csv holds lines like

    image,x,y,distance_m
    00042,611.5,180,38.4";

/// Pairs with the calibration of their rig.
struct Pairs {
    frames: Box<dyn Iterator<Item = StereoFrame>>,
    len: Option<u64>,
    calibration: StereoCalibration,
}

impl CalibrateArgs {
    /// Measures, tells and writes.
    pub fn run(&self, quiet: bool) -> Result<()> {
        let known = self.distances.as_ref().map(read_known_distances);
        let known = known.transpose()?.unwrap_or_default();
        let inputs = self.files();
        for (path, kind) in [
            (&self.out, Kind::CALIBRATION),
            (&self.picture, Kind::DRAWING),
        ] {
            if let Some(path) = path {
                check_target(path, kind, &inputs)?;
            }
        }
        let Pairs {
            frames,
            len,
            calibration,
        } = self.pairs()?;
        let (calibrated, frames) = self.calibrated(&calibration, frames)?;
        if !quiet {
            say(calibrated.note());
            if calibration.disparity_correction().is_some() {
                say(["the calibration's error of disparities is measured anew, not added to"]);
            }
        }
        let (found, findings) = terminal::with_progress(quiet, |progress| {
            let found = self.survey(frames, len, &calibrated, &known, progress)?;
            let findings = self.findings(&calibration, &calibrated, &found, progress);
            Ok((found, findings))
        })?;
        if !quiet {
            say(&found.unusable);
            say(found.unread.iter().map(|row| format!("--distances {row}")));
        }
        let findings = findings?;
        if let Some(path) = &self.out {
            let text = report::header(&findings)
                + &to_toml(&findings.refined.with_correction(findings.terms)?)?;
            write(path, text.as_bytes())?;
        }
        if let Some(path) = &self.picture {
            let svg = rows_picture(&found.matches, &findings.fit, &found.rig)?;
            write(path, svg.as_bytes())?;
        }
        stdout::print(&if self.json {
            report::json(&findings)?
        } else {
            report::text(&findings)
        })
    }

    /// Everything that is read, but for what is in folders.
    fn files(&self) -> Vec<PathBuf> {
        let given = self.inputs.iter().chain(self.calibration.files());
        given.chain(&self.distances).cloned().collect()
    }

    /// What was given, to be read.
    fn pairs(&self) -> Result<Pairs> {
        if let Some(folder) = &self.data {
            return of_dataset(StereoDataset::open(folder)?);
        }
        let source = FrameSource::open(&self.inputs, self.layout)?;
        let len = source.len();
        let mut frames = source.read_ahead(2)?.peekable();
        let first = frames.peek().and_then(|frame| frame.images.as_ref().ok());
        let size = first.map(|[left, _]| left.dimensions());
        let calibration = self.calibration.load(size)?.ok_or_else(|| {
            Error::value(
                "--calib",
                "no calibration is given, and there is nothing to check without one",
                "give --calib FILE, or --data DIR for a dataset, whose rig is known",
            )
        })?;
        Ok(Pairs {
            len,
            frames: Box::new(frames),
            calibration,
        })
    }

    /// The rig ready for the first usable pair, and all pairs.
    fn calibrated(
        &self,
        calibration: &StereoCalibration,
        mut frames: Box<dyn Iterator<Item = StereoFrame>>,
    ) -> Result<(CalibratedRig, impl Iterator<Item = StereoFrame>)> {
        let mut first: Vec<StereoFrame> = Vec::new();
        while first.last().is_none_or(|frame| frame.images.is_err())
            && let Some(frame) = frames.next()
        {
            first.push(frame);
        }
        let size = match first.last().map(|frame| frame.images.as_ref()) {
            Some(Ok([left, _])) => left.dimensions(),
            Some(Err(_)) => {
                let broken = first.into_iter().find_map(|frame| frame.images.err());
                return Err(broken.unwrap_or_else(no_pairs));
            }
            None => return Err(no_pairs()),
        };
        let calibrated = self.calibration.rig(calibration, size)?;
        Ok((calibrated, first.into_iter().chain(frames)))
    }

    fn survey(
        &self,
        frames: impl Iterator<Item = StereoFrame>,
        len: Option<u64>,
        calibrated: &CalibratedRig,
        known: &[KnownDistance],
        progress: &dyn Progress,
    ) -> Result<Survey> {
        let most = u64::from(self.frames);
        let options = SurveyOptions {
            every: len.unwrap_or(most).div_ceil(most).max(1),
            most_frames: self.frames as usize,
            ..SurveyOptions::default()
        };
        progress.begin("matching features", len.unwrap_or(0));
        let found = survey(frames, calibrated, known, options, progress);
        progress.end();
        found
    }

    fn findings(
        &self,
        calibration: &StereoCalibration,
        calibrated: &CalibratedRig,
        found: &Survey,
        progress: &dyn Progress,
    ) -> Result<Findings> {
        let fit = RectificationFit::new(&found.matches, &found.rig)?;
        let options: RigOptions = self.calibration.options();
        let refined = Refined::new(calibration, options, calibrated, found, &fit)?;
        let (terms, constant) = if self.distances.is_some() {
            let offset = offset_from_readings(&refined.readings, &refined.fit, &refined.rig)?;
            (offset.terms, Constant::Known(offset))
        } else if let Some(data) = self.data.as_ref().filter(|_| self.from_vehicles) {
            let shape = refined.fit.shape(UNKNOWN_CONSTANT_STD_PX);
            let evidence = self.vehicles(data, &refined, shape, progress)?;
            let offset = constant_from_evidence(&evidence, &offsets_px())?;
            let vehicles = evidence.len();
            (
                offset.applied_to(shape),
                Constant::Rulers { offset, vehicles },
            )
        } else {
            let terms = refined.fit.shape(UNKNOWN_CONSTANT_STD_PX);
            (terms, Constant::Unknown)
        };
        Ok(Findings {
            pairs: found.frames.len(),
            unusable: found.unusable.clone(),
            unread: found.unread.clone(),
            fit,
            refined,
            terms,
            constant,
        })
    }
}

impl CalibrateArgs {
    /// What the labelled vehicles of a dataset say of each offset.
    fn vehicles(
        &self,
        data: &Path,
        refined: &Refined,
        shape: DisparityTerms,
        progress: &dyn Progress,
    ) -> Result<Vec<Vec<f64>>> {
        let dataset = StereoDataset::open(data)?;
        if refined.is_turned {
            return Err(Error::value(
                "--from-vehicles",
                "rows are off so far that images must be resampled, and the labels are of the images \
                 as they are",
                "give known distances instead (--distances)",
            ));
        }
        let shape = DisparityTerms {
            constant_px: 0.0,
            ..shape
        };
        let rig = TrustedRig::corrected(
            refined.rig,
            DisparityCorrection::new(shape, refined.rig.left)?,
        );
        let kind = values::shown_kind(&dataset);
        let ranger = Ranger::default();
        let most = self.frames as usize;
        let every = dataset.frames.len().div_ceil(most).max(1);
        let frames = dataset.frames.iter().step_by(every);
        progress.begin("ranging vehicles", frames.len() as u64);
        let mut evidence = Vec::new();
        for frame in frames {
            progress.advance(1);
            let Ok([left, right]) = frame.load(dataset.rig()) else {
                continue;
            };
            let vehicles = frame.vehicles(kind);
            let targets: Vec<Target> = vehicles
                .iter()
                .map(|vehicle| Target {
                    box_pixel: vehicle.left.box_pixel,
                    kind,
                    class: dataset.classes().get(vehicle.class as usize).cloned(),
                    witness: None,
                })
                .collect();
            evidence.extend(ranger.offset_evidence([&left, &right], &targets, &rig, &offsets_px()));
        }
        progress.end();
        Ok(evidence)
    }
}

/// Constants that are tried with vehicles as rulers, pixels.
fn offsets_px() -> Vec<f64> {
    (-40..=40).map(|i| 0.1 * f64::from(i)).collect()
}

fn no_pairs() -> Error {
    Error::value("pairs", "there are none", "give images of both cameras")
}

/// The pairs of a dataset and its rig.
fn of_dataset(dataset: StereoDataset) -> Result<Pairs> {
    let rig = *dataset.rig();
    let calibration = StereoCalibration::rectified(
        Some([rig.left.width, rig.left.height]),
        [rig.left.intrinsics(), rig.right.intrinsics()],
        rig.baseline_m,
    )?;
    let len = dataset.frames.len() as u64;
    let frames = dataset.frames.into_iter().zip(0_u64..);
    let frames = frames.map(move |(frame, index)| StereoFrame {
        index,
        name: frame.name(),
        origins: origins(&frame),
        time_s: None,
        images: frame.load(&rig),
        read: std::time::Duration::ZERO,
    });
    Ok(Pairs {
        frames: Box::new(frames),
        len: Some(len),
        calibration,
    })
}

fn origins(frame: &Frame) -> [String; 2] {
    let right = frame.right.as_ref().map(|image| &image.path);
    [Some(&frame.left.path), right].map(|path| {
        path.map(|path| path.display().to_string())
            .unwrap_or_default()
    })
}
