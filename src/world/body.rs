//! The car's shape: a lofted lower body, a lofted cabin, wheels and mirrors.

use glam::Vec3A;

use super::mesh::{Mesh, Surface, VehiclePart};
use super::noise::mix;
use super::vehicle::{BodyStyle, Shape};

/// Height of the window line along the car, where the cabin stands on the lower body.
pub(crate) fn belt_height(shape: &Shape, part: f32) -> f32 {
    // A bonnet rises steeply behind the bumper and then ever less.
    let ahead = (1.0 - part / shape.cowl_part).max(0.0);
    let bonnet = mix(shape.cowl, shape.nose, ahead * ahead);
    let side = mix(
        shape.cowl,
        shape.deck,
        ((part - shape.cowl_part) / (shape.deck_part - shape.cowl_part)).clamp(0.0, 1.0),
    );
    if part < shape.cowl_part { bonnet } else { side }
}

/// The cabin's outline at a part `s` of the way from the window line (0) to the roof's rail (1).
pub(crate) struct CabinOutline {
    /// Middle along x.
    pub middle_x: f32,
    /// Half the length.
    pub half_length: f32,
    /// Half the width.
    pub half_width: f32,
}

impl CabinOutline {
    /// The outline at this height part.
    pub fn at(shape: &Shape, s: f32) -> Self {
        let front = mix(shape.x(shape.cowl_part), shape.x(shape.roof_front_part), s);
        let rear = mix(shape.x(shape.deck_part), shape.x(shape.roof_rear_part), s);
        let narrow = if shape.style == BodyStyle::Van {
            0.90
        } else {
            0.80
        };
        Self {
            middle_x: f32::midpoint(front, rear),
            half_length: (front - rear) * 0.5,
            half_width: shape.width * 0.5 * mix(0.94, narrow, s),
        }
    }
}

/// Height of the roof's rail, where windows end.
pub(crate) fn rail_height(shape: &Shape) -> f32 {
    shape.height
        - if shape.style == BodyStyle::Van {
            0.22
        } else {
            0.12
        }
}

/// The whole car in vehicle axes, origin on the ground.
pub(crate) fn build(shape: &Shape) -> Mesh {
    let mut mesh = Mesh::default();
    lower_body(&mut mesh, shape);
    cabin(&mut mesh, shape);
    wheels(&mut mesh, shape);
    mirrors(&mut mesh, shape);
    mesh
}

fn lower_body(mesh: &mut Mesh, shape: &Shape) {
    // Stations crowd at the ends, where bumpers curve.
    const STATIONS: [f32; 27] = [
        0.0, 0.004, 0.012, 0.025, 0.045, 0.07, 0.11, 0.16, 0.21, 0.26, 0.32, 0.38, 0.44, 0.50,
        0.56, 0.62, 0.68, 0.74, 0.80, 0.85, 0.89, 0.925, 0.95, 0.97, 0.985, 0.995, 1.0,
    ];
    // Half a cross-section from the middle of the floor up to the middle of the bonnet:
    // part of the half width, part of the height.
    const SECTION: [[f32; 2]; 10] = [
        [0.0, 0.0],
        [0.84, 0.0],
        [0.94, 0.05],
        [0.985, 0.18],
        [1.0, 0.50],
        [0.992, 0.72],
        [0.965, 0.88],
        [0.90, 0.965],
        [0.55, 1.0],
        [0.0, 1.02],
    ];
    let rows: Vec<Vec<Vec3A>> = STATIONS
        .iter()
        .map(|&part| {
            let to_end = part.min(1.0 - part) / 0.10;
            let curve = (1.0 - to_end.min(1.0)).max(0.0);
            let half_width = shape.width * 0.49 * (1.0 - 0.20 * curve * curve * curve);
            let ends = (1.0 - to_end * 4.0).max(0.0);
            let low = shape.clearance + 0.10 * ends * ends;
            let high = belt_height(shape, part) - 0.16 * ends * ends;
            let point = |[across, up]: [f32; 2], side: f32| {
                Vec3A::new(
                    shape.x(part),
                    side * across * half_width,
                    mix(low, high, up),
                )
            };
            let left = SECTION.iter().map(|&p| point(p, 1.0));
            let right = SECTION[1..9].iter().rev().map(|&p| point(p, -1.0));
            left.chain(right).collect()
        })
        .collect();
    let body = Surface::Vehicle(VehiclePart::Body);
    mesh.grid(&rows, true, body);
    for end in [&rows[0], &rows[rows.len() - 1]] {
        mesh.polygon(end, body);
    }
}

