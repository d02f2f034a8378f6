//! A street of textured surfaces, seen by a rig whose right camera stands as a test wants.

use std::collections::BTreeMap;
use std::sync::Mutex;

use glam::{DQuat, DVec3};
use image::{Rgb, RgbImage};
use rayon::prelude::*;

use crate::calibration::{CalibratedRig, RigOptions};
use crate::geometry::{Camera, StereoCalibration, StereoRig};
use crate::sources::StereoFrame;

pub const SIZE: [u32; 2] = [640, 288];

const BASELINE_M: f64 = 0.5;

/// What is wrong with the right camera.
#[derive(Debug, Clone, Copy, Default)]
pub struct Wrong {
    /// Turn about its x, y and z axis, degrees: what it sees moves up, right and clockwise.
    pub turn_deg: [f64; 3],
    /// Shift of its principal point, pixels.
    pub shift_px: [f64; 2],
    /// How much longer its focal length is, relative.
    pub focal: f64,
    /// Place beside the one it should have, metres: right, down, forward.
    pub aside_m: [f64; 3],
}

/// The rig as its calibration has it.
pub fn rig() -> StereoRig {
    StereoRig::from_hfov(SIZE[0], SIZE[1], 75.0, BASELINE_M).unwrap()
}

pub fn calibration() -> StereoCalibration {
    let rig = rig();
    let intrinsics = [rig.left.intrinsics(), rig.right.intrinsics()];
    StereoCalibration::rectified(Some(SIZE), intrinsics, BASELINE_M).unwrap()
}

pub fn calibrated() -> CalibratedRig {
    CalibratedRig::new(&calibration(), SIZE, RigOptions::default()).unwrap()
}

/// Frames of different streets.
pub fn frames(count: u64, wrong: Wrong) -> Vec<StereoFrame> {
    (0..count)
        .map(|index| frame(index, pair(index, wrong)))
        .collect()
}

pub fn frame(index: u64, images: [RgbImage; 2]) -> StereoFrame {
    StereoFrame {
        index,
        name: format!("{index:05}"),
        origins: ["left", "right"].map(|side| format!("in/{side}_{index:05}.png")),
        time_s: None,
        images: Ok(images),
        read: std::time::Duration::ZERO,
    }
}

pub fn pair(street: u64, wrong: Wrong) -> [RgbImage; 2] {
    let rig = rig();
    let mut right = rig.right;
    right.focal_x_px *= 1.0 + wrong.focal;
    right.focal_y_px *= 1.0 + wrong.focal;
    right.center_x_px += wrong.shift_px[0];
    right.center_y_px += wrong.shift_px[1];
    let turn = DVec3::from_array(wrong.turn_deg.map(f64::to_radians));
    // From the camera's axes to the left one's.
    let turn = DQuat::from_scaled_axis(turn).inverse();
    let place = DVec3::new(BASELINE_M, 0.0, 0.0) + DVec3::from_array(wrong.aside_m);
    [left(street), picture(street, &right, turn, place)]
}

/// What the left camera sees, which is the same for all tests.
fn left(street: u64) -> RgbImage {
    static SEEN: Mutex<BTreeMap<u64, RgbImage>> = Mutex::new(BTreeMap::new());
    if let Some(seen) = SEEN.lock().unwrap().get(&street) {
        return seen.clone();
    }
    let picture = picture(street, &rig().left, DQuat::IDENTITY, DVec3::ZERO);
    SEEN.lock().unwrap().insert(street, picture.clone());
    picture
}

/// How far the surface that a pixel of the left image shows is from the middle between the cameras.
pub fn distance_m(street: u64, pixel: [f64; 2]) -> f64 {
    let ray = DVec3::from_array(rig().left.camera_from_pixel(pixel));
    let (depth, _) = hit(street, DVec3::ZERO, ray);
    (ray * depth - DVec3::new(BASELINE_M / 2.0, 0.0, 0.0)).length()
}

