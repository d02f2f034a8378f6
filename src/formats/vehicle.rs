//! Labels of a vehicle whose box in space is known.

use super::draft::DraftFrame;
use crate::dataset::{BoxKind, Label, ObjectRow, Side};
use crate::generate::view_of_azimuth;
use crate::geometry::{Cuboid, PixelBox, StereoRig, sphere_box};

/// How near to the image's border an edge has to be to be cut off by it, pixels.
const BORDER_PX: f64 = 2.0;

/// Given right boxes may differ by this from those of the geometry, pixels, and in addition by
/// [`GIVEN_SLACK_PART`].
const GIVEN_SLACK_PX: f64 = 2.0;

/// Part of the box's width: what is hidden in one image may not be in the other.
const GIVEN_SLACK_PART: f64 = 0.06;

/// What a foreign label says of a vehicle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sighting {
    /// The vehicle's number.
    pub id: u32,
    /// Our class.
    pub class: u32,
    /// Neither learnt nor judged.
    pub ignored: bool,
    /// Visible fraction in the left and the right image.
    pub visible: [Option<f64>; 2],
    /// Its box in the left and the right image, pixels of our convention; a missing right one is
    /// worked out.
    pub boxes: [Option<PixelBox>; 2],
}

/// The labels of a vehicle in both images, of both kinds. `cuboid_rig` is its box in space, in rig
/// axes.
///
/// A box that the source does not give is its box in the other image, moved edge by edge as the
/// projected box in space moves: it keeps the style of the labels, and its disparity is that of
/// the geometry. An edge at the image's border hides where the vehicle ends; there the projection
/// alone decides. A right box whose disparity is not that of the box in space counts as not given:
/// copies of KITTI with wrong ones are about.
pub(super) fn labels(rig: &StereoRig, cuboid_rig: &Cuboid, sighting: &Sighting) -> [Vec<Label>; 2] {
    let half_m = rig.baseline_m / 2.0;
    let seen = [half_m, -half_m].map(|offset_m| cuboid_rig.moved([offset_m, 0.0, 0.0]));
    let projected = [seen[0].projected(&rig.left), seen[1].projected(&rig.right)];
    let distance_m = cuboid_rig.distance_m();
    let sizes = Side::ALL.map(|side| {
        let camera = rig.camera(side);
        [f64::from(camera.width), f64::from(camera.height)]
    });
    // The box of one image as the other image's and the geometry say it.
    let derived = |i: usize| {
        let known = sighting.boxes[1 - i];
        match (known, projected[1 - i], projected[i]) {
            (Some(known), Some(from), Some(to)) => Some(moved(&known, &from, &to, sizes[i])),
            _ => projected[i],
        }
    };
    let possible = |given: &PixelBox| {
        derived(1).is_none_or(|derived| {
            let slack_px = GIVEN_SLACK_PX + GIVEN_SLACK_PART * derived.width();
            let derived = derived.clipped(sizes[1][0], sizes[1][1]);
            let apart = [given.x_min - derived.x_min, given.x_max - derived.x_max];
            apart.iter().all(|apart| apart.abs() <= slack_px)
        })
    };
    let boxes = [
        sighting.boxes[0],
        sighting.boxes[1].filter(|right| sighting.boxes[0].is_none() || possible(right)),
    ];
    [0, 1].map(|i| {
        let side = Side::ALL[i];
        let camera = rig.camera(side);
        let size = sizes[i];
        let tight = boxes[i].or_else(|| derived(i));
        let Some(center_pixel) = camera.pixel_from_camera(seen[i].center_camera) else {
            return Vec::new();
        };
        let tight = tight.map(|area| area.clipped(size[0], size[1]));
        let sphere = sphere_box(camera, &seen[i].sphere_target());
        let in_image = |area: &PixelBox| area.clipped(size[0], size[1]).is_valid();
        [(BoxKind::Sphere, sphere), (BoxKind::Tight, tight)]
            .into_iter()
            .filter_map(|(kind, area)| {
                // A vehicle without a box that can be seen is not in the image.
                let box_pixel = area
                    .filter(in_image)
                    .filter(|_| tight.is_some_and(|t| in_image(&t)))?;
                Some(Label {
                    id: sighting.id,
                    class: sighting.class,
                    box_pixel,
                    center_pixel,
                    distance_m: Some(distance_m),
                    kind,
                    visible: sighting.visible[i],
                    ignored: sighting.ignored,
                })
            })
            .collect()
    })
}

