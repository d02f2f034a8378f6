//! The vehicles around the target: in the lanes and at the kerbs of the roads about it.

use rand::{Rng, RngExt as _};

use super::city::City;
use super::layout::Road;
use super::vehicle::{Vehicle, Wardrobe};

/// Places tried for each vehicle before the scene does without it.
const ATTEMPTS: u32 = 60;
/// Free road before and behind, and beside a vehicle, metres.
const GAP_M: [f64; 2] = [0.6, 0.25];
/// Heights between which nothing of the city may stand where a vehicle does, metres: kerbs are
/// lower and street lamps higher.
const SOLID_M: [f32; 2] = [0.3, 2.6];
/// Room for a trunk or a bush on either side of its middle, metres.
const TRUNK_M: f32 = 0.4;
/// Nobody parks this close to a crossing, metres.
const CROSSING_M: f32 = 5.0;
/// The middle of a parked vehicle from the kerb, metres.
const PARKED_M: f32 = 1.15;

/// A rectangle on the ground that a vehicle takes up.
#[derive(Debug, Clone, Copy)]
pub(super) struct Footprint {
    pub at: [f64; 2],
    pub heading: f64,
    /// Half of its length and of its width, metres.
    pub half: [f64; 2],
}

impl Footprint {
    fn of(vehicle: &Vehicle) -> Self {
        let [x, y, _] = vehicle.center_world;
        let [forward_x, forward_y, _] = vehicle.forward_world;
        let [length, width, _] = vehicle.size_m;
        Self {
            at: [x, y],
            heading: libm::atan2(forward_y, forward_x),
            half: [0.5 * length, 0.5 * width],
        }
    }

    /// The directions of its length and its width.
    fn axes(&self) -> [[f64; 2]; 2] {
        let [sin, cos] = [libm::sin(self.heading), libm::cos(self.heading)];
        [[cos, sin], [-sin, cos]]
    }

    fn grown(mut self, by: [f64; 2]) -> Self {
        self.half = [0, 1].map(|i| self.half[i] + by[i]);
        self
    }

    /// Half of its extent along a direction.
    fn reach(&self, direction: [f64; 2]) -> f64 {
        let along = |axis: [f64; 2]| (axis[0] * direction[0] + axis[1] * direction[1]).abs();
        self.axes()
            .into_iter()
            .zip(self.half)
            .map(|(axis, half)| half * along(axis))
            .sum()
    }

    /// Whether two rectangles overlap: no side's direction separates them.
    fn overlaps(&self, other: &Self) -> bool {
        let apart = [0, 1].map(|i| other.at[i] - self.at[i]);
        self.axes().into_iter().chain(other.axes()).all(|axis| {
            let distance = (apart[0] * axis[0] + apart[1] * axis[1]).abs();
            distance < self.reach(axis) + other.reach(axis)
        })
    }

    /// The axis-aligned rectangle around it: lowest and highest corner.
    pub fn bounds(&self) -> [[f32; 2]; 2] {
        let reach = [self.reach([1.0, 0.0]), self.reach([0.0, 1.0])];
        [-1.0, 1.0].map(|sign| [0, 1].map(|i| (self.at[i] + sign * reach[i]) as f32))
    }
}

/// Which vehicles to put around a target.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crowd<'a> {
    /// Number of the first; styles and paints follow from it.
    pub first_number: u32,
    pub count: u32,
    /// Distance from the target, metres.
    pub radius_m: f64,
    pub wardrobe: &'a Wardrobe,
}

/// Vehicles beside the target: `count` of them, or fewer where there is no room, within about
/// `radius_m` of it.
///
/// Half stand in traffic around the target, the others anywhere along the roads, denser near it;
/// about a third are parked. Traffic keeps to the right. Nothing overlaps.
pub(super) fn surround(
    target: &Vehicle,
    crowd: Crowd,
    city: &City,
    rng: &mut impl Rng,
) -> Vec<Vehicle> {
    let Crowd {
        first_number,
        count,
        radius_m,
        wardrobe,
    } = crowd;
    let [x, y, _] = target.center_world;
    let obstacles = obstacles(city, [x as f32, y as f32], radius_m as f32 + 10.0);
    let mut taken = vec![Footprint::of(target)];
    let mut vehicles = Vec::new();
    for number in 0..count {
        let room_m = wardrobe.room_m(first_number + number);
        let place = (0..ATTEMPTS).find_map(|_| {
            let place = draw_place([x, y], radius_m, room_m, city, rng)?;
            let grown = place.grown(GAP_M);
            let free = !taken.iter().any(|other| grown.overlaps(other))
                && !obstacles.iter().any(|o| intersect(o, &place.bounds()));
            free.then_some(place)
        });
        if let Some(place) = place {
            let vehicle = Vehicle::draw(
                first_number + number,
                wardrobe,
                place.at,
                place.heading,
                rng,
            );
            taken.push(Footprint::of(&vehicle));
            vehicles.push(vehicle);
        }
    }
    vehicles
}

