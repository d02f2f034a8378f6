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
        let narrow = if shape.style.is_boxy() { 0.90 } else { 0.80 };
        Self {
            middle_x: f32::midpoint(front, rear),
            half_length: (front - rear) * 0.5,
            half_width: shape.width * 0.5 * mix(0.935, narrow, s),
        }
    }
}

/// Height of the roof's rail, where windows end.
pub(crate) fn rail_height(shape: &Shape) -> f32 {
    shape.height - if shape.style.is_boxy() { 0.22 } else { 0.12 }
}

/// The whole car in vehicle axes, origin on the ground.
pub(crate) fn build(shape: &Shape) -> Mesh {
    let mut mesh = Mesh::default();
    lower_body(&mut mesh, shape);
    cabin(&mut mesh, shape);
    wheels(&mut mesh, shape);
    mirrors(&mut mesh, shape);
    fittings(&mut mesh, shape);
    mesh
}

/// Radius of the wheel arches against the wheels'.
pub(crate) const ARCH: f32 = 1.15;

/// Where along the length cross-sections stand: close together at the ends, where bumpers curve,
/// and around the wheel arches.
fn stations(shape: &Shape) -> Vec<f32> {
    const ENDS: [f32; 9] = [0.0, 0.003, 0.008, 0.016, 0.028, 0.045, 0.065, 0.09, 0.12];
    let mut parts: Vec<f32> = ENDS.iter().flat_map(|&p| [p, 1.0 - p]).collect();
    parts.extend((3..18_u8).map(|i| f32::from(i) * 0.05));
    parts.extend([shape.cowl_part, shape.deck_part]);
    for axle in shape.axles() {
        let radius = ARCH * shape.wheel_radius;
        for step in 0..=14_u8 {
            let [_, cos] = super::mesh::turn(f32::from(step) / 28.0);
            parts.push(0.5 - (axle + radius * 1.001 * cos) / shape.length);
        }
    }
    parts.retain(|part| (0.0..=1.0).contains(part));
    parts.sort_by(f32::total_cmp);
    parts.dedup_by(|a, b| *a - *b < 0.002);
    if let Some(last) = parts.last_mut() {
        *last = 1.0;
    }
    parts
}

/// Height of the wheel arches over the ground at this x, if one is there.
fn arch_height(shape: &Shape, x: f32) -> Option<f32> {
    let radius = ARCH * shape.wheel_radius;
    shape.axles().into_iter().find_map(|axle| {
        let rise = radius * radius - (x - axle) * (x - axle);
        (rise > 0.0).then(|| shape.wheel_radius + rise.sqrt())
    })
}

fn lower_body(mesh: &mut Mesh, shape: &Shape) {
    // Half a cross-section from the middle of the floor up to the middle of the bonnet: part of the
    // half width, part of the height. Sills are tucked in, a shoulder stands out below the windows.
    const SECTION: [[f32; 2]; 15] = [
        [0.0, 0.0],
        [0.66, 0.0],
        [0.70, 0.0],
        [0.90, 0.015],
        [0.945, 0.07],
        [0.965, 0.16],
        [0.972, 0.34],
        [0.985, 0.56],
        [1.0, 0.66],
        [0.998, 0.73],
        [0.972, 0.84],
        [0.945, 0.92],
        [0.885, 0.97],
        [0.52, 1.0],
        [0.0, 1.015],
    ];
    /// Points from here outwards give way to the wheels.
    const WELL: usize = 3;
    let boxy = shape.style.is_boxy();
    let rows: Vec<Vec<Vec3A>> = stations(shape)
        .into_iter()
        .map(|part| {
            let x = shape.x(part);
            // Seen from above, the nose is rounder than the tail.
            let (round, sharp) = if boxy { (0.07, 0.07) } else { (0.15, 0.10) };
            let to_end = if part < 0.5 {
                part / round
            } else {
                (1.0 - part) / sharp
            };
            let curve = (1.0 - to_end.min(1.0)).max(0.0);
            let half_width = shape.width * 0.49 * (1.0 - 0.22 * curve * curve * curve);
            let ends = (1.0 - part.min(1.0 - part) / 0.028).max(0.0);
            let low = shape.clearance + 0.09 * ends * ends;
            let high = belt_height(shape, part) - 0.15 * ends * ends;
            let arch = arch_height(shape, x).unwrap_or(0.0);
            let point = |index: usize, side: f32| {
                let [across, up] = SECTION[index];
                let flat = mix(low, high, up);
                let inside = index >= WELL && flat < arch;
                // The arch's lip stands out a little.
                let flare = if index >= WELL && flat < arch + 0.05 && arch > 0.0 {
                    0.012
                } else {
                    0.0
                };
                let z = if inside { arch.min(high - 0.05) } else { flat };
                Vec3A::new(x, side * (across * half_width + flare), z)
            };
            let last = SECTION.len() - 1;
            let left = (0..=last).map(|i| point(i, 1.0));
            let right = (1..last).rev().map(|i| point(i, -1.0));
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
    // Two over the exponent of the superellipse: an ellipse has 2, a rectangle a large one.
    const ROUNDNESS: f32 = 2.0 / 6.0;
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
            let outer = Vec3A::new(axle, side * (shape.width * 0.49 - 0.005), radius);
            let inner = outer - Vec3A::new(0.0, side * 0.24, 0.0);
            let shoulder = outer - Vec3A::new(0.0, side * 0.03, 0.0);
            mesh.tube([inner, shoulder], [radius, radius], 24, surface);
            mesh.tube([shoulder, outer], [radius, radius * 0.90], 24, surface);
            // The tyre's flank, then the rim a little further in.
            let rim = outer - Vec3A::new(0.0, side * 0.025, 0.0);
            mesh.tube([outer, rim], [radius * 0.90, radius * 0.68], 24, surface);
            mesh.disc(rim, radius * 0.68, 24, surface);
            mesh.disc(inner, radius, 24, surface);
        }
    }
}

