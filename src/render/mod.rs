//! A CPU ray tracer that turns a [`Scene`](crate::world::Scene) into stereo pairs.
//!
//! A [`Stage`] is a scene made ready for tracing; [`render`] draws what one camera of a rig sees,
//! [`Silhouette`] measures where the vehicle is in that image and how much of it is hidden.
//! The same input gives the same bytes on every machine: arithmetic is IEEE 754 basic operations
//! and `libm`, rays are traced in a fixed order, and nothing depends on threads.

mod appearance;
mod film;
mod forest;
mod frame;
mod lens;
mod maps;
mod material;
mod openness;
mod pose;
mod screen;
mod shade;
mod silhouette;
mod trace;

pub use appearance::{Appearance, BodyName, Conditions, Range};
pub use frame::{RenderSettings, render};
pub use maps::{Instances, depth};
pub use pose::{Eye, RigPose};
pub use silhouette::Silhouette;
pub use trace::Stage;
