//! Buildings, trees and lamp posts on the city's plan.

use glam::Vec3A;
use rand::{Rng, RngExt as _};

use super::facade::Building;
use super::layout::{Block, Layout, PAVEMENT_M, Use};
use super::mesh::{Mesh, Surface, turn};

/// Nothing but the ground stands within this distance of the vehicle, metres.
const CLEAR_M: f32 = 6.5;
/// Trees and lamp posts further from the vehicle than this are left out, metres.
const DETAIL_REACH_M: f32 = 230.0;

/// A city around a vehicle.
#[derive(Debug)]
pub(crate) struct City {
    /// Roads and blocks.
    pub layout: Layout,
    /// Buildings, as [`Surface::Wall`] and [`Surface::Roof`] number them.
    pub buildings: Vec<Building>,
    /// Everything that stands on the ground.
    pub mesh: Mesh,
}

/// An axis-aligned rectangle on the ground.
type Rect = [[f32; 2]; 2];

struct Builder<'a, R> {
    rng: &'a mut R,
    buildings: Vec<Building>,
    mesh: Mesh,
    vehicle: [f32; 2],
    /// Tangent of the highest angle above the horizon at which the vehicle may see a building, for
    /// each quarter around it.
    skyline: [f32; 4],
}

impl City {
    /// A city that reaches at least `reach_m` around a vehicle at the given place.
    ///
    /// Towards at least two quarters the skyline stays low, so that a drone can see the vehicle
    /// from afar; the other quarters may be street canyons.
    pub fn draw(reach_m: f32, vehicle: [f32; 2], mut layout: Layout, rng: &mut impl Rng) -> Self {
        let mut skyline = [0.0; 4];
        let open = rng.random_range(0..4_usize);
        for (quarter, limit) in skyline.iter_mut().enumerate() {
            let is_open = quarter == open || quarter == (open + 2) % 4;
            *limit = if is_open {
                rng.random_range(0.17..0.27_f32)
            } else {
                rng.random_range(0.40..0.75_f32)
            };
        }
        for block in layout.blocks_mut() {
            let near = distance(rect_of(block, 0.0), vehicle) < 12.0;
            // Blocks of flats right beside an open view would shrink to sheds.
            let center = rect_center(rect_of(block, 0.0));
            if near && skyline[quarter_of(center, vehicle)] < 0.3 && block.usage == Use::Built {
                block.usage = [Use::Park, Use::Plaza, Use::Parking][rng.random_range(0..3_usize)];
            }
        }
        let mut builder = Builder {
            rng,
            buildings: Vec::new(),
            mesh: Mesh::default(),
            vehicle,
            skyline,
        };
        for block in layout.blocks() {
            builder.fill(block);
        }
        builder.furnish_streets(&layout, reach_m);
        let Builder {
            buildings, mesh, ..
        } = builder;
        Self {
            layout,
            buildings,
            mesh,
        }
    }

    /// Whether a point lies in a building or less than `margin_m` from one.
    pub fn in_building(&self, point: [f64; 3], margin_m: f64) -> bool {
        self.buildings.iter().any(|b| {
            (0..2).all(|i| {
                point[i] > f64::from(b.low[i]) - margin_m
                    && point[i] < f64::from(b.high[i]) + margin_m
            }) && point[2] < f64::from(b.height + b.ridge) + margin_m
        })
    }
}

fn rect_of(block: &Block, inset: f32) -> Rect {
    [block.low.map(|v| v + inset), block.high.map(|v| v - inset)]
}

fn rect_center([low, high]: Rect) -> [f32; 2] {
    [
        f32::midpoint(low[0], high[0]),
        f32::midpoint(low[1], high[1]),
    ]
}

fn quarter_of(point: [f32; 2], vehicle: [f32; 2]) -> usize {
    usize::from(point[0] > vehicle[0]) + 2 * usize::from(point[1] > vehicle[1])
}

/// Distance from a point to the nearest point of a rectangle.
fn distance([low, high]: Rect, point: [f32; 2]) -> f32 {
    let [dx, dy] = [0, 1].map(|i| (low[i] - point[i]).max(point[i] - high[i]).max(0.0));
    (dx * dx + dy * dy).sqrt()
}

