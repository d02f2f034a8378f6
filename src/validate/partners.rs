//! Vehicles that one image of a pair has a label of and the other one has not.
//!
//! That alone is no mistake: what stands before the rig may hide a vehicle from one camera and not
//! from the other. The other image decides: where it shows the same pixels at the place that the
//! distance gives them, the label is missing.

use image::RgbImage;

use super::labels::{depth_m, is_unjudged};
use super::{Finding, FindingKind};
use crate::dataset::{BoxKind, Frame, Label, Side};
use crate::detector::Detection;
use crate::geometry::StereoRig;
use crate::pairing::PairingConfig;
use crate::pairing::search::{search, search_from_right};

/// The visible surface is nearer than the centre of a vehicle: its disparity may differ from the
/// centre's by this part of it and by some pixels more.
const SURFACE_PART: f64 = 0.25;
/// See [`SURFACE_PART`].
const SURFACE_PX: f64 = 2.0;

/// A box of less than this part of its width is cut off by the border.
const WHOLE: f64 = 0.99;

/// The vehicles of a frame that lack a label which the other image calls for, one finding a vehicle.
pub(super) fn check(rig: &StereoRig, frame: &Frame, images: [&RgbImage; 2]) -> Vec<Finding> {
    let Some(right) = &frame.right else {
        return Vec::new();
    };
    let sides = [
        (Side::Left, &frame.left.labels, &right.labels),
        (Side::Right, &right.labels, &frame.left.labels),
    ];
    let mut findings = Vec::new();
    for (side, labels, others) in sides {
        let has_partner = |label: &&Label| {
            let alike = |other: &Label| other.id == label.id && other.kind == label.kind;
            others.iter().any(alike)
        };
        let alone: Vec<&Label> = labels
            .iter()
            .filter(|label| !is_unjudged(label) && !has_partner(label))
            .collect();
        let mut ids: Vec<u32> = alone.iter().map(|label| label.id).collect();
        ids.sort_unstable();
        ids.dedup();
        for id in ids {
            let of_vehicle: Vec<&Label> = alone.iter().copied().filter(|l| l.id == id).collect();
            findings.extend(missing_partner(rig, frame, images, &of_vehicle, side));
        }
    }
    findings
}

/// Says that labels of a vehicle lack partners, where the other image shows the vehicle.
fn missing_partner(
    rig: &StereoRig,
    frame: &Frame,
    images: [&RgbImage; 2],
    labels: &[&Label],
    side: Side,
) -> Option<Finding> {
    // The tight box holds less of what is not the vehicle.
    let tight = labels.iter().find(|label| label.kind == BoxKind::Tight);
    let label = tight.or(labels.first())?;
    let (camera, other) = match side {
        Side::Left => (&rig.left, Side::Right),
        Side::Right => (&rig.right, Side::Left),
    };
    let ray = camera.camera_from_pixel(label.center_pixel);
    // The two cameras are mirror images of each other about the middle of the rig.
    let ray_of_left = [
        if side == Side::Left { ray[0] } else { -ray[0] },
        ray[1],
        ray[2],
    ];
    let expected_px = rig.disparity_px(depth_m(rig, ray_of_left, label.distance_m?));
    let box_pixel = label
        .box_pixel
        .clipped(f64::from(camera.width), f64::from(camera.height));
    if !box_pixel.is_valid() {
        return None;
    }
    let seen = [Detection {
        box_pixel,
        score: 1.0,
        class: 0,
    }];
    let config = PairingConfig::default();
    let found = match side {
        Side::Left => search(images, &seen, rig, &config),
        Side::Right => search_from_right(images, &seen, rig, &config),
    };
    let found = found.partners.first()?;
    let off_px = (found.disparity_px - expected_px).abs();
    // Whoever labels may leave out what the border cuts off.
    let is_cut_off = found.box_pixel.width() < WHOLE * box_pixel.width();
    if off_px > SURFACE_PX + SURFACE_PART * expected_px || is_cut_off {
        return None;
    }
    let kinds: Vec<String> = labels.iter().map(|label| label.kind.to_string()).collect();
    let kinds = kinds.join(" and a ");
    let x = found.box_pixel.center()[0];
    let reason = format!(
        "vehicle {} has a {kinds} box in the {side} image alone, and the {other} one shows it at x = \
         {x:.0} px",
        label.id
    );
    Some(Finding::of_frame(FindingKind::Partner, frame, reason))
}
