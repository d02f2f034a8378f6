//! How much of the sky each place in the streets sees: ambient occlusion by buildings.
//!
//! A coarse grid at a few heights holds, for eight directions, how high the skyline stands; from it
//! follows which share of the sky's light reaches a level and an upright surface. Blending between
//! cells keeps the shade smooth, so both eyes see the same.

use glam::Vec3A;

use crate::world::city::City;
use crate::world::mesh::turn;
use crate::world::noise::mix;

/// Side of a cell, metres.
const CELL_M: f32 = 4.0;
/// Cells along a side: the grid reaches 150 m in every direction from the vehicle.
const CELLS: usize = 76;
/// Heights over the ground at which the skyline is looked at, metres.
const HEIGHTS_M: [f32; 4] = [0.5, 5.0, 13.0, 30.0];
const DIRECTIONS: u16 = 8;
/// Distances at which the skyline is looked for, metres.
const STEPS_M: [f32; 10] = [4.0, 7.0, 11.0, 16.0, 22.0, 30.0, 40.0, 54.0, 72.0, 96.0];

/// What a place sees of the sky.
#[derive(Debug, Clone, Copy, Default)]
struct View {
    /// Share of the sky's light that reaches a level surface.
    up: f32,
    /// Share that reaches an upright one: mean, and how it changes with the direction it faces.
    side: f32,
    lean: [f32; 2],
}

/// The grid around a vehicle.
#[derive(Debug)]
pub(crate) struct Openness {
    low: [f32; 2],
    /// By height, row and column.
    views: Vec<View>,
}

impl Openness {
    /// Looks at a city around a place.
    pub fn new(city: &City, around: [f32; 2]) -> Self {
        let low = around.map(|v| v - 0.5 * CELL_M * CELLS as f32);
        let mut skyline = vec![0.0_f32; CELLS * CELLS];
        let cell = |v: f32, axis: usize| (v - low[axis]) / CELL_M;
        for solid in city.solids() {
            // Cells whose middle lies inside.
            let first = [0, 1].map(|i| (cell(solid.low[i], i) - 0.5).ceil().max(0.0) as usize);
            let last = [0, 1].map(|i| {
                (cell(solid.high[i], i) + 0.5)
                    .floor()
                    .clamp(0.0, CELLS as f32)
            });
            for row in first[1]..last[1] as usize {
                for column in first[0]..last[0] as usize {
                    let height = &mut skyline[row * CELLS + column];
                    *height = height.max(solid.top);
                }
            }
        }
        let rays: Vec<[f32; 2]> = (0..DIRECTIONS)
            .map(|i| {
                let [sin, cos] = turn(f32::from(i) / f32::from(DIRECTIONS));
                [cos, sin]
            })
            .collect();
        let mut views = Vec::with_capacity(HEIGHTS_M.len() * CELLS * CELLS);
        for height in HEIGHTS_M {
            let mut layer: Vec<Option<View>> = Vec::with_capacity(CELLS * CELLS);
            for row in 0..CELLS {
                for column in 0..CELLS {
                    let inside = skyline[row * CELLS + column] > height;
                    layer.push((!inside).then(|| look(&skyline, [column, row], height, &rays)));
                }
            }
            views.extend(spread(&layer));
        }
        Self { low, views }
    }

    /// The share of the sky's light that reaches a surface here.
    pub fn at(&self, at: Vec3A, normal: Vec3A) -> f32 {
        // A wall sees what the street in front of it sees.
        let [x, y] = [(at.x, normal.x, 0), (at.y, normal.y, 1)]
            .map(|(v, n, i)| (v + 2.5 * n - self.low[i]) / CELL_M - 0.5);
        let edge = (CELLS - 1) as f32;
        if !(x >= 0.0 && y >= 0.0 && x < edge && y < edge) {
            return 0.85;
        }
        let above = HEIGHTS_M.iter().position(|&h| at.z < h);
        let (first, part) = match above {
            Some(0) => (0, 0.0),
            Some(i) => (
                i - 1,
                (at.z - HEIGHTS_M[i - 1]) / (HEIGHTS_M[i] - HEIGHTS_M[i - 1]),
            ),
            None => (HEIGHTS_M.len() - 1, 0.0),
        };
        let lower = self.layer(first, x, y, normal);
        let open = if part > 0.0 {
            mix(lower, self.layer(first + 1, x, y, normal), part)
        } else {
            lower
        };
        // Over the highest layer the sky opens up.
        let over = ((at.z - HEIGHTS_M[HEIGHTS_M.len() - 1]) / 30.0).clamp(0.0, 1.0);
        mix(open, 1.0, over)
    }

