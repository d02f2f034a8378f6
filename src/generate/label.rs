//! What is written about the vehicles of a frame: their boxes in each image and their poses.

use super::config::GenerateConfig;
use super::settle::Capture;
use crate::dataset::{BoxKind, Label, ObjectRow};
use crate::geometry::{PixelBox, SphereTarget, StereoRig, sphere_box};
use crate::render::{Eye, Silhouette, Stage};
use crate::world::Vehicle;

/// Both boxes of every vehicle that can be seen in one image, by the vehicles' order in the scene.
///
/// A vehicle that is hidden, small or out of the range of distances is ignored; the target's
/// distance is always in range, and the farthest test distance may be beyond the others'.
pub(super) fn labels(
    config: &GenerateConfig,
    stage: &Stage,
    rig: &StereoRig,
    capture: &Capture,
    eye: Eye,
    silhouettes: &[Silhouette],
) -> Vec<Label> {
    let camera = eye.camera(rig);
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let mut labels = Vec::new();
    let vehicles = (0_u32..).zip(&stage.scene().vehicles);
    for ((id, vehicle), silhouette) in vehicles.zip(silhouettes) {
        let Some(tight) = silhouette.tight else {
            continue;
        };
        let [x, y, z] = capture.pose.rig_from_world(vehicle.center_world);
        let center_camera = [x - eye.offset_m(rig), y, z];
        // A vehicle whose middle is behind the camera shows an end at the image's border.
        let center_pixel = camera.pixel_from_camera(center_camera);
        let distance_m = distance_m(capture, id, vehicle);
        let in_range =
            id == 0 || (config.distance_min_m..=config.distance_max_m).contains(&distance_m);
        let ignored = !in_range
            || center_pixel.is_none()
            || silhouette.visible < config.ignore_below_visible
            || tight.width().max(tight.height()) < config.ignore_below_px;
        let sphere = sphere_box(camera, &sphere_target(vehicle, capture, center_camera));
        let is_in_image = |area: &PixelBox| area.clipped(width, height).is_valid();
        let boxes = [
            (BoxKind::Sphere, sphere.filter(is_in_image)),
            (BoxKind::Tight, Some(tight)),
        ];
        labels.extend(boxes.into_iter().filter_map(|(kind, box_pixel)| {
            Some(Label {
                id,
                class: 0,
                box_pixel: box_pixel?,
                center_pixel: center_pixel.unwrap_or_else(|| tight.center()),
                distance_m: Some(distance_m),
                kind,
                visible: Some(silhouette.visible),
                ignored,
            })
        }));
    }
    labels
}

fn sphere_target(vehicle: &Vehicle, capture: &Capture, center_camera: [f64; 3]) -> SphereTarget {
    SphereTarget {
        center_camera,
        forward_camera: capture.pose.rig_direction_from_world(vehicle.forward_world),
        radius_min_m: vehicle.radius_min_m(),
        radius_sphere_m: vehicle.radius_sphere_m(),
    }
}

/// Rig midpoint to the centre of a vehicle; the target's is the planned one to the last digit.
fn distance_m(capture: &Capture, id: u32, vehicle: &Vehicle) -> f64 {
    if id == 0 {
        return capture.distance_m;
    }
    let point = capture.pose.rig_from_world(vehicle.center_world);
    point.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Size, place and heading of every vehicle of a frame's scene.
pub(super) fn objects(stage: &Stage, capture: &Capture) -> Vec<ObjectRow> {
    let pose = &capture.pose;
    (0_u32..)
        .zip(&stage.scene().vehicles)
        .map(|(id, vehicle)| {
            let [length_m, width_m, height_m] = vehicle.size_m;
            let [x_m, y_m, z_m] = pose.rig_from_world(vehicle.center_world);
            let [forward_x, forward_y, forward_z] =
                pose.rig_direction_from_world(vehicle.forward_world);
            // The rig never rolls: its heading is a quarter turn left of its right.
            let [right_x, right_y, _] = pose.right_world;
            let [ahead_x, ahead_y] = [-right_y, right_x];
            let [drives_x, drives_y, _] = vehicle.forward_world;
            let yaw = libm::atan2(
                drives_x * right_x + drives_y * right_y,
                drives_x * ahead_x + drives_y * ahead_y,
            );
            let [out_x, out_y, out_z] =
                [0, 1, 2].map(|i| pose.position_world[i] - vehicle.center_world[i]);
            let azimuth = libm::atan2(
                out_x * drives_y - out_y * drives_x,
                out_x * drives_x + out_y * drives_y,
            );
            let distance_m = distance_m(capture, id, vehicle);
            let elevation = libm::asin((out_z / distance_m).clamp(-1.0, 1.0));
            ObjectRow {
                stamp: capture.row.stamp,
                id,
                style: vehicle.body_name().to_owned(),
                length_m,
                width_m,
                height_m,
                x_m,
                y_m,
                z_m,
                forward_x,
                forward_y,
                forward_z,
                yaw_deg: yaw.to_degrees(),
                azimuth_deg: azimuth.to_degrees(),
                elevation_deg: elevation.to_degrees(),
                distance_m,
            }
        })
        .collect()
}
