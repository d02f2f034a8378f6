//! Where the vehicle is in an image, and how much of it can be seen.

use super::pose::{Eye, RigPose};
use super::trace::Stage;
use crate::geometry::{PixelBox, StereoRig};

/// Samples along a pixel's side: edges are good to a quarter of a pixel.
const SAMPLES_PER_SIDE: u32 = 4;
/// What hides a sample must be nearer than the vehicle by this much, metres.
const TOUCH_M: f32 = 2e-3;

/// The vehicle's silhouette in one image, sampled on a regular grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Silhouette {
    /// The box around everything of the vehicle that can be seen in the image: outer edges of the
    /// samples, so exact to one sample. None when nothing can be seen.
    pub tight: Option<PixelBox>,
    /// Part of the whole silhouette that is inside the image and not hidden, 0 to 1.
    pub visible: f64,
}

/// A grid of sample cells in the image.
struct Grid {
    origin: [f64; 2],
    step: [f64; 2],
    count: [u32; 2],
}

impl Silhouette {
    /// The exact silhouette, sixteen samples a pixel. A vehicle behind or inside the camera is not
    /// visible.
    pub fn measure(stage: &Stage, rig: &StereoRig, pose: &RigPose, eye: Eye) -> Self {
        let Some(area) = vehicle_rectangle(stage, rig, pose, eye) else {
            return Self::NONE;
        };
        let step = 1.0 / f64::from(SAMPLES_PER_SIDE);
        let origin = [area.x_min.floor(), area.y_min.floor()];
        let count = [(area.x_max, origin[0]), (area.y_max, origin[1])]
            .map(|(max, min)| (max.ceil() - min) as u32 * SAMPLES_PER_SIDE);
        Self::on_grid(
            stage,
            rig,
            pose,
            eye,
            &Grid {
                origin,
                step: [step; 2],
                count,
            },
        )
    }

    /// A quick look with the same number of samples however large the vehicle is in the image: good
    /// to some hundredths for the visible part, and too coarse for boxes.
    pub(crate) fn estimate_visible(
        stage: &Stage,
        rig: &StereoRig,
        pose: &RigPose,
        eye: Eye,
    ) -> f64 {
        const SAMPLES: u32 = 28;
        let Some(area) = vehicle_rectangle(stage, rig, pose, eye) else {
            return 0.0;
        };
        let step = [area.width(), area.height()].map(|length| length / f64::from(SAMPLES));
        let grid = Grid {
            origin: [area.x_min, area.y_min],
            step,
            count: [SAMPLES; 2],
        };
        Self::on_grid(stage, rig, pose, eye, &grid).visible
    }

    const NONE: Self = Self {
        tight: None,
        visible: 0.0,
    };

    fn on_grid(stage: &Stage, rig: &StereoRig, pose: &RigPose, eye: Eye, grid: &Grid) -> Self {
        let camera = eye.camera(rig);
        let origin = pose.eye_world(rig, eye);
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        let (mut whole, mut seen) = (0_u64, 0_u64);
        let mut tight: Option<PixelBox> = None;
        for row in 0..grid.count[1] {
            for column in 0..grid.count[0] {
                let x = grid.origin[0] + f64::from(column) * grid.step[0];
                let y = grid.origin[1] + f64::from(row) * grid.step[1];
                let [middle_x, middle_y] = [x + grid.step[0] * 0.5, y + grid.step[1] * 0.5];
                let direction = pose.world_from_pixel(camera, [middle_x, middle_y]);
                let Some(t) = stage.vehicle_distance(origin, direction) else {
                    continue;
                };
                whole += 1;
                let inside =
                    middle_x > 0.0 && middle_x < width && middle_y > 0.0 && middle_y < height;
                if !inside || !stage.is_free_of_city(origin, direction, t - TOUCH_M) {
                    continue;
                }
                seen += 1;
                let cell = PixelBox::new(x, y, x + grid.step[0], y + grid.step[1]);
                tight = Some(tight.map_or(cell, |b| {
                    PixelBox::new(
                        b.x_min.min(cell.x_min),
                        b.y_min.min(cell.y_min),
                        b.x_max.max(cell.x_max),
                        b.y_max.max(cell.y_max),
                    )
                }));
            }
        }
        let visible = if whole == 0 {
            0.0
        } else {
            seen as f64 / whole as f64
        };
        Self { tight, visible }
    }
}

