//! Light: what a ray brings back from the first surface that it meets.

use glam::Vec3A;

use super::trace::{Hit, Object, Stage};
use crate::world::mesh::{Surface, Triangle, VehiclePart};
use crate::world::noise::{self, fractal, mix, smooth_step};
use crate::world::sun::Light;
use crate::world::{ground, livery};

/// Key of the sky and the ground among the faces of triangles.
const SKY_FACE: u32 = 0;
const GROUND_FACE: u32 = 1;
/// Set in the keys of the vehicle's faces.
const VEHICLE_FACES: u32 = 1 << 31;

/// What a ray brings back.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    /// Linear light, before exposure.
    pub light: Vec3A,
    /// Which face it comes from; an edge runs where it changes.
    pub face: u32,
}

/// A surface at the point where a ray meets it.
struct Point {
    at: Vec3A,
    normal: Vec3A,
    albedo: Vec3A,
    /// Share of light mirrored straight on, and the share of the point that mirrors at all.
    mirror: f32,
    gloss: f32,
    /// Share of the sky's light that reaches it.
    open: f32,
    /// Leaves let some sun through.
    translucent: bool,
}

/// A scene under a light.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shader<'a> {
    pub stage: &'a Stage,
    pub light: Light,
}

/// How a ray came about, which decides what is worth computing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum RayKind {
    Camera,
    Mirrored,
}

