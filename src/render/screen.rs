//! What may hide a vehicle in an image: most pixels need no ray to know that nothing does.

use glam::Vec3A;

use super::pose::{Eye, RigPose};
use super::trace::{Object, Stage};
use crate::geometry::{Camera, PixelBox, StereoRig};

/// What reaches closer to the camera's plane than this may be anywhere in the image, metres.
const NEAR_M: f32 = 0.05;
/// Room for rounding around projected things, pixels, and before them, metres.
const MARGIN_PX: f32 = 1.0;
const MARGIN_M: f32 = 0.02;

/// Something that stands in the scene, as a rectangle in one image.
#[derive(Debug, Clone, Copy)]
struct Screen {
    /// Depth of its nearest point.
    z_m: f32,
    /// Lowest and highest coordinates, pixels.
    low: [f32; 2],
    high: [f32; 2],
    object: Object,
}

/// Everything that stands in a scene as rectangles in one image.
pub(super) struct Screens {
    all: Vec<Screen>,
}

/// The pixels of an image in which something may hide a vehicle.
pub(super) struct MayHide {
    /// First column and row of the part of the image that was looked at.
    origin: [u32; 2],
    /// Its columns and rows.
    size: [u32; 2],
    pixels: Vec<bool>,
}

/// One camera's axes and intrinsics in single precision.
struct Projection {
    origin: Vec3A,
    axes: [Vec3A; 3],
    focal_px: [f32; 2],
    center_px: [f32; 2],
}

impl Projection {
    fn new(rig: &StereoRig, pose: &RigPose, eye: Eye) -> Self {
        let camera = eye.camera(rig);
        let vector = |v: [f64; 3]| Vec3A::from_array(v.map(|v| v as f32));
        Self {
            origin: pose.eye_world(rig, eye),
            axes: [pose.right_world, pose.down_world, pose.forward_world].map(vector),
            focal_px: [camera.focal_x_px, camera.focal_y_px].map(|v| v as f32),
            center_px: [camera.center_x_px, camera.center_y_px].map(|v| v as f32),
        }
    }

    /// The rectangle of what lies between some points, of which each may be joined to each; None
    /// where all are behind the camera.
    fn screen(&self, points: &[Vec3A], object: Object) -> Option<Screen> {
        let camera = |point: Vec3A| {
            let apart = point - self.origin;
            self.axes.map(|axis| axis.dot(apart))
        };
        let mut screen = Screen {
            z_m: f32::INFINITY,
            low: [f32::INFINITY; 2],
            high: [f32::NEG_INFINITY; 2],
            object,
        };
        let mut add = |[x, y, z]: [f32; 3]| {
            screen.z_m = screen.z_m.min(z - MARGIN_M);
            for (i, along) in [x, y].into_iter().enumerate() {
                let pixel = self.center_px[i] + self.focal_px[i] * along / z;
                screen.low[i] = screen.low[i].min(pixel - MARGIN_PX);
                screen.high[i] = screen.high[i].max(pixel + MARGIN_PX);
            }
        };
        for (index, &point) in points.iter().enumerate() {
            let here = camera(point);
            if here[2] >= NEAR_M {
                add(here);
                continue;
            }
            // Where lines to points before the camera cross the near plane.
            for (other, &end) in points.iter().enumerate() {
                let there = camera(end);
                if other != index && there[2] >= NEAR_M {
                    let part = (NEAR_M - here[2]) / (there[2] - here[2]);
                    let [x, y] = [0, 1].map(|i| here[i] + part * (there[i] - here[i]));
                    add([x, y, NEAR_M]);
                }
            }
        }
        screen.z_m.is_finite().then_some(screen)
    }
}

impl Screens {
    pub fn new(stage: &Stage, rig: &StereoRig, pose: &RigPose, eye: Eye) -> Self {
        let projection = Projection::new(rig, pose, eye);
        let camera = eye.camera(rig);
        let size = [camera.width, camera.height].map(|v| v as f32);
        let triangles = stage
            .triangles()
            .filter_map(|(object, t)| projection.screen(&t.vertices, object));
        let plants = stage.plant_bounds().filter_map(|(object, [low, high])| {
            let corners: [Vec3A; 8] = std::array::from_fn(|corner| {
                let pick = |axis: usize| [low, high][(corner >> axis) & 1][axis];
                Vec3A::new(pick(0), pick(1), pick(2))
            });
            projection.screen(&corners, object)
        });
        let is_in_image = |s: &Screen| (0..2).all(|i| s.high[i] > 0.0 && s.low[i] < size[i]);
        Self {
            all: triangles.chain(plants).filter(is_in_image).collect(),
        }
    }

    /// Where something may hide a vehicle, by its index in the scene, that lies in `area` and no
    /// further than `z_m`.
    pub fn before(&self, vehicle: usize, area: &PixelBox, z_m: f32, camera: &Camera) -> MayHide {
        let bounds = |low: f64, high: f64, side: u32| {
            let clamp = |v: f64| v.clamp(0.0, f64::from(side)) as u32;
            [clamp(low.floor()), clamp(high.ceil())]
        };
        let [x, y] = [
            bounds(area.x_min, area.x_max, camera.width),
            bounds(area.y_min, area.y_max, camera.height),
        ];
        let mut hidden = MayHide {
            origin: [x[0], y[0]],
            size: [x[1] - x[0], y[1] - y[0]],
            pixels: vec![false; ((x[1] - x[0]) * (y[1] - y[0])) as usize],
        };
        for screen in &self.all {
            let own = matches!(screen.object, Object::Vehicle(v) if usize::from(v) == vehicle);
            if !own && screen.z_m < z_m {
                hidden.cover(screen);
            }
        }
        hidden
    }
}

impl MayHide {
    fn cover(&mut self, screen: &Screen) {
        let range = |axis: usize| {
            let first = self.origin[axis] as f32;
            let length = self.size[axis] as f32;
            let low = (screen.low[axis] - first).floor().clamp(0.0, length) as usize;
            let high = (screen.high[axis] - first).ceil().clamp(0.0, length) as usize;
            low..high.max(low)
        };
        let columns = range(0);
        for row in range(1) {
            let start = row * self.size[0] as usize;
            self.pixels[start + columns.start..start + columns.end].fill(true);
        }
    }

    /// Whether a ray has to be traced to know whether the vehicle is hidden in a pixel.
    pub fn at(&self, [x, y]: [u32; 2]) -> bool {
        let [column, row] = [
            x.wrapping_sub(self.origin[0]),
            y.wrapping_sub(self.origin[1]),
        ];
        let inside = column < self.size[0] && row < self.size[1];
        // What was not looked at may hold anything.
        !inside || self.pixels[(row * self.size[0] + column) as usize]
    }
}