/// The rectangle of the image plane that holds the vehicle, not clipped to the image. None when a
/// part of the vehicle is not in front of the camera.
pub(crate) fn vehicle_rectangle(
    stage: &Stage,
    rig: &StereoRig,
    pose: &RigPose,
    eye: Eye,
) -> Option<PixelBox> {
    let camera = eye.camera(rig);
    let offset = eye.offset_m(rig);
    let mut area = PixelBox::new(
        f64::INFINITY,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::NEG_INFINITY,
    );
    for corner in stage.vehicle_corners() {
        let [x, y, z] = pose.rig_from_world(corner.to_array().map(f64::from));
        // Closer than this the projection would blow up.
        let pixel = if z > 0.2 {
            camera.pixel_from_camera([x - offset, y, z])
        } else {
            None
        };
        let [px, py] = pixel?;
        area = PixelBox::new(
            area.x_min.min(px),
            area.y_min.min(py),
            area.x_max.max(px),
            area.y_max.max(py),
        );
    }
    Some(area)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::{Scene, Wardrobe};

    fn above(width: u32) -> (Stage, StereoRig, RigPose) {
        let stage = Stage::new(Scene::draw(11, 3, 60.0, Wardrobe::ALL));
        let rig = StereoRig::from_hfov(width, width * 9 / 16, 90.0, 0.8).unwrap();
        let [x, y, z] = stage.scene().vehicle.center_world;
        // From high above nothing can hide the vehicle.
        let pose = RigPose::aimed([x + 4.0, y + 3.0, z + 17.0], [x, y, z], [0.1, -0.05]).unwrap();
        (stage, rig, pose)
    }

    #[test]
    fn the_tight_box_is_within_half_a_pixel_of_the_projected_corners() {
        let (stage, rig, pose) = above(640);
        for eye in Eye::BOTH {
            let silhouette = Silhouette::measure(&stage, &rig, &pose, eye);
            let [tight, corners] = [
                silhouette.tight,
                vehicle_rectangle(&stage, &rig, &pose, eye),
            ]
            .map(Option::unwrap);
            for (a, b) in [
                (tight.x_min, corners.x_min),
                (tight.y_min, corners.y_min),
                (tight.x_max, corners.x_max),
                (tight.y_max, corners.y_max),
            ] {
                assert!((a - b).abs() <= 0.5, "{tight:?} {corners:?}");
            }
            assert!((silhouette.visible - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn every_point_of_the_vehicle_lands_within_half_a_pixel_of_the_silhouette() {
        let (stage, rig, pose) = above(640);
        let origin = pose.eye_world(&rig, Eye::Left);
        let offset = Eye::Left.offset_m(&rig);
        for corner in stage.vehicle_corners() {
            let [x, y, z] = pose.rig_from_world(corner.to_array().map(f64::from));
            let [px, py] = rig.left.pixel_from_camera([x - offset, y, z]).unwrap();
            // A corner on the outline may be missed by its own ray, but not by all those around it.
            let around = [[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]];
            let lands = around.iter().any(|[dx, dy]| {
                let direction = pose.world_from_pixel(&rig.left, [px + dx, py + dy]);
                stage.vehicle_distance(origin, direction).is_some()
            });
            assert!(lands, "{corner}");
        }
    }

    #[test]
    fn the_tight_box_is_the_bounds_of_the_samples_that_hit_the_vehicle_first() {
        let (stage, rig, pose) = above(128);
        let silhouette = Silhouette::measure(&stage, &rig, &pose, Eye::Right);
        let origin = pose.eye_world(&rig, Eye::Right);
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for row in 0..72 * 4 {
            for column in 0..128 * 4 {
                let middle = [column, row].map(|i| (f64::from(i) + 0.5) / 4.0);
                let direction = pose.world_from_pixel(&rig.right, middle);
                let hit = stage.nearest(origin, direction);
                if hit.is_some_and(|h| h.object == super::super::trace::Object::Vehicle) {
                    for i in 0..2 {
                        low[i] = low[i].min(middle[i] - 0.125);
                        high[i] = high[i].max(middle[i] + 0.125);
                    }
                }
            }
        }
        let tight = silhouette.tight.unwrap();
        assert_eq!(tight, PixelBox::new(low[0], low[1], high[0], high[1]));
    }
}
