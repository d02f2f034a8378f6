//! What buildings look like: walls with windows, shop fronts and roofs.
//!
//! Windows are recessed: the glass lies behind the wall's plane, so that a slanted ray meets the
//! reveal first and the lintel throws its shadow on the pane. Nothing of it is a triangle; the ray's
//! direction shifts the place that is looked up, which gives both eyes their true parallax.

mod masonry;
mod shop;
mod style;

use glam::Vec3A;

use super::noise::{self, mix, stripes};
use style::WallTexture;
pub(crate) use style::{Style, shop_color};

/// One building: a box with a style, and perhaps a narrower box on top.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Building {
    /// Corner with the lowest coordinates.
    pub low: [f32; 2],
    /// Corner with the highest coordinates.
    pub high: [f32; 2],
    /// Height over the ground at which its walls begin, metres; above 0 for a set-back storey.
    pub base: f32,
    /// Height of the walls' top, metres.
    pub height: f32,
    /// Height of the ridge over the walls, metres; 0 for a flat roof.
    pub ridge: f32,
    /// Its walls and windows.
    pub style: Style,
}

/// What a point of a building sends back.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Look {
    /// Diffuse reflectance.
    pub albedo: Vec3A,
    /// Share of the pixel that is glass and mirrors the street.
    pub glass: f32,
    /// Tilt of the pane, along the wall and up: no two mirror quite the same.
    pub tilt: [f32; 2],
    /// Share of the sunlight that reaches it past ledges and reveals.
    pub sun: f32,
    /// Share of the sky's light that reaches it past them.
    pub open: f32,
}

/// The ray that looks at a wall, and where the light comes from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sight {
    /// Unit direction of the ray.
    pub direction: Vec3A,
    /// Towards the sun.
    pub sun: Vec3A,
    /// Width of the pixel on the wall, metres.
    pub footprint_m: f32,
}

/// Buildings lower than this have no ground floor of its own kind, metres.
const LOW_M: f32 = 6.9;

/// Where a building's windows are along one wall.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bays {
    /// Width of a bay: a whole number of them fills the wall.
    pub bay_m: f32,
    /// Number of bays.
    pub count: u32,
}

/// One shop of a wall.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shop {
    /// Where it begins along the wall, metres.
    pub start: f32,
    /// Its width, metres.
    pub width: f32,
    /// Colours and letters follow from it.
    pub seed: u32,
}

/// A shop takes as many bays as make it four metres wide.
fn shop_width(bay_m: f32) -> f32 {
    bay_m * (4.2 / bay_m).ceil().max(1.0)
}

impl Building {
    /// The bays of a wall of this length.
    pub fn bays(&self, length: f32) -> Bays {
        let count = (length / self.style.bay_m).floor().max(1.0);
        Bays {
            bay_m: length / count,
            count: count as u32,
        }
    }

    /// The shops along a wall of this length, which is one of four.
    pub fn shops(&self, length: f32, side: u32) -> Vec<Shop> {
        let width = shop_width(self.bays(length).bay_m);
        let seed = self.style.seed.wrapping_add(side);
        (0..(length / width).ceil() as i32)
            .map(|number| Shop {
                start: number as f32 * width,
                width,
                seed: noise::hash(number, 7, seed),
            })
            .collect()
    }

    /// Height at which the floors above the ground floor begin.
    pub fn first_floor(&self) -> f32 {
        if self.base > 0.0 || self.height < LOW_M {
            self.base
        } else {
            self.style.ground_m
        }
    }

    /// Number of floors above the ground floor.
    pub fn floors(&self) -> u32 {
        ((self.height - self.first_floor() - 0.3) / self.style.floor_m).max(0.0) as u32
    }

    /// Whether a window has a balcony; its bay, floor and wall (0 to 3).
    pub fn has_balcony(&self, bay: u32, floor: u32, side: u32) -> bool {
        let column = noise::hash(bay as i32, side as i32, self.style.seed ^ 0xba1c);
        self.style.balconies && column.is_multiple_of(3) && floor > 0
    }

    /// The wall at a point; `normal` tells which of the four walls it is.
    pub fn wall(&self, point: Vec3A, normal: Vec3A, sight: &Sight) -> Look {
        let style = &self.style;
        let faces_x = normal.x.abs() > normal.y.abs();
        let [i, j] = if faces_x { [1, 0] } else { [0, 1] };
        let (u, length) = (point[i] - self.low[i], self.high[i] - self.low[i]);
        let side = u32::from(faces_x) * 2 + u32::from(normal.x + normal.y > 0.0);
        let inward = (sight.direction[j] * normal[j]).abs().max(0.12);
        let along = [sight.direction[i] / inward, sight.direction.z / inward];
        let toward_sun = (sight.sun[j] * normal[j]).max(0.05);
        let sun = [sight.sun[i] / toward_sun, sight.sun.z / toward_sun];
        let spot = Spot {
            u,
            z: point.z,
            along,
            sun,
            seed: style.seed.wrapping_add(side),
            footprint_m: sight.footprint_m,
        };
        let bays = self.bays(length);
        let first_floor = self.first_floor();
        if point.z < first_floor && self.base <= 0.0 {
            if style.shops {
                return self.shop(&spot, bays);
            }
            return self.windows(&spot, bays, 0.0, style.ground_m, [style.window[0], 0.55]);
        }
        let floors = self.floors() as f32;
        if floors < 1.0 {
            // One low storey.
            let high = (self.height - self.base).min(style.floor_m);
            if point.z > self.base + high || high < 2.3 {
                return self.plain(&spot);
            }
            return self.windows(&spot, bays, self.base, high, style.window);
        }
        if point.z > first_floor + floors * style.floor_m {
            return self.plain(&spot);
        }
        self.windows(&spot, bays, first_floor, style.floor_m, style.window)
    }

