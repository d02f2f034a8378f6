//! Lamps, plates, a taxi's sign and a truck's box.

use glam::Vec3A;

use super::{Finish, LAMP, PLASTIC, PLATE, TAIL_LAMP, matt, shiny, within};
use crate::world::noise::{self, mix, stripe, stripes};
use crate::world::vehicle::Bodywork;

/// Reflectors behind clear glass in a dark housing, with an orange corner.
pub(super) fn head_lamp(vehicle: &Bodywork, at: Vec3A, across: f32, low: f32) -> Finish {
    if across > 0.90 {
        return shiny(Vec3A::new(0.45, 0.16, 0.02), 0.08);
    }
    let (dy, dz) = (
        (across - 0.72) * vehicle.shape.width * 0.5,
        at.z - low - 0.085,
    );
    let bowl = (dy * dy + dz * dz).sqrt();
    if bowl < 0.075 {
        Finish {
            flakes: Vec3A::splat(0.35),
            ..LAMP
        }
    } else {
        shiny(Vec3A::splat(0.10), 0.12)
    }
}

/// Red glass with a pale strip and ribs.
pub(super) fn tail_lamp(at: Vec3A, across: f32, footprint_m: f32) -> Finish {
    let ribs = stripes(at.z, 0.05, 0.0, 0.02, footprint_m);
    let mut lamp = TAIL_LAMP;
    if within(across, 0.74, 0.82) {
        lamp.albedo = Vec3A::new(0.42, 0.36, 0.34);
    }
    lamp.albedo *= 0.75 + 0.35 * ribs;
    lamp.glow = Vec3A::new(0.10, 0.002, 0.002);
    lamp
}

/// Dark letters on a pale plate; both coordinates in metres from its middle and its lower edge.
pub(super) fn number_plate(vehicle: &Bodywork, across: f32, up: f32, footprint_m: f32) -> Finish {
    if across.abs() > 0.235 || !within(up, 0.022, 0.093) {
        return PLATE;
    }
    let letter = noise::hash((across / 0.062).floor() as i32, 5, vehicle.seed);
    let strokes = stripes(across, 0.062, 0.008, 0.030, footprint_m);
    let gap = ((up - 0.02) * 30.0 + noise::unit(letter) * 2.0).fract() > 0.8;
    let ink = if letter.is_multiple_of(6) || gap {
        0.0
    } else {
        strokes
    };
    matt(mix(0.62, 0.04, ink))
}

/// A lit box that says what it is, seen from in front and behind.
pub(super) fn roof_sign(at: Vec3A, normal: Vec3A, footprint_m: f32) -> Finish {
    let mut sign = shiny(Vec3A::new(0.62, 0.46, 0.06), 0.04);
    sign.glow = Vec3A::new(0.30, 0.22, 0.03);
    if normal.x.abs() > 0.7 && at.y.abs() < 0.24 {
        let ink = stripes(at.y, 0.12, 0.015, 0.07, footprint_m);
        sign.albedo *= 1.0 - 0.9 * ink;
        sign.glow *= 1.0 - 0.9 * ink;
    }
    sign
}

/// The sides of a truck's box: panels, a rail at the foot and a coloured band.
pub(super) fn cargo(vehicle: &Bodywork, at: Vec3A, normal: Vec3A, footprint_m: f32) -> Finish {
    let white = shiny(Vec3A::splat(0.60), 0.02);
    if normal.z.abs() > 0.5 {
        return white;
    }
    if at.z < 0.90 {
        return PLASTIC;
    }
    if normal.x < -0.7 {
        // Two doors with bars.
        let gap = stripe(at.y, 0.0, 0.012, footprint_m).max(stripe(
            at.y.abs(),
            vehicle.shape.width * 0.25,
            0.02,
            footprint_m,
        ));
        return matt(0.60 * (1.0 - 0.8 * gap));
    }
    let seams = stripes(at.x, 0.85, 0.0, 0.014, footprint_m);
    let middle = f32::midpoint(0.9, vehicle.shape.box_top());
    let band = stripe(at.z, middle, 0.30, footprint_m) * f32::from(u8::from(vehicle.seed & 1 == 0));
    let albedo = white.albedo + (vehicle.paint + vehicle.flakes - white.albedo) * band;
    Finish {
        albedo: albedo * (1.0 - 0.45 * seams),
        ..white
    }
}
