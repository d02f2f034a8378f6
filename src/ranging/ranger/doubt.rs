//! Doubts about a pair: whether its images can be the left and the right one of a capture.

use std::fmt;

use image::{RgbImage, imageops};
use rayon::prelude::*;

use super::stereo::{StereoEvidence, stereo_evidence};
use crate::geometry::{Camera, PixelBox, StereoRig};

/// Vehicles whose windows agree by this much were found in the right image.
const FOUND_SUPPORT: f64 = 0.5;

/// The other order of the images must bring this much more agreement.
const LEAST_LEAD: f64 = 1.25;

/// What makes it likely that the two images are not the left and the right one of a capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PairDoubt {
    /// Both are the same to the last pixel.
    Identical,
    /// Most vehicles have their place in the other image where they would be if left and right were
    /// exchanged.
    Exchanged {
        /// Vehicles that were looked for.
        vehicles: usize,
        /// Of these, found in the right image where the rig allows it.
        found: usize,
        /// Of these, found where exchanged images would show them.
        exchanged: usize,
    },
}

impl PairDoubt {
    /// Whether both images are the same; a pair of one colour, such as the black ones that begin a
    /// video, says nothing.
    pub fn of_images([left, right]: [&RgbImage; 2]) -> Option<Self> {
        let is_plain = || left.pixels().all(|pixel| pixel == left.get_pixel(0, 0));
        (left == right && !is_plain()).then_some(Self::Identical)
    }

    /// What the vehicles of the left image tell, given their evidence. The other order is tried only
    /// where under half of them were found.
    pub(super) fn of(
        images: [&RgbImage; 2],
        boxes: &[PixelBox],
        nearer: &[Vec<PixelBox>],
        stereo: &[Option<StereoEvidence>],
        rig: &StereoRig,
    ) -> Option<Self> {
        let support =
            |evidence: &Option<StereoEvidence>| evidence.as_ref().map_or(0.0, |e| e.support);
        let given: Vec<f64> = stereo.iter().map(support).collect();
        let count = |supports: &[f64]| supports.iter().filter(|&&s| s >= FOUND_SUPPORT).count();
        let found = count(&given);
        let identical = Self::of_images(images);
        if identical.is_some() || boxes.is_empty() || 2 * found > boxes.len() {
            return identical;
        }
        // Exchanged images have the disparities of a capture in a mirror.
        let width = f64::from(images[0].width());
        let mirrored = |camera: Camera| Camera {
            center_x_px: width - camera.center_x_px,
            ..camera
        };
        let rig = StereoRig {
            left: mirrored(rig.left),
            right: mirrored(rig.right),
            ..*rig
        };
        let [left, right] = images.map(imageops::flip_horizontal);
        let other: Vec<f64> = boxes
            .par_iter()
            .zip(nearer)
            .map(|(area, nearer)| {
                let nearer: Vec<PixelBox> = nearer.iter().map(|b| b.mirrored(width)).collect();
                support(&stereo_evidence(
                    [&left, &right],
                    &area.mirrored(width),
                    &nearer,
                    &rig,
                ))
            })
            .collect();
        let exchanged = count(&other);
        let [sum_given, sum_other] = [&given, &other].map(|supports| supports.iter().sum::<f64>());
        (2 * exchanged > boxes.len() && exchanged > found && sum_other > LEAST_LEAD * sum_given)
            .then_some(Self::Exchanged {
                vehicles: boxes.len(),
                found,
                exchanged,
            })
    }
}

impl fmt::Display for PairDoubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Identical => write!(
                f,
                "the left and the right image are the same, and without a disparity no distance \
                 can be measured; give the two images of one capture"
            ),
            Self::Exchanged {
                vehicles,
                found,
                exchanged,
            } => write!(
                f,
                "left and right may be exchanged: of {vehicles} vehicles {found} appear in the \
                 right image where they can, and {exchanged} where exchanged images would show \
                 them; if they are, give the other one first"
            ),
        }
    }
}
