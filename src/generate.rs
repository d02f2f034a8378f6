//! Makes a dataset without any simulator: plans the captures, renders them and writes them down.
//!
//! [`generate`] makes a dataset and [`add_frames`] lets it grow. A frame is a function of the configuration and its number, so
//! frames are rendered in any order and on any number of threads with the same bytes, and a stopped
//! run goes on where it was.

mod assets;
mod config;
mod estimate;
mod label;
mod outputs;
mod part;
mod plan;
mod settle;
mod truth;
mod vehicle_count;
mod write;

use std::path::Path;
use std::time::Instant;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use rayon::prelude::*;

pub use assets::Assets;
pub use config::{GenerateConfig, SplitMode, TestProtocol};
pub use outputs::Outputs;
pub use plan::view_of_azimuth;
pub use vehicle_count::VehicleCount;

use crate::dataset::{Split, read_frames_csv};
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::render::{Conditions, Eye, Instances, RenderSettings, Stage, render};
use crate::world::noise::derive_seed;
use crate::world::{Scene, Wardrobe};
use estimate::{Sample, Work, announce};
use label::{labels, objects};
use part::Task;
use plan::{FrameDraft, SceneDraft, plan_scenes};
use settle::Capture;
use truth::write_maps;
use write::{FrameRecord, Target};

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
    /// Of these, frames that an earlier run had already written.
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
/// While frames are missing the folder holds `generating.toml` with the settings; started again
/// with the same ones, the function keeps the frames that are complete. `frames.csv` and
/// `dataset.toml` come last, so nothing takes an unfinished folder for a dataset.
///
/// A folder with a finished dataset of the same settings but fewer frames gets the missing ones,
/// as [`add_frames`] would add them.
///
/// The first frame is rendered alone, and what it cost tells time and disk of the others: they are
/// said through `progress`, and a disk that is too small is an error.
///
/// # Errors
/// An unusable configuration, a folder that holds another dataset or one begun with another
/// configuration, a disk that is too small, a failed write, or [`Error::Interrupted`].
pub fn generate(
    config: &GenerateConfig,
    out: &Path,
    progress: &dyn Progress,
) -> Result<GenerateReport> {
    config.validate()?;
    let (config, wardrobe) = config.dressed()?;
    run(Task::generate(&config, out)?, &wardrobe, out, progress)
}

/// Adds training and validation frames, with scenes of their own, to a finished dataset of
/// [`generate`], with the settings that made it. What is there stays as it is, splits included.
/// Stopped, it goes on when it is called again with the same number.
///
/// `assets` is where the user's assets are now, if not where they were.
///
/// # Errors
/// A folder without a finished dataset of this version of the program, and those of [`generate`].
pub fn add_frames(
    frames: u32,
    out: &Path,
    assets: Option<&Path>,
    progress: &dyn Progress,
) -> Result<GenerateReport> {
    let task = Task::extend(out, frames)?;
    let mut config = GenerateConfig {
        frames,
        ..task.history.config.clone()
    };
    if let Some(folder) = assets {
        let Some(assets) = &mut config.assets else {
            return Err(Error::dataset(
                out,
                "was made without assets",
                "leave the folder of assets out, or make another dataset with them",
            ));
        };
        folder.clone_into(&mut assets.folder);
    }
    config.validate()?;
    let (_, wardrobe) = config.dressed()?;
    run(task, &wardrobe, out, progress)
}

fn run(
    task: Task,
    wardrobe: &Wardrobe,
    out: &Path,
    progress: &dyn Progress,
) -> Result<GenerateReport> {
    let target = Target::open(task, out)?;
    let task = target.task();
    let scenes = plan_scenes(&task.history.config, &task.part);
    let stamps = scenes.iter().flat_map(|scene| &scene.frames);
    let reused = stamps
        .clone()
        .filter(|frame| target.has_frame(frame.stamp))
        .count();
    let first = measure(&target, wardrobe, &scenes, progress)?;
    progress.begin("rendering frames", stamps.count() as u64);
    let done = generate_scenes(&scenes, first, wardrobe, &target, progress);
    progress.end();
    let mut done = done?;
    done.sort_by_key(|record| record.row.stamp);
    target.finish(&done)?;
    let (rows, _) = read_frames_csv(out.join("frames.csv"))?;
    let count = |split| rows.iter().filter(|row| row.split == split).count();
    Ok(GenerateReport {
        frames: rows.len(),
        reused: rows.len().saturating_sub(done.len()) + reused,
        train: count(Split::Train),
        val: count(Split::Val),
        test: count(Split::Test),
    })
}

