//! What the car's surface looks like: windows, lamps, seams, plates, wheels.
//!
//! These details are painted on by position instead of modelled: at 10 to 60 m they are a few
//! pixels wide, and a painted line can be averaged over a pixel where a thin triangle cannot.

mod details;

use glam::Vec3A;

use super::body::{ARCH, CabinOutline, belt_height, rail_height};
use super::mesh::VehiclePart;
use super::noise::{self, mix, stripe, stripes};
use super::vehicle::{BodyStyle, Bodywork, Shape};
use details::{cargo, head_lamp, number_plate, roof_sign, tail_lamp};

/// What a point of the car sends back.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Finish {
    /// Diffuse reflectance.
    pub albedo: Vec3A,
    /// Share of light mirrored when seen straight on; it rises towards grazing angles.
    pub mirror: f32,
    /// Reflectance of metal flakes under the clear coat.
    pub flakes: Vec3A,
    /// Shares of the sky's and the sun's light that reach it.
    pub open: f32,
    pub sun: f32,
    /// Light of its own.
    pub glow: Vec3A,
}

const fn shiny(albedo: Vec3A, mirror: f32) -> Finish {
    Finish {
        albedo,
        mirror,
        flakes: Vec3A::ZERO,
        open: 1.0,
        sun: 1.0,
        glow: Vec3A::ZERO,
    }
}

const fn matt(level: f32) -> Finish {
    shiny(Vec3A::splat(level), 0.0)
}

const GLASS: Finish = shiny(Vec3A::new(0.010, 0.012, 0.013), 0.06);
const RUBBER: Finish = matt(0.016);
const PLASTIC: Finish = shiny(Vec3A::splat(0.024), 0.02);
const LAMP: Finish = shiny(Vec3A::new(0.36, 0.38, 0.40), 0.16);
const TAIL_LAMP: Finish = shiny(Vec3A::new(0.30, 0.006, 0.008), 0.06);
const PLATE: Finish = matt(0.62);
const CHROME: Finish = Finish {
    flakes: Vec3A::splat(0.25),
    ..shiny(Vec3A::splat(0.10), 0.55)
};
/// In a wheel arch, a grille or a gap little light finds its way.
const HOLLOW: Finish = Finish {
    open: 0.25,
    sun: 0.15,
    ..matt(0.012)
};

/// The finish of a point, both arguments in vehicle axes.
pub(crate) fn finish(
    vehicle: &Bodywork,
    part: VehiclePart,
    at: Vec3A,
    normal: Vec3A,
    footprint_m: f32,
) -> Finish {
    let coat = Finish {
        flakes: vehicle.flakes,
        ..shiny(vehicle.paint, 0.045)
    };
    match part {
        VehiclePart::Body => body(vehicle, coat, at, normal, footprint_m),
        VehiclePart::Cabin => cabin(vehicle, coat, at, normal),
        VehiclePart::Wheel => wheel(&vehicle.shape, vehicle.seed, at),
        VehiclePart::Rail => PLASTIC,
        VehiclePart::RoofSign => roof_sign(at, normal, footprint_m),
        VehiclePart::Cargo => cargo(vehicle, at, normal, footprint_m),
        VehiclePart::Trim => {
            if vehicle.seed.is_multiple_of(3) {
                PLASTIC
            } else {
                coat
            }
        }
    }
}

fn within(value: f32, low: f32, high: f32) -> bool {
    value >= low && value <= high
}

