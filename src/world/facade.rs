//! What buildings look like: walls with windows, shop fronts and roofs.
//!
//! Windows are recessed: the glass lies behind the wall's plane, so that a slanted ray meets the
//! reveal first and the lintel throws its shadow on the pane. Nothing of it is a triangle; the ray's
//! direction shifts the place that is looked up, which gives both eyes their true parallax.

use glam::Vec3A;
use rand::{Rng, RngExt as _};

use super::noise::{self, fractal, mix, stripe, stripes};

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

/// Everything about a building but its size.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Style {
    wall: Vec3A,
    /// Surrounds, ledges and the ground floor.
    stone: Vec3A,
    frame: Vec3A,
    roof: Vec3A,
    /// What the glass lets be seen of itself.
    tint: Vec3A,
    texture: WallTexture,
    /// Height of the ground floor and of those above.
    pub ground_m: f32,
    pub floor_m: f32,
    bay_m: f32,
    /// Part of a bay's width, and of a floor's height, that is window.
    window: [f32; 2],
    /// How deep the glass lies behind the wall.
    recess_m: f32,
    /// Panes beside each other in a window.
    panes: f32,
    ledge: bool,
    shutters: bool,
    surround: bool,
    /// Shops along the street.
    pub shops: bool,
    /// Balconies in front of some windows.
    pub balconies: bool,
    pub seed: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum WallTexture {
    Plaster,
    Brick,
    Panels,
    Curtain,
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

const WALLS: [[f32; 3]; 14] = [
    [0.50, 0.44, 0.34],
    [0.56, 0.53, 0.47],
    [0.36, 0.22, 0.15],
    [0.31, 0.145, 0.10],
    [0.25, 0.245, 0.24],
    [0.58, 0.46, 0.28],
    [0.22, 0.105, 0.08],
    [0.62, 0.60, 0.56],
    [0.35, 0.37, 0.39],
    [0.46, 0.31, 0.22],
    [0.31, 0.36, 0.33],
    [0.60, 0.54, 0.43],
    [0.52, 0.34, 0.26],
    [0.40, 0.42, 0.47],
];
const SHOP_COLORS: [[f32; 3]; 8] = [
    [0.30, 0.02, 0.02],
    [0.02, 0.10, 0.06],
    [0.02, 0.05, 0.20],
    [0.03, 0.03, 0.03],
    [0.42, 0.38, 0.30],
    [0.45, 0.20, 0.02],
    [0.03, 0.16, 0.20],
    [0.20, 0.10, 0.05],
];

/// The colour of a shop by its number.
pub(crate) fn shop_color(number: u32) -> Vec3A {
    Vec3A::from_array(SHOP_COLORS[number as usize % SHOP_COLORS.len()])
}

impl Style {
    /// A random style for a building of this height.
    pub fn draw(height: f32, ridge: f32, rng: &mut impl Rng) -> Self {
        let tall = height > 15.0;
        let texture = match rng.random_range(0..10_u32) {
            0..4 => WallTexture::Plaster,
            4..7 => WallTexture::Brick,
            7..9 if tall => WallTexture::Curtain,
            _ => WallTexture::Panels,
        };
        let wall = match texture {
            WallTexture::Brick => WALLS[[2, 3, 6, 9][rng.random_range(0..4_usize)]],
            WallTexture::Curtain => WALLS[[4, 8, 13, 7][rng.random_range(0..4_usize)]],
            _ => WALLS[rng.random_range(0..WALLS.len())],
        };
        let roofs: [[f32; 3]; 4] = if ridge > 0.0 {
            [
                [0.30, 0.11, 0.065],
                [0.20, 0.085, 0.06],
                [0.11, 0.11, 0.115],
                [0.17, 0.125, 0.095],
            ]
        } else {
            [
                [0.22, 0.215, 0.20],
                [0.30, 0.29, 0.27],
                [0.12, 0.12, 0.125],
                [0.26, 0.23, 0.19],
            ]
        };
        let tints = [
            [0.020, 0.026, 0.030],
            [0.012, 0.030, 0.034],
            [0.030, 0.028, 0.022],
            [0.016, 0.020, 0.034],
        ];
        let curtain = texture == WallTexture::Curtain;
        let ribbon = texture == WallTexture::Panels && tall && rng.random_bool(0.5);
        let window = if curtain {
            [0.95, rng.random_range(0.70..0.92_f32)]
        } else if ribbon {
            [0.97, rng.random_range(0.42..0.55_f32)]
        } else {
            [
                rng.random_range(0.34..0.60_f32),
                rng.random_range(0.46..0.62_f32),
            ]
        };
        let shops = ridge == 0.0 && height > 7.0 && rng.random_bool(0.6);
        Self {
            wall: Vec3A::from_array(wall) * rng.random_range(0.82..1.12_f32),
            stone: Vec3A::from_array([[0.52, 0.49, 0.43], [0.40, 0.38, 0.35], [0.58, 0.56, 0.53]]
                [rng.random_range(0..3_usize)]),
            frame: Vec3A::splat([0.62, 0.05, 0.20][rng.random_range(0..3_usize)]),
            roof: Vec3A::from_array(roofs[rng.random_range(0..4_usize)]),
            tint: Vec3A::from_array(tints[rng.random_range(0..4_usize)]),
            texture,
            ground_m: if shops {
                rng.random_range(3.9..4.6_f32)
            } else {
                3.3
            },
            floor_m: rng.random_range(2.9..3.6_f32),
            bay_m: if curtain || ribbon {
                rng.random_range(1.3..2.2_f32)
            } else {
                rng.random_range(2.2..3.8_f32)
            },
            window,
            recess_m: if curtain {
                0.06
            } else {
                rng.random_range(0.12..0.28_f32)
            },
            panes: if curtain || ribbon { 1.0 } else { 2.0 },
            ledge: texture == WallTexture::Plaster && rng.random_bool(0.6),
            shutters: texture == WallTexture::Plaster && !tall && rng.random_bool(0.4),
            surround: texture == WallTexture::Brick || rng.random_bool(0.3),
            shops,
            balconies: !curtain && !ribbon && ridge == 0.0 && rng.random_bool(0.35),
            seed: rng.random(),
        }
    }
}

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
        self.style.balconies && column % 3 == 0 && floor > 0
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
        let Spot { u, z, footprint_m, .. } = *spot;
        let z = z - base;
        let bay_m = bays.bay_m;
        let curtain = style.texture == WallTexture::Curtain;
        let [wide, high] = [bay_m * window[0], floor_m * window[1]];
        let start = [
            0.5 * (bay_m - wide),
            (floor_m - high) * if curtain { 0.5 } else { 0.55 },
        ];
        let cover = |u: f32, z: f32, border: f32| {
            stripes(u, bay_m, start[0] - border, wide + 2.0 * border, footprint_m)
                * stripes(z, floor_m, start[1] - border, high + 2.0 * border, footprint_m)
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

    /// The ground floor of a street of shops: panes, a band with the shop's sign, a door.
    fn shop(&self, spot: &Spot, bays: Bays) -> Look {
        let style = &self.style;
        let Spot { u, z, footprint_m, .. } = *spot;
        let bay_m = bays.bay_m;
        let width = shop_width(bay_m);
        let number = (u / width).floor();
        let shop = noise::hash(number as i32, 7, spot.seed);
        let color = shop_color(shop);
        let band = style.ground_m - 0.95;
        let local = u - number * width;
        if z > band {
            // The sign: light letters on the shop's colour.
            let mut albedo = color;
            let lettering = 0.16 + 0.10 * noise::unit(shop ^ 0x11);
            let from_end = (local - width * 0.5).abs();
            let row = (z - band - 0.30).abs() < 0.17;
            if row && from_end < width * (0.22 + 0.18 * noise::unit(shop ^ 0x12)) {
                let glyph = noise::hash((local / lettering).floor() as i32, 3, shop);
                let stroke = stripes(local, lettering, 0.02, lettering * 0.55, footprint_m);
                let bite = ((z - band) * 9.0 + noise::unit(glyph) * 4.0).fract() < 0.62;
                let ink = if glyph % 7 == 0 || !bite { 0.0 } else { stroke };
                let pale = if shop % 3 == 1 { 0.06 } else { 0.72 };
                albedo = albedo + (Vec3A::splat(pale) - albedo) * ink;
            }
            let top = stripe(z, style.ground_m, 0.14, footprint_m);
            albedo = albedo + (style.stone - albedo) * top;
            return Look {
                albedo,
                glass: 0.0,
                tilt: [0.0; 2],
                sun: 1.0,
                open: 0.95,
            };
        }
        let depth = 0.16 * (1.3 - 2.0 * footprint_m).clamp(0.0, 1.0);
        let pane_u = (local + spot.along[0] * depth).clamp(0.0, width);
        let pane_z = z + spot.along[1] * depth;
        let door = 1.1 / width;
        let [low, high] = [0.45, band - 0.1];
        let cover = |u: f32, z: f32, border: f32| {
            stripe(u, width * 0.5, width * 0.5 - 0.25 - border, footprint_m)
                * stripe(
                    z,
                    f32::midpoint(low, high),
                    (high - low) * 0.5 - border,
                    footprint_m,
                )
        };
        let is_door = local < width * door + 0.3;
        let pillar = stripe(local, width * 0.5, width * 0.5 - 0.25, footprint_m);
        let opening = if is_door {
            pillar * stripe(z, high * 0.5, high * 0.5, footprint_m)
        } else {
            cover(local, z, 0.0)
        };
        let bar = stripes(local - 0.3 - width * door, (width * (1.0 - door)) / 2.0, 0.0, 0.07, footprint_m);
        let mut glass = if is_door {
            opening * f32::from(u8::from((0.15..high - 0.35).contains(&z)))
        } else {
            opening * cover(pane_u, pane_z, 0.05)
        };
        glass *= 1.0 - bar;
        let stall = color * 0.8 + Vec3A::splat(0.02);
        let wall = if pillar < 0.5 {
            self.wall_color(spot) * 0.4 + style.stone * 0.6
        } else {
            stall
        };
        let vivid = (1.5 - footprint_m / 2.0).clamp(0.0, 1.0);
        let seen = self.room(shop | 1, [pane_u, pane_z.max(0.0)], [width, style.ground_m], spot);
        let mean = Vec3A::new(0.07, 0.065, 0.055);
        let room = mean + (seen * 1.6 + 0.02 - mean) * vivid;
        let albedo = wall * (1.0 - opening)
            + (style.frame * 0.5 + color * 0.5) * (opening - glass).max(0.0)
            + room * glass;
        Look {
            albedo,
            glass,
            tilt: [0.0; 2],
            sun: 1.0,
            open: 0.9 - 0.2 * opening,
        }
    }

    /// What is behind a pane: curtains, blinds, or a room seen in its true perspective.
    fn room(&self, cell: u32, local: [f32; 2], size: [f32; 2], spot: &Spot) -> Vec3A {
        const DEPTH_M: f32 = 4.5;
        let [u, z] = local;
        let pick = cell % 9;
        if self.style.texture != WallTexture::Curtain {
            if pick == 0 {
                let fold = 0.8 + 0.2 * noise::value(u * 14.0, 0.5, cell);
                return Vec3A::new(0.40, 0.38, 0.33) * fold;
            }
            if pick == 2 || pick == 4 {
                let drop = 0.35 + 0.5 * noise::unit(cell ^ 0x61);
                if z / size[1] > drop {
                    let slats = stripes(z, 0.06, 0.0, 0.03, spot.footprint_m);
                    return Vec3A::splat(0.26 + 0.16 * slats);
                }
            }
        }
        let [du, dz] = spot.along;
        let reach = |rate: f32, to_high: f32, to_low: f32| {
            if rate > 1e-4 {
                to_high / rate
            } else if rate < -1e-4 {
                to_low / -rate
            } else {
                f32::INFINITY
            }
        };
        let [side, level] = [reach(du, size[0] - u, u), reach(dz, size[1] - z, z)];
        let depth = side.min(level).min(DEPTH_M);
        let tone = 0.7 + 0.6 * noise::unit(cell ^ 0x3d);
        let paint = [
            Vec3A::new(0.34, 0.31, 0.26),
            Vec3A::new(0.26, 0.29, 0.30),
            Vec3A::new(0.36, 0.34, 0.31),
        ][(cell >> 5) as usize % 3];
        let surface = if depth >= level {
            if dz > 0.0 {
                Vec3A::splat(0.42)
            } else {
                Vec3A::new(0.15, 0.10, 0.07)
            }
        } else if depth >= side {
            paint * 0.8
        } else {
            // The back wall, with something on it.
            let (x, y) = (u + du * depth, z + dz * depth);
            let thing = noise::hash((x * 1.1).floor() as i32, (y * 0.9).floor() as i32, cell);
            paint * if thing % 3 == 0 { 0.45 } else { 1.0 }
        };
        let dim = 1.0 / (1.0 + depth * depth * 0.35);
        surface * (0.40 * tone * (0.12 + 0.88 * dim)) + self.style.tint
    }

    fn wall_color(&self, spot: &Spot) -> Vec3A {
        let Style {
            wall,
            texture,
            floor_m,
            ..
        } = self.style;
        let Spot {
            u,
            z,
            seed,
            footprint_m,
            ..
        } = *spot;
        let dirt = fractal(u, z, 4.0, 3, footprint_m, seed);
        // Rain leaves streaks, traffic dirties the foot of the wall.
        let streak = fractal(u, z * 0.12, 0.7, 2, footprint_m, seed ^ 0x2b);
        let foot = (1.0 - z * 0.5).clamp(0.0, 1.0);
        let base = wall * ((1.0 + 0.13 * dirt + 0.10 * streak) * (1.0 - 0.22 * foot));
        match texture {
            WallTexture::Plaster => {
                let grain = fractal(u, z, 0.35, 3, footprint_m, seed ^ 0x13);
                base * (1.0 + 0.10 * grain)
            }
            WallTexture::Brick => {
                let row = (z / 0.08).floor();
                let shifted = u + 0.11 * (row % 2.0);
                // Bonds of many bricks keep some contrast when single bricks are too small to see.
                let bond = 0.20 * fractal(u, z, 1.3, 2, footprint_m, seed ^ 0x15);
                let near = (1.4 - footprint_m / 0.15).clamp(0.0, 1.0);
                if near <= 0.0 {
                    // Mortar takes a fifth of the wall.
                    return base * (0.80 * (1.0 + bond)) + Vec3A::splat(0.068);
                }
                let mortar = stripes(z, 0.08, 0.0, 0.012, footprint_m).max(stripes(
                    shifted,
                    0.22,
                    0.0,
                    0.012,
                    footprint_m,
                ));
                let brick = noise::unit(noise::hash(
                    (shifted / 0.22).floor() as i32,
                    row as i32,
                    seed,
                ));
                let tint = 0.45 * (brick - 0.5) * near;
                base * (1.0 + tint + bond) * (1.0 - mortar) + Vec3A::splat(0.34) * mortar
            }
            WallTexture::Panels => {
                let level = z - self.first_floor();
                let joints = stripes(u, 2.4, 0.0, 0.04, footprint_m).max(stripes(
                    level,
                    floor_m,
                    0.0,
                    0.05,
                    footprint_m,
                ));
                let panel = noise::hash(
                    (u / 2.4).floor() as i32,
                    (level / floor_m).floor() as i32,
                    seed ^ 0x17,
                );
                let grain = fractal(u, z, 0.5, 2, footprint_m, seed ^ 0x19);
                base * (0.93 + 0.14 * noise::unit(panel) + 0.06 * grain) * (1.0 - 0.5 * joints)
            }
            WallTexture::Curtain => {
                let mullion = stripes(u, 1.7, 0.0, 0.08, footprint_m);
                base * (0.5 + 0.5 * mullion)
            }
        }
    }

    /// The roof at a point.
    pub fn roof(&self, point: Vec3A, normal: Vec3A, footprint_m: f32) -> Vec3A {
        let Style { roof, seed, .. } = self.style;
        let stains = fractal(point.x, point.y, 5.0, 3, footprint_m, seed);
        if self.ridge > 0.0 {
            // Rows of tiles run level, so they repeat with height.
            let slope = (1.0 - normal.z * normal.z).sqrt().max(0.2);
            let rows = stripes(point.z / slope, 0.33, 0.0, 0.07, footprint_m);
            let along = if normal.x.abs() > normal.y.abs() {
                point.y
            } else {
                point.x
            };
            let columns = stripes(along, 0.26, 0.0, 0.04, footprint_m);
            let tile = noise::hash(
                (point.z / slope / 0.33).floor() as i32,
                (along / 0.26).floor() as i32,
                seed,
            );
            let tint = (noise::unit(tile) - 0.5) * (1.4 - footprint_m / 0.3).clamp(0.0, 1.0);
            return roof * (1.0 + 0.3 * stains + 0.5 * tint) * (1.0 - 0.5 * rows.max(columns));
        }
        let gravel = fractal(point.x, point.y, 0.6, 3, footprint_m, seed ^ 0x3);
        let sheets = stripes(point.x, 1.9, 0.0, 0.05, footprint_m);
        roof * (1.0 + 0.3 * stains + 0.22 * gravel) * (1.0 - 0.25 * sheets)
    }

    /// Stone of ledges, cornices and parapets.
    pub fn stone(&self, point: Vec3A, footprint_m: f32) -> Vec3A {
        let seed = self.style.seed ^ 0x57;
        let grain = fractal(point.x + point.y, point.z, 1.4, 3, footprint_m, seed);
        self.style.stone * (1.0 + 0.16 * grain)
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
