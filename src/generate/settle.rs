//! Where the drone really goes: plans settled against what stands in the scene.

use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::config::GenerateConfig;
use super::plan::{FrameDraft, HIGHEST_DEG, view_of_azimuth};
use crate::dataset::FrameRow;
use crate::geometry::StereoRig;
use crate::render::{Eye, RigPose, Silhouette, Stage};
use crate::world::{Sun, Vehicle};

/// From here nothing can hide a vehicle on an open road: the last resort, degrees.
const LAST_RESORT_DEG: f64 = 82.0;
/// Views tried before the best of them is taken.
const ATTEMPTS: u32 = 40;
/// Directions of view tried where there is more than the target to look at.
const AIMS: u32 = 4;
/// The drone keeps further from every vehicle than this part of the shortest distance.
const NEAREST_PART: f64 = 0.5;
/// The drone keeps this far from buildings, trees and the ground, metres.
const CLEARANCE_M: f64 = 1.3;

/// A frame that is ready to be rendered.
#[derive(Debug, Clone)]
pub(super) struct Capture {
    pub row: FrameRow,
    pub pose: RigPose,
    pub sun: Sun,
    pub distance_m: f64,
    pub noise_seed: u64,
}

/// A place of the drone against the vehicle.
#[derive(Debug, Clone, Copy)]
struct Station {
    azimuth_deg: f64,
    elevation_deg: f64,
    distance_m: f64,
}

impl FrameDraft {
    /// Finds a place near the planned one from where the target can be seen.
    ///
    /// The first place is the planned one. Later ones move further and further round and up, with
    /// the distance anywhere in its stratum; test frames stay on their side and at their distance.
    /// The first place where both cameras see at least `min_visible` is taken, else the best.
    pub fn settle(&self, config: &GenerateConfig, rig: &StereoRig, stage: &Stage) -> Capture {
        let mut rng = Pcg64::seed_from_u64(self.seed);
        let mut best: Option<(f64, Station, RigPose)> = None;
        for attempt in 0..ATTEMPTS {
            let station = self.station(attempt, &mut rng);
            let Some(pose) = place(&station, config, rig, stage, &mut rng) else {
                continue;
            };
            let visible = Eye::BOTH
                .map(|eye| Silhouette::estimate_visible(stage, 0, rig, &pose, eye))
                .into_iter()
                .fold(1.0, f64::min);
            if best
                .as_ref()
                .map_or(visible > 0.0, |(most, ..)| visible > *most)
            {
                best = Some((visible, station, pose));
            }
            if visible >= config.min_visible {
                break;
            }
        }
        let (station, pose) = match best {
            Some((_, station, pose)) => (station, pose),
            None => self.overhead(stage),
        };
        let view = view_of_azimuth(station.azimuth_deg);
        Capture {
            row: FrameRow {
                stamp: self.stamp,
                split: self.split,
                scene: Some(self.scene),
                sun: Some(self.sun.name().to_owned()),
                view: Some(view),
                azimuth_deg: Some(station.azimuth_deg),
                elevation_deg: Some(station.elevation_deg),
                distance_m: Some(station.distance_m),
            },
            pose,
            sun: self.sun,
            distance_m: station.distance_m,
            noise_seed: self.seed,
        }
    }

    fn station(&self, attempt: u32, rng: &mut impl Rng) -> Station {
        let effort = f64::from(attempt) / f64::from(ATTEMPTS);
        let [round, up, along] = [(); 3].map(|()| rng.random_range(-1.0..1.0_f64));
        // Test frames were planned within 10 degrees of their axis; 14 more are still that side.
        let furthest = if self.side.is_some() { 14.0 } else { 180.0 };
        let azimuth_deg = self.azimuth_deg + round * (220.0 * effort * effort).min(furthest);
        let higher = (HIGHEST_DEG - self.elevation_deg).max(0.0);
        let elevation_deg = if attempt + 4 >= ATTEMPTS {
            LAST_RESORT_DEG
        } else {
            self.elevation_deg + up.abs() * higher * (2.0 * effort).min(1.0)
        };
        let round_to = |value: f64| (value * 1e4 + 0.5).floor() / 1e4;
        let turned = azimuth_deg - 360.0 * ((azimuth_deg + 180.0) / 360.0).floor();
        Station {
            // Rounded here, so that the numbers in the files are exactly what was rendered.
            azimuth_deg: round_to(turned),
            elevation_deg: round_to(elevation_deg),
            distance_m: round_to(self.distance_m + along * self.distance_slack_m),
        }
    }