    fn layer(&self, layer: usize, x: f32, y: f32, normal: Vec3A) -> f32 {
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let level = normal.z.max(0.0);
        let at = |dx: usize, dy: usize| {
            let view = self.views[(layer * CELLS + row + dy) * CELLS + column + dx];
            let side = view.side + view.lean[0] * normal.x + view.lean[1] * normal.y;
            mix(side, view.up, level)
        };
        let open = mix(mix(at(0, 0), at(1, 0), fx), mix(at(0, 1), at(1, 1), fx), fy);
        open.clamp(0.03, 1.0)
    }
}

/// Looks around from the middle of a cell.
fn look(skyline: &[f32], [column, row]: [usize; 2], height: f32, rays: &[[f32; 2]]) -> View {
    let mut view = View::default();
    let share = 1.0 / rays.len() as f32;
    for ray in rays {
        let mut steepest = 0.0_f32;
        for step in STEPS_M {
            let place = [(column, ray[0]), (row, ray[1])]
                .map(|(cell, along)| (cell as f32 + 0.5 + along * step / CELL_M).floor());
            if place.iter().any(|&v| v < 0.0 || v >= CELLS as f32) {
                break;
            }
            let rise = skyline[place[1] as usize * CELLS + place[0] as usize] - height;
            steepest = steepest.max(rise / step);
        }
        let sine = steepest / (1.0 + steepest * steepest).sqrt();
        // A level surface weighs the sky by the sine of its height, so the hidden part has sin^2.
        view.up += share * (1.0 - sine * sine);
        let side = 1.0 - sine * (1.27 - 0.27 * sine);
        view.side += share * side;
        view.lean[0] += share * 1.5 * side * ray[0];
        view.lean[1] += share * 1.5 * side * ray[1];
    }
    view
}

/// Fills the cells inside buildings with the mean of their free neighbours.
fn spread(layer: &[Option<View>]) -> Vec<View> {
    let free = |row: usize, column: usize| layer[row * CELLS + column];
    (0..CELLS * CELLS)
        .map(|index| {
            let (row, column) = (index / CELLS, index % CELLS);
            if let Some(view) = free(row, column) {
                return view;
            }
            let (mut sum, mut count) = (View::default(), 0.0_f32);
            for r in row.saturating_sub(1)..=(row + 1).min(CELLS - 1) {
                for c in column.saturating_sub(1)..=(column + 1).min(CELLS - 1) {
                    if let Some(view) = free(r, c) {
                        sum.up += view.up;
                        sum.side += view.side;
                        sum.lean = [0, 1].map(|i| sum.lean[i] + view.lean[i]);
                        count += 1.0;
                    }
                }
            }
            if count == 0.0 {
                return View {
                    up: 0.5,
                    side: 0.5,
                    lean: [0.0; 2],
                };
            }
            View {
                up: sum.up / count,
                side: sum.side / count,
                lean: sum.lean.map(|v| v / count),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::Scene;

    #[test]
    fn roofs_see_more_of_the_sky_than_streets_and_shares_stay_in_range() {
        for number in 0..4 {
            let scene = Scene::draw(5, number, 60.0);
            let [x, y, _] = scene.target().center_world.map(|v| v as f32);
            let openness = Openness::new(&scene.city, [x, y]);
            for i in 0..400_u16 {
                let [dx, dy] = [i % 20, i / 20].map(|k| f32::from(k) * 14.0 - 140.0);
                let at = |z| openness.at(Vec3A::new(x + dx, y + dy, z), Vec3A::Z);
                let (street, high) = (at(0.0), at(90.0));
                assert!((0.03..=1.0).contains(&street) && street <= high + 1e-6);
                assert!(high > 0.8, "{high}");
            }
        }
    }
}
