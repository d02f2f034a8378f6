//! Labels that cannot be right, alone or together.

use super::{Finding, FindingKind};
use crate::dataset::{BoxKind, Frame, FrameImage, Label, Side, StereoDataset};
use crate::generate::view_of_azimuth;
use crate::geometry::{Camera, StereoRig};

/// Visible boxes may reach this far out of the image, pixels: rounding does that.
const OUTSIDE_PX: f64 = 0.5;

/// Sides of a sphere box may differ by this, pixels: each edge has four decimals.
const SQUARE_PX: f64 = 0.05;

/// How exactly projected centres obey the rig, pixels.
const CENTER_PX: f64 = 0.5;

/// Centres of boxes stand in for projected ones in data without boxes in space; they are this much
/// less exact, as a fraction of the box.
const BOX_CENTER_PART: f64 = 0.1;

/// Distances of a row and of a label are the same within this, metres.
const SAME_M: f64 = 0.02;

/// Vehicles that are hidden more may be seen by one camera alone.
const PARTNER_VISIBLE: f64 = 0.5;

/// What all labels together say against `dataset.toml`.
pub(super) fn check_dataset(dataset: &StereoDataset) -> Vec<Finding> {
    let has = |kind: BoxKind| {
        let mut images = dataset.frames.iter().flat_map(Frame::images);
        images.any(|(_, image)| image.labels_of(kind).next().is_some())
    };
    let file = "dataset.toml";
    BoxKind::ALL
        .iter()
        .filter_map(|kind| {
            let promised = dataset.info.label_kinds.contains(kind);
            let reason = match (promised, has(*kind)) {
                (true, false) => format!("promises {kind} boxes, and no frame has any"),
                (false, true) => {
                    format!("does not list the kind {kind}, and frames have such boxes")
                }
                _ => return None,
            };
            Some(Finding::new(FindingKind::Label, file, reason))
        })
        .collect()
}

/// What is wrong with the labels of a frame.
pub(super) fn check_frame(dataset: &StereoDataset, frame: &Frame) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (side, image) in frame.images() {
        let camera = dataset.rig().camera(side);
        for label in &image.labels {
            let name = format!(
                "vehicle {}, {} box in the {side} image",
                label.id, label.kind
            );
            let known = !dataset.info.stereo || label.distance_m.is_some() || label.ignored;
            let reasons = [
                box_problem(label, camera),
                (!known).then(|| "has no distance".to_owned()),
            ];
            findings.extend(reasons.into_iter().flatten().map(|reason| {
                Finding::of_frame(FindingKind::Label, frame, format!("{name}: {reason}"))
            }));
        }
    }
    if let Some(right) = &frame.right {
        for left in frame.left.labels.iter().filter(|label| !label.ignored) {
            let alike = |label: &&Label| label.id == left.id && label.kind == left.kind;
            match right.labels.iter().find(alike) {
                Some(right) => findings.extend(pair_problems(dataset.rig(), frame, left, right)),
                None => findings.extend(missing_partner(dataset.rig(), frame, left, Side::Left)),
            }
        }
        for label in right.labels.iter().filter(|label| !label.ignored) {
            let alike = |left: &Label| left.id == label.id && left.kind == label.kind;
            if !frame.left.labels.iter().any(alike) {
                findings.extend(missing_partner(dataset.rig(), frame, label, Side::Right));
            }
        }
    }
    findings.extend(row_problems(frame));
    findings
}

/// What is wrong with a box by itself.
fn box_problem(label: &Label, camera: &Camera) -> Option<String> {
    let area = label.box_pixel;
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    match label.kind {
        BoxKind::Tight => {
            let out = [
                -area.x_min,
                -area.y_min,
                area.x_max - width,
                area.y_max - height,
            ];
            let furthest = out.into_iter().fold(0.0, f64::max);
            (furthest > OUTSIDE_PX)
                .then(|| format!("reaches {furthest:.1} px out of the {width}x{height} image"))
        }
        // What is ignored may be a region of any shape.
        BoxKind::Sphere if label.ignored => None,
        BoxKind::Sphere => {
            let (wide, high) = (area.width(), area.height());
            let [x, y] = area.center();
            let [center_x, center_y] = label.center_pixel;
            let off = libm::hypot(x - center_x, y - center_y);
            // Pixels that are not square make boxes that are not.
            let stretch = camera.focal_y_px / camera.focal_x_px;
            if (wide - high).abs() > SQUARE_PX + wide * (stretch - 1.0).abs() {
                Some(format!("is {wide:.1} by {high:.1} px, not a square"))
            } else if off > CENTER_PX {
                Some(format!("is {off:.1} px away from the projected centre"))
            } else {
                None
            }
        }
    }
}

/// Whether the centre of a box stands in for the projected centre that nobody knew.
fn is_stand_in(label: &Label) -> bool {
    let [x, y] = label.box_pixel.center();
    let off = libm::hypot(x - label.center_pixel[0], y - label.center_pixel[1]);
    label.kind == BoxKind::Tight && off < 1e-3
}

