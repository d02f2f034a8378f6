//! Makes a dataset without any simulator: plans the captures, renders them and writes them down.
//!
//! [`generate`] is the only entry. A frame is a function of the configuration and its number, so
//! frames are rendered in any order and on any number of threads with the same bytes, and a stopped
//! run goes on where it was.

mod config;
mod plan;
mod settle;
mod write;

use std::path::Path;

use rayon::prelude::*;

pub use config::{GenerateConfig, SplitMode, TestProtocol};
pub use plan::view_of_azimuth;

use crate::dataset::{BoxKind, FrameRow, Label, Split};
use crate::error::{Error, Result};
use crate::geometry::{SphereTarget, StereoRig, sphere_box};
use crate::progress::Progress;
use crate::render::{Conditions, Eye, RenderSettings, RigPose, Silhouette, Stage, render};
use crate::world::Scene;
use plan::{SceneDraft, plan_scenes};
use settle::Capture;
use write::Target;

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
    let done: Result<Vec<Vec<(FrameRow, bool)>>> = scenes
        .par_iter()
        .map(|scene| generate_scene(config, &rig, scene, &target, progress))
        .collect();
    progress.end();
    let mut done: Vec<(FrameRow, bool)> = done?.into_iter().flatten().collect();
    done.sort_by_key(|(row, _)| row.stamp);
    let reused = done.iter().filter(|(_, reused)| *reused).count();
    let rows: Vec<FrameRow> = done.into_iter().map(|(row, _)| row).collect();
    target.finish(config, rig, &rows)?;
    let count = |split| rows.iter().filter(|row| row.split == split).count();
    Ok(GenerateReport {
        frames: rows.len(),
        reused,
        train: count(Split::Train),
        val: count(Split::Val),
        test: count(Split::Test),
    })
}

/// Renders what is missing of one scene; the flags tell which frames were there already.
fn generate_scene(
    config: &GenerateConfig,
    rig: &StereoRig,
    scene: &SceneDraft,
    target: &Target,
    progress: &dyn Progress,
) -> Result<Vec<(FrameRow, bool)>> {
    if progress.interrupted() {
        return Err(interrupted());
    }
    let reach_m = scene
        .frames
        .iter()
        .map(|frame| frame.distance_m)
        .fold(0.0, f64::max);
    let stage = Stage::new(Scene::draw(
        config.seed,
        scene.number,
        reach_m,
        config.appearance.wardrobe(),
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
            Ok((capture.row, reused))
        })
        .collect()
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
        conditions: Conditions::draw(&config.appearance, capture.sun, capture.noise_seed),
    };
    for eye in Eye::BOTH {
        let image = render(stage, rig, &capture.pose, eye, &settings);
        let labels = labels(stage, rig, &capture.pose, eye, capture.distance_m);
        target.write_view(capture.row.stamp, eye, &image, &labels)?;
    }
    Ok(())
}

/// Both boxes of the vehicle in one image.
fn labels(stage: &Stage, rig: &StereoRig, pose: &RigPose, eye: Eye, distance_m: f64) -> Vec<Label> {
    let vehicle = &stage.scene().vehicle;
    let camera = eye.camera(rig);
    let [x, y, z] = pose.rig_from_world(vehicle.center_world);
    let center_camera = [x - eye.offset_m(rig), y, z];
    let silhouette = Silhouette::measure(stage, rig, pose, eye);
    let sphere = SphereTarget {
        center_camera,
        forward_camera: pose.rig_direction_from_world(vehicle.forward_world),
        radius_min_m: vehicle.radius_min_m(),
        radius_sphere_m: vehicle.radius_sphere_m(),
    };
    let boxes = [
        (BoxKind::Sphere, sphere_box(camera, &sphere)),
        (BoxKind::Tight, silhouette.tight),
    ];
    boxes
        .into_iter()
        .filter_map(|(kind, box_pixel)| {
            Some(Label {
                id: 0,
                class: 0,
                box_pixel: box_pixel?,
                center_pixel: camera.pixel_from_camera(center_camera)?,
                distance_m,
                kind,
                visible: Some(silhouette.visible),
            })
        })
        .collect()
}

#[cfg(test)]
mod tests;
