//! Light: what a ray brings back from the first surface that it meets.

use glam::Vec3A;

use super::material::{Gaze, Point, SKY_FACE, point, power_of_two_below};
use super::trace::{Object, Stage};
use crate::world::noise::{self, fractal, mix, smooth_step};
use crate::world::sky::Light;

/// Half the sun's width as a tangent; half of what it is, because few samples make a wide penumbra
/// grainy.
const SUN_RADIUS: f32 = 0.002_3;
/// What mirrors less than this of a share of light is not worth a ray.
const LEAST_SHARE: f32 = 0.035;

/// What a ray brings back.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sample {
    /// Linear light, before exposure.
    pub light: Vec3A,
    /// Which face it comes from; an edge runs where it changes.
    pub face: u32,
    /// How it is lit by the sun.
    pub lit: Lit,
}

/// Whether the sun reaches a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Lit {
    /// The point faces away, or there is no sun.
    #[default]
    Dark,
    /// Something stands in the way.
    Shaded,
    /// It does.
    Sunny,
}

/// A scene under a light.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shader<'a> {
    pub stage: &'a Stage,
    pub light: &'a Light,
    /// 0 for dry streets, 1 for puddles.
    pub wetness: f32,
}

/// How a ray came to a point.
#[derive(Debug, Clone, Copy)]
struct Arrival {
    direction: Vec3A,
    /// Its length, metres.
    t: f32,
    /// Its width as a tangent.
    angle: f32,
    kind: RayKind,
    /// Whether it met a plant.
    plant: bool,
}

/// How a ray came about, which decides what is worth computing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum RayKind {
    Camera,
    Mirrored,
}