fn body(vehicle: &Bodywork, coat: Finish, at: Vec3A, normal: Vec3A, footprint_m: f32) -> Finish {
    let shape = &vehicle.shape;
    let half_width = shape.width * 0.5;
    let across = at.y.abs() / half_width;
    let rugged = matches!(shape.style, BodyStyle::Suv | BodyStyle::Pickup);
    if normal.z < -0.7 {
        return HOLLOW;
    }

    if across > 0.55 {
        for axle in shape.axles() {
            let (dx, dz) = (at.x - axle, at.z - shape.wheel_radius);
            let reach = (dx * dx + dz * dz).sqrt() / shape.wheel_radius;
            if reach < ARCH - 0.02 {
                return HOLLOW;
            }
            if rugged && reach < 1.30 {
                return PLASTIC;
            }
        }
    }
    if at.z < shape.clearance + if rugged { 0.17 } else { 0.08 } {
        return PLASTIC;
    }
    let to_front = shape.length * 0.5 - at.x;
    let to_rear = shape.length * 0.5 + at.x;
    if to_front < 0.45
        && let Some(finish) = front(vehicle, at, across, to_front, footprint_m)
    {
        return finish;
    }
    if to_rear < 0.45
        && let Some(finish) = rear(vehicle, at, across, to_rear, footprint_m)
    {
        return finish;
    }
    if shape.style == BodyStyle::Pickup && normal.z.abs() > 0.6 {
        let part = 0.5 - at.x / shape.length;
        if within(part, shape.deck_part + 0.005, 0.972) && across < 0.84 {
            let ribs = stripes(at.y, 0.16, 0.0, 0.06, footprint_m);
            return matt(0.022 + 0.03 * ribs);
        }
    }
    let seam = seams(shape, at, normal, across, footprint_m);
    if shape.style == BodyStyle::Taxi
        && across > 0.9
        && within(at.z, shape.cowl - 0.26, shape.cowl - 0.14)
    {
        let row = f32::from(u8::from(at.z > shape.cowl - 0.20));
        let checks = stripes(at.x + 0.06 * row, 0.12, 0.0, 0.06, footprint_m);
        return shiny(Vec3A::splat(mix(0.02, 0.65, checks)), coat.mirror);
    }
    Finish {
        albedo: coat.albedo * (1.0 - 0.9 * seam),
        flakes: coat.flakes * (1.0 - 0.9 * seam),
        mirror: coat.mirror * (1.0 - seam),
        ..coat
    }
}

fn front(
    vehicle: &Bodywork,
    at: Vec3A,
    across: f32,
    to_front: f32,
    footprint_m: f32,
) -> Option<Finish> {
    let shape = &vehicle.shape;
    let lamp_low = shape.nose - 0.27;
    if within(across, 0.50, 0.97)
        && within(at.z, lamp_low + 0.05 * (1.0 - across), shape.nose - 0.12)
    {
        return Some(head_lamp(vehicle, at, across, lamp_low));
    }
    if to_front > 0.16 {
        return None;
    }
    if within(at.z, shape.nose - 0.36, shape.nose - 0.17) && across < 0.46 {
        let badge = at.y * at.y + (at.z - shape.nose + 0.26) * (at.z - shape.nose + 0.26) < 0.0036;
        return Some(if badge {
            CHROME
        } else {
            let bars = stripes(at.z, 0.055, 0.0, 0.018, footprint_m);
            let shine = if vehicle.seed & 8 == 0 { 0.30 } else { 0.04 };
            Finish {
                albedo: Vec3A::splat(mix(0.010, 0.5 * shine, bars)),
                flakes: Vec3A::splat(shine * bars),
                open: 0.5 + 0.5 * bars,
                ..PLASTIC
            }
        });
    }
    let plate = shape.clearance + 0.16;
    if at.y.abs() < 0.26 && within(at.z, plate, plate + 0.115) {
        return Some(number_plate(vehicle, at.y, at.z - plate, footprint_m));
    }
    (across < 0.72 && within(at.z, shape.clearance + 0.08, shape.clearance + 0.20))
        .then_some(RUBBER)
}

fn rear(
    vehicle: &Bodywork,
    at: Vec3A,
    across: f32,
    to_rear: f32,
    footprint_m: f32,
) -> Option<Finish> {
    let shape = &vehicle.shape;
    let tall = matches!(
        shape.style,
        BodyStyle::Van | BodyStyle::Suv | BodyStyle::Pickup | BodyStyle::Minibus | BodyStyle::Truck
    );
    let top = shape.deck - 0.10;
    let inner = if tall { 0.78 } else { 0.56 };
    let height = if tall { 0.36 } else { 0.17 };
    if to_rear < 0.30 && within(across, inner, 1.0) && within(at.z, top - height, top) {
        return Some(tail_lamp(at, across, footprint_m));
    }
    if to_rear > 0.16 {
        return None;
    }
    let plate = top - 0.30;
    if at.y.abs() < 0.26 && within(at.z, plate, plate + 0.115) {
        return Some(number_plate(vehicle, at.y, at.z - plate, footprint_m));
    }
    (across < 0.75 && within(at.z, shape.clearance + 0.08, shape.clearance + 0.19))
        .then_some(PLASTIC)
}

