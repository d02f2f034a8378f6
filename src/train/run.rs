//! A whole run: data, detector, distance network, and what came of it.

use std::fmt;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use serde::Serialize;

use super::checkpoint::StageFolder;
use super::config::TrainConfig;
use super::detector::DetectorRecipe;
use super::devices::DeviceSet;
use super::distance::DistanceRecipe;
use super::log::RunLog;
use super::saved::{refuse_changed_data, refuse_other_settings, write_config};
use super::size::SizeRecipe;
use super::stage::{PreparedStage, Recipe, StagePlace, StageResult, run_stage};
use crate::dataset::{Frame, Split, StereoDataset};
use crate::device::DeviceName;
use crate::error::{Error, Result};
use crate::evaluate::{Evaluation, evaluate_dataset, write_json};
use crate::files;
use crate::pipeline::StereoRanger;
use crate::progress::Progress;

/// The networks of a run.
pub(super) const STAGES: [&str; 3] = [
    DetectorRecipe::STAGE,
    DistanceRecipe::STAGE,
    SizeRecipe::STAGE,
];
/// Those without which a run cannot tell distances.
const NEEDED: [&str; 2] = [DetectorRecipe::STAGE, DistanceRecipe::STAGE];
/// File that a process holds locked while it trains.
const LOCK: &str = "train.lock";

/// Which networks are trained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// The detector, then the distance network.
    All,
    /// The detector alone.
    Detector,
    /// The distance network, and the size network that belongs to it.
    Distance,
}

/// What to train, on what, and where to.
#[derive(Debug, Clone, Copy)]
pub struct TrainRequest<'a> {
    /// All settings.
    pub config: &'a TrainConfig,
    /// Dataset folder.
    pub data: &'a Path,
    /// Run folder.
    pub run: &'a Path,
    /// Which networks.
    pub stage: Stage,
    /// Go on from where a stopped run was.
    pub resume: bool,
    /// Where to compute: one device, or several that share every batch.
    pub devices: &'a [DeviceName],
}

/// What a run came to.
#[derive(Debug, Clone, Serialize)]
pub struct TrainSummary {
    /// Run folder.
    pub run: PathBuf,
    /// Dataset folder.
    pub data: PathBuf,
    /// Seconds of detector training in this call.
    pub detector_seconds: Option<f64>,
    /// Seconds of distance training in this call.
    pub distance_seconds: Option<f64>,
    /// Seconds of the size network's training in this call.
    pub size_seconds: Option<f64>,
    /// The finished run on the validation split.
    pub evaluation: Option<Evaluation>,
    /// Why there is no evaluation, where there is none.
    pub not_evaluated: Option<NotEvaluated>,
}

/// Why a run is not evaluated at its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NotEvaluated {
    /// One of the networks is still missing.
    MissingNetwork,
    /// The dataset has no validation frames.
    NoValidationFrames,
}

