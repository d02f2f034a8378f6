//! Where a vehicle is in an image, and how much of it can be seen.

use super::pose::{Eye, RigPose};
use super::trace::Stage;
use crate::geometry::{Camera, PixelBox, StereoRig};

/// Samples along a pixel's side: edges are good to a quarter of a pixel.
const SAMPLES_PER_SIDE: u32 = 4;
/// Vehicles that fill more pixels than this are sampled more thinly.
const LARGE_PX: f64 = 250_000.0;
/// What hides a sample must be nearer than the vehicle by this much, metres.
const TOUCH_M: f32 = 2e-3;
/// What is closer to the camera's plane than this is cut off, metres: the projection blows up.
const NEAR_M: f64 = 0.2;
/// A silhouette is followed outside the image by this part of the image's size.
const BORDER: f64 = 0.5;

/// One vehicle's silhouette in one image, sampled on a regular grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Silhouette {
    /// The box around everything of the vehicle that can be seen in the image: outer edges of the
    /// samples, so exact to one sample. None when nothing can be seen.
    pub tight: Option<PixelBox>,
    /// Part of the whole silhouette that is inside the image and hidden neither by the city nor by
    /// another vehicle, 0 to 1. Further outside the image than half its size nothing is counted.
    pub visible: f64,
}

/// A grid of sample cells in the image.
struct Grid {
    origin: [f64; 2],
    step: [f64; 2],
    count: [u32; 2],
}

/// A vehicle, by its index in the scene, before one camera.
#[derive(Clone, Copy)]
struct Sight<'a> {
    stage: &'a Stage,
    vehicle: usize,
    rig: &'a StereoRig,
    pose: &'a RigPose,
    eye: Eye,
}

impl Silhouette {
    /// The exact silhouette of a vehicle, by its index in the scene: sixteen samples a pixel, and
    /// four or one for a vehicle of more than 250,000 or a million pixels.
    pub fn measure(
        stage: &Stage,
        vehicle: usize,
        rig: &StereoRig,
        pose: &RigPose,
        eye: Eye,
    ) -> Self {
        let Some(area) = vehicle_rectangle(stage, vehicle, rig, pose, eye) else {
            return Self::NONE;
        };
        let per_side = if area.area() <= LARGE_PX {
            SAMPLES_PER_SIDE
        } else if area.area() <= 4.0 * LARGE_PX {
            SAMPLES_PER_SIDE / 2
        } else {
            1
        };
        let origin = [area.x_min.floor(), area.y_min.floor()];
        let count = [(area.x_max, origin[0]), (area.y_max, origin[1])]
            .map(|(max, min)| (max.ceil() - min) as u32 * per_side);
        let sight = Sight {
            stage,
            vehicle,
            rig,
            pose,
            eye,
        };
        sight.on_grid(&Grid {
            origin,
            step: [1.0 / f64::from(per_side); 2],
            count,
        })
    }

    /// A quick look with the same number of samples however large the vehicle is in the image: good
    /// to some hundredths for the visible part, and too coarse for boxes.
    pub(crate) fn estimate_visible(
        stage: &Stage,
        vehicle: usize,
        rig: &StereoRig,
        pose: &RigPose,
        eye: Eye,
    ) -> f64 {
        const SAMPLES: u32 = 28;
        let Some(area) = vehicle_rectangle(stage, vehicle, rig, pose, eye) else {
            return 0.0;
        };
        let step = [area.width(), area.height()].map(|length| length / f64::from(SAMPLES));
        let sight = Sight {
            stage,
            vehicle,
            rig,
            pose,
            eye,
        };
        let grid = Grid {
            origin: [area.x_min, area.y_min],
            step,
            count: [SAMPLES; 2],
        };
        sight.on_grid(&grid).visible
    }

    const NONE: Self = Self {
        tight: None,
        visible: 0.0,
    };
}

impl Sight<'_> {
    fn on_grid(&self, grid: &Grid) -> Silhouette {
        let camera = self.eye.camera(self.rig);
        let origin = self.pose.eye_world(self.rig, self.eye);
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        let (mut whole, mut seen) = (0_u64, 0_u64);
        let mut tight: Option<PixelBox> = None;
        for row in 0..grid.count[1] {
            for column in 0..grid.count[0] {
                let x = grid.origin[0] + f64::from(column) * grid.step[0];
                let y = grid.origin[1] + f64::from(row) * grid.step[1];
                let [middle_x, middle_y] = [x + grid.step[0] * 0.5, y + grid.step[1] * 0.5];
                let direction = self.pose.world_from_pixel(camera, [middle_x, middle_y]);
                let Some(t) = self.stage.vehicle_distance(self.vehicle, origin, direction) else {
                    continue;
                };
                whole += 1;
                let inside =
                    middle_x > 0.0 && middle_x < width && middle_y > 0.0 && middle_y < height;
                if !inside || !self.stage.is_free_until(origin, direction, t - TOUCH_M) {
                    continue;
                }
                seen += 1;
                let cell = PixelBox::new(x, y, x + grid.step[0], y + grid.step[1]);
                tight = Some(tight.map_or(cell, |b| b.around(&cell)));
            }
        }
        let visible = if whole == 0 {
            0.0
        } else {
            seen as f64 / whole as f64
        };
        Silhouette { tight, visible }
    }
}

