//! What buildings look like: walls with windows, and roofs.

use glam::Vec3A;
use rand::{Rng, RngExt as _};

use super::noise::{self, fractal, mix, stripes};

/// One building: a box with a style.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Building {
    /// Corner with the lowest coordinates.
    pub low: [f32; 2],
    /// Corner with the highest coordinates.
    pub high: [f32; 2],
    /// Height of the walls, metres.
    pub height: f32,
    /// Height of the ridge over the walls, metres; 0 for a flat roof.
    pub ridge: f32,
    style: Style,
}

#[derive(Debug, Clone, Copy)]
struct Style {
    wall: Vec3A,
    frame: Vec3A,
    roof: Vec3A,
    texture: WallTexture,
    floor_m: f32,
    bay_m: f32,
    /// Part of a bay's width, and of a floor's height, that is window.
    window: [f32; 2],
    seed: u32,
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
    /// Share of the pixel that is glass and mirrors the sky.
    pub glass: f32,
}

const WALLS: [[f32; 3]; 12] = [
    [0.46, 0.42, 0.35],
    [0.52, 0.50, 0.46],
    [0.40, 0.26, 0.18],
    [0.34, 0.17, 0.12],
    [0.28, 0.27, 0.26],
    [0.56, 0.47, 0.31],
    [0.24, 0.12, 0.09],
    [0.60, 0.58, 0.54],
    [0.38, 0.40, 0.42],
    [0.50, 0.36, 0.27],
    [0.33, 0.37, 0.33],
    [0.58, 0.53, 0.44],
];

impl Building {
    /// A building of this footprint and height in a random style.
    pub fn draw(
        low: [f32; 2],
        high: [f32; 2],
        height: f32,
        ridge: f32,
        rng: &mut impl Rng,
    ) -> Self {
        let tall = height > 16.0;
        let texture = match rng.random_range(0..10_u32) {
            0..4 => WallTexture::Plaster,
            4..7 => WallTexture::Brick,
            7..9 if tall => WallTexture::Curtain,
            _ => WallTexture::Panels,
        };
        let curtain = texture == WallTexture::Curtain;
        let wall = match texture {
            WallTexture::Brick => WALLS[[2, 3, 6, 9][rng.random_range(0..4_usize)]],
            _ => WALLS[rng.random_range(0..WALLS.len())],
        };
        let frame = if rng.random_bool(0.6) { 0.62 } else { 0.07 };
        let roof = if ridge > 0.0 {
            [
                [0.30, 0.11, 0.065],
                [0.20, 0.085, 0.06],
                [0.11, 0.11, 0.115],
                [0.17, 0.125, 0.095],
            ][rng.random_range(0..4_usize)]
        } else {
            [
                [0.22, 0.215, 0.20],
                [0.30, 0.29, 0.27],
                [0.12, 0.12, 0.125],
                [0.26, 0.23, 0.19],
            ][rng.random_range(0..4_usize)]
        };
        let style = Style {
            wall: Vec3A::from_array(wall) * rng.random_range(0.8..1.15_f32),
            frame: Vec3A::splat(frame),
            roof: Vec3A::from_array(roof),
            texture,
            floor_m: rng.random_range(2.9..3.7_f32),
            bay_m: if curtain {
                1.6
            } else {
                rng.random_range(2.2..4.2_f32)
            },
            window: if curtain {
                [0.93, 0.80]
            } else {
                [
                    rng.random_range(0.32..0.62_f32),
                    rng.random_range(0.42..0.62_f32),
                ]
            },
            seed: rng.random(),
        };
        Self {
            low,
            high,
            height,
            ridge,
            style,
        }
    }

