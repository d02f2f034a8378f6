//! The user's props on the pavements around the target.

use rand::{Rng, RngExt as _};

use super::city::City;
use super::traffic::{Footprint, obstacles};
use super::vehicle::{OwnAssets, placed};

/// Props stand within this distance of the target along each axis, metres.
const REACH_M: f32 = 120.0;
/// From the kerb to a prop, and from the corner of a crossing, metres.
const KERB_M: f64 = 0.45;
const CORNER_M: f32 = 5.0;

/// Puts props along the roads, their fronts to the road.
///
/// Nothing overlaps; where there is no room, there is no prop.
pub(super) fn furnish(city: &mut City, own: &OwnAssets, target: [f32; 2], rng: &mut impl Rng) {
    let numbers = own.library.prop_numbers();
    if numbers.is_empty() {
        return;
    }
    let mut taken = obstacles(city, target, REACH_M + 20.0);
    let spacing_m = own.prop_spacing_m as f32;
    let roads = city.layout.roads.clone();
    let mut turn = rng.random_range(0..numbers.len());
    for (axis, roads) in roads.iter().enumerate() {
        for road in roads {
            if (road.center - target[axis]).abs() > REACH_M {
                continue;
            }
            for side in [-1.0, 1.0_f64] {
                for step in 0..(2.0 * REACH_M / spacing_m) as u32 {
                    let shift: f32 = rng.random_range(0.0..1.0);
                    let wobble: f64 = rng.random_range(-4.0..4.0);
                    let along = target[1 - axis] - REACH_M + spacing_m * (step as f32 + shift);
                    let number = numbers[turn % numbers.len()];
                    let model = own.library.model(number);
                    let [depth, length, _] = model.size_m.map(f64::from);
                    let crossing = city.layout.nearest(1 - axis, along);
                    if crossing.offset.abs() < crossing.half_width + CORNER_M + 0.5 * length as f32
                    {
                        continue;
                    }
                    let across = f64::from(road.center)
                        + side * (f64::from(road.half_width) + KERB_M + 0.5 * depth);
                    // Its front looks across the kerb, along -side of the axis across the road.
                    let inward = match (axis, side < 0.0) {
                        (0, true) => 0.0,
                        (0, false) => 2.0,
                        (_, true) => 1.0,
                        (_, false) => -1.0,
                    };
                    let heading = std::f64::consts::FRAC_PI_2 * inward + wobble.to_radians();
                    let at = if axis == 0 {
                        [across, f64::from(along)]
                    } else {
                        [f64::from(along), across]
                    };
                    let bounds = Footprint {
                        at,
                        heading,
                        half: [0.5 * depth + 0.1, 0.5 * length + 0.1],
                    }
                    .bounds();
                    let overlaps = |[low, high]: &[[f32; 2]; 2]| {
                        (0..2).all(|i| low[i] < bounds[1][i] && bounds[0][i] < high[i])
                    };
                    if taken.iter().any(overlaps) {
                        continue;
                    }
                    taken.push(bounds);
                    city.mesh.append(placed(&model.triangles, at, heading));
                    turn += 1;
                }
            }
        }
    }
}
