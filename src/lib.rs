//! How many metres away is that vehicle?
//!
//! Twinsight finds vehicles in both images of a stereo pair with a YOLO11 detector and turns each
//! one's two crops and box size into a distance with a small twin-branch network. Networks,
//! training, evaluation and inference are written in [Burn](burn); a built-in renderer makes
//! stereo data to train on.
//!
//! # The pipeline
//!
//! ```text
//! left, right image                                   [`imaging`]
//!   |  letterbox to multiples of 32                   [`geometry::letterbox`]
//!   |  YOLO11, decode, suppress                       [`detector`], [`nn`], [`kernels`]
//!   v
//! boxes in both images, or in the left one
//!   |  same rows, positive disparity, best overall,   [`pairing`]
//!   |  or most alike pixels in the right image        [`pairing::search`]
//!   v
//! pairs of boxes
//!   |  right crop above left crop, box size           [`dataset::composite()`]
//!   |  twin-branch network                            [`ranging`]
//!   v
//! metres                                              [`pipeline::StereoRanger`]
//! ```
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
//! * The library never prints and never reads the environment; long work reports to a
//!   [`progress::Progress`].
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
//! Distances from a trained run: see [`pipeline::StereoRanger`].

pub mod ablate;
pub mod annotate;
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
pub mod nn;
mod page;
pub mod pairing;
pub mod pipeline;
pub mod progress;
pub mod ranging;
pub mod render;
pub mod report;
pub mod train;
pub mod validate;
pub mod weights;
pub mod world;

pub use error::{Error, Result};
