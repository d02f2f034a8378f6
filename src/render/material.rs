//! What a surface is like at the point where a ray meets it.

use glam::Vec3A;

use super::trace::{Hit, Object, Stage};
use crate::world::facade::{Sight, shop_color};
use crate::world::mesh::{Surface, Triangle, VehiclePart};
use crate::world::noise::{self, fractal, mix, smooth_step, stripes};
use crate::world::tree::leaf_openness;
use crate::world::vehicle::Kind;
use crate::world::{Vehicle, ground, livery};

/// Key of the sky and the ground among the faces of triangles.
pub(super) const SKY_FACE: u32 = 0;
pub(super) const GROUND_FACE: u32 = 1;
/// Set in the keys of the vehicle's faces, and of those of trees.
pub(super) const VEHICLE_FACES: u32 = 1 << 31;
const PLANT_FACES: u32 = 1 << 30;

/// A surface at the point where a ray meets it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    pub at: Vec3A,
    pub normal: Vec3A,
    /// Diffuse reflectance.
    pub albedo: Vec3A,
    /// Share of light mirrored straight on, and the share of the point that mirrors at all.
    pub mirror: f32,
    pub gloss: f32,
    /// The normal of the mirroring surface, which may be rougher or smoother.
    pub mirror_normal: Vec3A,
    /// Reflectance of metal flakes under a clear coat: a broad, coloured highlight.
    pub flakes: Vec3A,
    /// Shares of the sky's and the sun's light that small things nearby let through.
    pub open: f32,
    pub sun: f32,
    /// Light of its own.
    pub glow: Vec3A,
    /// Leaves let some sun through.
    pub translucent: bool,
}

impl Point {
    fn matt(at: Vec3A, normal: Vec3A, albedo: Vec3A) -> Self {
        Self {
            at,
            normal,
            albedo,
            mirror: 0.0,
            gloss: 0.0,
            mirror_normal: normal,
            flakes: Vec3A::ZERO,
            open: 1.0,
            sun: 1.0,
            glow: Vec3A::ZERO,
            translucent: false,
        }
    }
}

impl Point {
    /// Where rays from the point start: a little off the surface, so that it does not meet itself,
    /// after a ray of length `t` found it.
    pub fn start(&self, t: f32) -> Vec3A {
        self.at + self.normal * (0.004 + t * 4e-5)
    }
}

/// How a ray looks at a surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gaze {
    pub origin: Vec3A,
    pub direction: Vec3A,
    /// Width of the ray as a tangent.
    pub angle: f32,
    /// Towards the sun.
    pub sun: Vec3A,
    /// 0 for dry streets, 1 for puddles.
    pub wetness: f32,
}

/// The point that a ray hits, and the key of its face.
pub(super) fn point(stage: &Stage, gaze: &Gaze, hit: &Hit) -> (Point, u32) {
    let at = gaze.origin + gaze.direction * hit.t;
    let width_m = hit.t * gaze.angle;
    let Some(triangle) = stage.triangle(hit) else {
        return (ground_point(stage, gaze, at, width_m), GROUND_FACE);
    };
    if let Object::Plant(plant) = hit.object {
        let face = (triangle.face << 16 | (plant & 0xffff)) | PLANT_FACES;
        return (plant_point(stage, gaze, plant, triangle, at, width_m), face);
    }
    let normal = toward(smooth_normal(triangle, at), gaze.direction);
    let footprint_m = width_m * stretch(normal.dot(gaze.direction).abs());
    let face = triangle.face + GROUND_FACE;
    if let Object::Vehicle(index) = hit.object {
        let vehicle = &stage.scene.vehicles[usize::from(index)];
        let point = match triangle.surface {
            Surface::Model(..) => Point {
                open: mix(0.40, 1.0, smooth_step(0.0, 0.9, at.z)),
                ..model_point(stage, triangle, at, normal, footprint_m)
            },
            surface => vehicle_point(vehicle, surface, at, normal, footprint_m),
        };
        return (point, (face ^ (u32::from(index) << 16)) | VEHICLE_FACES);
    }
    let point = match triangle.surface {
        Surface::Model(..) => Point {
            open: mix(0.6, 1.0, smooth_step(0.0, 0.6, at.z)),
            ..model_point(stage, triangle, at, normal, footprint_m)
        },
        kind => surface(stage, gaze, kind, at, normal, footprint_m),
    };
    (point, face)
}