impl<R: Rng> Builder<'_, R> {
    fn fill(&mut self, block: &Block) {
        let inner = rect_of(block, PAVEMENT_M);
        match block.usage {
            Use::Built => self.split(inner, false),
            Use::Houses => self.split(inner, true),
            Use::Park => self.scatter_trees(inner, 170.0),
            Use::Plaza | Use::Parking => self.scatter_trees(inner, 700.0),
        }
    }

    /// Divides a block into lots and builds on them.
    fn split(&mut self, [low, high]: Rect, houses: bool) {
        let size = [high[0] - low[0], high[1] - low[1]];
        let largest = if houses {
            21.0
        } else {
            self.rng.random_range(20.0..32.0_f32)
        };
        let axis = usize::from(size[1] > size[0]);
        if size[axis] > largest {
            let cut = low[axis] + size[axis] * self.rng.random_range(0.38..0.62_f32);
            let (mut first_high, mut second_low) = (high, low);
            first_high[axis] = cut;
            second_low[axis] = cut;
            self.split([low, first_high], houses);
            self.split([second_low, high], houses);
        } else if size[0] > 7.0 && size[1] > 7.0 {
            if houses {
                self.house([low, high]);
            } else {
                self.flats([low, high]);
            }
        }
    }

    /// The greatest height at this place that keeps the skyline, metres.
    fn height_limit(&self, rect: Rect) -> f32 {
        distance(rect, self.vehicle) * self.skyline[quarter_of(rect_center(rect), self.vehicle)]
    }

    fn flats(&mut self, lot: Rect) {
        if self.rng.random_bool(0.07) {
            self.scatter_trees(lot, 120.0);
            return;
        }
        let narrow = (lot[1][0] - lot[0][0]).min(lot[1][1] - lot[0][1]) < 12.0;
        let inset = if narrow || self.rng.random_bool(0.6) {
            0.0
        } else {
            self.rng.random_range(0.5..2.5_f32)
        };
        let rect: Rect = [lot[0].map(|v| v + inset), lot[1].map(|v| v - inset)];
        let tower = self.rng.random_bool(0.14);
        let wish = if tower {
            self.rng.random_range(30.0..58.0_f32)
        } else {
            self.rng.random_range(9.0..25.0_f32)
        };
        let height = wish.min(self.height_limit(rect));
        if height < 3.2 {
            self.scatter_trees(lot, 150.0);
            return;
        }
        self.raise(rect, height, 0.0);
        // Plant rooms and ventilation on the roof.
        for _ in 0..self.rng.random_range(1..4_u32) {
            let [x, y] = [0, 1].map(|i| self.rng.random_range(rect[0][i] + 1.0..rect[1][i] - 3.5));
            let [dx, dy, dz] = [(); 3].map(|()| self.rng.random_range(0.9..2.4_f32));
            let low = Vec3A::new(x, y, height);
            self.mesh.block(
                low,
                low + Vec3A::new(dx, dy, dz * 0.8),
                Surface::Metal,
                Surface::Metal,
            );
        }
    }

    fn house(&mut self, lot: Rect) {
        let size = [0, 1].map(|i| (lot[1][i] - lot[0][i] - 5.0).clamp(6.0, 12.5));
        let center = rect_center(lot);
        let rect: Rect = [
            [0, 1].map(|i| center[i] - size[i] * 0.5),
            [0, 1].map(|i| center[i] + size[i] * 0.5),
        ];
        let wish: f32 = if self.rng.random_bool(0.5) { 3.1 } else { 5.8 };
        let limit = self.height_limit(rect);
        let ridge = self.rng.random_range(1.8..3.4_f32);
        if limit > 4.5 {
            self.raise(rect, wish.min(limit - 1.5).max(2.9), ridge.min(limit * 0.5));
        }
        for corner in [
            [lot[0][0] + 1.6, lot[0][1] + 1.6],
            [lot[1][0] - 1.6, lot[1][1] - 1.6],
        ] {
            if self.rng.random_bool(0.6) {
                self.tree(corner);
            }
        }
        // A hedge along one side of the garden.
        let [low, high] = [
            [lot[0][0] + 0.3, lot[0][1] + 2.5],
            [lot[0][0] + 1.1, lot[1][1] - 2.5],
        ];
        if high[1] > low[1] + 2.0 && distance([low, high], self.vehicle) > CLEAR_M {
            let tint = Surface::Foliage(self.rng.random_range(0..64_u16));
            let top = self.rng.random_range(0.9..1.7_f32);
            self.mesh.block(
                Vec3A::new(low[0], low[1], 0.0),
                Vec3A::new(high[0], high[1], top),
                tint,
                tint,
            );
        }
    }

    fn raise(&mut self, [low, high]: Rect, height: f32, ridge: f32) {
        // Surfaces count buildings in 16 bits; cities of this size have some hundreds.
        let Ok(index) = u16::try_from(self.buildings.len()) else {
            return;
        };
        self.buildings
            .push(Building::draw(low, high, height, ridge, &mut *self.rng));
        let (walls, roof) = (Surface::Wall(index), Surface::Roof(index));
        let [bottom, top] = [
            Vec3A::new(low[0], low[1], 0.0),
            Vec3A::new(high[0], high[1], height),
        ];
        self.mesh.block(bottom, top, walls, roof);
        if ridge > 0.0 {
            self.gable([low, high], height, ridge, walls, roof);
        }
    }

    fn gable(&mut self, [low, high]: Rect, height: f32, ridge: f32, walls: Surface, roof: Surface) {
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

    /// Trees in a rectangle, one for every `area_m2` or so.
    fn scatter_trees(&mut self, [low, high]: Rect, area_m2: f32) {
        let size = [high[0] - low[0] - 3.0, high[1] - low[1] - 3.0];
        if size[0] <= 0.0 || size[1] <= 0.0 {
            return;
        }
        for _ in 0..(size[0] * size[1] / area_m2) as u32 {
            let at = [0, 1].map(|i| low[i] + 1.5 + self.rng.random_range(0.0..size[i]));
            self.tree(at);
        }
    }

    fn tree(&mut self, [x, y]: [f32; 2]) {
        let apart = distance([[x, y], [x, y]], self.vehicle);
        let height = self.rng.random_range(4.0..8.5_f32);
        let seed: u32 = self.rng.random();
        let crown = height * self.rng.random_range(0.24..0.34_f32);
        // Crowns keep below the skyline as well, or a park would hide the vehicle.
        let limit = apart * self.skyline[quarter_of([x, y], self.vehicle)] * 1.6;
        if apart < CLEAR_M + crown || apart > DETAIL_REACH_M || height > limit.max(4.6) {
            return;
        }
        let surface = Surface::Foliage((seed & 63) as u16);
        let trunk = [Vec3A::new(x, y, 0.0), Vec3A::new(x, y, height - crown)];
        self.mesh.tube(trunk, [0.17, 0.11], 6, Surface::Bark);
        let top = Vec3A::new(x, y, height - crown);
        self.mesh.blob(
            top,
            Vec3A::new(crown, crown, crown * 1.05),
            0.5,
            seed,
            surface,
        );
        if apart < 90.0 {
            for lump in 0..2_u16 {
                let [sin, cos] =
                    turn((f32::from((seed >> 8) as u8) + 110.0 * f32::from(lump)) / 256.0);
                let center =
                    top + Vec3A::new(cos * 0.55, sin * 0.55, -0.35 + 0.5 * f32::from(lump)) * crown;
                let size = crown * (0.62 + 0.1 * f32::from(lump));
                self.mesh.blob(
                    center,
                    Vec3A::splat(size),
                    0.5,
                    seed ^ u32::from(lump + 1),
                    surface,
                );
            }
        }
    }

    /// Lamp posts and trees along the pavements.
    fn furnish_streets(&mut self, layout: &Layout, reach_m: f32) {
        const SPACING_M: f32 = 13.0;
        let reach = reach_m.min(DETAIL_REACH_M);
        let steps = (reach / SPACING_M) as i32;
        for axis in 0..2 {
            for road in &layout.roads[axis] {
                let leafy = self.rng.random_bool(0.45);
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
                            self.tree(at);
                        }
                        if apart < 120.0 {
                            self.street_things(at, inward);
                        }
                    }
                }
            }
        }
    }

    /// Bins, bollards, cabinets, benches and signs beside a place at the kerb.
    fn street_things(&mut self, [x, y]: [f32; 2], inward: Vec3A) {
        let along = Vec3A::new(inward.y, inward.x, 0.0).abs();
        let shift = self.rng.random_range(2.0..5.0_f32);
        let foot = Vec3A::new(x, y, 0.0) + along * shift;
        let metal = Surface::Metal;
        match self.rng.random_range(0..8_u32) {
            0 => {
                for place in 0..5_u8 {
                    let low = foot + along * (f32::from(place) * 1.4);
                    self.mesh
                        .tube([low, low + Vec3A::Z * 0.95], [0.08, 0.08], 6, metal);
                }
            }
            1 => {
                let size = along * 0.9
                    + inward.abs() * 0.4
                    + Vec3A::Z * self.rng.random_range(1.0..1.5_f32);
                let low = foot - inward * 1.2;
                self.mesh.block(low, low + size, Surface::Bark, metal);
            }
            2 => {
                let seat = foot - inward * 1.6 + Vec3A::Z * 0.35;
                self.mesh.block(
                    seat,
                    seat + along * 1.7 + inward.abs() * 0.5 + Vec3A::Z * 0.1,
                    metal,
                    Surface::Bark,
                );
                let back = seat + Vec3A::Z * 0.1;
                self.mesh.block(
                    back,
                    back + along * 1.7 + Vec3A::new(0.06, 0.06, 0.4),
                    Surface::Bark,
                    Surface::Bark,
                );
            }
            3 | 4 => {
                self.mesh
                    .tube([foot, foot + Vec3A::Z * 2.7], [0.04, 0.04], 5, metal);
                let plate = foot + Vec3A::Z * 2.05 - inward.abs() * 0.3 - along * 0.02;
                self.mesh.block(
                    plate,
                    plate + inward.abs() * 0.6 + along * 0.04 + Vec3A::Z * 0.6,
                    Surface::Sign,
                    metal,
                );
            }
            5 => {
                let low = foot - inward * 0.4;
                self.mesh
                    .tube([low, low + Vec3A::Z * 0.9], [0.24, 0.28], 8, Surface::Bark);
            }
            _ => {}
        }
    }

    fn lamp_post(&mut self, [x, y]: [f32; 2], inward: Vec3A) {
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