fn mirrors(mesh: &mut Mesh, shape: &Shape) {
    let x = shape.x(shape.cowl_part + 0.055);
    let z = shape.cowl + 0.08;
    for side in [-1.0, 1.0] {
        let center = Vec3A::new(x, side * (shape.width * 0.5 + 0.06), z);
        let half = Vec3A::new(0.07, 0.11, 0.08);
        let trim = Surface::Vehicle(VehiclePart::Trim);
        mesh.blob(center, half, 0.0, 0, trim);
        let foot = Vec3A::new(x + 0.02, side * shape.width * 0.46, z - 0.07);
        mesh.tube([foot, center], [0.025, 0.025], 6, trim);
    }
}

/// What some styles carry on top: roof rails, a taxi's sign, a truck's box, an aerial.
fn fittings(mesh: &mut Mesh, shape: &Shape) {
    let top = shape.height;
    let [front, rear] = [shape.roof_front_part, shape.roof_rear_part].map(|part| shape.x(part));
    let middle = f32::midpoint(front, rear);
    let dark = Surface::Vehicle(VehiclePart::Rail);
    match shape.style {
        BodyStyle::Estate | BodyStyle::Suv => {
            let half_width = CabinOutline::at(shape, 1.0).half_width * 0.86;
            for side in [-1.0, 1.0] {
                let [from, to] = [front - 0.25, rear + 0.25]
                    .map(|x| Vec3A::new(x, side * half_width, top - 0.005));
                mesh.tube([from, to], [0.022, 0.022], 6, dark);
            }
        }
        BodyStyle::Taxi => {
            let sign = Surface::Vehicle(VehiclePart::RoofSign);
            let half = Vec3A::new(0.10, 0.32, 0.0);
            let at = Vec3A::new(middle + 0.25, 0.0, top - 0.02);
            mesh.slab(at - half, at + half + Vec3A::Z * 0.17, sign);
        }
        BodyStyle::Truck => {
            let cargo = Surface::Vehicle(VehiclePart::Cargo);
            let half_width = shape.width * 0.5;
            let [back, ahead] = [shape.x(0.99), shape.x(0.305)];
            let bevel = 0.05;
            // Two boxes, one narrower and one lower, bevel the long edges.
            mesh.slab(
                Vec3A::new(back, -half_width, 0.78),
                Vec3A::new(ahead, half_width, shape.box_top() - bevel),
                cargo,
            );
            mesh.slab(
                Vec3A::new(back + bevel, -half_width + bevel, 0.78),
                Vec3A::new(ahead - bevel, half_width - bevel, shape.box_top()),
                cargo,
            );
        }
        _ => {}
    }
    if !shape.style.is_boxy() && shape.style != BodyStyle::Pickup {
        let fin = Vec3A::new(rear + 0.28, 0.0, top - 0.01);
        mesh.blob(fin, Vec3A::new(0.09, 0.025, 0.05), 0.0, 0, dark);
    }
}
