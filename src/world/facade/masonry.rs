//! Walls without their windows, roofs and stone.

use glam::Vec3A;

use super::style::WallTexture;
use super::{Building, Spot, Style};
use crate::world::noise::{self, fractal, stripes};

impl Building {
    pub(super) fn wall_color(&self, spot: &Spot) -> Vec3A {
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