/// Trains a run.
///
/// The folder gets `config.json` first, then per stage `best.safetensors`, `last.safetensors` and
/// the state to resume from, `metrics.csv`, TensorBoard events and at the end `summary.json`.
///
/// # Errors
/// [`Error::Interrupted`] on the user's wish; otherwise whatever stops it.
pub fn train(request: &TrainRequest, progress: &dyn Progress) -> Result<TrainSummary> {
    let (dataset, devices) = open_dataset(request, progress)?;
    files::create_folder(request.run)?;
    let fingerprint = dataset.fingerprint()?;
    let _lock = lock(request.run)?;
    refuse_other_settings(request)?;
    if request.resume {
        refuse_changed_data(request, &fingerprint)?;
    }
    write_config(request, &dataset, &fingerprint)?;
    let log = Arc::new(Mutex::new(RunLog::open(request.run)?));
    let mut summary = TrainSummary {
        run: request.run.to_path_buf(),
        data: request.data.to_path_buf(),
        detector_seconds: None,
        distance_seconds: None,
        size_seconds: None,
        evaluation: None,
        not_evaluated: None,
    };
    let validates = !dataset.split(Split::Val).is_empty();
    if !validates {
        progress.note(
            "the dataset has no validation frames: nothing is validated, and the best weights are \
             the last ones",
        );
    }
    let place = || StagePlace {
        run: request.run,
        resume: request.resume,
        devices: &devices,
        log: Arc::clone(&log),
        progress,
    };
    let device = devices.main();
    if request.stage != Stage::Distance {
        let goes_on = request.goes_on(DetectorRecipe::STAGE)?;
        let stage = DetectorRecipe::prepared(request.config, &dataset, goes_on, device, progress)?;
        summary.detector_seconds = Some(run_announced(stage, &fingerprint, &place())?.seconds);
    }
    if request.stage != Stage::Detector {
        let stage = DistanceRecipe::prepared(
            request.config,
            &dataset,
            Some(request.run),
            request.goes_on(DistanceRecipe::STAGE)?,
            device,
            progress,
        )?;
        summary.distance_seconds = Some(run_announced(stage, &fingerprint, &place())?.seconds);
    }
    if request.trains(SizeRecipe::STAGE) {
        let stage = SizeRecipe::prepared(request.config, &dataset, device, progress)?;
        let recipe = Arc::clone(&stage.recipe);
        summary.size_seconds = Some(run_announced(stage, &fingerprint, &place())?.seconds);
        recipe.finish(request.run, &dataset, progress)?;
    }
    let complete = NEEDED
        .iter()
        .all(|stage| request.folder(stage).best().exists());
    if !complete {
        summary.not_evaluated = Some(NotEvaluated::MissingNetwork);
    } else if !validates {
        summary.not_evaluated = Some(NotEvaluated::NoValidationFrames);
    } else {
        let ranger = StereoRanger::load(request.run, device)?;
        let evaluation = evaluate_dataset(&ranger, request.run, &dataset, Split::Val, progress)?;
        summary.evaluation = Some(evaluation);
    }
    write_json(&request.run.join("summary.json"), &summary)?;
    Ok(summary)
}

/// Keeps other processes from training into the run; the system ends it with this one.
fn lock(run: &Path) -> Result<File> {
    let path = run.join(LOCK);
    let file = File::create(&path).map_err(Error::io("write", &path))?;
    if matches!(file.try_lock(), Err(TryLockError::WouldBlock)) {
        return Err(Error::training(
            format!("another process trains into {}", run.display()),
            "wait for it, stop it, or train into another --run",
        ));
    }
    // A file system without locks is no reason not to train.
    Ok(file)
}

/// Checks the settings and opens what they name: the dataset, divided as the settings say, and the
/// device.
pub(super) fn open_dataset(
    request: &TrainRequest,
    progress: &dyn Progress,
) -> Result<(StereoDataset, DeviceSet)> {
    let devices = DeviceSet::open(request.devices)?;
    request.config.validate()?;
    refuse_uneven(request, devices.len())?;
    let mut dataset = StereoDataset::open(request.data)?;
    if let Some(split) = request.config.split {
        dataset.resplit(split, request.config.seed)?;
    }
    refuse_unlearnable(request, &dataset)?;
    dataset.check_images(progress)?;
    for problem in &dataset.problems {
        progress.note(&format!("left out: {problem}"));
    }
    Ok((dataset, devices))
}

/// Refuses batches that several devices cannot share evenly.
fn refuse_uneven(request: &TrainRequest, devices: usize) -> Result<()> {
    let config = request.config;
    if devices == 1 {
        return Ok(());
    }
    let stages = [
        (
            "detector",
            config.detector.batch,
            config.detector.micro_batch,
        ),
        (
            "distance",
            config.distance.batch,
            config.distance.micro_batch,
        ),
        ("size", config.size.batch, config.size.batch),
    ];
    for (stage, batch, micro_batch) in stages {
        if !request.trains(stage) {
            continue;
        }
        let each = batch / devices;
        if !batch.is_multiple_of(devices) || !each.is_multiple_of(micro_batch.min(each)) {
            return Err(Error::value(
                format!("{stage}.batch = {batch}, {stage}.micro_batch = {micro_batch}"),
                format!("cannot be shared evenly by {devices} devices"),
                format!(
                    "give a batch that {devices} divides, and a micro_batch that divides the \
                     devices' shares"
                ),
            ));
        }
    }
    Ok(())
}

