//! The ray through the middle of a box, and depths along it.

use crate::geometry::{PixelBox, StereoRig};

/// Cameras that are farther apart see no vehicle at the least depth, and on an oblique ray nearer depths
/// could be farther from their midpoint.
const LARGEST_HALF_BASELINE_M: f64 = 3.0;

/// The ray through the middle of a box: between depths and distances from the midpoint between the
/// cameras.
pub(super) struct Ray {
    right: f64,
    down: f64,
    half_baseline_m: f64,
}

impl Ray {
    pub fn new(area: &PixelBox, rig: &StereoRig) -> Self {
        let [right, down, _] = rig.left.camera_from_pixel(area.center());
        let finite = |value: f64| if value.is_finite() { value } else { 0.0 };
        Self {
            right: finite(right),
            down: finite(down),
            half_baseline_m: (0.5 * rig.baseline_m).min(LARGEST_HALF_BASELINE_M),
        }
    }

    /// Distance of a depth along it from the midpoint between the cameras, metres.
    pub fn distance_m(&self, z_m: f64) -> f64 {
        let x = self.right * z_m - self.half_baseline_m;
        let y = self.down * z_m;
        (x * x + y * y + z_m * z_m).sqrt()
    }

    /// The inverse of [`Ray::distance_m`].
    pub fn depth_m(&self, distance_m: f64) -> f64 {
        let ray = 1.0 + self.right * self.right + self.down * self.down;
        let b = self.right * self.half_baseline_m;
        let c = self.half_baseline_m * self.half_baseline_m - distance_m * distance_m;
        (b + (b * b - ray * c).max(0.0).sqrt()) / ray
    }
}

/// Values from the first to the last, even in their logarithm.
pub(super) fn log_spaced(first: f64, last: f64, count: usize) -> impl Iterator<Item = f64> {
    let step = libm::log(last / first) / (count - 1) as f64;
    (0..count).map(move |i| first * libm::exp(step * i as f64))
}