/// The rectangle of the image plane that holds a vehicle, by its index in the scene; it reaches
/// outside the image by no more than [`BORDER`]. None when nothing of it can be in the image.
pub(crate) fn vehicle_rectangle(
    stage: &Stage,
    vehicle: usize,
    rig: &StereoRig,
    pose: &RigPose,
    eye: Eye,
) -> Option<PixelBox> {
    let camera = eye.camera(rig);
    let offset = eye.offset_m(rig);
    let mut area: Option<PixelBox> = None;
    let mut add = |point: [f64; 3]| {
        if let Some([x, y]) = camera.pixel_from_camera(point) {
            let point = PixelBox::new(x, y, x, y);
            area = Some(area.map_or(point, |b| b.around(&point)));
        }
    };
    for triangle in stage.vehicle_triangles(vehicle) {
        let corners = triangle.vertices.map(|corner| {
            let [x, y, z] = pose.rig_from_world(corner.to_array().map(f64::from));
            [x - offset, y, z]
        });
        for (index, corner) in corners.into_iter().enumerate() {
            if corner[2] >= NEAR_M {
                add(corner);
            }
            // Where the edge crosses the near plane.
            let next = corners[(index + 1) % 3];
            if (corner[2] < NEAR_M) != (next[2] < NEAR_M) {
                let part = (NEAR_M - corner[2]) / (next[2] - corner[2]);
                let crossing = [0, 1].map(|i| corner[i] + part * (next[i] - corner[i]));
                add([crossing[0], crossing[1], NEAR_M]);
            }
        }
    }
    area.and_then(|area| near_image(&area, camera))
}

/// The part of a rectangle that is not further from the image than its border; None when it does
/// not touch the image.
fn near_image(area: &PixelBox, camera: &Camera) -> Option<PixelBox> {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let touches = area.x_max > 0.0 && area.x_min < width && area.y_max > 0.0 && area.y_min < height;
    touches.then(|| {
        PixelBox::new(
            area.x_min.max(-BORDER * width),
            area.y_min.max(-BORDER * height),
            area.x_max.min((1.0 + BORDER) * width),
            area.y_max.min((1.0 + BORDER) * height),
        )
    })
}

#[cfg(test)]
mod tests {
    use glam::Vec3A;

    use super::*;
    use crate::render::trace::Object;
    use crate::world::Scene;

    fn above(width: u32) -> (Stage, StereoRig, RigPose) {
        let stage = Stage::new(Scene::draw(11, 3, 60.0));
        let rig = StereoRig::from_hfov(width, width * 9 / 16, 90.0, 0.8).unwrap();
        let [x, y, z] = stage.scene().target().center_world;
        // From high above nothing can hide the vehicle.
        let pose = RigPose::aimed([x + 4.0, y + 3.0, z + 17.0], [x, y, z], [0.1, -0.05]).unwrap();
        (stage, rig, pose)
    }

    /// Several vehicles seen low along the road, so that they hide one another.
    fn queue(number: u32) -> (Stage, StereoRig, RigPose) {
        let stage = Stage::new(Scene::draw_with_traffic(11, number, 60.0, 8, 20.0));
        let rig = StereoRig::from_hfov(192, 108, 90.0, 0.8).unwrap();
        let [x, y, z] = stage.scene().target().center_world;
        let pose = RigPose::aimed([x + 3.0, y - 16.0, z + 3.5], [x, y, z], [0.1, -0.05]).unwrap();
        (stage, rig, pose)
    }

    fn corners(stage: &Stage) -> impl Iterator<Item = Vec3A> {
        stage.vehicle_triangles(0).iter().flat_map(|t| t.vertices)
    }