    /// The wall at a point, seen with this footprint; `normal` tells which of the four walls it is.
    pub fn wall(&self, point: Vec3A, normal: Vec3A, footprint_m: f32) -> Look {
        let Style {
            floor_m,
            bay_m,
            window,
            seed,
            ..
        } = self.style;
        let faces_x = normal.x.abs() > normal.y.abs();
        let (u, length) = if faces_x {
            (point.y - self.low[1], self.high[1] - self.low[1])
        } else {
            (point.x - self.low[0], self.high[0] - self.low[0])
        };
        let side = seed.wrapping_add(u32::from(faces_x) * 2 + u32::from(normal.x + normal.y > 0.0));
        // Whole bays, so that no window is cut by a corner.
        let bay_m = length / (length / bay_m).floor().max(1.0);
        let z = point.z;
        let ground_floor = z < floor_m && self.height > 8.0;
        let [part_u, part_z] = if ground_floor { [0.82, 0.74] } else { window };
        let top_margin = self.height - floor_m * (self.height / floor_m).floor();
        let under_eaves = z > self.height - top_margin.max(0.35);

        let start_u = 0.5 * bay_m * (1.0 - part_u);
        let start_z = floor_m * (1.0 - part_z) * if ground_floor { 0.25 } else { 0.6 };
        let spread = |border: f32| {
            stripes(
                u,
                bay_m,
                start_u - border,
                bay_m * part_u + 2.0 * border,
                footprint_m,
            ) * stripes(
                z,
                floor_m,
                start_z - border,
                floor_m * part_z + 2.0 * border,
                footprint_m,
            )
        };
        let blank = under_eaves || self.height < 2.5;
        let glass = if blank { 0.0 } else { spread(0.0) };
        let framed = if blank { 0.0 } else { spread(0.09) };
        // Glazing bars split a window in two.
        let bar = stripes(u, bay_m, 0.5 * bay_m - 0.035, 0.07, footprint_m);
        let glass = glass * (1.0 - bar);

        let cell = noise::hash(
            (u / bay_m).floor() as i32,
            (z / floor_m).floor() as i32,
            side,
        );
        let vivid = (1.5 - footprint_m / bay_m).clamp(0.0, 1.0);
        let room = self.room(cell, u, z) * vivid + Vec3A::new(0.075, 0.08, 0.085) * (1.0 - vivid);
        let wall = self.wall_color(u, z, side, footprint_m);
        let albedo =
            wall * (1.0 - framed) + self.style.frame * (framed - glass).max(0.0) + room * glass;
        Look { albedo, glass }
    }

    /// What is behind a window: mostly darkness, sometimes blinds or curtains.
    fn room(&self, cell: u32, u: f32, z: f32) -> Vec3A {
        match cell % 7 {
            0 => Vec3A::new(0.38, 0.36, 0.31),
            1 => Vec3A::new(0.28, 0.24, 0.18),
            2 => {
                // Blinds let down to a random height.
                let blind = (z / self.style.floor_m).fract() > 0.3 + 0.5 * noise::unit(cell ^ 0x61);
                Vec3A::splat(if blind { 0.42 } else { 0.04 })
            }
            _ => Vec3A::new(0.035, 0.04, 0.05) * (0.6 + noise::value(u * 1.3, z * 1.3, cell)),
        }
    }

    fn wall_color(&self, u: f32, z: f32, side: u32, footprint_m: f32) -> Vec3A {
        let Style {
            wall,
            texture,
            floor_m,
            ..
        } = self.style;
        let dirt = fractal(u, z, 4.0, 4, footprint_m, side);
        let base = wall * (1.0 + 0.2 * dirt);
        match texture {
            WallTexture::Plaster => {
                let grain = fractal(u, z, 0.35, 3, footprint_m, side ^ 0x13);
                let ledge = stripes(z, floor_m, 0.0, 0.14, footprint_m);
                base * (1.0 + 0.16 * grain) * (1.0 + 0.22 * ledge)
            }
            WallTexture::Brick => {
                let row = (z / 0.08).floor();
                let shifted = u + 0.11 * (row % 2.0);
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
                    side,
                ));
                let tint = 0.45 * (brick - 0.5) * (1.4 - footprint_m / 0.15).clamp(0.0, 1.0);
                // Bonds of many bricks keep some contrast when single bricks are too small to see.
                let bond = 0.22 * fractal(u, z, 1.3, 2, footprint_m, side ^ 0x15);
                base * (1.0 + tint + bond) * (1.0 - mortar) + Vec3A::splat(0.34) * mortar
            }
            WallTexture::Panels => {
                let joints = stripes(u, 2.4, 0.0, 0.05, footprint_m).max(stripes(
                    z,
                    floor_m,
                    0.0,
                    0.06,
                    footprint_m,
                ));
                let panel = noise::hash(
                    (u / 2.4).floor() as i32,
                    (z / floor_m).floor() as i32,
                    side ^ 0x17,
                );
                base * (0.92 + 0.16 * noise::unit(panel)) * (1.0 - 0.5 * joints)
            }
            WallTexture::Curtain => base * 0.55,
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
        let edge = [0, 1]
            .map(|i| (point[i] - self.low[i]).min(self.high[i] - point[i]))
            .into_iter()
            .fold(f32::INFINITY, f32::min);
        let flat = roof * (1.0 + 0.3 * stains + 0.22 * gravel) * (1.0 - 0.25 * sheets);
        // Parapet capping along the edge.
        let capping = if edge < 0.35 { 1.0 } else { 0.0 };
        Vec3A::new(
            mix(flat.x, 0.42, capping),
            mix(flat.y, 0.41, capping),
            mix(flat.z, 0.39, capping),
        )
    }
}
