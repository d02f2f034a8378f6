//! Calibration files of stereo cameras, and images rectified by them.
//!
//! [`load`] reads what people have; [`known`] lists the formats, and `docs/formats.md` has an example of
//! each. The content decides first and the name second. A new one is a type with the trait `Format` in
//! a file of its own, and a line in the table. What it says becomes a checked [`StereoCalibration`], and [`CalibratedRig`] makes of it the rig
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

mod cityscapes;
mod documents;
mod entries;
mod euroc;
mod format;
mod json;
mod kalibr;
pub(crate) mod kitti;
mod lines;
mod middlebury;
mod named;
mod oak;
mod opencv;
mod orb_slam;
mod places;
mod realsense;
mod resolution;
mod rig;
mod ros;
mod settings;
mod writer;
mod zed;

use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use crate::error::{Error, Result};
use crate::geometry::StereoCalibration;

pub use format::{KnownFormat, known};
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
    /// Size of the images, width and height in pixels: decides where a calibration has several
    /// resolutions.
    pub image_size: Option<[u32; 2]>,
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
    let names: Vec<&Path> = paths.iter().map(AsRef::as_ref).collect();
    let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
    format::parse(&texts, &names, options)
        .and_then(|parts| StereoCalibration::new(parts, options.baseline_m))
        .map_err(|error| of_file(first.as_ref(), error))
}

/// Reads the text of a single calibration file.
///
/// # Errors
/// [`Error::Value`] for what [`load`] refuses.
pub fn from_text(text: &str, options: &LoadOptions) -> Result<StereoCalibration> {
    StereoCalibration::new(format::parse(&[text], &[], options)?, options.baseline_m)
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
    let Some(text) = text_of(bytes) else {
        return Err(Error::calibration(
            path,
            "is no text file",
            format!(
                "give a calibration file, not an image, a video or NumPy's arrays; {}",
                format::known_list()
            ),
        ));
    };
    Ok(match text.strip_prefix('\u{feff}') {
        Some(rest) => rest.to_owned(),
        None => text,
    })
}

/// The text of a file: UTF-8, or UTF-16 as some editors of Windows write it.
fn text_of(bytes: Vec<u8>) -> Option<String> {
    let wide = |pairs: &[u8], read: fn([u8; 2]) -> u16| {
        let (pairs, _) = pairs.as_chunks::<2>();
        let units: Vec<u16> = pairs.iter().map(|pair| read(*pair)).collect();
        String::from_utf16(&units).ok()
    };
    match &bytes[..] {
        [0xFF, 0xFE, rest @ ..] => wide(rest, u16::from_le_bytes),
        [0xFE, 0xFF, rest @ ..] => wide(rest, u16::from_be_bytes),
        _ => String::from_utf8(bytes).ok(),
    }
}

#[cfg(test)]
mod tests;
