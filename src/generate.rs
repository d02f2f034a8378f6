//! Makes a dataset without any simulator: plans the captures, renders them and writes them down.
//!
//! [`generate`] is the only entry. A frame is a function of the configuration and its number, so
//! frames are rendered in any order and on any number of threads with the same bytes, and a stopped
//! run goes on where it was.

mod config;
mod label;
mod plan;
mod settle;
mod write;

use std::path::Path;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use rayon::prelude::*;

pub use config::{GenerateConfig, SplitMode, TestProtocol, VehicleCount};
pub use plan::view_of_azimuth;

use crate::dataset::{FrameRow, ObjectRow, Split};
use crate::error::{Error, Result};
use crate::geometry::StereoRig;
use crate::progress::Progress;
use crate::render::{Eye, RenderSettings, Stage, render};
use crate::world::Scene;
use crate::world::noise::derive_seed;
use label::{labels, objects};
use plan::{SceneDraft, plan_scenes};
use settle::Capture;
use write::Target;

/// Random numbers for how many vehicles a scene has.
const COUNT_STREAM: u64 = 7;
/// The vehicles around the target stand within this part of the longest distance, and within these
/// bounds, metres: near enough to be in its pictures, far enough to be at other distances.
const TRAFFIC_PART: f64 = 0.6;
const TRAFFIC_M: [f64; 2] = [20.0, 90.0];

/// What [`generate`] did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GenerateReport {
    /// Frames of the finished dataset.
    pub frames: usize,
    /// Of these, frames that an earlier, stopped run had already written.
    pub reused: usize,
    /// Training frames.
    pub train: usize,
    /// Validation frames.
    pub val: usize,
    /// Test frames.
    pub test: usize,
}

/// Writes a whole dataset into a folder, which is created where it is missing.
///
/// While frames are missing the folder holds `generating.toml` with the configuration; started
/// again with the same one, the function keeps the frames that are complete. `frames.csv` and
/// `dataset.toml` come last, so nothing takes an unfinished folder for a dataset.
///
/// # Errors
/// An unusable configuration, a folder that holds a finished dataset or one begun with another
/// configuration, a failed write, or [`Error::Interrupted`].
pub fn generate(
    config: &GenerateConfig,
    out: &Path,
    progress: &dyn Progress,
) -> Result<GenerateReport> {
    config.validate()?;
    let rig = config.rig()?;
    let target = Target::open(config, out)?;
    let scenes = plan_scenes(config);
    let total = scenes.iter().map(|scene| scene.frames.len()).sum::<usize>();
    progress.begin("rendering frames", total as u64);
    let done: Result<Vec<Vec<Done>>> = scenes
        .par_iter()
        .map(|scene| generate_scene(config, &rig, scene, &target, progress))
        .collect();
    progress.end();
    let mut done: Vec<Done> = done?.into_iter().flatten().collect();
    done.sort_by_key(|done| done.row.stamp);
    let reused = done.iter().filter(|done| done.reused).count();
    let (rows, objects): (Vec<FrameRow>, Vec<Vec<ObjectRow>>) = done
        .into_iter()
        .map(|done| (done.row, done.objects))
        .unzip();
    target.finish(config, rig, &rows, &objects.concat())?;
    let count = |split| rows.iter().filter(|row| row.split == split).count();
    Ok(GenerateReport {
        frames: rows.len(),
        reused,
        train: count(Split::Train),
        val: count(Split::Val),
        test: count(Split::Test),
    })
}

/// A frame that is on disk.
struct Done {
    row: FrameRow,
    objects: Vec<ObjectRow>,
    /// Whether it was there already.
    reused: bool,
}

/// Renders what is missing of one scene.
fn generate_scene(
    config: &GenerateConfig,
    rig: &StereoRig,
    scene: &SceneDraft,
    target: &Target,
    progress: &dyn Progress,
) -> Result<Vec<Done>> {
    if progress.interrupted() {
        return Err(interrupted());
    }
    let reach_m = scene
        .frames
        .iter()
        .map(|frame| frame.distance_m)
        .fold(0.0, f64::max);
    let stage = Stage::new(Scene::draw_with_traffic(
        config.seed,
        scene.number,
        reach_m,
        vehicles_of_scene(config, scene.number),
        (TRAFFIC_PART * config.distance_max_m).clamp(TRAFFIC_M[0], TRAFFIC_M[1]),
    ));
    scene
        .frames
        .par_iter()
        .map(|draft| {
            if progress.interrupted() {
                return Err(interrupted());
            }
            let capture = draft.settle(config, rig, &stage);
            let reused = target.has_frame(draft.stamp);
            if !reused {
                write_frame(config, rig, &stage, &capture, target)?;
            }
            progress.advance(1);
            Ok(Done {
                objects: objects(&stage, &capture),
                row: capture.row,
                reused,
            })
        })
        .collect()
}

fn vehicles_of_scene(config: &GenerateConfig, number: u32) -> u32 {
    let seed = derive_seed(config.seed, COUNT_STREAM, u64::from(number));
    Pcg64::seed_from_u64(seed).random_range(config.vehicles.least..=config.vehicles.most)
}

fn interrupted() -> Error {
    Error::Interrupted {
        resume:
            "the frames so far are kept; start again with the same settings and folder to go on"
                .to_owned(),
    }
}

fn write_frame(
    config: &GenerateConfig,
    rig: &StereoRig,
    stage: &Stage,
    capture: &Capture,
    target: &Target,
) -> Result<()> {
    let settings = RenderSettings {
        samples_per_pixel: config.samples_per_pixel,
        noise_counts: config.noise_counts,
        noise_seed: capture.noise_seed,
    };
    for eye in Eye::BOTH {
        let image = render(stage, rig, &capture.pose, eye, capture.sun, &settings);
        let labels = labels(config, stage, rig, capture, eye);
        target.write_view(capture.row.stamp, eye, &image, &labels)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