    fn plain(&self, spot: &Spot) -> Look {
        Look {
            albedo: self.wall_color(spot),
            glass: 0.0,
            tilt: [0.0; 2],
            sun: 1.0,
            open: 1.0,
        }
    }

    /// A wall with rows of windows from `base` upwards.
    fn windows(&self, spot: &Spot, bays: Bays, base: f32, floor_m: f32, window: [f32; 2]) -> Look {
        let style = &self.style;
        let Spot {
            u, z, footprint_m, ..
        } = *spot;
        let z = z - base;
        let bay_m = bays.bay_m;
        let curtain = style.texture == WallTexture::Curtain;
        let [wide, high] = [bay_m * window[0], floor_m * window[1]];
        let start = [
            0.5 * (bay_m - wide),
            (floor_m - high) * if curtain { 0.5 } else { 0.55 },
        ];
        let cover = |u: f32, z: f32, border: f32| {
            stripes(
                u,
                bay_m,
                start[0] - border,
                wide + 2.0 * border,
                footprint_m,
            ) * stripes(
                z,
                floor_m,
                start[1] - border,
                high + 2.0 * border,
                footprint_m,
            )
        };
        let opening = cover(u, z, 0.0);
        let mut wall = self.wall_color(spot);
        if style.surround && opening < 1.0 {
            let around = cover(u, z, 0.13) - opening;
            wall = wall + (style.stone - wall) * around.clamp(0.0, 1.0);
        }
        if style.shutters && opening < 1.0 {
            let leaf = wide * 0.48;
            let beside = stripes(u, bay_m, start[0] - leaf, wide + 2.0 * leaf, footprint_m)
                * stripes(z, floor_m, start[1], high, footprint_m)
                - opening;
            let slats = 0.75 + 0.25 * stripes(z, 0.12, 0.0, 0.06, footprint_m);
            let paint = shop_color(style.seed >> 3) * 1.2 + Vec3A::splat(0.02);
            wall = wall + (paint * slats - wall) * beside.clamp(0.0, 1.0);
        }
        let mut sun = 1.0;
        if style.ledge {
            let edge = stripes(z, floor_m, 0.0, 0.16, footprint_m);
            wall = wall + (style.stone - wall) * edge;
            let drop = (0.14 * spot.sun[1]).clamp(0.0, 1.2);
            sun = 1.0 - stripes(z, floor_m, floor_m - drop, drop, footprint_m);
        }
        if opening <= 0.0 {
            return Look {
                albedo: wall,
                glass: 0.0,
                tilt: [0.0; 2],
                sun,
                open: 1.0,
            };
        }
        // From afar a recess is smaller than a pixel, and its shift would only flicker.
        let depth = style.recess_m * (1.3 - 2.0 * footprint_m).clamp(0.0, 1.0);
        let (cell_u, cell_z) = ((u / bay_m).floor(), (z / floor_m).floor());
        let cell = noise::hash(cell_u as i32, cell_z as i32, spot.seed);
        let clamp_u = |v: f32| v.clamp(cell_u * bay_m, (cell_u + 1.0) * bay_m);
        let clamp_z = |v: f32| v.clamp(cell_z * floor_m, (cell_z + 1.0) * floor_m);
        let (pane_u, pane_z) = (
            clamp_u(u + spot.along[0] * depth),
            clamp_z(z + spot.along[1] * depth),
        );
        let behind = opening * cover(pane_u, pane_z, 0.0);
        let (out_u, out_z) = (
            clamp_u(pane_u + spot.sun[0] * depth),
            clamp_z(pane_z + spot.sun[1] * depth),
        );
        let shine = cover(out_u, out_z, 0.0);
        // Frame and glazing bars.
        let mut glass = opening * cover(pane_u, pane_z, if curtain { -0.03 } else { -0.065 });
        let part = wide / style.panes;
        if style.panes > 1.0 {
            glass *= 1.0 - stripes(pane_u - start[0], bay_m, part - 0.03, 0.06, footprint_m);
            glass *= 1.0 - stripes(pane_z - start[1], floor_m, high * 0.7, 0.05, footprint_m);
        }
        let vivid = (1.5 - footprint_m / bay_m).clamp(0.0, 1.0);
        let room = if vivid > 0.0 {
            let local = [pane_u - cell_u * bay_m, pane_z - cell_z * floor_m];
            let seen = self.room(cell, local, [bay_m, floor_m], spot);
            let mean = style.tint * 1.5 + 0.03;
            mean + (seen - mean) * vivid
        } else {
            style.tint * 1.5 + 0.03
        };
        let frame = (behind - glass).max(0.0);
        let reveal = (opening - behind).max(0.0);
        let albedo =
            wall * (1.0 - opening) + wall * (reveal * 0.8) + style.frame * frame + room * glass;
        let wobble = |bits: u32| ((bits & 255) as f32 / 127.5 - 1.0) * 0.006;
        Look {
            albedo,
            glass,
            tilt: [wobble(cell >> 7), wobble(cell >> 15)],
            sun: sun * mix(1.0, shine, opening),
            open: 1.0 - 0.35 * opening,
        }
    }
}

/// A place on a wall and the slopes of ray and sun there.
#[derive(Debug, Clone, Copy)]
struct Spot {
    u: f32,
    z: f32,
    /// How far a ray goes along the wall and up for every metre inwards.
    along: [f32; 2],
    /// How far sunlight comes from along the wall and from above for every metre outwards.
    sun: [f32; 2],
    seed: u32,
    footprint_m: f32,
}