fn picture(street: u64, camera: &Camera, turn: DQuat, place: DVec3) -> RgbImage {
    const PARTS: u32 = 2;
    let (width, height) = (camera.width, camera.height);
    let mut bytes = vec![0; (3 * width * height) as usize];
    let rows = bytes.par_chunks_exact_mut(3 * width as usize);
    rows.enumerate().for_each(|(row, bytes)| {
        for (column, rgb) in bytes.chunks_exact_mut(3).enumerate() {
            let mut sum = 0.0;
            for i in 0..PARTS * PARTS {
                let part = |i: u32| (f64::from(i) + 0.5) / f64::from(PARTS);
                let pixel = [
                    column as f64 + part(i % PARTS),
                    row as f64 + part(i / PARTS),
                ];
                let ray = turn * DVec3::from_array(camera.camera_from_pixel(pixel));
                sum += hit(street, place, ray).1;
            }
            rgb.fill((sum / f64::from(PARTS * PARTS)).round().clamp(0.0, 255.0) as u8);
        }
    });
    RgbImage::from_raw(width, height, bytes).unwrap()
}

/// Nearest surface on a ray, as a multiple of it, and its grey value.
fn hit(street: u64, from: DVec3, ray: DVec3) -> (f64, f64) {
    let mut best = (f64::INFINITY, 0, [0.0; 2]);
    let mut meet = |depth: f64, surface: u64, place: [f64; 2], detail: f64| {
        if depth > 0.0 && depth < best.0 {
            best = (depth, street * 100 + surface, place.map(|v| v / detail));
        }
    };
    // The end of the street.
    let depth = (60.0 - from.z) / ray.z;
    let at = from + ray * depth;
    meet(depth, 1, [at.x, at.y], 1.2);
    // The ground.
    if ray.y > 1e-9 {
        let depth = (1.6 - from.y) / ray.y;
        let at = from + ray * depth;
        meet(depth, 2, [at.x, at.z], 0.25);
    }
    // Houses on both sides.
    for (surface, x) in [(3, -9.0), (4, 11.0)] {
        let depth = (x - from.x) / ray.x;
        let at = from + ray * depth;
        meet(depth, surface, [at.z, at.y], 0.4);
    }
    // Boards that stand about.
    for board in 0..6 {
        let random = |i: u64| chance(street * 7919 + board * 31 + i);
        let z = 5.0 + 22.0 * random(1);
        let depth = (z - from.z) / ray.z;
        let at = from + ray * depth;
        let middle = [(random(2) - 0.5) * 1.3 * z, (random(3) - 0.5) * 0.5 * z];
        let half = [0.5 + random(4), 0.5 + 0.7 * random(5)].map(|v| v * z / 8.0);
        if (at.x - middle[0]).abs() < half[0] && (at.y - middle[1]).abs() < half[1] {
            meet(depth, 10 + board, [at.x, at.y], 0.017 * z);
        }
    }
    let (depth, seed, place) = best;
    (depth, grey(seed, place))
}

/// Smooth noise with details of about 1 and of 4.
fn grey(seed: u64, [x, y]: [f64; 2]) -> f64 {
    128.0 + 70.0 * (noise(seed, x, y) + noise(seed + 50_000, x / 4.0, y / 4.0) - 1.0)
}

fn noise(seed: u64, x: f64, y: f64) -> f64 {
    let (column, row) = (x.floor(), y.floor());
    let at = |i: f64, j: f64| {
        let cell = ((column + i) as i64).wrapping_mul(73_856_093) as u64
            ^ ((row + j) as i64).wrapping_mul(19_349_663) as u64;
        chance(cell ^ seed.wrapping_mul(83_492_791))
    };
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (u, v) = (smooth(x - column), smooth(y - row));
    let along = |j: f64| at(0.0, j) + u * (at(1.0, j) - at(0.0, j));
    along(0.0) + v * (along(1.0) - along(0.0))
}

/// A number from 0 to 1 (the finaliser of splitmix64).
fn chance(seed: u64) -> f64 {
    let mut z = seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}
