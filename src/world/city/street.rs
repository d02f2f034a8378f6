//! What stands along the streets: lamp posts, trees, traffic lights, benches, signs.

use glam::Vec3A;
use rand::{Rng, RngExt as _};

use super::{Builder, CLEAR_M, DETAIL_REACH_M, distance};
use crate::world::layout::Layout;
use crate::world::mesh::{Surface, turn};

impl<R: Rng> Builder<'_, R> {
    /// Lamp posts and trees along the pavements.
    pub(super) fn furnish_streets(&mut self, layout: &Layout, reach_m: f32) {
        const SPACING_M: f32 = 13.0;
        let reach = reach_m.min(DETAIL_REACH_M);
        let steps = (reach / SPACING_M) as i32;
        for axis in 0..2 {
            for road in &layout.roads[axis] {
                let leafy = self.rng.random_bool(0.6);
                let kind = self.rng.random_range(0..6_u8);
                for side in [-1.0, 1.0] {
                    for step in -steps..=steps {
                        let along = SPACING_M * step as f32 + self.rng.random_range(-1.5..1.5_f32);
                        let across = road.center + side * (road.half_width + 0.75);
                        let crossing = layout.nearest(1 - axis, along);
                        if crossing.offset.abs() < crossing.half_width + 3.0 {
                            continue;
                        }
                        let at = if axis == 0 {
                            [across, along]
                        } else {
                            [along, across]
                        };
                        let apart = distance([at, at], self.vehicle);
                        if apart > reach || apart < CLEAR_M {
                            continue;
                        }
                        let inward = if axis == 0 { Vec3A::X } else { Vec3A::Y } * -side;
                        if step % 2 == 0 {
                            self.lamp_post(at, inward);
                        } else if leafy {
                            self.tree(at, kind);
                        }
                        if apart < 120.0 {
                            self.street_things(at, inward);
                        }
                    }
                }
            }
        }
    }

    /// Bins, bollards, cabinets, benches, hydrants and signs beside a place at the kerb.
    pub(super) fn street_things(&mut self, [x, y]: [f32; 2], inward: Vec3A) {
        let along = Vec3A::new(inward.y, inward.x, 0.0).abs();
        let across = inward.abs();
        let shift = self.rng.random_range(2.0..5.0_f32);
        let foot = Vec3A::new(x, y, 0.0) + along * shift;
        let back = foot - inward * 1.5;
        let paint = Surface::Painted(self.rng.random_range(0..6_u16));
        let mesh = &mut self.mesh;
        match self.rng.random_range(0..10_u32) {
            0 => {
                for place in 0..5_u8 {
                    let low = foot + along * (f32::from(place) * 1.4);
                    mesh.tube([low, low + Vec3A::Z * 0.9], [0.07, 0.07], 8, Surface::Metal);
                    mesh.blob(
                        low + Vec3A::Z * 0.9,
                        Vec3A::splat(0.07),
                        0.0,
                        0,
                        Surface::Metal,
                    );
                }
            }
            1 => {
                let tall = self.rng.random_range(1.0..1.5_f32);
                mesh.block(
                    back,
                    back + along * 0.9 + across * 0.4 + Vec3A::Z * tall,
                    paint,
                    paint,
                );
            }
            2 | 3 => {
                // A bench: slats on two feet.
                for end in [0.1, 1.5] {
                    let low = back + along * end;
                    mesh.block(
                        low,
                        low + along * 0.08 + across * 0.45 + Vec3A::Z * 0.42,
                        Surface::Painted(2),
                        Surface::Painted(2),
                    );
                }
                for slat in 0..4_u8 {
                    let low = back + across * (f32::from(slat) * 0.12) + Vec3A::Z * 0.42;
                    mesh.slab(
                        low,
                        low + along * 1.7 + across * 0.09 + Vec3A::Z * 0.04,
                        Surface::Painted(6),
                    );
                }
                for slat in 0..3_u8 {
                    let low = back + Vec3A::Z * (0.55 + 0.13 * f32::from(slat));
                    mesh.slab(
                        low,
                        low + along * 1.7 + across * 0.04 + Vec3A::Z * 0.09,
                        Surface::Painted(6),
                    );
                }
            }
            4 | 5 => {
                mesh.tube(
                    [foot, foot + Vec3A::Z * 2.7],
                    [0.035, 0.035],
                    8,
                    Surface::Metal,
                );
                let plate = foot + Vec3A::Z * 2.05 - across * 0.3 - along * 0.06;
                mesh.slab(
                    plate,
                    plate + across * 0.6 + along * 0.02 + Vec3A::Z * 0.6,
                    Surface::Sign,
                );
            }
            6 | 7 => {
                let low = foot - inward * 0.4;
                mesh.tube([low, low + Vec3A::Z * 0.85], [0.22, 0.25], 10, paint);
                mesh.tube(
                    [low + Vec3A::Z * 0.85, low + Vec3A::Z * 0.97],
                    [0.27, 0.12],
                    10,
                    Surface::Painted(2),
                );
            }
            8 => {
                // A hydrant.
                let red = Surface::Painted(4);
                mesh.tube([foot, foot + Vec3A::Z * 0.55], [0.12, 0.11], 9, red);
                mesh.blob(foot + Vec3A::Z * 0.58, Vec3A::splat(0.13), 0.0, 0, red);
                let arm = along * 0.22;
                mesh.tube(
                    [foot + Vec3A::Z * 0.4 - arm, foot + Vec3A::Z * 0.4 + arm],
                    [0.06, 0.06],
                    7,
                    red,
                );
            }
            _ => {}
        }
    }

    /// Traffic lights at the corners of the crossings near the vehicle.
    pub(super) fn traffic_lights(&mut self, layout: &Layout) {
        for column in &layout.roads[0] {
            for row in &layout.roads[1] {
                let middle = [column.center, row.center];
                if distance([middle, middle], self.vehicle) > 110.0 {
                    continue;
                }
                let green = self.rng.random_range(0..2_u16);
                for (corner, [sx, sy]) in [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0_f32]]
                    .into_iter()
                    .enumerate()
                {
                    let at = [
                        column.center + sx * (column.half_width + 1.75),
                        row.center + sy * (row.half_width + 1.75),
                    ];
                    if distance([at, at], self.vehicle) < 4.0 {
                        continue;
                    }
                    let foot = Vec3A::new(at[0], at[1], 0.0);
                    let top = foot + Vec3A::Z * 3.5;
                    let dark = Surface::Painted(2);
                    self.mesh.tube([foot, top], [0.07, 0.06], 8, dark);
                    let lit = (green + corner as u16) % 2 * 2;
                    let half = Vec3A::new(0.14, 0.14, 0.45);
                    let head = foot + Vec3A::new(-0.22 * sx, -0.22 * sy, 3.0);
                    self.mesh.slab(head - half, head + half, dark);
                    for lamp in 0..3_u16 {
                        let center = head + Vec3A::Z * (0.29 - 0.29 * f32::from(lamp));
                        let surface = Surface::Signal(lamp + if lamp == lit { 3 } else { 0 });
                        for side in [Vec3A::X, -Vec3A::X, Vec3A::Y, -Vec3A::Y] {
                            self.lamp(center + side * 0.145, side, 0.1, surface);
                        }
                    }
                }
            }
        }
    }

    /// A round lamp on an upright face.
    pub(super) fn lamp(&mut self, center: Vec3A, outward: Vec3A, radius: f32, surface: Surface) {
        const CORNERS: u16 = 8;
        let across = outward.cross(Vec3A::Z);
        let rim: Vec<Vec3A> = (0..CORNERS)
            .map(|i| {
                let [sin, cos] = turn(f32::from(i) / f32::from(CORNERS));
                center + (across * cos + Vec3A::Z * sin) * radius
            })
            .collect();
        self.mesh.polygon(&rim, surface);
    }

    pub(super) fn lamp_post(&mut self, [x, y]: [f32; 2], inward: Vec3A) {
        let foot = Vec3A::new(x, y, 0.0);
        let top = foot + Vec3A::Z * 6.4;
        let arm = top + inward * 1.5 + Vec3A::Z * 0.35;
        self.mesh
            .tube([foot, top], [0.085, 0.055], 6, Surface::Metal);
        self.mesh.tube([top, arm], [0.05, 0.04], 4, Surface::Metal);
        let half = Vec3A::new(0.12, 0.12, 0.05) + inward.abs() * 0.22;
        self.mesh
            .block(arm - half, arm + half, Surface::Metal, Surface::Metal);
    }
}