/// A point of a model of the user's.
fn model_point(
    stage: &Stage,
    triangle: &Triangle,
    at: Vec3A,
    normal: Vec3A,
    footprint_m: f32,
) -> Point {
    let point = Point::matt(at, normal, Vec3A::splat(0.1));
    let (Surface::Model(model, part), Some(library)) = (triangle.surface, &stage.scene.library)
    else {
        return point;
    };
    let coat = library
        .model(model)
        .coat(part, corner_weights(triangle, at), footprint_m);
    Point {
        albedo: coat.albedo,
        mirror: coat.mirror,
        gloss: coat.gloss,
        flakes: coat.flakes,
        glow: coat.glow,
        ..point
    }
}

fn toward(normal: Vec3A, direction: Vec3A) -> Vec3A {
    if normal.dot(direction) > 0.0 {
        -normal
    } else {
        normal
    }
}

fn ground_point(stage: &Stage, gaze: &Gaze, at: Vec3A, width_m: f32) -> Point {
    let footprint_m = width_m * stretch(-gaze.direction.z);
    let layout = &stage.scene.city.layout;
    let soil = ground::look(layout, at.x, at.y, footprint_m);
    let mut point = Point {
        open: vehicle_shade(stage, at),
        ..Point::matt(at, Vec3A::Z, soil.albedo)
    };
    if gaze.wetness > 0.0 {
        wet(
            &mut point,
            gaze.wetness * soil.paved,
            footprint_m,
            layout.seed,
        );
    }
    point
}

/// Water darkens the ground, and mirrors where it stands.
fn wet(point: &mut Point, wetness: f32, footprint_m: f32, seed: u32) {
    let [x, y] = [point.at.x, point.at.y];
    let low = fractal(x, y, 4.5, 3, footprint_m, seed ^ 0x91);
    // The wetter, the larger the puddles.
    let puddle = smooth_step(0.55 - 0.6 * wetness, 0.75 - 0.45 * wetness, low) * wetness;
    let film = wetness * (0.55 + 0.25 * low).clamp(0.0, 1.0);
    point.albedo *= 1.0 - 0.55 * wetness.min(1.0);
    point.mirror = 0.025;
    point.gloss = puddle.max(0.75 * film).min(1.0);
    // Grains that stand out of the film spread what it mirrors.
    let rough = 0.09 * (1.0 - puddle) * (1.2 - footprint_m / 0.12).clamp(0.25, 1.0);
    if rough > 0.0 {
        // A lattice of a power of two, the same for both eyes.
        let cell_m = power_of_two_below(footprint_m.max(0.02));
        let cell = [x, y].map(|v| (v / cell_m).floor() as i32);
        let bits = noise::hash(cell[0], cell[1], seed ^ 0x93);
        let tilt = |bits: u32| ((bits & 0xff) as f32 / 127.5 - 1.0) * rough;
        point.mirror_normal = Vec3A::new(tilt(bits), tilt(bits >> 8), 1.0).normalize();
    }
}

/// The largest power of two that is not above a positive number.
pub(super) fn power_of_two_below(value: f32) -> f32 {
    f32::from_bits(value.to_bits() & 0x7f80_0000)
}

/// Share of the sky that the ground sees beside and under the vehicles.
fn vehicle_shade(stage: &Stage, at: Vec3A) -> f32 {
    /// Further away a vehicle hides too little of the sky to count, metres.
    const REACH_M: f32 = 6.0;
    let shade = |vehicle: &Vehicle| {
        let [x, y, _] = vehicle.center_world.map(|v| v as f32);
        let [length, width, _] = vehicle.size_m.map(|v| v as f32 * 0.5);
        // A lorry or a bus is longer.
        let reach_m = REACH_M.max(length + 2.5);
        if (at.x - x).abs() > reach_m || (at.y - y).abs() > reach_m {
            return 1.0;
        }
        let local = vehicle.vehicle_from_world(at);
        let [dx, dy] = [
            (local.x.abs() - length * 0.93).max(0.0),
            (local.y.abs() - width * 0.80).max(0.0),
        ];
        let apart = (dx * dx + dy * dy).sqrt();
        let open = mix(0.10, 1.0, (apart / (apart + 0.28)).min(1.0));
        // Gone at the reach, so that no edge shows there.
        let far = (at.x - x).abs().max((at.y - y).abs()) / reach_m;
        mix(open, 1.0, far * far * far * far)
    };
    stage.scene.vehicles.iter().map(shade).product()
}

