//! `--calib` and what belongs to it.

use std::fmt::Display;
use std::path::PathBuf;

use clap::Args;
use twinsight::Result;
use twinsight::calibration::{CalibratedRig, ImageState, LoadOptions, RigOptions, load};
use twinsight::geometry::StereoCalibration;

use super::{stderr, values};

/// Which cameras took the images.
#[derive(Debug, Args)]
#[command(next_help_heading = "The cameras that took the images")]
pub struct CalibrationArgs {
    /// Calibration of the cameras that took the images (given twice where it is in two files): OpenCV's
    /// stereo YAML, ROS, Kalibr, KITTI, ZED, OAK-D, `RealSense`, `EuRoC`, `ORB_SLAM`, Middlebury, Cityscapes,
    /// a camera matrix and a baseline in two lines, or TOML; docs/formats.md has an example of each.
    /// Images that are not rectified are rectified by it; boxes are then those of the rectified images
    #[arg(long, value_name = "FILE")]
    calib: Vec<PathBuf>,
    /// Distance between the cameras, in place of the calibration's, which may be in other units
    #[arg(long, value_name = "METRES", value_parser = values::above_zero, requires = "calib")]
    calib_baseline: Option<f64>,
    /// The images are rectified already, with the projections of the calibration
    #[arg(long, requires = "calib")]
    calib_rectified: bool,
    /// How much of unrectified images is kept: 0 for no black borders, 1 for everything that was seen
    /// [default: as the calibration says, or 0]
    #[arg(long, value_name = "ALPHA", value_parser = values::share::<f32>, requires = "calib", conflicts_with = "calib_rectified")]
    calib_alpha: Option<f32>,
    /// Take KITTI's grey cameras, 0 and 1, and not the colour ones, 2 and 3
    #[arg(long, requires = "calib")]
    calib_grey: bool,
}

impl CalibrationArgs {
    /// The files of the calibration.
    pub fn files(&self) -> &[PathBuf] {
        &self.calib
    }

    /// Reads the calibration, if one is given; of several resolutions that of images of this size.
    pub fn load(&self, size: Option<(u32, u32)>) -> Result<Option<StereoCalibration>> {
        if self.calib.is_empty() {
            return Ok(None);
        }
        let options = LoadOptions {
            baseline_m: self.calib_baseline,
            kitti_grey: self.calib_grey,
            image_size: size.map(Into::into),
        };
        load(&self.calib, &options).map(Some)
    }

    /// How the calibration is used.
    pub fn options(&self) -> RigOptions {
        RigOptions {
            images: if self.calib_rectified {
                ImageState::Rectified
            } else {
                ImageState::Auto
            },
            alpha: self.calib_alpha.map(f64::from),
        }
    }

    /// The calibration ready for images of this size.
    pub fn rig(&self, calibration: &StereoCalibration, size: (u32, u32)) -> Result<CalibratedRig> {
        CalibratedRig::new(calibration, size.into(), self.options())
            .map_err(|error| self.of_file(error))
    }

    /// The error of a value, said of the file that it comes from.
    fn of_file(&self, error: twinsight::Error) -> twinsight::Error {
        match (error, self.calib.first()) {
            (
                twinsight::Error::Value {
                    name,
                    problem,
                    remedy,
                },
                Some(path),
            ) => twinsight::Error::calibration(path, format!("{name}: {problem}"), remedy),
            (error, _) => error,
        }
    }
}

/// Says what is to be known of the images, such as in what they differ from those that the run was
/// trained on.
pub fn say(notes: impl IntoIterator<Item = impl Display>) {
    for note in notes {
        stderr::line(&format!("note: {note}"));
    }
}
