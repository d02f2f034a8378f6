//! Buildings, trees and lamp posts on the city's plan.

use glam::Vec3A;
use rand::{Rng, RngExt as _};

use super::facade::{Building, Style};
use super::layout::{Block, Layout, PAVEMENT_M, Use};
use super::mesh::{Mesh, Surface, turn};
use super::tree::Plant;

/// Nothing but the ground stands within this distance of the vehicle, metres.
const CLEAR_M: f32 = 6.5;
/// Trees and lamp posts further from the vehicle than this are left out, metres.
const DETAIL_REACH_M: f32 = 230.0;
/// Balconies and awnings further from the vehicle than this are left out, metres.
const RELIEF_REACH_M: f32 = 120.0;

/// A city around a vehicle.
#[derive(Debug)]
pub(crate) struct City {
    /// Roads and blocks.
    pub layout: Layout,
    /// Buildings, as [`Surface::Wall`] and [`Surface::Roof`] number them.
    pub buildings: Vec<Building>,
    /// Everything that stands on the ground but trees.
    pub mesh: Mesh,
    /// Trees and bushes.
    pub plants: Vec<Plant>,
}

/// The space that a building takes, roughly.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Solid {
    /// Corner with the lowest coordinates.
    pub low: [f32; 2],
    /// Corner with the highest coordinates.
    pub high: [f32; 2],
    /// Height of its top, metres.
    pub top: f32,
}

/// An axis-aligned rectangle on the ground.
type Rect = [[f32; 2]; 2];

