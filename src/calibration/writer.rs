//! Calibrations written as TOML.

use super::settings::Written;
use crate::error::{Error, Result};
use crate::geometry::StereoCalibration;

/// The calibration as a TOML file that [`load`](super::load) reads back to the same numbers; what it
/// says of given rectified images is left out.
///
/// # Errors
/// [`Error::Value`] for a calibration that does not say the size of its images.
pub fn to_toml(calibration: &StereoCalibration) -> Result<String> {
    let settings = Written::of(calibration).ok_or_else(|| {
        Error::value(
            "calibration",
            "does not say the size of its images",
            "make it ready for one first",
        )
    })?;
    toml::to_string(&settings)
        .map_err(|error| Error::value("calibration", error.to_string(), "report this as a bug"))
}