/// Renders the first frame that is missing and says what the others will cost. Returns the first
/// scene, ready for the other frames, where the frame was of that one.
fn measure(
    target: &Target,
    wardrobe: &Wardrobe,
    scenes: &[SceneDraft],
    progress: &dyn Progress,
) -> Result<Option<Stage>> {
    let missing = |frame: &&FrameDraft| !target.has_frame(frame.stamp);
    let Some((index, scene, frame)) = scenes
        .iter()
        .enumerate()
        .find_map(|(index, scene)| Some((index, scene, scene.frames.iter().find(missing)?)))
    else {
        return Ok(None);
    };
    let begun = Instant::now();
    let stage = stage_of(&target.task().history.config, wardrobe, scene);
    let staged = Instant::now();
    make_frame(frame, &stage, target)?;
    let sample = Sample {
        scene: staged - begun,
        frame: staged.elapsed(),
        bytes: target.frame_bytes(frame.stamp),
    };
    let left: Vec<usize> = scenes
        .iter()
        .map(|scene| scene.frames.iter().filter(missing).count())
        .collect();
    let work = Work {
        scenes: left.iter().filter(|&&frames| frames > 0).count(),
        frames: left.iter().sum(),
        threads: rayon::current_num_threads(),
    };
    if work.frames > 0 {
        progress.note(&announce(sample, work, target)?);
    }
    Ok((index == 0).then_some(stage))
}

/// Renders what is missing of all scenes.
///
/// One scene after the other: the threads share its frames, their two images and the rows of those,
/// and prepare the next scene meanwhile. So few frames keep many threads busy, and memory holds two
/// scenes however many threads there are.
fn generate_scenes(
    scenes: &[SceneDraft],
    first: Option<Stage>,
    wardrobe: &Wardrobe,
    target: &Target,
    progress: &dyn Progress,
) -> Result<Vec<FrameRecord>> {
    let config = &target.task().history.config;
    let prepare = |scene: Option<&SceneDraft>| scene.map(|scene| stage_of(config, wardrobe, scene));
    let mut done = Vec::new();
    let mut stage = first.or_else(|| prepare(scenes.first()));
    for (index, scene) in scenes.iter().enumerate() {
        let (records, next) = rayon::join(
            || match &stage {
                Some(stage) => generate_scene(scene, stage, target, progress),
                None => Ok(Vec::new()),
            },
            || prepare(scenes.get(index + 1)),
        );
        done.extend(records?);
        stage = next;
    }
    Ok(done)
}

/// Renders what is missing of one scene.
fn generate_scene(
    scene: &SceneDraft,
    stage: &Stage,
    target: &Target,
    progress: &dyn Progress,
) -> Result<Vec<FrameRecord>> {
    // A frame has two images, and a thread that waits for one of its rows may begin another frame:
    // fewer frames at once than threads keep memory small.
    let at_once = (rayon::current_num_threads() / 2).max(1);
    let mut records = Vec::with_capacity(scene.frames.len());
    for drafts in scene.frames.chunks(at_once) {
        let some: Result<Vec<FrameRecord>> = drafts
            .par_iter()
            .map(|draft| {
                if progress.interrupted() {
                    return Err(interrupted());
                }
                let record = make_frame(draft, stage, target);
                progress.advance(1);
                record
            })
            .collect();
        records.extend(some?);
    }
    Ok(records)
}

fn stage_of(config: &GenerateConfig, wardrobe: &Wardrobe, scene: &SceneDraft) -> Stage {
    let reach_m = scene
        .frames
        .iter()
        .map(|frame| frame.distance_m)
        .fold(0.0, f64::max);
    Stage::new(Scene::draw_dressed(
        config.seed,
        scene.number,
        reach_m,
        vehicles_of_scene(config, scene.number),
        (TRAFFIC_PART * config.distance_max_m).clamp(TRAFFIC_M[0], TRAFFIC_M[1]),
        wardrobe,
    ))
}

/// Settles a frame, and renders and writes it where it is missing.
fn make_frame(draft: &FrameDraft, stage: &Stage, target: &Target) -> Result<FrameRecord> {
    let config = &target.task().history.config;
    let capture = draft.settle(config, target.rig(), stage);
    if !target.has_frame(draft.stamp) {
        write_frame(config, stage, &capture, target)?;
    }
    Ok(FrameRecord {
        objects: objects(stage, &capture),
        pose: capture.pose,
        row: capture.row,
    })
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
    stage: &Stage,
    capture: &Capture,
    target: &Target,
) -> Result<()> {
    let settings = RenderSettings {
        samples_per_pixel: config.samples_per_pixel,
        noise_counts: config.noise_counts.drawn(capture.noise_seed),
        noise_seed: capture.noise_seed,
        conditions: Conditions::draw(&config.appearance, capture.sun, capture.noise_seed),
    };
    let rig = target.rig();
    Eye::BOTH.into_par_iter().try_for_each(|eye| {
        let image = render(stage, rig, &capture.pose, eye, &settings);
        let Instances { silhouettes, map } = Instances::measure(stage, rig, &capture.pose, eye);
        let labels = labels(config, stage, rig, capture, eye, &silhouettes);
        write_maps(config.outputs, stage, capture, eye, &map, target)?;
        target.write_view(capture.row.stamp, eye, &image, &labels)
    })
}

#[cfg(test)]
mod growth;
#[cfg(test)]
mod laws;
#[cfg(test)]
mod own;
#[cfg(test)]
mod tests;