/// What is wrong with two labels of one vehicle.
fn pair_problems(rig: &StereoRig, frame: &Frame, left: &Label, right: &Label) -> Vec<Finding> {
    let finding = |kind, reason: String| {
        let name = format!("vehicle {}, {} boxes", left.id, left.kind);
        Finding::of_frame(kind, frame, format!("{name}: {reason}"))
    };
    let rays = [
        rig.left.camera_from_pixel(left.center_pixel),
        rig.right.camera_from_pixel(right.center_pixel),
    ];
    // As if both cameras were the left one.
    let row_px = (rays[0][1] - rays[1][1]).abs() * rig.left.focal_y_px;
    let disparity_px = (rays[0][0] - rays[1][0]) * rig.focal_px();
    let stand_in = is_stand_in(left) || is_stand_in(right);
    // The image's border and what hides a vehicle move the centres of boxes.
    let rows_px = if stand_in {
        CENTER_PX + BOX_CENTER_PART * left.box_pixel.height()
    } else {
        CENTER_PX
    };
    let mut findings = Vec::new();
    if row_px > rows_px {
        let reason = format!("the centres are {row_px:.1} rows apart");
        findings.push(finding(FindingKind::Rows, reason));
    }
    if disparity_px <= 0.0 {
        let reason = format!(
            "the disparity is {disparity_px:.1} px: left and right may be swapped, or the ids wrong"
        );
        findings.push(finding(FindingKind::Disparity, reason));
    } else if let Some(distance_m) = left.distance_m {
        let z_m = depth_m(rig, rays[0], distance_m);
        let expected_px = rig.disparity_px(z_m);
        if !stand_in && (disparity_px - expected_px).abs() > CENTER_PX {
            let reason = format!(
                "the disparity is {disparity_px:.1} px, and {distance_m} m would be \
                 {expected_px:.1} px"
            );
            findings.push(finding(FindingKind::Disparity, reason));
        } else if left.kind == BoxKind::Tight
            && !rig.boxes_agree(&left.box_pixel, &right.box_pixel, z_m)
        {
            let [left_x, right_x] = [left, right].map(|label| label.box_pixel.center()[0]);
            let reason = format!(
                "the boxes' centres are at x = {left_x:.1} and {right_x:.1} px, and {distance_m} m \
                 is a disparity of {expected_px:.1} px"
            );
            findings.push(finding(FindingKind::Disparity, reason));
        }
    }
    findings
}

/// Depth of the point on a ray of the left camera at a distance from the middle of the rig.
fn depth_m(rig: &StereoRig, ray: [f64; 3], distance_m: f64) -> f64 {
    let square: f64 = ray.iter().map(|v| v * v).sum();
    let half_m = rig.baseline_m / 2.0;
    let along = half_m * ray[0];
    let root = along * along - square * (half_m * half_m - distance_m * distance_m);
    (along + libm::sqrt(root.max(0.0))) / square
}

/// A vehicle that the other camera should have, too.
fn missing_partner(rig: &StereoRig, frame: &Frame, label: &Label, side: Side) -> Option<Finding> {
    let distance_m = label.distance_m?;
    if label
        .visible
        .is_some_and(|visible| visible < PARTNER_VISIBLE)
    {
        return None;
    }
    let (other, ray, sign) = match side {
        Side::Left => (
            Side::Right,
            rig.left.camera_from_pixel(label.center_pixel),
            -1.0,
        ),
        Side::Right => (
            Side::Left,
            rig.right.camera_from_pixel(label.center_pixel),
            1.0,
        ),
    };
    let disparity_px = rig.disparity_px(depth_m(rig, ray, distance_m));
    let x =
        rig.camera(other).center_x_px + ray[0] * rig.camera(other).focal_x_px + sign * disparity_px;
    let half = label.box_pixel.width() / 2.0;
    let whole = x - half >= 0.0 && x + half <= f64::from(rig.camera(other).width);
    whole.then(|| {
        let reason = format!(
            "vehicle {} has a {} box in the {side} image alone, and the {other} camera sees it at \
             x = {x:.0} px",
            label.id, label.kind
        );
        Finding::of_frame(FindingKind::Partner, frame, reason)
    })
}

/// What `frames.csv` says against the labels.
fn row_problems(frame: &Frame) -> Vec<Finding> {
    let row = &frame.row;
    let mut findings = Vec::new();
    let mut add = |reason: String| {
        findings.push(Finding::of_frame(FindingKind::Row, frame, reason));
    };
    let labels = || {
        frame
            .images()
            .flat_map(|(_, image): (Side, &FrameImage)| &image.labels)
    };
    if let Some(distance_m) = row.distance_m {
        let mut known = labels().filter_map(|label| label.distance_m).peekable();
        let empty = known.peek().is_none();
        if !empty && !known.any(|known_m| (known_m - distance_m).abs() <= SAME_M) {
            add(format!(
                "frames.csv says {distance_m} m, and no vehicle is there"
            ));
        }
    }
    if let (Some(view), Some(azimuth_deg)) = (row.view, row.azimuth_deg)
        && view_of_azimuth(azimuth_deg) != view
    {
        let seen = view_of_azimuth(azimuth_deg);
        add(format!(
            "frames.csv says {view}, and {azimuth_deg} degrees are {seen}"
        ));
    }
    findings
}