/// A box in one image from the box in the other, edge by edge.
fn moved(known: &PixelBox, from: &PixelBox, to: &PixelBox, size: [f64; 2]) -> PixelBox {
    let edge = |known: f64, from: f64, to: f64, size: f64| {
        let cut_off = known < BORDER_PX || known > size - BORDER_PX;
        if cut_off { to } else { known + to - from }
    };
    PixelBox::new(
        edge(known.x_min, from.x_min, to.x_min, size[0]),
        edge(known.y_min, from.y_min, to.y_min, size[1]),
        edge(known.x_max, from.x_max, to.x_max, size[0]),
        edge(known.y_max, from.y_max, to.y_max, size[1]),
    )
}

/// What `objects.csv` says of a vehicle; `stamp` is filled in when the frame has one.
pub(super) fn object_row(id: u32, style: &str, cuboid_rig: &Cuboid) -> ObjectRow {
    let [x_m, y_m, z_m] = cuboid_rig.center_camera;
    let [forward_x, forward_y, forward_z] = cuboid_rig.forward_camera();
    // KITTI counts from a vehicle that drives to the right, this crate from one that leaves.
    let yaw_deg = cuboid_rig.yaw_rad.to_degrees() + 90.0;
    ObjectRow {
        stamp: 0,
        id,
        style: style.to_owned(),
        length_m: cuboid_rig.length_m,
        width_m: cuboid_rig.width_m,
        height_m: cuboid_rig.height_m,
        x_m,
        y_m,
        z_m,
        forward_x,
        forward_y,
        forward_z,
        yaw_deg: yaw_deg - 360.0 * ((yaw_deg + 180.0) / 360.0).floor(),
        azimuth_deg: cuboid_rig.azimuth_deg(),
        elevation_deg: cuboid_rig.elevation_deg(),
        distance_m: cuboid_rig.distance_m(),
    }
}

/// Fills in what `frames.csv` says of a frame with a single vehicle. With several, no one of them
/// is the frame's.
pub(super) fn describe(frame: &mut DraftFrame, vehicles: &[Cuboid]) {
    let [vehicle] = vehicles else {
        return;
    };
    let azimuth_deg = vehicle.azimuth_deg();
    frame.row.view = Some(view_of_azimuth(azimuth_deg));
    frame.row.azimuth_deg = Some(azimuth_deg);
    frame.row.elevation_deg = Some(vehicle.elevation_deg());
    frame.row.distance_m = Some(vehicle.distance_m());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn disparities_of_labels_obey_the_law_and_a_cut_off_edge_follows_the_projection() {
        let rig = StereoRig::from_hfov(1000, 400, 90.0, 0.5).unwrap();
        let cuboid = Cuboid {
            center_camera: [2.0, 1.0, 20.0],
            length_m: 4.0,
            width_m: 1.6,
            height_m: 1.5,
            yaw_rad: 0.4,
        };
        let left = cuboid.moved([0.25, 0.0, 0.0]).projected(&rig.left).unwrap();
        let sighting = Sighting {
            id: 3,
            class: 0,
            ignored: false,
            visible: [Some(1.0), None],
            boxes: [Some(left), None],
        };
        let [left, right] = labels(&rig, &cuboid, &sighting);
        assert_eq!((left.len(), right.len()), (2, 2));
        for (left, right) in left.iter().zip(&right) {
            let disparity = left.center_pixel[0] - right.center_pixel[0];
            assert!((disparity - 500.0 * 0.5 / 20.0).abs() < 1e-9);
            assert!((left.center_pixel[1] - right.center_pixel[1]).abs() < 1e-9);
            assert!((left.distance_m.unwrap() - 405.0_f64.sqrt()).abs() < 1e-9);
        }
        let cut = PixelBox::new(990.0, 10.0, 1000.0, 20.0);
        let (from, to) = (
            PixelBox::new(991.0, 10.0, 1100.0, 20.0),
            PixelBox::new(961.0, 10.0, 980.0, 20.0),
        );
        assert_eq!(
            moved(&cut, &from, &to, [1000.0, 400.0]),
            PixelBox::new(960.0, 10.0, 980.0, 20.0)
        );
    }
}
