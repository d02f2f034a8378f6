//! Pure arithmetic of cameras, stereo rigs and boxes. Knows neither files nor tensors.
//!
//! Spaces: `camera` is metres with x right, y down, z forward and the origin in one camera;
//! `rig` is the same axes with the origin midway between the two cameras, which is the drone's
//! position; `pixel` is the full image, x right, y down, the first pixel's centre at (0.5, 0.5);
//! `letterbox` is the detector's input.

mod boxes;
mod calibration;
mod camera;
mod cuboid;
mod disparity_correction;
mod distortion;
pub mod letterbox;
mod polygon;
mod rectification;
mod resized;
mod sphere;

pub use boxes::PixelBox;
pub use calibration::{CalibrationParts, GivenRectification, LensCamera, StereoCalibration};
pub use camera::{Camera, Intrinsics, RigSettings, StereoRig};
pub use cuboid::Cuboid;
pub use disparity_correction::{DisparityCorrection, DisparityTerms};
pub use distortion::Distortion;
pub use polygon::Polygon;
pub use rectification::{Rectification, RectifiedView};
pub use resized::is_same_shape;
pub use sphere::{SphereTarget, sphere_box};
