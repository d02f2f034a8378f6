//! Buildings, trees and lamp posts on the city's plan.

mod relief;
mod street;

use glam::Vec3A;
use rand::{Rng, RngExt as _};

use super::facade::{Building, Style};
use super::layout::{Block, Layout, PAVEMENT_M, Use};
use super::mesh::{Mesh, Surface};
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
            Use::Park => self.scatter_trees(inner, 130.0, true),
            Use::Plaza | Use::Parking => self.scatter_trees(inner, 600.0, false),
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
            self.scatter_trees(lot, 90.0, true);
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
            self.scatter_trees(lot, 110.0, true);
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
            self.mesh
                .block(stack, top, Surface::Painted(7), Surface::Painted(2));
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

    /// Trees in a rectangle, one for every `area_m2` or so.
    fn scatter_trees(&mut self, [low, high]: Rect, area_m2: f32, bushes: bool) {
        let size = [high[0] - low[0] - 3.0, high[1] - low[1] - 3.0];
        if size[0] <= 0.0 || size[1] <= 0.0 {
            return;
        }
        for _ in 0..(size[0] * size[1] / area_m2) as u32 {
            let at = [0, 1].map(|i| low[i] + 1.5 + self.rng.random_range(0.0..size[i]));
            let kind = self.rng.random_range(0..6_u8);
            self.tree(at, kind);
            // Bushes under some of them.
            if bushes && self.rng.random_bool(0.6) {
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
}
