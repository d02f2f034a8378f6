//! How many metres away is that vehicle?
//!
//! Twinsight finds vehicles in a stereo pair with a YOLO11 detector and makes a posterior over each one's
//! distance from its box, its pixels in both images and, where they were trained, small networks; the
//! paper's twin-branch network can be asked alone. Networks,
//! training, evaluation and inference are written in [Burn](burn); a built-in renderer makes
//! stereo data to train on.
//!
//! # The pipeline
//!
//! ```text
//! left, right image                                   [`imaging`]
//!   |  undo the lenses, turn both onto the same rows  [`calibration`]
//!   |  letterbox to multiples of 32                   [`geometry::letterbox`]
//!   |  YOLO11, decode, suppress                       [`detector`], [`nn`], [`kernels`]
//!   v
//! boxes in both images, or in the left one
//!   |  same rows, possible disparity, best overall,   [`pairing`]
//!   |  or most alike pixels in the right image        [`pairing::search`]
//!   v
//! pairs of boxes
//!   |  size, disparity, learnt size: a posterior      [`ranging::FusedRanger`]
//!   |  or the paper's network on both crops           [`ranging::DistanceEstimator`]
//!   v
//! metres                                              [`pipeline::StereoRanger`]
//! ```
//!
//! [`calibrate`](mod@calibrate) says from pairs how well a rig is calibrated.
//!
//! [`sources`] brings pairs from files, folders and videos, and [`predict`](mod@predict) takes what
//! is found in them to files.
//!
//! [`world`] and [`render`] build and draw scenes, [`generate`](mod@generate) turns them into a
//! dataset, [`formats`] brings foreign datasets into that format and out of it, [`dataset`] reads it, [`train`] trains both networks on it, and
//! [`evaluate`](mod@evaluate) says how good they are with [`metrics`], and [`report`](mod@report)
//! makes a page of it.
//!
//! # Invariants
//!
//! * [`geometry`], [`world`], [`render`] and [`metrics`] know no tensors; [`detector`] and
//!   [`ranging`] do not know each other; only [`train`] knows optimisers.
//! * The library never prints; long work reports to a [`progress::Progress`]. Of the environment it
//!   reads two variables: `TWINSIGHT_TOKEN`, the token for `remote` devices (`worker`), and
//!   `TWINSIGHT_SIMD`, which narrows the vectors of [`kernels`] for tests.
//! * Bad input is an [`Error`] that names the file or value and the remedy.
//! * Names say which space a number lives in: `pixel` (full image), `letterbox` (network input),
//!   `grid` (feature cell), `camera` and `rig` (metres); angles are radians inside, degrees at the
//!   edge.
//! * Files are written to a temporary name and renamed.
//! * The same seed gives the same dataset to the byte, and the same training on the same device
//!   and build.
//! * `unsafe` lives in [`kernels`] only.
//!
//! # Example
//!
//! Geometry without any network:
//!
//! ```
//! use twinsight::geometry::StereoRig;
//!
//! # fn main() -> twinsight::Result<()> {
//! let rig = StereoRig::from_hfov(2048, 1152, 90.0, 0.80)?;
//! assert!((rig.disparity_px(10.0) - 81.92).abs() < 1e-9);
//! assert!((rig.depth_m(4.096) - 200.0).abs() < 1e-9);
//! # Ok(())
//! # }
//! ```
//!
//! Distances from a trained run, which is what most programs want:
//!
//! | | |
//! |---|---|
//! | [`DeviceName`] | what to compute on |
//! | [`StereoRanger`] | a trained run: a pair of images, or a batch of them, to [`Vehicle`]s |
//! | [`PredictOptions`], [`pipeline::VehicleFilter`] | what counts as a vehicle, and which are wanted |
//! | [`imaging::load_pair`] | two image files |
//! | [`sources::FrameSource`] | folders, numbered files and videos, read ahead |
//! | [`predict::predict`] | all of a source to files of results, past broken frames |
//! | [`progress::Progress`] | hears how far long work is, and may stop it |
//! | [`Error`] | what went wrong, with the file or value and the remedy |

pub mod ablate;
pub mod annotate;
pub mod calibrate;
pub mod calibration;
pub mod dataset;
pub mod detector;
pub mod device;
pub mod error;
pub mod evaluate;
pub mod files;
pub mod formats;
pub mod generate;
pub mod geometry;
pub mod imaging;
pub mod inspect;
pub mod kernels;
pub mod metrics;
#[cfg(test)]
mod mutate;
pub mod nn;
mod page;
pub mod pairing;
pub mod pipeline;
pub mod predict;
pub mod progress;
pub mod ranging;
pub mod render;
pub mod report;
pub mod sources;
pub mod train;
pub mod validate;
pub mod weights;
#[cfg(feature = "remote")]
pub mod worker;
pub mod world;

pub use device::DeviceName;
pub use error::{Error, Result};
pub use pipeline::{PredictOptions, StereoRanger, Vehicle};