    #[test]
    fn the_tight_box_is_within_half_a_pixel_of_the_projected_corners() {
        let (stage, rig, pose) = above(640);
        for eye in Eye::BOTH {
            let silhouette = Silhouette::measure(&stage, 0, &rig, &pose, eye);
            let [tight, corners] = [
                silhouette.tight,
                vehicle_rectangle(&stage, 0, &rig, &pose, eye),
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
        for corner in corners(&stage) {
            let [x, y, z] = pose.rig_from_world(corner.to_array().map(f64::from));
            let [px, py] = rig.left.pixel_from_camera([x - offset, y, z]).unwrap();
            // A corner on the outline may be missed by its own ray, but not by all those around it.
            let around = [[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]];
            let lands = around.iter().any(|[dx, dy]| {
                let direction = pose.world_from_pixel(&rig.left, [px + dx, py + dy]);
                stage.vehicle_distance(0, origin, direction).is_some()
            });
            assert!(lands, "{corner}");
        }
    }

    /// Which vehicle each of sixteen samples a pixel meets first.
    fn first_hits(stage: &Stage, rig: &StereoRig, pose: &RigPose, eye: Eye) -> Vec<Option<u16>> {
        let camera = eye.camera(rig);
        let origin = pose.eye_world(rig, eye);
        let mut hits = Vec::new();
        for row in 0..camera.height * 4 {
            for column in 0..camera.width * 4 {
                let middle = [column, row].map(|i| (f64::from(i) + 0.5) / 4.0);
                let direction = pose.world_from_pixel(camera, middle);
                hits.push(
                    stage
                        .nearest(origin, direction)
                        .and_then(|hit| match hit.object {
                            Object::Vehicle(index) => Some(index),
                            Object::Ground | Object::City => None,
                        }),
                );
            }
        }
        hits
    }

    #[test]
    fn each_tight_box_is_the_bounds_of_the_samples_that_hit_its_vehicle_first() {
        let mut hidden = 0;
        let views = (0..6).flat_map(|number| {
            let (stage, rig, pose) = queue(number);
            let views = Eye::BOTH.map(|eye| {
                let hits = first_hits(&stage, &rig, &pose, eye);
                let silhouettes: Vec<Silhouette> = (0..stage.scene().vehicles.len())
                    .map(|vehicle| Silhouette::measure(&stage, vehicle, &rig, &pose, eye))
                    .collect();
                (hits, silhouettes, rig.left.width as usize * 4)
            });
            views.into_iter()
        });
        for (hits, silhouettes, columns) in views {
            for (vehicle, silhouette) in (0_u16..).zip(silhouettes) {
                let own: Vec<usize> = (0..hits.len())
                    .filter(|&i| hits[i] == Some(vehicle))
                    .collect();
                let bounds = |value: &dyn Fn(usize) -> usize| {
                    let values: Vec<usize> = own.iter().map(|&i| value(i)).collect();
                    let [low, high] = [values.iter().min(), values.iter().max()];
                    low.zip(high)
                        .map(|(low, high)| [*low as f64 / 4.0, (*high as f64 + 1.0) / 4.0])
                };
                let [x, y] = [bounds(&|i| i % columns), bounds(&|i| i / columns)];
                let expected = x.zip(y).map(|(x, y)| PixelBox::new(x[0], y[0], x[1], y[1]));
                assert_eq!(silhouette.tight, expected, "vehicle {vehicle}");
                assert_eq!(silhouette.visible > 0.0, expected.is_some());
                hidden += u32::from((0.05..0.95).contains(&silhouette.visible));
            }
        }
        assert!(hidden >= 5, "only {hidden} vehicles are partly hidden");
    }

    #[test]
    fn a_vehicle_beside_the_camera_is_cut_at_its_plane_and_one_behind_it_is_not_there() {
        let stage = Stage::new(Scene::draw(11, 3, 60.0));
        let rig = StereoRig::from_hfov(128, 72, 90.0, 0.8).unwrap();
        let vehicle = stage.scene().target();
        let [x, y, z] = vehicle.center_world;
        let [forward_x, forward_y, _] = vehicle.forward_world;
        let pose_at = |ahead: f64, right: f64, turn: f64| RigPose {
            position_world: [
                x + ahead * forward_x + right * forward_y,
                y + ahead * forward_y - right * forward_x,
                z,
            ],
            right_world: [turn * forward_y, -turn * forward_x, 0.0],
            down_world: [0.0, 0.0, -1.0],
            forward_world: [turn * forward_x, turn * forward_y, 0.0],
        };
        // Level with its middle, 1.5 m to the right, looking along it: the front half is in view.
        let beside = Silhouette::measure(&stage, 0, &rig, &pose_at(0.0, 1.6, 1.0), Eye::Right);
        let tight = beside.tight.unwrap();
        assert!(tight.x_min == 0.0 && tight.x_max < 64.0, "{tight:?}");
        assert!(beside.visible > 0.05 && beside.visible < 0.9, "{beside:?}");
        let ahead = Silhouette::measure(&stage, 0, &rig, &pose_at(8.0, 0.0, 1.0), Eye::Left);
        assert_eq!(ahead, Silhouette::NONE);
    }
}