fn plant_point(
    stage: &Stage,
    gaze: &Gaze,
    index: u32,
    triangle: &Triangle,
    at: Vec3A,
    width_m: f32,
) -> Point {
    let plant = stage.plant(index);
    let local = plant.template_from_world(at - plant.foot) / plant.scale;
    let smooth = plant.world_from_template(smooth_normal(triangle, local));
    if triangle.surface == Surface::Bark {
        let normal = toward(smooth, gaze.direction);
        let grain = fractal(local.x * 6.0 + local.y * 6.0, local.z, 0.4, 2, width_m, 5);
        let open = mix(0.45, 0.9, smooth_step(3.0, 0.5, local.z));
        return Point {
            open,
            ..Point::matt(
                at,
                normal,
                Vec3A::new(0.13, 0.10, 0.075) * (1.0 + 0.4 * grain),
            )
        };
    }
    let seed = u32::from(plant.tint) * 31 + 7;
    let warm = noise::unit(noise::hash(i32::from(plant.tint), 3, 8));
    // Every spray of leaves has a tone of its own, until it is smaller than a pixel.
    let corner = triangle.vertices[0] * 16.0;
    let own = noise::unit(noise::hash(corner.x as i32, corner.z as i32, seed));
    let vivid = (1.6 - width_m / 0.3).clamp(0.0, 1.0);
    let tone = 1.0 + 0.55 * (own - 0.5) * vivid;
    let green = Vec3A::new(
        0.055 + 0.055 * warm,
        0.098 + 0.018 * warm,
        0.024 + 0.008 * own,
    );
    let open = leaf_openness(plant.template, local);
    Point {
        open,
        sun: 0.35 + 0.65 * open,
        translucent: true,
        ..Point::matt(at, smooth, green * tone)
    }
}

fn surface(
    stage: &Stage,
    gaze: &Gaze,
    surface: Surface,
    at: Vec3A,
    normal: Vec3A,
    footprint_m: f32,
) -> Point {
    let scene = &stage.scene;
    let matt = |albedo: Vec3A| Point::matt(at, normal, albedo);
    match surface {
        Surface::Wall(index) => {
            let sight = Sight {
                direction: gaze.direction,
                sun: gaze.sun,
                footprint_m,
            };
            let look = scene.city.buildings[usize::from(index)].wall(at, normal, &sight);
            let along = Vec3A::new(normal.y, normal.x, 0.0);
            Point {
                mirror: 0.055,
                gloss: look.glass,
                mirror_normal: (normal + along * look.tilt[0] + Vec3A::Z * look.tilt[1])
                    .normalize(),
                sun: look.sun,
                open: look.open * mix(0.72, 1.0, smooth_step(0.0, 2.5, at.z)),
                ..matt(look.albedo)
            }
        }
        Surface::Roof(index) => {
            let roof = scene.city.buildings[usize::from(index)].roof(at, normal, footprint_m);
            let mut point = matt(roof);
            if gaze.wetness > 0.0 && normal.z > 0.9 {
                wet(
                    &mut point,
                    gaze.wetness * 0.8,
                    footprint_m,
                    u32::from(index),
                );
            }
            point
        }
        Surface::Stone(index) => {
            let building = &scene.city.buildings[usize::from(index)];
            let down = smooth_step(0.5, -0.8, normal.z);
            Point {
                open: 1.0 - 0.5 * down,
                ..matt(building.stone(at, footprint_m))
            }
        }
        Surface::Awning(shop) => {
            let color = shop_color(u32::from(shop)) * 1.3 + Vec3A::splat(0.03);
            let white = if shop & 0x40 == 0 {
                stripes(at.x + at.y, 0.5, 0.0, 0.25, footprint_m)
            } else {
                0.0
            };
            Point {
                translucent: true,
                ..matt(color + (Vec3A::splat(0.62) - color) * white)
            }
        }
        Surface::Foliage(_) => matt(Vec3A::new(0.06, 0.1, 0.03)),
        Surface::Bark => matt(Vec3A::new(0.13, 0.10, 0.075)),
        Surface::Metal => {
            let grain = fractal(at.x + at.z, at.y - at.z, 0.8, 2, footprint_m, 11);
            Point {
                flakes: Vec3A::splat(0.10),
                ..matt(Vec3A::new(0.27, 0.28, 0.29) * (1.0 + 0.2 * grain))
            }
        }
        Surface::Painted(index) => painted(index, at, normal, footprint_m),
        Surface::Sign => sign(at, normal),
        Surface::Signal(lit) => signal(at, normal, lit),
        // Vehicles and models have functions of their own.
        Surface::Vehicle(_) | Surface::Model(..) => matt(Vec3A::splat(0.1)),
    }
}