impl Shader<'_> {
    /// What a camera ray brings back; `angle` is a pixel's width as a tangent. Where `known` says
    /// how the whole neighbourhood is lit, no ray asks again.
    pub fn sample(
        &self,
        origin: Vec3A,
        direction: Vec3A,
        angle: f32,
        known: Option<Lit>,
    ) -> Sample {
        self.trace(origin, direction, angle, RayKind::Camera, known)
    }

    fn trace(
        &self,
        origin: Vec3A,
        direction: Vec3A,
        angle: f32,
        kind: RayKind,
        known: Option<Lit>,
    ) -> Sample {
        let Some(hit) = self.stage.nearest(origin, direction) else {
            return Sample {
                light: self.sky(direction, angle, kind),
                face: SKY_FACE,
                lit: Lit::Dark,
            };
        };
        let gaze = Gaze {
            origin,
            direction,
            angle,
            sun: self.light.direction,
            wetness: if kind == RayKind::Camera {
                self.wetness
            } else {
                0.0
            },
        };
        let (point, face) = point(self.stage, &gaze, &hit);
        // A plant's leaves shade each other by their openness.
        let plant = matches!(hit.object, Object::Plant(_));
        let ray = Arrival {
            direction,
            t: hit.t,
            angle,
            kind,
            plant,
        };
        let open = self.stage.openness.at(point.at, point.normal);
        let (sunny, lit) = self.sunshine(&point, &ray, open, known);
        let light = self.reflect(&point, &ray, open, sunny);
        Sample {
            light: self.light.through_haze(light, direction, hit.t),
            face,
            lit,
        }
    }

    fn sky(&self, direction: Vec3A, angle: f32, kind: RayKind) -> Vec3A {
        let sky = self.light.sky(direction);
        let clouds = self.light.air.clouds;
        if kind == RayKind::Mirrored || direction.z < 0.01 {
            return sky;
        }
        let toward_sun = direction.dot(self.light.direction);
        let disc = if toward_sun > 0.999_93 {
            self.light.sun * 12.0
        } else {
            // The lens and the air spread the sun's light around it.
            let near = toward_sun.max(0.0);
            let near = near * near * near * near;
            let near = near * near * near * near;
            self.light.sun * (0.10 * near * near * near * near)
        };
        // Clouds on a flat layer; their detail shrinks towards the horizon with its distance.
        let scale = 1.0 / (direction.z + 0.09);
        let seed = self.stage.scene.city.layout.seed;
        let [x, y] = [direction.x * scale, direction.y * scale];
        let shape = fractal(x, y, 1.7, 5, angle * scale * scale, seed);
        let fade = smooth_step(0.01, 0.14, direction.z);
        let overcast = self.light.air.overcast;
        if overcast > 0.0 {
            return sky * (1.0 + 0.22 * overcast * shape * fade);
        }
        let edge = 0.75 - 1.15 * clouds;
        let cover = smooth_step(edge, edge + 0.55, shape) * fade;
        let thick = smooth_step(edge + 0.25, edge + 1.0, shape);
        let cloud = self.light.cloud(direction, thick);
        sky + disc * (1.0 - cover) + (cloud - sky) * (cover * 0.92)
    }

    /// Sunlight on a white surface that faces the sun, at a point, and whether it gets there.
    fn sunshine(
        &self,
        point: &Point,
        ray: &Arrival,
        open: f32,
        known: Option<Lit>,
    ) -> (Vec3A, Lit) {
        let light = self.light;
        let away = !point.translucent && point.normal.dot(light.direction) <= 0.0;
        if away || light.air.overcast > 0.95 || point.sun <= 0.0 {
            return (Vec3A::ZERO, Lit::Dark);
        }
        if ray.kind == RayKind::Mirrored {
            // What a mirror shows is not worth a ray for its shadow.
            return (light.sun * smooth_step(0.25, 0.8, open), Lit::Sunny);
        }
        let lit = match known {
            Some(known) if known != Lit::Dark => known,
            _ => {
                let start = if ray.plant {
                    // Leaves are not shaded by their neighbours, which are drawn larger than life.
                    point.at + light.direction * 0.35
                } else {
                    point.start(ray.t)
                };
                let toward = self.toward_sun(point.at, ray.t * ray.angle);
                if self.stage.is_free(start, toward) {
                    Lit::Sunny
                } else {
                    Lit::Shaded
                }
            }
        };
        if lit == Lit::Sunny {
            (light.sun * point.sun, lit)
        } else {
            (Vec3A::ZERO, lit)
        }
    }

    /// Light sent back by a point: sun, sky, street and what it mirrors.
    fn reflect(&self, point: &Point, ray: &Arrival, open: f32, sun: Vec3A) -> Vec3A {
        let light = self.light;
        let normal = point.normal;
        let toward_sun = normal.dot(light.direction);
        let slant = if point.translucent {
            // A good part of what falls on the other side comes through.
            toward_sun.max(0.0) * 0.75 + toward_sun.abs() * 0.22 + 0.10
        } else {
            toward_sun.max(0.0)
        };
        let diffuse = point.albedo * (sun * slant + self.around(normal, open, point.open));
        let mut sum = diffuse + point.glow;
        if ray.kind == RayKind::Mirrored {
            return sum;
        }
        let facing = -ray.direction.dot(point.mirror_normal);
        let mirrored = ray.direction + point.mirror_normal * (2.0 * facing);
        if point.flakes.max_element() > 0.0 {
            sum += self.flakes(point, mirrored, sun, open);
        }
        if point.gloss <= 0.0 {
            return sum;
        }
        let grazing = (1.0 - facing).clamp(0.0, 1.0);
        let grazing_2 = grazing * grazing;
        let share =
            point.gloss * (point.mirror + (1.0 - point.mirror) * grazing_2 * grazing_2 * grazing);
        let seen = if share > LEAST_SHARE && mirrored.dot(normal) > 0.0 {
            let angle = ray.angle.max(0.012);
            self.trace(point.start(ray.t), mirrored, angle, RayKind::Mirrored, None)
                .light
        } else {
            self.street(mirrored, open)
        };
        let mut highlight = mirrored.dot(light.direction).max(0.0);
        for _ in 0..8 {
            highlight *= highlight;
        }
        sum * (1.0 - share) + seen * share + sun * (highlight * share * 40.0).min(30.0)
    }

    /// Diffuse light from everywhere but the sun on a white surface: the open part of the sky, the
    /// ground, and the walls that hide the rest of the sky.
    fn around(&self, normal: Vec3A, open: f32, nearby: f32) -> Vec3A {
        let light = self.light;
        let up = 0.5 + 0.5 * normal.z;
        let sky = light.skylight(normal) * open;
        // The sun reaches the ground of a canyon for a part of its width only.
        let ground = light.ground * mix(0.30, 0.95, open * open) * (1.0 - up);
        let walls = light.ground * (0.42 * (1.0 - open) * (0.35 + 0.65 * up));
        (sky + ground + walls) * nearby
    }

    /// The broad highlight of metal flakes.
    fn flakes(&self, point: &Point, mirrored: Vec3A, sun: Vec3A, open: f32) -> Vec3A {
        let near = mirrored.dot(self.light.direction).max(0.0);
        let near_4 = near * near * near * near;
        let near_16 = near_4 * near_4 * near_4 * near_4;
        let sky = self.light.skylight(mirrored) * mix(0.6, 1.0, open);
        let street = self.light.ground * (0.5 - 0.5 * mirrored.z);
        point.flakes * ((sky + street) * point.open + sun * (near_16 * 2.2 + near_4 * 0.25))
    }

    /// What the street around shows without a ray: sky above, the other side of it below.
    fn street(&self, mirrored: Vec3A, open: f32) -> Vec3A {
        let sky = self.light.sky(mirrored);
        let street = self.light.ground * 0.9;
        street + (sky - street) * smooth_step(0.75 - 0.8 * open, 1.1 - 0.8 * open, mirrored.z)
    }

    /// Towards a point of the sun's disc, which soft shadows need: which one depends on the place in
    /// the world alone, so that both eyes see the same grain.
    fn toward_sun(&self, at: Vec3A, footprint_m: f32) -> Vec3A {
        // The largest power of two that a pixel holds, as the lattice's cell.
        let cell = power_of_two_below(footprint_m.max(0.004));
        let [x, y, z] = (at / cell).to_array().map(|v| v.floor() as i32);
        // Steps of the plastic number's powers (Roberts 2018) spread evenly over neighbours, so that
        // the samples of a pixel never cluster as random ones do.
        let steps = |a: u32, b: u32| {
            let [x, y, z] = [x, y, z].map(i32::cast_unsigned);
            let sum = x
                .wrapping_mul(a)
                .wrapping_add(y.wrapping_mul(b))
                .wrapping_add(z.wrapping_mul(0x6a09_e667));
            (noise::unit(sum) * 2.0 - 1.0) * SUN_RADIUS
        };
        let sun = self.light.direction;
        let side = Vec3A::new(-sun.y, sun.x, 0.0).normalize_or(Vec3A::X);
        let up = sun.cross(side);
        let [round, high] = [
            steps(0xc13f_a9a9, 0x91e1_0da6),
            steps(0x9e37_79b9, 0x6a3b_1c55),
        ];
        (sun + side * round + up * high).normalize()
    }
}
