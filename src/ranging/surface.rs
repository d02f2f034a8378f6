//! How far the visible surface of a vehicle is, by the disparity of its pixels.

use super::Sighting;
use crate::geometry::StereoRig;
use crate::pairing::PairingConfig;
use crate::pairing::search::disparity_px;

/// Distance of the surface that the left box shows, from the midpoint between the cameras, metres:
/// triangulated from the sub-pixel disparity that normalised cross-correlation finds along the
/// epipolar line. None where nothing in the right image is alike enough, or more than one place is.
pub fn surface_m(sighting: &Sighting, rig: &StereoRig) -> Option<f64> {
    let [left, _] = &sighting.boxes;
    let disparity_px = disparity_px(sighting.images, left, rig, &PairingConfig::default())?;
    rig.triangulated_m(left.center(), disparity_px)
}
