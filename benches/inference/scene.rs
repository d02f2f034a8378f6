//! A rendered stereo pair, and vehicles as a detector would have found them.

use std::f64::consts::FRAC_PI_6;

use image::RgbImage;
use rayon::prelude::*;
use twinsight::detector::Detection;
use twinsight::geometry::{PixelBox, StereoRig};
use twinsight::render::{Eye, RenderSettings, RigPose, Stage, render};
use twinsight::world::{Scene, Sun};
use twinsight::{Error, Result};

const SEED: u64 = 1;
/// Furthest camera from the vehicle, metres.
const REACH_M: f64 = 60.0;

/// Field of view and baseline of every rig here.
const HFOV_DEG: f64 = 90.0;
const BASELINE_M: f64 = 0.8;

/// Planted boxes stand in a grid of this many columns and rows.
const GRID: usize = 4;
/// Largest number of planted vehicles.
pub const MOST_VEHICLES: usize = GRID * GRID;
/// Side of a planted box, and its disparity, as shares of the image's width: a car of 4 m at 40 m.
const BOX_SHARE: f64 = 0.05;
const DISPARITY_SHARE: f64 = 0.01;

/// The rig for images of this size.
pub fn rig([width, height]: [u32; 2]) -> Result<StereoRig> {
    StereoRig::from_hfov(width, height, HFOV_DEG, BASELINE_M)
}

/// A city with one vehicle.
pub fn stage() -> Stage {
    Stage::new(Scene::draw(SEED, 0, REACH_M))
}

/// A view from behind the vehicle, above the road, from this distance.
pub fn view(stage: &Stage, distance_m: f64) -> Result<RigPose> {
    let vehicle = stage.scene().target();
    let [forward_x, forward_y, _] = vehicle.forward_world;
    let [x, y, z] = vehicle.center_world;
    let (back_m, up_m) = (
        distance_m * libm::cos(FRAC_PI_6),
        distance_m * libm::sin(FRAC_PI_6),
    );
    let position = [x - back_m * forward_x, y - back_m * forward_y, z + up_m];
    RigPose::aimed(position, vehicle.center_world, [0.1, 0.1]).ok_or_else(|| {
        Error::value(
            "the benchmark's view",
            "no level camera can have it",
            "report this as a defect",
        )
    })
}

/// Both images of each view, views and eyes in parallel.
pub fn render_views(stage: &Stage, rig: &StereoRig, views: &[RigPose]) -> Vec<[RgbImage; 2]> {
    let settings = RenderSettings {
        samples_per_pixel: 4,
        noise_counts: 1.5,
        noise_seed: SEED,
    };
    views
        .par_iter()
        .map(|view| {
            let [left, right] =
                Eye::BOTH.map(|eye| move || render(stage, rig, view, eye, Sun::Noon, &settings));
            let (left, right) = rayon::join(left, right);
            [left, right]
        })
        .collect()
}

/// One pair of this size.
pub fn pair([width, height]: [u32; 2]) -> Result<[RgbImage; 2]> {
    let stage = stage();
    let views = [view(&stage, 30.0)?];
    let mut pairs = render_views(&stage, &rig([width, height])?, &views);
    Ok(pairs.swap_remove(0))
}

/// Detections of so many vehicles in both images; fresh weights find none themselves.
pub fn planted(vehicles: usize, [width, height]: [u32; 2]) -> [Vec<Detection>; 2] {
    let (width, height) = (f64::from(width), f64::from(height));
    [0.0, DISPARITY_SHARE].map(|disparity| {
        (0..vehicles.min(MOST_VEHICLES))
            .map(|index| {
                let [column, row] = [index % GRID, index / GRID].map(|i| i as f64);
                let center = [
                    (0.2 + 0.2 * column - disparity) * width,
                    (0.4 + 0.15 * row) * height,
                ];
                Detection {
                    box_pixel: PixelBox::from_center(center, BOX_SHARE * width, BOX_SHARE * width),
                    score: 0.9,
                    class: 0,
                }
            })
            .collect()
    })
}