fn vehicle_point(
    vehicle: &Vehicle,
    surface: Surface,
    at: Vec3A,
    normal: Vec3A,
    footprint_m: f32,
) -> Point {
    let (Surface::Vehicle(part), Kind::BuiltIn(bodywork)) = (surface, &vehicle.kind) else {
        return Point::matt(at, normal, Vec3A::splat(0.1));
    };
    let local = vehicle.vehicle_from_world(at);
    let local_normal = vehicle.vehicle_direction_from_world(normal);
    let finish = livery::finish(bodywork, part, local, local_normal, footprint_m);
    let low = if part == VehiclePart::Wheel {
        0.25
    } else {
        0.40
    };
    Point {
        mirror: finish.mirror,
        gloss: if finish.mirror > 0.0 { 1.0 } else { 0.0 },
        flakes: finish.flakes,
        open: finish.open * mix(low, 1.0, smooth_step(0.0, 0.9, at.z)),
        sun: finish.sun,
        glow: finish.glow,
        ..Point::matt(at, normal, finish.albedo)
    }
}

/// Street furniture.
fn painted(index: u16, at: Vec3A, normal: Vec3A, footprint_m: f32) -> Point {
    const COLORS: [[f32; 3]; 8] = [
        [0.025, 0.060, 0.035],
        [0.30, 0.30, 0.29],
        [0.045, 0.047, 0.05],
        [0.03, 0.07, 0.16],
        [0.34, 0.025, 0.02],
        [0.42, 0.27, 0.03],
        [0.20, 0.115, 0.06],
        [0.28, 0.15, 0.11],
    ];
    let grain = fractal(at.x + at.z, at.y - at.z, 0.6, 2, footprint_m, 17);
    let base = Vec3A::from_array(COLORS[usize::from(index) % COLORS.len()]);
    Point {
        open: mix(0.6, 1.0, smooth_step(0.0, 0.6, at.z)),
        ..Point::matt(at, normal, base * (1.0 + 0.22 * grain))
    }
}

fn sign(at: Vec3A, normal: Vec3A) -> Point {
    // Each sign has a colour of its own; signs are further apart than this lattice.
    let pick = noise::hash((at.x / 1.5).round() as i32, (at.y / 1.5).round() as i32, 21) % 4;
    let colors = [
        [0.42, 0.02, 0.02],
        [0.02, 0.09, 0.40],
        [0.55, 0.55, 0.52],
        [0.02, 0.20, 0.10],
    ];
    // A pale rim and a pale bar or disc in the middle; plates hang from 2.05 to 2.65 m.
    let up = (at.z - 2.35).abs();
    let pale = up > 0.265 || (pick != 2 && up < 0.06);
    let albedo = if pale {
        Vec3A::splat(0.6)
    } else {
        Vec3A::from_array(colors[pick as usize])
    };
    Point::matt(at, normal, albedo)
}

fn signal(at: Vec3A, normal: Vec3A, lamp: u16) -> Point {
    const LAMPS: [[f32; 3]; 3] = [[1.0, 0.04, 0.02], [1.0, 0.45, 0.02], [0.03, 0.9, 0.35]];
    let color = Vec3A::from_array(LAMPS[usize::from(lamp) % 3]);
    let glow = if lamp < 3 { 0.0 } else { 4.0 };
    Point {
        glow: color * glow,
        ..Point::matt(at, normal, color * 0.04 + 0.01)
    }
}

/// How much longer than wide a pixel's footprint is taken to be on a surface seen at an angle.
///
/// The square root splits the difference between blur and flicker.
fn stretch(facing: f32) -> f32 {
    1.0 / facing.max(0.04).sqrt()
}

/// The shading normal at a point of a triangle.
fn smooth_normal(triangle: &Triangle, at: Vec3A) -> Vec3A {
    let [v, w] = corner_weights(triangle, at);
    let [na, nb, nc] = triangle.normals;
    (na * (1.0 - v - w) + nb * v + nc * w).normalize_or(Vec3A::Z)
}

/// The weights of a triangle's second and third corner at a point of it.
fn corner_weights(triangle: &Triangle, at: Vec3A) -> [f32; 2] {
    let [a, b, c] = triangle.vertices;
    let (e1, e2, s) = (b - a, c - a, at - a);
    let [d11, d12, d22] = [e1.dot(e1), e1.dot(e2), e2.dot(e2)];
    let [d1, d2] = [s.dot(e1), s.dot(e2)];
    let scale = 1.0 / (d11 * d22 - d12 * d12);
    let v = (d22 * d1 - d12 * d2) * scale;
    let w = (d11 * d2 - d12 * d1) * scale;
    [v, w]
}