impl Shader<'_> {
    /// What a camera ray brings back; `angle` is a pixel's width as a tangent.
    pub fn sample(&self, origin: Vec3A, direction: Vec3A, angle: f32) -> Sample {
        self.trace(origin, direction, angle, RayKind::Camera)
    }

    fn trace(&self, origin: Vec3A, direction: Vec3A, angle: f32, kind: RayKind) -> Sample {
        let Some(hit) = self.stage.nearest(origin, direction) else {
            return Sample {
                light: self.sky(direction, angle, kind),
                face: SKY_FACE,
            };
        };
        let (point, face) = self.point(origin, direction, angle, &hit);
        let mut light = self.reflect(&point, direction, hit.t, kind);
        let haze = 1.0 - libm::expf(-hit.t / self.light.haze_m);
        light += (self.light.horizon * 0.9 - light) * haze;
        Sample { light, face }
    }

    fn sky(&self, direction: Vec3A, angle: f32, kind: RayKind) -> Vec3A {
        let sky = self.light.sky(direction);
        if kind == RayKind::Mirrored || direction.z < 0.02 {
            return sky;
        }
        let sun_disc = if direction.dot(self.light.direction) > 0.9997 {
            8.0
        } else {
            0.0
        };
        // Clouds on a flat layer; their detail shrinks towards the horizon with its distance.
        let scale = 1.0 / (direction.z + 0.08);
        let seed = self.stage.scene.target().seed;
        let cloud = fractal(
            direction.x * scale,
            direction.y * scale,
            1.6,
            5,
            angle * scale * scale,
            seed,
        );
        let cover = smooth_step(0.05, 0.65, cloud) * smooth_step(0.02, 0.2, direction.z) * 0.75;
        let white = self.light.horizon * 0.55 + self.light.sun * 0.22;
        sky + (white - sky) * cover + self.light.sun * sun_disc
    }

    fn point(&self, origin: Vec3A, direction: Vec3A, angle: f32, hit: &Hit) -> (Point, u32) {
        let at = origin + direction * hit.t;
        let Some(triangle) = self.stage.triangle(hit) else {
            return (self.ground(at, hit.t * angle, -direction.z), GROUND_FACE);
        };
        let smooth = smooth_normal(triangle, at);
        let normal = if smooth.dot(direction) > 0.0 {
            -smooth
        } else {
            smooth
        };
        let facing = normal.dot(direction).abs();
        let footprint_m = hit.t * angle * stretch(facing);
        let face = triangle.face + GROUND_FACE;
        let (vehicle, face) = match hit.object {
            Object::Vehicle(index) => (
                usize::from(index),
                (face ^ (u32::from(index) << 16)) | VEHICLE_FACES,
            ),
            Object::Ground | Object::City => (0, face),
        };
        let point = self.surface(triangle.surface, vehicle, at, normal, footprint_m);
        (point, face)
    }

    fn ground(&self, at: Vec3A, width_m: f32, facing: f32) -> Point {
        let albedo = ground::albedo(
            &self.stage.scene.city.layout,
            at.x,
            at.y,
            width_m * stretch(facing),
        );
        // Under and close beside a vehicle the sky is hidden.
        let open = self
            .stage
            .scene
            .vehicles
            .iter()
            .map(|vehicle| {
                let local = vehicle.vehicle_from_world(at);
                let [length, width, _] = vehicle.size_m.map(|v| v as f32 * 0.5);
                let [dx, dy] = [
                    (local.x.abs() - length * 0.93).max(0.0),
                    (local.y.abs() - width * 0.80).max(0.0),
                ];
                let apart = (dx * dx + dy * dy).sqrt();
                mix(0.12, 1.0, (apart / (apart + 0.25)).min(1.0))
            })
            .product();
        Point {
            at,
            normal: Vec3A::Z,
            albedo,
            mirror: 0.0,
            gloss: 0.0,
            open,
            translucent: false,
        }
    }

    /// `vehicle` is the index of the vehicle that the surface belongs to, if to any.
    fn surface(
        &self,
        surface: Surface,
        vehicle: usize,
        at: Vec3A,
        normal: Vec3A,
        footprint_m: f32,
    ) -> Point {
        let scene = &self.stage.scene;
        let matt = |albedo: Vec3A, open: f32| Point {
            at,
            normal,
            albedo,
            mirror: 0.0,
            gloss: 0.0,
            open,
            translucent: false,
        };
        // Streets are canyons: the lower floors see less of the sky.
        let canyon = mix(0.62, 1.0, smooth_step(0.0, 9.0, at.z));
        match surface {
            Surface::Wall(index) => {
                let look = scene.city.buildings[usize::from(index)].wall(at, normal, footprint_m);
                Point {
                    mirror: 0.06,
                    gloss: look.glass,
                    ..matt(look.albedo, canyon)
                }
            }
            Surface::Roof(index) => matt(
                scene.city.buildings[usize::from(index)].roof(at, normal, footprint_m),
                1.0,
            ),
            Surface::Foliage(tint) => foliage(tint, at, normal, footprint_m),
            Surface::Bark => {
                let grain = fractal(at.x * 3.0 + at.y * 3.0, at.z, 0.4, 2, footprint_m, 5);
                matt(Vec3A::new(0.12, 0.09, 0.065) * (1.0 + 0.4 * grain), 0.8)
            }
            Surface::Metal => {
                let grain = fractal(at.x + at.z, at.y - at.z, 0.8, 3, footprint_m, 11);
                matt(Vec3A::new(0.26, 0.27, 0.28) * (1.0 + 0.25 * grain), 0.9)
            }
            Surface::Sign => {
                // Each sign has a colour of its own; signs are further apart than this lattice.
                let pick =
                    noise::hash((at.x / 1.5).round() as i32, (at.y / 1.5).round() as i32, 21) % 3;
                let colors = [[0.42, 0.02, 0.02], [0.02, 0.09, 0.40], [0.55, 0.55, 0.52]];
                matt(Vec3A::from_array(colors[pick as usize]), 1.0)
            }
            Surface::Vehicle(part) => {
                let vehicle = &scene.vehicles[vehicle];
                let local = vehicle.vehicle_from_world(at);
                let local_normal = vehicle.vehicle_direction_from_world(normal);
                let finish = livery::finish(vehicle, part, local, local_normal, footprint_m);
                let low = if part == VehiclePart::Wheel {
                    0.30
                } else {
                    0.42
                };
                let open = mix(low, 1.0, smooth_step(0.0, 0.9, at.z));
                Point {
                    mirror: finish.mirror,
                    gloss: 1.0,
                    ..matt(finish.albedo, open)
                }
            }
        }
    }

    /// Light sent back by a point: sun, sky and what it mirrors.
    fn reflect(&self, point: &Point, direction: Vec3A, t: f32, kind: RayKind) -> Vec3A {
        let toward_sun = point.normal.dot(self.light.direction);
        let sunny = if point.translucent {
            (toward_sun * 0.7 + 0.3).max(0.0)
        } else {
            toward_sun.max(0.0)
        };
        // Starting a little off the surface keeps a point from shading itself.
        let start = point.at + point.normal * (0.004 + t * 4e-5);
        // What a curved mirror shows is small: shadows in it are not worth their rays.
        let lit = sunny > 0.0
            && (kind == RayKind::Mirrored || self.stage.is_free(start, self.light.direction));
        let sun = if lit { self.light.sun } else { Vec3A::ZERO };
        let diffuse = point.albedo * (sun * sunny + self.light.ambient(point.normal) * point.open);
        if point.gloss <= 0.0 || kind == RayKind::Mirrored {
            return diffuse;
        }
        let facing = -direction.dot(point.normal);
        let mirrored = direction + point.normal * (2.0 * facing);
        let grazing = (1.0 - facing).clamp(0.0, 1.0);
        let grazing_2 = grazing * grazing;
        let share = point.mirror + (1.0 - point.mirror) * grazing_2 * grazing_2 * grazing;
        let around = if point.gloss >= 1.0 {
            self.trace(start, mirrored, 0.02, RayKind::Mirrored).light
        } else {
            self.street_reflection(mirrored)
        };
        let mut highlight = mirrored.dot(self.light.direction).max(0.0);
        for _ in 0..7 {
            highlight *= highlight;
        }
        let share = share * point.gloss;
        diffuse * (1.0 - share) + around * share + sun * (highlight * share * 25.0)
    }

    /// What a shop or office window mirrors, without a ray: sky above, the other side of the street
    /// below.
    fn street_reflection(&self, mirrored: Vec3A) -> Vec3A {
        let sky = self.light.sky(mirrored);
        let street = self.light.ambient(Vec3A::Z) * 0.28;
        street + (sky - street) * smooth_step(0.05, 0.35, mirrored.z)
    }
}

