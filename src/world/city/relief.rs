//! What stands out of a building's box: parapets, gables, balconies, awnings and roof units.

use glam::Vec3A;
use rand::{Rng, RngExt as _};

use super::{Builder, Rect};
use crate::world::facade::Building;
use crate::world::mesh::Surface;

impl<R: Rng> Builder<'_, R> {
    /// Plant rooms, ventilation and masts.
    pub(super) fn roof_units(&mut self, rect: Rect, height: f32) {
        for _ in 0..self.rng.random_range(1..6_u32) {
            let [x, y] = [0, 1].map(|i| {
                let (low, high) = (rect[0][i] + 1.2, rect[1][i] - 3.5);
                self.rng.random_range(low..high.max(low + 0.1))
            });
            let low = Vec3A::new(x, y, height);
            match self.rng.random_range(0..5_u32) {
                0 => {
                    let size = Vec3A::new(3.2, 2.6, 2.4) * self.rng.random_range(0.7..1.0_f32);
                    self.mesh
                        .block(low, low + size, Surface::Painted(1), Surface::Painted(1));
                }
                1 => {
                    let top = low + Vec3A::Z * self.rng.random_range(1.5..4.5_f32);
                    self.mesh.tube([low, top], [0.05, 0.03], 5, Surface::Metal);
                }
                2 => {
                    let top = low + Vec3A::Z * 1.1;
                    self.mesh.tube([low, top], [0.35, 0.35], 8, Surface::Metal);
                    let cap = Vec3A::new(0.45, 0.45, 0.12);
                    self.mesh.slab(top - cap, top + cap, Surface::Metal);
                }
                _ => {
                    let [dx, dy, dz] = [(); 3].map(|()| self.rng.random_range(0.8..1.9_f32));
                    let high = low + Vec3A::new(dx, dy, dz * 0.7);
                    self.mesh
                        .block(low, high, Surface::Metal, Surface::Painted(2));
                }
            }
        }
    }

    /// The parapet around a flat roof, which stands out over the wall as a cornice.
    pub(super) fn parapet(&mut self, [low, high]: Rect, height: f32, stone: Surface) {
        let out = self.rng.random_range(0.04..0.40_f32);
        let (down, up) = (
            self.rng.random_range(0.15..0.5_f32),
            self.rng.random_range(0.3..0.9_f32),
        );
        let (z0, z1) = (height - down, height + up);
        let outer = [low.map(|v| v - out), high.map(|v| v + out)];
        let inner = [low.map(|v| v + 0.28), high.map(|v| v - 0.28)];
        for [a, b] in [
            [outer[0], [outer[1][0], inner[0][1]]],
            [[outer[0][0], inner[1][1]], outer[1]],
            [[outer[0][0], inner[0][1]], [inner[0][0], inner[1][1]]],
            [[inner[1][0], inner[0][1]], [outer[1][0], inner[1][1]]],
        ] {
            self.mesh.slab(
                Vec3A::new(a[0], a[1], z0),
                Vec3A::new(b[0], b[1], z1),
                stone,
            );
        }
    }

    /// Balconies and awnings on the four walls of a building near the vehicle.
    pub(super) fn relief(&mut self, building: &Building, stone: Surface) {
        for side in 0..4_u32 {
            let faces_x = side >= 2;
            let [i, j] = if faces_x { [1, 0] } else { [0, 1] };
            let outward = if side % 2 == 1 { 1.0 } else { -1.0 };
            let wall = if side % 2 == 1 {
                building.high[j]
            } else {
                building.low[j]
            };
            let start = building.low[i];
            let length = building.high[i] - start;
            let place = |u: f32, out: f32, z: f32| {
                let mut at = [0.0; 2];
                at[i] = start + u;
                at[j] = wall + outward * out;
                Vec3A::new(at[0], at[1], z)
            };
            let bays = building.bays(length);
            for bay in 0..bays.count {
                for floor in 0..building.floors() {
                    if !building.has_balcony(bay, floor, side) {
                        continue;
                    }
                    let middle = (bay as f32 + 0.5) * bays.bay_m;
                    let half = bays.bay_m * 0.42;
                    let z = building.first_floor() + floor as f32 * building.style.floor_m + 0.12;
                    let mut slab = |from: Vec3A, to: Vec3A, surface: Surface| {
                        self.mesh.slab(from.min(to), from.max(to), surface);
                    };
                    slab(
                        place(middle - half, 0.0, z),
                        place(middle + half, 1.05, z + 0.14),
                        stone,
                    );
                    let rail = if building.style.seed.is_multiple_of(2) {
                        Surface::Painted(2)
                    } else {
                        stone
                    };
                    slab(
                        place(middle - half, 1.0, z),
                        place(middle + half, 1.05, z + 1.05),
                        rail,
                    );
                    for end in [middle - half, middle + half - 0.04] {
                        slab(place(end, 0.0, z), place(end + 0.04, 1.0, z + 1.05), rail);
                    }
                }
            }
            if building.base > 0.0 || !building.style.shops {
                continue;
            }
            for shop in building.shops(length, side) {
                if shop.seed % 5 > 2 {
                    continue;
                }
                let surface = Surface::Awning((shop.seed & 0xffff) as u16);
                let z = building.style.ground_m - 0.98;
                let [from, to] = [
                    shop.start + 0.2,
                    (shop.start + shop.width).min(length) - 0.2,
                ];
                let cloth = [
                    place(from, 0.02, z),
                    place(to, 0.02, z),
                    place(to, 1.25, z - 0.5),
                    place(from, 1.25, z - 0.5),
                ];
                self.mesh.polygon(&cloth, surface);
                let drop = Vec3A::Z * -0.22;
                self.mesh.polygon(
                    &[cloth[3], cloth[2], cloth[2] + drop, cloth[3] + drop],
                    surface,
                );
            }
        }
    }

    pub(super) fn gable(
        &mut self,
        [low, high]: Rect,
        height: f32,
        ridge: f32,
        walls: Surface,
        roof: Surface,
    ) {
        const EAVES_M: f32 = 0.45;
        // The ridge runs along the longer side.
        let along_x = high[0] - low[0] > high[1] - low[1];
        let place = |along: f32, across: f32, z: f32| {
            if along_x {
                Vec3A::new(along, across, z)
            } else {
                Vec3A::new(across, along, z)
            }
        };
        let [a, c] = if along_x { [0, 1] } else { [1, 0] };
        let middle = f32::midpoint(low[c], high[c]);
        let drop = ridge * EAVES_M / (high[c] - middle);
        let ends = [low[a] - EAVES_M, high[a] + EAVES_M];
        for edge in [low[c] - EAVES_M, high[c] + EAVES_M] {
            self.mesh.polygon(
                &[
                    place(ends[0], edge, height - drop + 0.08),
                    place(ends[1], edge, height - drop + 0.08),
                    place(ends[1], middle, height + ridge + 0.08),
                    place(ends[0], middle, height + ridge + 0.08),
                ],
                roof,
            );
        }
        for end in [low[a], high[a]] {
            let corners = [
                place(end, low[c], height),
                place(end, high[c], height),
                place(end, middle, height + ridge),
            ];
            self.mesh.polygon(&corners, walls);
        }
    }
}
