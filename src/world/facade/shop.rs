//! Shop fronts, and what is behind panes.

use glam::Vec3A;

use super::style::WallTexture;
use super::{Bays, Building, Look, Spot, shop_color, shop_width};
use crate::world::noise::{self, stripe, stripes};

impl Building {
    /// The ground floor of a street of shops: panes, a band with the shop's sign, a door.
    pub(super) fn shop(&self, spot: &Spot, bays: Bays) -> Look {
        let style = &self.style;
        let Spot {
            u, z, footprint_m, ..
        } = *spot;
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
                let ink = if glyph.is_multiple_of(7) || !bite {
                    0.0
                } else {
                    stroke
                };
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
        let bar = stripes(
            local - 0.3 - width * door,
            (width * (1.0 - door)) / 2.0,
            0.0,
            0.07,
            footprint_m,
        );
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
        let seen = self.room(
            shop | 1,
            [pane_u, pane_z.max(0.0)],
            [width, style.ground_m],
            spot,
        );
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
    pub(super) fn room(&self, cell: u32, local: [f32; 2], size: [f32; 2], spot: &Spot) -> Vec3A {
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
            paint * if thing.is_multiple_of(3) { 0.45 } else { 1.0 }
        };
        let dim = 1.0 / (1.0 + depth * depth * 0.35);
        surface * (0.40 * tone * (0.12 + 0.88 * dim)) + self.style.tint
    }
}