/// Leaves: clumps of light and shade with normals in all directions.
fn foliage(tint: u16, at: Vec3A, normal: Vec3A, footprint_m: f32) -> Point {
    let seed = u32::from(tint) * 31 + 7;
    let [u, v] = [at.x + 0.61 * at.z, at.y - 0.73 * at.z];
    let clumps = fractal(u, v, 0.9, 4, footprint_m, seed);
    let tilt = Vec3A::new(
        fractal(u, v, 0.5, 2, footprint_m, seed ^ 1),
        fractal(u, v, 0.5, 2, footprint_m, seed ^ 2),
        0.2,
    );
    let warm = noise::unit(noise::hash(i32::from(tint), 3, 8));
    let green = Vec3A::new(0.045 + 0.06 * warm, 0.095 + 0.015 * warm, 0.026);
    Point {
        at,
        normal: (normal + tilt * 0.8).normalize_or_zero(),
        albedo: green * (1.0 + 0.6 * clumps).max(0.1),
        mirror: 0.0,
        gloss: 0.0,
        open: mix(0.35, 1.0, smooth_step(-0.8, 0.9, normal.z)) * (1.0 + 0.3 * clumps).max(0.2),
        translucent: true,
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
    let [a, b, c] = triangle.vertices;
    let [na, nb, nc] = triangle.normals;
    let (e1, e2, s) = (b - a, c - a, at - a);
    let [d11, d12, d22] = [e1.dot(e1), e1.dot(e2), e2.dot(e2)];
    let [d1, d2] = [s.dot(e1), s.dot(e2)];
    let scale = 1.0 / (d11 * d22 - d12 * d12);
    let v = (d22 * d1 - d12 * d2) * scale;
    let w = (d11 * d2 - d12 * d1) * scale;
    (na * (1.0 - v - w) + nb * v + nc * w).normalize_or(Vec3A::Z)
}
