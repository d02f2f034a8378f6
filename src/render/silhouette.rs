//! Where a vehicle is in an image, and how much of it can be seen.

use glam::Vec3A;

use super::pose::{Eye, RigPose};
use super::screen::{MayHide, Screens};
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
    /// Cells along the side of a pixel, or 1 where cells and pixels have nothing in common.
    block: u32,
}

impl Grid {
    /// The middle of a cell, pixels.
    fn middle(&self, cell: [u32; 2]) -> [f64; 2] {
        [0, 1].map(|i| self.origin[i] + (f64::from(cell[i]) + 0.5) * self.step[i])
    }

    /// The box of some cells in a square, from its first one.
    fn cells(&self, first: [u32; 2], side: u32) -> PixelBox {
        let [low, high] = [0, side]
            .map(|more| [0, 1].map(|i| self.origin[i] + f64::from(first[i] + more) * self.step[i]));
        PixelBox::new(low[0], low[1], high[0], high[1])
    }

    /// The cells of a block, row by row.
    fn samples(&self, [column, row]: [u32; 2]) -> impl Iterator<Item = [u32; 2]> + use<> {
        let block = self.block;
        (row..row + block).flat_map(move |y| (column..column + block).map(move |x| [x, y]))
    }
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
        let screens = Screens::new(stage, rig, pose, eye);
        Self::measure_samples(&screens, stage, vehicle, rig, pose, eye, &mut |_, _| {})
    }

    /// [`Silhouette::measure`] that hands out every sample that sees the vehicle: its pixel and the
    /// part of the pixel that it stands for, sixteenths.
    pub(super) fn measure_samples(
        screens: &Screens,
        stage: &Stage,
        vehicle: usize,
        rig: &StereoRig,
        pose: &RigPose,
        eye: Eye,
        seen: &mut dyn FnMut([u32; 2], u8),
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
        let grid = Grid {
            origin,
            step: [1.0 / f64::from(per_side); 2],
            count,
            block: per_side,
        };
        let sixteenths = (16 / (per_side * per_side)) as u8;
        let hidden = screens.before(vehicle, &area, sight.furthest_m(), eye.camera(rig));
        sight.on_grid(&grid, Some(&hidden), &mut |pixel| seen(pixel, sixteenths))
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
            block: 1,
        };
        sight.on_grid(&grid, None, &mut |_| {}).visible
    }

    const NONE: Self = Self {
        tight: None,
        visible: 0.0,
    };
}

impl Sight<'_> {
    /// Depth of the vehicle's furthest point, metres.
    fn furthest_m(&self) -> f32 {
        let [x, y, z] = self.pose.forward_world;
        let position = self.pose.position_world;
        let corners = self.stage.vehicle_triangles(self.vehicle).iter();
        let depths = corners.flat_map(|t| t.vertices).map(|corner| {
            let [dx, dy, dz] = [0, 1, 2].map(|i| f64::from(corner[i]) - position[i]);
            (x * dx + y * dy + z * dz) as f32
        });
        depths.fold(0.0, f32::max) + 0.01
    }

    /// `hidden` knows in which pixels nothing can hide the vehicle.
    fn on_grid(
        &self,
        grid: &Grid,
        hidden: Option<&MayHide>,
        on_seen: &mut dyn FnMut([u32; 2]),
    ) -> Silhouette {
        let camera = self.eye.camera(self.rig);
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        let is_inside = |[x, y]: [f64; 2]| x > 0.0 && x < width && y > 0.0 && y < height;
        let (mut whole, mut seen) = (0_u64, 0_u64);
        let mut tight: Option<PixelBox> = None;
        let mut see = |cells: PixelBox, samples: u32, pixel: [u32; 2]| {
            seen += u64::from(samples);
            (0..samples).for_each(|_| on_seen(pixel));
            tight = Some(tight.map_or(cells, |b| b.around(&cells)));
        };
        for first_row in (0..grid.count[1]).step_by(grid.block as usize) {
            for first_column in (0..grid.count[0]).step_by(grid.block as usize) {
                let block = [first_column, first_row];
                let middle = grid.middle(block);
                let pixel = middle.map(|v| v as u32);
                let is_open = hidden.is_some_and(|hidden| !hidden.at(pixel));
                if grid.block > 2 && is_open && is_inside(middle) && self.fills(grid, block) {
                    let samples = grid.block * grid.block;
                    whole += u64::from(samples);
                    see(grid.cells(block, grid.block), samples, pixel);
                    continue;
                }
                for sample in grid.samples(block) {
                    let middle = grid.middle(sample);
                    let Some((ray, t)) = self.hit(middle) else {
                        continue;
                    };
                    whole += 1;
                    let is_free = || {
                        let [origin, direction] = ray;
                        is_open || self.stage.is_free_until(origin, direction, t - TOUCH_M)
                    };
                    if is_inside(middle) && is_free() {
                        see(grid.cells(sample, 1), 1, middle.map(|v| v as u32));
                    }
                }
            }
        }
        let visible = if whole == 0 {
            0.0
        } else {
            seen as f64 / whole as f64
        };
        Silhouette { tight, visible }
    }

    /// The ray through a point of the image and the distance at which it hits the vehicle.
    fn hit(&self, point_pixel: [f64; 2]) -> Option<([Vec3A; 2], f32)> {
        let camera = self.eye.camera(self.rig);
        let origin = self.pose.eye_world(self.rig, self.eye);
        let direction = self.pose.world_from_pixel(camera, point_pixel);
        let t = self
            .stage
            .vehicle_distance(self.vehicle, origin, direction)?;
        Some(([origin, direction], t))
    }

    /// Whether the vehicle fills a block: its corner samples stand for those between them.
    fn fills(&self, grid: &Grid, [column, row]: [u32; 2]) -> bool {
        let last = grid.block - 1;
        [[0, 0], [last, last], [last, 0], [0, last]]
            .into_iter()
            .all(|[x, y]| self.hit(grid.middle([column + x, row + y])).is_some())
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
                            Object::Ground | Object::City | Object::Plant(_) => None,
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
