//! Calibration files of stereo cameras, and images rectified by them.
//!
//! [`load`] reads what people have: OpenCV's YAML, ROS' and Kalibr's, KITTI's text files, two lines
//! with a camera matrix and a baseline, or a TOML file of ours. The content decides, not the name.
//! What it says becomes a checked [`StereoCalibration`], and [`CalibratedRig`] makes of it the rig
//! that the pipeline needs, rectifying images where they are not:
//!
//! ```no_run
//! use twinsight::calibration::{CalibratedRig, LoadOptions, RigOptions, load};
//! use twinsight::device::DeviceName;
//! use twinsight::imaging::load_pair;
//! use twinsight::pipeline::StereoRanger;
//!
//! # fn main() -> twinsight::Result<()> {
//! let calibration = load(&["stereo.yml"], &LoadOptions::default())?;
//! let images = load_pair("left.png", "right.png")?;
//! let calibrated = CalibratedRig::new(&calibration, images[0].dimensions().into(), RigOptions::default())?;
//! let [left, right] = calibrated.rectify(images)?;
//! let ranger = StereoRanger::load("checkpoints/quick", &DeviceName::FLEX.open()?)?
//!     .with_rig(*calibrated.rig());
//! for vehicle in ranger.estimate(&left, &right)? {
//!     println!("{:.1} m", vehicle.distance_m);
//! }
//! # Ok(())
//! # }
//! ```
//!
//! Knows neither networks nor datasets.

mod entries;
pub(crate) mod kitti;
mod lines;
mod opencv;
mod rig;
mod settings;
mod writer;

use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use crate::error::{Error, Result};
use crate::geometry::{CalibrationParts, StereoCalibration};

pub use rig::{CalibratedRig, ImageState, RigOptions};
pub use writer::to_toml;

/// The largest file that is read, bytes: calibrations have one or two thousand.
const MOST_BYTES: u64 = 1 << 20;

/// From pixel coordinates whose origin is the first pixel's centre, as those of OpenCV and KITTI, to
/// this crate's, whose origin is its corner.
pub(crate) const HALF_PIXEL: f64 = 0.5;

/// What a calibration file does not say, or says otherwise.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LoadOptions {
    /// Distance between the cameras, metres: replaces the file's, whose unit may be another.
    pub baseline_m: Option<f64>,
    /// Of KITTI's four cameras take the grey ones, 0 and 1, and not the colour ones, 2 and 3.
    pub kitti_grey: bool,
}

/// Reads a calibration: one file, or two that belong together (OpenCV's `intrinsics.yml` and
/// `extrinsics.yml` in any order, or ROS' `left.yaml` and `right.yaml`).
///
/// # Errors
/// [`Error::Io`] for a file that cannot be read; [`Error::Calibration`] for one that is none, is
/// damaged or larger than 1 MiB, or holds numbers that no rig of two cameras side by side has.
pub fn load<P: AsRef<Path>>(paths: &[P], options: &LoadOptions) -> Result<StereoCalibration> {
    let Some(first) = paths.first() else {
        return Err(Error::value(
            "calibration",
            "no file is given",
            "give one or two files",
        ));
    };
    let mut texts = Vec::with_capacity(paths.len());
    for path in paths {
        texts.push(read(path.as_ref())?);
    }
    let parts = match &texts[..] {
        [text] => parse(text, options),
        [one, other] => match (Format::of(one), Format::of(other)) {
            (Format::Yaml, Format::Yaml) => opencv::parse(&[one, other]),
            _ => Err(Error::value(
                "two files",
                "only YAML calibrations come in two",
                "give intrinsics.yml and extrinsics.yml, left.yaml and right.yaml, or one file",
            )),
        },
        _ => Err(Error::value(
            format!("{} files", paths.len()),
            "a calibration has one or two",
            "give one or two files",
        )),
    };
    parts
        .and_then(|parts| StereoCalibration::new(parts, options.baseline_m))
        .map_err(|error| of_file(first.as_ref(), error))
}

/// Reads the text of a single calibration file.
///
/// # Errors
/// [`Error::Value`] for what [`load`] refuses.
pub fn from_text(text: &str, options: &LoadOptions) -> Result<StereoCalibration> {
    StereoCalibration::new(parse(text, options)?, options.baseline_m)
}

/// The error of a value, said of the file that holds it.
fn of_file(path: &Path, error: Error) -> Error {
    match error {
        Error::Value {
            name,
            problem,
            remedy,
        } => Error::calibration(path, format!("{name}: {problem}"), remedy),
        error => error,
    }
}

fn read(path: &Path) -> Result<String> {
    let file = File::open(path).map_err(Error::io("read", path))?;
    let mut bytes = Vec::new();
    // Not by the length that the system names: devices have none.
    file.take(MOST_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(Error::io("read", path))?;
    if bytes.len() as u64 > MOST_BYTES {
        return Err(Error::calibration(
            path,
            "has more than 1 MiB",
            "give a calibration file, not an image or a video",
        ));
    }
    let Ok(text) = String::from_utf8(bytes) else {
        return Err(Error::calibration(
            path,
            "is no text file",
            "give a calibration file, not an image or a video",
        ));
    };
    Ok(match text.strip_prefix('\u{feff}') {
        Some(rest) => rest.to_owned(),
        None => text,
    })
}

/// The kinds of file that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Empty,
    Xml,
    Kitti,
    TwoLines,
    Yaml,
    Toml,
    Unknown,
}

impl Format {
    fn of(text: &str) -> Self {
        let mut lines = text
            .lines()
            .map(str::trim)
            .filter(|line| !line.is_empty() && !line.starts_with('#'));
        let Some(first) = lines.clone().next() else {
            return Self::Empty;
        };
        if first.starts_with('<') {
            return Self::Xml;
        }
        if lines.clone().any(kitti::is_projection) {
            return Self::Kitti;
        }
        let starts_with_number = first
            .split([' ', ',', '\t', '['])
            .find(|word| !word.is_empty())
            .is_some_and(|word| word.parse::<f64>().is_ok());
        if starts_with_number {
            return Self::TwoLines;
        }
        if first.starts_with(['%', '{']) || first.starts_with("---") {
            return Self::Yaml;
        }
        // The first line that says anything: `[table]`, `key = value` or `key: value`.
        if first.starts_with('[') {
            return Self::Toml;
        }
        lines
            .find_map(|line| match line.find([':', '=']) {
                Some(at) if line[at..].starts_with('=') => Some(Self::Toml),
                Some(_) => Some(Self::Yaml),
                None => None,
            })
            .unwrap_or(Self::Unknown)
    }
}

fn parse(text: &str, options: &LoadOptions) -> Result<CalibrationParts> {
    let known = "give OpenCV's YAML, KITTI's text, a camera matrix and a baseline in two lines, or \
                 TOML; docs/calibration.md describes them";
    match Format::of(text) {
        Format::Kitti => kitti::parse(text, options.kitti_grey),
        Format::TwoLines => lines::parse(text, options.baseline_m),
        Format::Yaml => opencv::parse(&[text]),
        Format::Toml => settings::parse(text, options.baseline_m),
        Format::Empty => Err(Error::value("content", "the file is empty", known)),
        Format::Xml => Err(Error::value(
            "content",
            "is XML",
            "save it with OpenCV's FileStorage under a name that ends in .yml",
        )),
        Format::Unknown => Err(Error::value(
            "content",
            "is no calibration that is known",
            known,
        )),
    }
}

#[cfg(test)]
mod tests;