/// Refuses, before hours of training, a dataset without the labels that a stage learns from.
fn refuse_unlearnable(request: &TrainRequest, dataset: &StereoDataset) -> Result<()> {
    let kind = request.config.box_kind;
    if !dataset.info.label_kinds.contains(&kind) {
        let kinds = dataset.info.label_kinds.iter().map(ToString::to_string);
        let kinds: Vec<_> = kinds.collect();
        return Err(Error::dataset(
            &dataset.folder,
            format!("has no {kind} boxes, only {}", kinds.join(" and ")),
            format!("train with `--box-kind {}`", kinds.join("` or `")),
        ));
    }
    if request.stage != Stage::Detector && !dataset.info.stereo {
        return Err(Error::dataset(
            &dataset.folder,
            "has single images (stereo = false), which show no distance",
            "train the detector alone on it: `twinsight train detector`",
        ));
    }
    if request.stage != Stage::Detector {
        let frames = dataset.split(Split::Train);
        let labelled = |frame: &&Frame| !frame.vehicles(kind).is_empty();
        if !frames.iter().any(labelled) {
            return Err(Error::dataset(
                &dataset.folder,
                format!(
                    "has no vehicle with a {kind} box in both images of a training frame and a \
                     distance, which the distance network learns from"
                ),
                "label distances, or train the detector alone: `twinsight train detector`",
            ));
        }
    }
    Ok(())
}

/// Runs a stage and says what on, and what came of it.
fn run_announced<R: Recipe>(
    mut stage: PreparedStage<R>,
    fingerprint: &str,
    place: &StagePlace,
) -> Result<StageResult> {
    fingerprint.clone_into(&mut stage.steering.dataset);
    let progress = place.progress;
    let items = stage.recipe.items();
    progress.note(&format!("{}: {items} training images", R::STAGE));
    let result = run_stage(stage, place)?;
    if let Some((_, epoch)) = result.best {
        progress.note(&format!(
            "{}: best weights are those of epoch {epoch}",
            R::STAGE
        ));
    }
    Ok(result)
}

impl TrainRequest<'_> {
    /// Whether a network of this name is trained.
    pub(super) fn trains(&self, stage: &str) -> bool {
        if stage == SizeRecipe::STAGE && self.config.size.epochs == 0 {
            return false;
        }
        match self.stage {
            Stage::All => true,
            Stage::Detector => stage == DetectorRecipe::STAGE,
            Stage::Distance => stage != DetectorRecipe::STAGE,
        }
    }

    pub(super) fn folder(&self, stage: &str) -> StageFolder {
        StageFolder::new(self.run, stage)
    }

    /// Whether a network of this name goes on from an epoch that it saved.
    fn goes_on(&self, stage: &str) -> Result<bool> {
        Ok(self.resume && self.folder(stage).dataset()?.is_some())
    }

    /// Whether a network of this name has been trained before.
    pub(super) fn has(&self, stage: &str) -> bool {
        self.folder(stage).last().exists()
    }
}

impl fmt::Display for TrainSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (stage, seconds) in [
            ("detector", self.detector_seconds),
            ("distance", self.distance_seconds),
            ("size", self.size_seconds),
        ] {
            if let Some(seconds) = seconds {
                writeln!(f, "{stage:<10} trained in {:.1} minutes", seconds / 60.0)?;
            }
        }
        if let Some(evaluation) = &self.evaluation {
            return write!(f, "{evaluation}");
        }
        f.write_str(match self.not_evaluated {
            Some(NotEvaluated::NoValidationFrames) => {
                "not evaluated: the dataset has no validation frames"
            }
            _ => "not evaluated: the run does not have both networks yet",
        })
    }
}