/// Share of the pixel covered by the gaps around doors, bonnet and boot.
fn seams(shape: &Shape, at: Vec3A, normal: Vec3A, across: f32, footprint_m: f32) -> f32 {
    const HALF_GAP_M: f32 = 0.006;
    let line = |x: f32, at_x: f32| stripe(x, at_x, HALF_GAP_M, footprint_m);
    if normal.z.abs() > 0.75 {
        let bonnet = line(at.x, shape.x(shape.cowl_part - 0.015));
        let boot = if shape.deck_part < 0.95 {
            line(at.x, shape.x(shape.deck_part + 0.012))
        } else {
            0.0
        };
        return bonnet.max(boot);
    }
    if across < 0.75 {
        return 0.0;
    }
    let [first, middle, last] = door_edges(shape);
    let mut cover = line(at.x, first)
        .max(line(at.x, middle))
        .max(line(at.x, last));
    if within(at.x, last, first) {
        cover = cover.max(line(at.z, shape.clearance + 0.15));
        for edge in [middle, last] {
            let handle = Vec3A::new(edge + 0.17, 0.0, shape.cowl - 0.15);
            if (at.x - handle.x).abs() < 0.09 && (at.z - handle.z).abs() < 0.018 {
                return 0.75;
            }
        }
    }
    cover
}

/// Where the doors begin, meet and end, along x.
fn door_edges(shape: &Shape) -> [f32; 3] {
    let first = shape.x(shape.cowl_part + 0.035);
    let last = match shape.style {
        BodyStyle::Coupe => shape.x(0.63),
        BodyStyle::Van => shape.x(0.56),
        BodyStyle::Minibus => shape.x(0.50),
        BodyStyle::Truck => shape.x(0.285),
        _ => shape.x((shape.roof_rear_part - 0.03).min(0.74)),
    };
    let share = if matches!(shape.style, BodyStyle::Coupe) {
        0.98
    } else {
        0.53
    };
    [first, first + (last - first) * share, last]
}

fn cabin(vehicle: &Bodywork, coat: Finish, at: Vec3A, normal: Vec3A) -> Finish {
    let shape = &vehicle.shape;
    let rail = rail_height(shape);
    let belt = belt_height(shape, 0.5 - at.x / shape.length);
    let s = (at.z - belt) / (rail - belt).max(0.05);
    if s > 0.94 {
        let panorama = vehicle.seed % 5 == 1 && normal.z.abs() > 0.9 && !shape.style.is_boxy();
        return if panorama { GLASS } else { coat };
    }
    if s < 0.05 {
        return RUBBER;
    }
    let outline = CabinOutline::at(shape, s);
    let along = (at.x - outline.middle_x) / outline.half_length;
    let across = at.y / outline.half_width;
    if across.abs() < 0.86 && along.abs() > 0.80 {
        // Windscreen and rear window; a van's doors have two small panes.
        let rear_post =
            along < 0.0 && shape.style == BodyStyle::Van && (across.abs() < 0.10 || s < 0.35);
        return if rear_post { coat } else { GLASS };
    }
    let [_, middle, last] = door_edges(shape);
    let glazed = match shape.style {
        BodyStyle::Van => at.x > middle + 0.05 || vehicle.seed.is_multiple_of(4),
        _ => true,
    };
    let end = if shape.roof_rear_part > 0.80 {
        0.88
    } else {
        0.74
    };
    if !glazed || along > 0.84 || along < -end {
        return coat;
    }
    let post = |x: f32| (at.x - x).abs() < 0.045;
    if post(middle) || (shape.style != BodyStyle::Coupe && post(last + 0.02)) {
        RUBBER
    } else {
        GLASS
    }
}

fn wheel(shape: &Shape, seed: u32, at: Vec3A) -> Finish {
    let [front, rear] = shape.axles();
    let axle = if at.x > 0.0 { front } else { rear };
    let (dx, dz) = (at.x - axle, at.z - shape.wheel_radius);
    let reach = (dx * dx + dz * dz).sqrt() / shape.wheel_radius;
    if at.y.abs() < shape.width * 0.49 - 0.034 || reach > 0.67 {
        return RUBBER;
    }
    let spokes = 5 + seed % 3;
    let turns = (libm::atan2f(dz, dx) / std::f32::consts::TAU + 1.0) * spokes as f32;
    let on_spoke = (turns.fract() - 0.5).abs() < 0.27;
    if on_spoke || !(0.22..=0.57).contains(&reach) {
        let level = 0.35 + 0.25 * noise::unit(seed);
        Finish {
            flakes: Vec3A::splat(0.5 * level),
            ..shiny(Vec3A::splat(0.4 * level), 0.20)
        }
    } else {
        matt(0.02)
    }
}