    /// Straight down on the vehicle, the one place that is always free.
    fn overhead(&self, stage: &Stage) -> (Station, RigPose) {
        let station = Station {
            azimuth_deg: 0.0,
            elevation_deg: 90.0,
            distance_m: self.distance_m,
        };
        let [x, y, z] = stage.scene().target().center_world;
        let [forward_x, forward_y, _] = stage.scene().target().forward_world;
        let pose = RigPose {
            position_world: [x, y, z + self.distance_m],
            right_world: [forward_y, -forward_x, 0.0],
            down_world: [-forward_x, -forward_y, 0.0],
            forward_world: [0.0, 0.0, -1.0],
        };
        (station, pose)
    }
}

/// The pose of a drone at a station that looks roughly at the target; None where no drone can be,
/// or where the target would leave the image.
fn place(
    station: &Station,
    config: &GenerateConfig,
    rig: &StereoRig,
    stage: &Stage,
    rng: &mut impl Rng,
) -> Option<RigPose> {
    let vehicle = stage.scene().target();
    let others = &stage.scene().vehicles[1..];
    let [azimuth, elevation] = [station.azimuth_deg, station.elevation_deg].map(f64::to_radians);
    let [forward_x, forward_y, _] = vehicle.forward_world;
    let [sin, cos] = [libm::sin(azimuth), libm::cos(azimuth)];
    // Azimuth grows towards the vehicle's right, clockwise seen from above.
    let out = [
        forward_x * cos + forward_y * sin,
        forward_y * cos - forward_x * sin,
    ];
    let [up, level] = [libm::sin(elevation), libm::cos(elevation)];
    let offset = [level * out[0], level * out[1], up];
    let position = [0, 1, 2].map(|i| vehicle.center_world[i] + station.distance_m * offset[i]);

    // Room around the vehicle's sphere in the image, as tangents.
    let camera = &rig.left;
    let radius = vehicle.radius_sphere_m() / station.distance_m;
    let parallax = 0.5 * rig.baseline_m / station.distance_m;
    let room_x = (0.5 * f64::from(camera.width) / camera.focal_x_px - parallax - radius).max(0.0);
    let room_y = (0.5 * f64::from(camera.height) / camera.focal_y_px - radius).max(0.0);
    let mut aims = (0..if others.is_empty() { 1 } else { AIMS }).map(|_| {
        let [a, b] = [(); 2].map(|()| rng.random_range(-1.0..1.0_f64));
        let v = 0.8 * room_y * b;
        // Near the zenith a level camera can turn only a little away from the vehicle.
        let most_u = (0.985 * 0.985 / (up * up) - 1.0).max(0.0).sqrt() * (1.0 + v * v).sqrt();
        [0.8 * room_x.min(most_u) * a, v]
    });
    let free = position[2] > CLEARANCE_M && !stage.scene().in_building(position, CLEARANCE_M);
    if !free || !stage.has_room(position, CLEARANCE_M) {
        return None;
    }
    let nearest_m = NEAREST_PART * config.distance_min_m;
    if others.iter().any(|other| {
        let apart = [0, 1, 2].map(|i| other.center_world[i] - position[i]);
        apart.iter().map(|v| v * v).sum::<f64>() < nearest_m * nearest_m
    }) {
        return None;
    }
    let sees = |pose: &RigPose, vehicle: &Vehicle| {
        let pixels = rig.pixels_from_rig(pose.rig_from_world(vehicle.center_world));
        pixels.is_some_and(|pixels| {
            pixels.iter().all(|[x, y]| {
                *x > 0.0
                    && *x < f64::from(camera.width)
                    && *y > 0.0
                    && *y < f64::from(camera.height)
            })
        })
    };
    // The aim that shows most of the other vehicles, the first of equals.
    let mut best: Option<(usize, RigPose)> = None;
    for aim in &mut aims {
        let Some(pose) = RigPose::aimed(position, vehicle.center_world, aim) else {
            continue;
        };
        if !sees(&pose, vehicle) {
            continue;
        }
        let count = others.iter().filter(|other| sees(&pose, other)).count();
        if best.as_ref().is_none_or(|(most, _)| count > *most) {
            best = Some((count, pose));
        }
    }
    best.map(|(_, pose)| pose)
}