struct Builder<'a, R> {
    rng: &'a mut R,
    buildings: Vec<Building>,
    mesh: Mesh,
    plants: Vec<Plant>,
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
            plants: Vec::new(),
            vehicle,
            skyline,
        };
        for block in layout.blocks() {
            builder.fill(block);
        }
        builder.furnish_streets(&layout, reach_m);
        builder.traffic_lights(&layout);
        let Builder {
            buildings,
            mesh,
            plants,
            ..
        } = builder;
        Self {
            layout,
            buildings,
            mesh,
            plants,
        }
    }

    /// What hides the sky.
    pub fn solids(&self) -> impl Iterator<Item = Solid> {
        self.buildings.iter().map(|b| Solid {
            low: b.low,
            high: b.high,
            top: b.height + 0.5 * b.ridge,
        })
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
            self.scatter_trees(lot, 90.0);
            return;
        }
        let narrow = (lot[1][0] - lot[0][0]).min(lot[1][1] - lot[0][1]) < 12.0;
        let inset = if narrow || self.rng.random_bool(0.6) {
            0.0
        } else {
            self.rng.random_range(0.5..2.5_f32)
        };
        let rect: Rect = [lot[0].map(|v| v + inset), lot[1].map(|v| v - inset)];
        let tower = self.rng.random_bool(0.16);
        let wish = if tower {
            self.rng.random_range(30.0..64.0_f32)
        } else {
            self.rng.random_range(9.0..26.0_f32)
        };
        let height = wish.min(self.height_limit(rect));
        if height < 3.2 {
            self.scatter_trees(lot, 110.0);
            return;
        }
        let style = Style::draw(height, 0.0, &mut *self.rng);
        let side = (rect[1][0] - rect[0][0]).min(rect[1][1] - rect[0][1]);
        // Tall buildings often step back above the cornice of their neighbours.
        let step = self.rng.random_range(1.8..4.2_f32);
        if height > 22.0 && side > 14.0 && self.rng.random_bool(0.6) {
            let waist = height * self.rng.random_range(0.35..0.75_f32);
            self.raise(rect, 0.0, waist, 0.0, style);
            let upper = [rect[0].map(|v| v + step), rect[1].map(|v| v - step)];
            self.raise(upper, waist, height, 0.0, style);
            self.roof_units(upper, height);
        } else {
            self.raise(rect, 0.0, height, 0.0, style);
            self.roof_units(rect, height);
        }
    }

    /// Plant rooms, ventilation and masts.
    fn roof_units(&mut self, rect: Rect, height: f32) {
        for _ in 0..self.rng.random_range(1..6_u32) {
            let [x, y] = [0, 1].map(|i| {
                let (low, high) = (rect[0][i] + 1.2, rect[1][i] - 3.5);
                self.rng.random_range(low..high.max(low + 0.1))
            });
            let low = Vec3A::new(x, y, height);
            match self.rng.random_range(0..5_u32) {
                0 => {
                    let size = Vec3A::new(3.2, 2.6, 2.4) * self.rng.random_range(0.7..1.0_f32);
                    self.mesh.block(low, low + size, Surface::Painted(1), Surface::Painted(1));
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
                    self.mesh.block(low, high, Surface::Metal, Surface::Painted(2));
                }
            }
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
        let ridge = self.rng.random_range(1.8..3.4_f32).min(limit * 0.5);
        if limit > 4.5 {
            let height = wish.min(limit - 1.5).max(2.9);
            let style = Style::draw(height, ridge, &mut *self.rng);
            self.raise(rect, 0.0, height, ridge, style);
            let stack = Vec3A::new(center[0] + 1.3, center[1] + 0.4, height);
            let top = stack + Vec3A::new(0.6, 0.6, ridge + 0.5);
            self.mesh.block(stack, top, Surface::Painted(7), Surface::Painted(2));
        }
        for corner in [
            [lot[0][0] + 1.6, lot[0][1] + 1.6],
            [lot[1][0] - 1.6, lot[1][1] - 1.6],
        ] {
            if self.rng.random_bool(0.6) {
                let kind = self.rng.random_range(0..6_u8);
                self.tree(corner, kind);
            }
        }
        // A hedge along one side of the garden.
        let tall = self.rng.random_range(1.1..1.9_f32);
        let mut along = lot[0][1] + 2.5;
        while along < lot[1][1] - 2.5 {
            let at = [lot[0][0] + 0.7, along];
            if distance([at, at], self.vehicle) > CLEAR_M {
                let height = tall * self.rng.random_range(0.85..1.15_f32);
                self.plant(6, at, height);
            }
            along += tall * 0.75;
        }
    }

    fn raise(&mut self, [low, high]: Rect, base: f32, height: f32, ridge: f32, style: Style) {
        // Surfaces count buildings in 16 bits; cities of this size have some hundreds.
        let Ok(index) = u16::try_from(self.buildings.len()) else {
            return;
        };
        let building = Building {
            low,
            high,
            base,
            height,
            ridge,
            style,
        };
        self.buildings.push(building);
        let (walls, roof) = (Surface::Wall(index), Surface::Roof(index));
        let [bottom, top] = [
            Vec3A::new(low[0], low[1], base),
            Vec3A::new(high[0], high[1], height),
        ];
        self.mesh.block(bottom, top, walls, roof);
        if ridge > 0.0 {
            self.gable([low, high], height, ridge, walls, roof);
        } else {
            self.parapet([low, high], height, Surface::Stone(index));
            if distance([low, high], self.vehicle) < RELIEF_REACH_M {
                self.relief(&building, Surface::Stone(index));
            }
        }
    }

    /// The parapet around a flat roof, which stands out over the wall as a cornice.
    fn parapet(&mut self, [low, high]: Rect, height: f32, stone: Surface) {
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
    fn relief(&mut self, building: &Building, stone: Surface) {
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
                    slab(place(middle - half, 0.0, z), place(middle + half, 1.05, z + 0.14), stone);
                    let rail = if building.style.seed.is_multiple_of(2) {
                        Surface::Painted(2)
                    } else {
                        stone
                    };
                    slab(place(middle - half, 1.0, z), place(middle + half, 1.05, z + 1.05), rail);
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
                let [from, to] = [shop.start + 0.2, (shop.start + shop.width).min(length) - 0.2];
                let cloth = [
                    place(from, 0.02, z),
                    place(to, 0.02, z),
                    place(to, 1.25, z - 0.5),
                    place(from, 1.25, z - 0.5),
                ];
                self.mesh.polygon(&cloth, surface);
                let drop = Vec3A::Z * -0.22;
                self.mesh.polygon(&[cloth[3], cloth[2], cloth[2] + drop, cloth[3] + drop], surface);
            }
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
            let kind = self.rng.random_range(0..6_u8);
            self.tree(at, kind);
            // Bushes under some of them.
            if self.rng.random_bool(0.5) {
                let spread = [(); 2].map(|()| self.rng.random_range(-3.0..3.0_f32));
                let beside = [at[0] + spread[0], at[1] + spread[1]];
                if distance([beside, beside], self.vehicle) > CLEAR_M + 2.0 {
                    let height = self.rng.random_range(0.7..1.6_f32);
                    self.plant(6, beside, height);
                }
            }
        }
    }

    fn tree(&mut self, [x, y]: [f32; 2], kind: u8) {
        let apart = distance([[x, y], [x, y]], self.vehicle);
        let height = self.rng.random_range(4.5..9.5_f32);
        let crown = height * 0.34;
        // Crowns keep below the skyline as well, or a park would hide the vehicle.
        let limit = apart * self.skyline[quarter_of([x, y], self.vehicle)] * 1.6;
        if apart < CLEAR_M + crown || apart > DETAIL_REACH_M || height > limit.max(5.0) {
            return;
        }
        self.plant(kind, [x, y], height);
    }

    fn plant(&mut self, kind: u8, at: [f32; 2], height: f32) {
        let apart = distance([at, at], self.vehicle);
        let foot = Vec3A::new(at[0], at[1], 0.0);
        let plant = Plant::new(kind, foot, height, apart, &mut *self.rng);
        self.plants.push(plant);
    }

    /// Lamp posts and trees along the pavements.
    fn furnish_streets(&mut self, layout: &Layout, reach_m: f32) {
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
    fn street_things(&mut self, [x, y]: [f32; 2], inward: Vec3A) {
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
                    mesh.blob(low + Vec3A::Z * 0.9, Vec3A::splat(0.07), 0.0, 0, Surface::Metal);
                }
            }
            1 => {
                let tall = self.rng.random_range(1.0..1.5_f32);
                mesh.block(back, back + along * 0.9 + across * 0.4 + Vec3A::Z * tall, paint, paint);
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
                    mesh.slab(low, low + along * 1.7 + across * 0.09 + Vec3A::Z * 0.04, Surface::Painted(6));
                }
                for slat in 0..3_u8 {
                    let low = back + Vec3A::Z * (0.55 + 0.13 * f32::from(slat));
                    mesh.slab(low, low + along * 1.7 + across * 0.04 + Vec3A::Z * 0.09, Surface::Painted(6));
                }
            }
            4 | 5 => {
                mesh.tube([foot, foot + Vec3A::Z * 2.7], [0.035, 0.035], 8, Surface::Metal);
                let plate = foot + Vec3A::Z * 2.05 - across * 0.3 - along * 0.06;
                mesh.slab(plate, plate + across * 0.6 + along * 0.02 + Vec3A::Z * 0.6, Surface::Sign);
            }
            6 | 7 => {
                let low = foot - inward * 0.4;
                mesh.tube([low, low + Vec3A::Z * 0.85], [0.22, 0.25], 10, paint);
                mesh.tube([low + Vec3A::Z * 0.85, low + Vec3A::Z * 0.97], [0.27, 0.12], 10, Surface::Painted(2));
            }
            8 => {
                // A hydrant.
                let red = Surface::Painted(4);
                mesh.tube([foot, foot + Vec3A::Z * 0.55], [0.12, 0.11], 9, red);
                mesh.blob(foot + Vec3A::Z * 0.58, Vec3A::splat(0.13), 0.0, 0, red);
                let arm = along * 0.22;
                mesh.tube([foot + Vec3A::Z * 0.4 - arm, foot + Vec3A::Z * 0.4 + arm], [0.06, 0.06], 7, red);
            }
            _ => {}
        }
    }

    /// Traffic lights at the corners of the crossings near the vehicle.
    fn traffic_lights(&mut self, layout: &Layout) {
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
                        column.center + sx * (column.half_width + 0.9),
                        row.center + sy * (row.half_width + 0.9),
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
    fn lamp(&mut self, center: Vec3A, outward: Vec3A, radius: f32, surface: Surface) {
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