/// A place in a lane or at a kerb; None where the draw is no place for a vehicle.
fn draw_place(
    target: [f64; 2],
    radius_m: f64,
    room_m: [f64; 2],
    city: &City,
    rng: &mut impl Rng,
) -> Option<Footprint> {
    let layout = &city.layout;
    // The target's road runs along y, across axis 0.
    let axis = usize::from(rng.random_bool(0.3));
    let within: Vec<Road> = layout.roads[axis]
        .iter()
        .copied()
        .filter(|road| f64::from(road.center - target[axis] as f32).abs() < radius_m)
        .collect();
    let nearest = within.iter().min_by(|a, b| {
        let gap = |road: &Road| (road.center - target[axis] as f32).abs();
        gap(a).total_cmp(&gap(b))
    })?;
    let road = if rng.random_bool(0.7) {
        *nearest
    } else {
        within[rng.random_range(0..within.len())]
    };
    let spread = if rng.random_bool(0.5) {
        radius_m.min(18.0)
    } else {
        radius_m
    };
    let part: f64 = rng.random_range(-1.0..1.0);
    let along = target[1 - axis] + spread * part * part.abs().sqrt();
    let parked = rng.random_bool(0.35);
    let crossing = layout.nearest(1 - axis, along as f32);
    let to_crossing = crossing.offset.abs() - crossing.half_width;
    if parked && to_crossing < CROSSING_M {
        return None;
    }
    let side = if parked {
        road.half_width - PARKED_M.max(room_m[1] as f32)
    } else if road.half_width > 5.0 {
        road.half_width * [0.25, 0.75][rng.random_range(0..2_usize)]
    } else {
        road.half_width * 0.5
    };
    let wobble_deg: f64 = if parked { 1.5 } else { 2.5 };
    let forth = rng.random_bool(0.5);
    // Right of the direction +y is +x; right of +x is -y.
    let right = if axis == 0 { 1.0 } else { -1.0 };
    let across = f64::from(road.center) + f64::from(side) * if forth { right } else { -right };
    let quarter_turns = match (axis, forth) {
        (0, true) => 1.0,
        (0, false) => -1.0,
        (_, true) => 0.0,
        (_, false) => 2.0,
    };
    let heading = std::f64::consts::FRAC_PI_2 * quarter_turns
        + rng.random_range(-wobble_deg..wobble_deg).to_radians();
    let at = if axis == 0 {
        [across, along]
    } else {
        [along, across]
    };
    Some(Footprint {
        at,
        heading,
        half: room_m,
    })
}

/// Rectangles around the city's triangles that a vehicle could run into.
pub(super) fn obstacles(city: &City, around: [f32; 2], radius_m: f32) -> Vec<[[f32; 2]; 2]> {
    let area = [-radius_m, radius_m].map(|r| around.map(|v| v + r));
    city.mesh
        .triangles
        .iter()
        .filter_map(|triangle| {
            let [a, b, c] = triangle.vertices;
            let (low, high) = (a.min(b).min(c), a.max(b).max(c));
            let rect = [[low.x, low.y], [high.x, high.y]];
            (low.z < SOLID_M[1] && high.z > SOLID_M[0] && intersect(&area, &rect)).then_some(rect)
        })
        .chain(city.plants.iter().map(|plant| {
            let foot = [plant.foot.x, plant.foot.y];
            let reach = plant.reach_below(SOLID_M[1]).max(TRUNK_M);
            [-reach, reach].map(|r| foot.map(|v| v + r))
        }))
        .collect()
}

fn intersect(a: &[[f32; 2]; 2], b: &[[f32; 2]; 2]) -> bool {
    (0..2).all(|i| a[0][i] < b[1][i] && b[0][i] < a[1][i])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::Scene;

    fn scenes() -> impl Iterator<Item = Scene> {
        (0..12).map(|number| Scene::draw_with_traffic(9, number, 60.0, 8, 35.0))
    }

    #[test]
    fn no_two_vehicles_overlap() {
        for scene in scenes() {
            let footprints: Vec<Footprint> = scene.vehicles.iter().map(Footprint::of).collect();
            for (index, a) in footprints.iter().enumerate() {
                for b in &footprints[index + 1..] {
                    assert!(!a.overlaps(b), "{a:?} {b:?}");
                }
            }
        }
    }

    #[test]
    fn every_vehicle_stands_on_a_road_on_its_right_side_along_it() {
        for scene in scenes() {
            for vehicle in &scene.vehicles[1..] {
                let [x, y, _] = vehicle.center_world;
                let [forward_x, forward_y, _] = vehicle.forward_world;
                // Along which axis it drives, and how far right of the road's middle it is.
                let (axis, right) = if forward_y.abs() > forward_x.abs() {
                    (0, forward_y.signum())
                } else {
                    (1, -forward_x.signum())
                };
                let road = scene.city.layout.nearest(axis, [x, y][axis] as f32);
                let offset = f64::from(road.offset) * right;
                let half_width = f64::from(road.half_width);
                assert!(offset > 0.9 && offset < half_width - 0.9, "{vehicle:?}");
                assert!(forward_x.abs().max(forward_y.abs()) > 0.99);
            }
        }
    }

    #[test]
    fn no_vehicle_touches_anything_of_the_city() {
        for scene in scenes() {
            for vehicle in &scene.vehicles[1..] {
                let [x, y, _] = vehicle.center_world;
                let bounds = Footprint::of(vehicle).bounds();
                let near = obstacles(&scene.city, [x as f32, y as f32], 6.0);
                assert!(!near.iter().any(|o| intersect(o, &bounds)), "at {x}, {y}");
            }
        }
    }

    #[test]
    fn most_places_are_found_and_neighbours_in_number_differ_in_style() {
        let mut found = 0;
        for scene in scenes() {
            found += scene.vehicles.len();
            for pair in scene.vehicles.windows(2) {
                assert_ne!(pair[0].body_name(), pair[1].body_name());
            }
        }
        assert!(found > 12 * 7, "{found} of {}", 12 * 8);
    }
}
