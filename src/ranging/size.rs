//! The size network: from the crop of a vehicle to mean and spread of its metric size and of its
//! extent along the line of sight.
//!
//! A compact network of its own beside the twin-branch network, whose training it does not touch. It
//! sees one image: how large the vehicle is across the line of sight, in metres, follows from which
//! vehicle it is and from where it is seen, and neither needs the second camera. Nothing of its input
//! says how many pixels the box has, so that it learns no prior over distance and carries over to
//! cameras of another resolution.

mod estimator;
mod guard;
mod network;
mod view;

pub use estimator::{Calibration, Moments, SizeEstimator, SizeHeader};
pub(crate) use estimator::{RawWitness, SizeInputs};
pub use guard::Guard;
pub use guard::{FrameLimits, GuardEvidence, GuardLimits};
pub use network::{SizeConfig, SizeNetwork, SizeOutput};
pub(crate) use view::write_pixels;
pub use view::{SIDE_PX, SizeView, VIEW_CHANNELS, VIEW_NUMBERS, crop_area};
