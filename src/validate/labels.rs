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

/// Of vehicles that are hidden more, boxes say little: they may be a strip at either end, and one
/// camera may see nothing at all.
const JUDGED_VISIBLE: f64 = 0.5;

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

/// How many vehicles of a stereo dataset nobody knows the distance of, where there are any.
pub(super) fn without_distance(dataset: &StereoDataset) -> Option<String> {
    let images = dataset.frames.iter().flat_map(Frame::images);
    let judged: Vec<&Label> = images
        .flat_map(|(_, image)| &image.labels)
        .filter(|label| !label.ignored)
        .collect();
    let is_unknown = |label: &&&Label| label.distance_m.is_none();
    let unknown = judged.iter().filter(is_unknown).count();
    (dataset.info.stereo && unknown > 0).then(|| {
        format!(
            "{unknown} of {} labels have no distance (`-`): the detector learns from them, the \
             distance network does not",
            judged.len()
        )
    })
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
            findings.extend(box_problem(label, camera).map(|reason| {
                Finding::of_frame(FindingKind::Label, frame, format!("{name}: {reason}"))
            }));
        }
    }
    if let Some(right) = &frame.right {
        for left in frame.left.labels.iter().filter(|label| !label.ignored) {
            let alike = |label: &&Label| label.id == left.id && label.kind == left.kind;
            if let Some(right) = right.labels.iter().find(alike) {
                findings.extend(pair_problems(dataset.rig(), frame, left, right));
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
            && !is_unjudged(left)
            && !is_unjudged(right)
            && !rig.boxes_agree(
                &left.box_pixel,
                &right.box_pixel,
                z_m,
                hidden_slack_px(left, right),
            )
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

/// Whether so little is seen of a vehicle, or so little asked of it, that its box says nothing.
pub(super) fn is_unjudged(label: &Label) -> bool {
    let is_hidden = |visible: f64| visible < JUDGED_VISIBLE;
    label.ignored || label.visible.is_some_and(is_hidden)
}

/// How far apart what hides parts of a vehicle may move the centres of its two boxes, pixels: by
/// half of the hidden width each. What is hidden may be a low end of the vehicle, and so is up to
/// twice as wide as its share of the silhouette says.
fn hidden_slack_px(left: &Label, right: &Label) -> f64 {
    let visible = |label: &Label| label.visible.unwrap_or(1.0);
    let whole_px = [left, right]
        .map(|label| label.box_pixel.width() / visible(label).max(JUDGED_VISIBLE))
        .into_iter()
        .fold(0.0, f64::max);
    (2.0 - visible(left) - visible(right)) * whole_px
}

/// Depth of the point on a ray of the left camera at a distance from the middle of the rig.
pub(super) fn depth_m(rig: &StereoRig, ray: [f64; 3], distance_m: f64) -> f64 {
    let square: f64 = ray.iter().map(|v| v * v).sum();
    let half_m = rig.baseline_m / 2.0;
    let along = half_m * ray[0];
    let root = along * along - square * (half_m * half_m - distance_m * distance_m);
    (along + libm::sqrt(root.max(0.0))) / square
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