/// A ring of points around an outline: a rectangle with rounded corners.
fn ring(outline: &CabinOutline, shrink: f32, height: impl Fn(f32) -> f32) -> Vec<Vec3A> {
    const POINTS: u16 = 44;
    // The exponent of the superellipse: 2 is an ellipse, large is a rectangle.
    const ROUNDNESS: f32 = 2.0 / 7.0;
    (0..POINTS)
        .map(|i| {
            let [sin, cos] = super::mesh::turn(f32::from(i) / f32::from(POINTS));
            let bend = |v: f32| libm::powf(v.abs(), ROUNDNESS).copysign(v);
            let x = outline.middle_x + (outline.half_length - shrink) * bend(cos);
            let y = (outline.half_width - shrink) * bend(sin);
            Vec3A::new(x, y, height(x))
        })
        .collect()
}

fn cabin(mesh: &mut Mesh, shape: &Shape) {
    let rail = rail_height(shape);
    let belt_at = |x: f32| belt_height(shape, 0.5 - x / shape.length) - 0.03;
    let mut rows: Vec<Vec<Vec3A>> = [0.0_f32, 0.35, 0.7, 1.0]
        .iter()
        .map(|&s| {
            let outline = CabinOutline::at(shape, s);
            // Windows bulge a little between window line and rail.
            let bulge = 0.035 * s * (1.0 - s) * 4.0;
            ring(&outline, -bulge, |x| mix(belt_at(x), rail, s))
        })
        .collect();
    let top = CabinOutline::at(shape, 1.0);
    let rise = shape.height - rail;
    // The roof: inset as a share of the half width, height as a share of the rise.
    for [inset, up] in [[0.05, 0.45], [0.14, 0.75], [0.40, 0.95], [0.95, 1.0]] {
        let shrink = inset * top.half_width;
        rows.push(ring(&top, shrink, |_| rail + rise * up));
    }
    mesh.grid(&rows, true, Surface::Vehicle(VehiclePart::Cabin));
    mesh.polygon(&rows[rows.len() - 1], Surface::Vehicle(VehiclePart::Cabin));
}

fn wheels(mesh: &mut Mesh, shape: &Shape) {
    let surface = Surface::Vehicle(VehiclePart::Wheel);
    let radius = shape.wheel_radius;
    for axle in shape.axles() {
        for side in [-1.0, 1.0] {
            let outer = Vec3A::new(axle, side * shape.width * 0.5, radius);
            let inner = outer - Vec3A::new(0.0, side * 0.24, 0.0);
            let shoulder = outer - Vec3A::new(0.0, side * 0.03, 0.0);
            mesh.tube([inner, shoulder], [radius, radius], 24, surface);
            mesh.tube([shoulder, outer], [radius, radius * 0.88], 24, surface);
            mesh.disc(outer, radius * 0.88, 24, surface);
            mesh.disc(inner, radius, 24, surface);
        }
    }
}

fn mirrors(mesh: &mut Mesh, shape: &Shape) {
    let x = shape.x(shape.cowl_part + 0.055);
    let z = shape.cowl + 0.08;
    for side in [-1.0, 1.0] {
        let center = Vec3A::new(x, side * (shape.width * 0.5 + 0.04), z);
        let half = Vec3A::new(0.06, 0.10, 0.075);
        mesh.blob(center, half, 0.0, 0, Surface::Vehicle(VehiclePart::Trim));
    }
}
