//! Calibrations checked and refined by a rig's own pairs, without a board.
//!
//! [`survey`] finds features again from image to image; [`RectificationFit`] says from their rows how
//! the right camera is turned against what its calibration says. Turned cameras change disparities as
//! well: [`RectificationFit::shape`] is the error of disparities that follows, all but its constant,
//! which no row shows. [`offset_from_readings`] finds the constant from a few known distances, and
//! [`constant_from_evidence`] from vehicles as rulers. [`Refined`] is the calibration to be written:
//! [`CalibratedRig`](crate::calibration::CalibratedRig) then brings the error of disparities along.
//!
//! ```no_run
//! use twinsight::calibrate::{RectificationFit, Refined, SurveyOptions, survey};
//! use twinsight::calibration::{CalibratedRig, LoadOptions, RigOptions, load, to_toml};
//! use twinsight::progress::Silent;
//! use twinsight::sources::FrameSource;
//!
//! # fn main() -> twinsight::Result<()> {
//! let calibration = load(&["calib.txt"], &LoadOptions::default())?;
//! let options = RigOptions::default();
//! let calibrated = CalibratedRig::new(&calibration, [1242, 375], options)?;
//! let frames = FrameSource::open(&["image_2", "image_3"], None)?.read_ahead(2)?;
//! let found = survey(frames, &calibrated, &[], SurveyOptions::default(), &Silent)?;
//! let fit = RectificationFit::new(&found.matches, &found.rig)?;
//! println!("rows are off by {:.2} px", fit.row_offset_px.value);
//! let refined = Refined::new(&calibration, options, &calibrated, &found, &fit)?;
//! let terms = refined.fit.shape(0.5);
//! std::fs::write("rig.toml", to_toml(&refined.with_correction(terms)?)?).ok();
//! # Ok(())
//! # }
//! ```
//!
//! Knows no networks.

mod corners;
mod evidence;
mod fit;
mod grey;
mod known;
mod linear;
mod matching;
mod offset;
mod picture;
mod reading;
mod refine;
mod search;
mod spread;
mod subpixel;
mod survey;

pub use evidence::{LEAST_VEHICLES, Offset, constant_from_evidence};
pub use fit::{Estimate, RectificationFit};
pub use known::{KnownDistance, Target, read_known_distances};
pub use matching::FeatureMatch;
pub use offset::{KnownOffset, offset_from_readings};
pub use picture::rows_picture;
pub use reading::Reading;
pub use refine::{MOST_ROWS_PX, Refined};
pub use survey::{Survey, SurveyOptions, survey};

/// Standard deviation of the constant of the error of disparities while nothing is known of it,
/// pixels of images as they were taken: real rigs are off by half a pixel.
pub const UNKNOWN_CONSTANT_STD_PX: f64 = 0.5;

#[cfg(test)]
mod tests;
