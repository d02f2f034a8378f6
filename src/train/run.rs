//! A whole run: data, detector, distance network, and what came of it.

use std::collections::BTreeSet;
use std::fmt;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::checkpoint::StageFolder;
use super::config::TrainConfig;
use super::detector::DetectorRecipe;
use super::devices::DeviceSet;
use super::distance::DistanceRecipe;
use super::log::RunLog;
use super::stage::{PreparedStage, Recipe, StagePlace, StageResult, run_stage};
use crate::dataset::{Frame, Split, StereoDataset};
use crate::device::DeviceName;
use crate::error::{Error, Result};
use crate::evaluate::{Evaluation, evaluate_dataset};
use crate::files;
use crate::pipeline::StereoRanger;
use crate::progress::Progress;

/// The networks of a run.
const STAGES: [&str; 2] = [DetectorRecipe::STAGE, DistanceRecipe::STAGE];
/// File that a process holds locked while it trains.
const LOCK: &str = "train.lock";
/// File of a run's settings.
const CONFIG: &str = "config.json";

/// Which networks are trained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// The detector, then the distance network.
    All,
    /// The detector alone.
    Detector,
    /// The distance network alone.
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
    let complete = STAGES
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

/// The settings that a run folder was last trained with, if it has any.
///
/// # Errors
/// A `config.json` that cannot be read.
pub fn saved_config(run: &Path) -> Result<Option<TrainConfig>> {
    Ok(SavedRun::read(run)?.map(|saved| saved.config))
}

/// What a run folder was last trained with, as its `config.json` tells.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct SavedRun {
    /// The settings.
    pub config: TrainConfig,
    /// The dataset's folder as it was given.
    pub data: PathBuf,
    /// What was computed on, separated by commas.
    device: String,
}

impl SavedRun {
    /// Reads a run folder's `config.json`, if there is one.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn read(run: &Path) -> Result<Option<Self>> {
        let path = run.join(CONFIG);
        if !path.exists() {
            return Ok(None);
        }
        let saved = serde_json::from_str(&files::read_text(&path)?).map_err(|source| {
            Error::value(
                path.display().to_string(),
                format!("does not hold a run's settings: {source}"),
                "restore the file that `train` wrote",
            )
        })?;
        Ok(Some(saved))
    }

    /// What was computed on.
    ///
    /// # Errors
    /// A name that is no device's.
    pub fn devices(&self) -> Result<Vec<DeviceName>> {
        self.device.split(',').map(str::parse).collect()
    }
}

impl TrainRequest<'_> {
    /// Whether a network of this name is trained.
    fn trains(&self, stage: &str) -> bool {
        match self.stage {
            Stage::All => true,
            Stage::Detector => stage == DetectorRecipe::STAGE,
            Stage::Distance => stage == DistanceRecipe::STAGE,
        }
    }

    fn folder(&self, stage: &str) -> StageFolder {
        StageFolder::new(self.run, stage)
    }

    /// Whether a network of this name goes on from an epoch that it saved.
    fn goes_on(&self, stage: &str) -> Result<bool> {
        Ok(self.resume && self.folder(stage).dataset()?.is_some())
    }

    /// Whether a network of this name has been trained before.
    fn has(&self, stage: &str) -> bool {
        self.folder(stage).last().exists()
    }
}

/// Refuses to go on with a dataset that is no longer what a network was started on.
fn refuse_changed_data(request: &TrainRequest, fingerprint: &str) -> Result<()> {
    for stage in STAGES {
        if !request.trains(stage) {
            continue;
        }
        let known = request.folder(stage).dataset()?;
        if known.is_some_and(|known| known != fingerprint) {
            return Err(Error::dataset(
                request.data,
                format!(
                    "is no longer the dataset that the {stage} of {} was started on: frames, splits \
                     or labels changed",
                    request.run.display()
                ),
                "resume with the old dataset, or train on into another --run from this one's weights \
                 (--weights, --distance-weights)",
            ));
        }
    }
    Ok(())
}

/// Refuses settings that a network goes on with and was not started with, and a second network
/// that does not share the first one's general settings. The run's own `config.json`, which says
/// what to go back to, is still there then.
fn refuse_other_settings(request: &TrainRequest) -> Result<()> {
    let Some(saved) = saved_config(request.run)? else {
        return Ok(());
    };
    let encoded = |config: &TrainConfig| {
        serde_json::to_value(config).map_err(|source| {
            Error::training(
                format!("cannot encode the settings: {source}"),
                "report this as a defect",
            )
        })
    };
    let (mut before, mut now) = (encoded(&saved)?, encoded(request.config)?);
    for settings in [&mut before, &mut now] {
        let Some(settings) = settings.as_object_mut() else {
            continue;
        };
        // It changes no result.
        settings.remove("cache_mib");
        for stage in STAGES {
            if !(request.resume && request.trains(stage) && request.has(stage)) {
                settings.remove(stage);
            }
        }
        let stays = |stage: &&str| request.has(stage) && (request.resume || !request.trains(stage));
        if !STAGES.iter().any(stays) {
            settings.clear();
        }
    }
    let mut changes = Vec::new();
    differences("", &before, &now, &mut changes);
    if changes.is_empty() {
        return Ok(());
    }
    Err(Error::training(
        format!(
            "{} was started with other settings: {}",
            request.run.display(),
            changes.join(", ")
        ),
        "give the run's own values (with --resume they may be left out), or train into another --run",
    ))
}

/// Names the settings that differ, with both values.
fn differences(name: &str, before: &Value, now: &Value, found: &mut Vec<String>) {
    if let (Value::Object(before), Value::Object(now)) = (before, now) {
        let keys: BTreeSet<&String> = before.keys().chain(now.keys()).collect();
        for key in keys {
            let path = if name.is_empty() {
                key.clone()
            } else {
                format!("{name}.{key}")
            };
            let of = |values: &serde_json::Map<String, Value>| {
                values.get(key).cloned().unwrap_or_default()
            };
            differences(&path, &of(before), &of(now), found);
        }
    } else if before != now {
        found.push(format!("{name} was {before} and is {now}"));
    }
}

/// `config.json`: the settings and what they were applied to. A network that is there already and is
/// not trained now keeps its own.
fn write_config(request: &TrainRequest, dataset: &StereoDataset, fingerprint: &str) -> Result<()> {
    let mut config = request.config.clone();
    if let Some(saved) = saved_config(request.run)? {
        let keeps = |stage: &str| request.has(stage) && !request.trains(stage);
        if keeps(DetectorRecipe::STAGE) {
            config.detector = saved.detector;
        }
        if keeps(DistanceRecipe::STAGE) {
            config.distance = saved.distance;
        }
    }
    let config = serde_json::json!({
        "version": env!("CARGO_PKG_VERSION"),
        "config": config,
        "stage": request.stage,
        "device": request.devices.iter().map(ToString::to_string).collect::<Vec<_>>().join(","),
        "data": request.data,
        "environment": {
            "commit": option_env!("TWINSIGHT_COMMIT"),
            "system": std::env::consts::OS,
            "processor": std::env::consts::ARCH,
            "threads": rayon::current_num_threads(),
            "vector_lanes": crate::kernels::simd::vector_lanes(),
        },
        "dataset": {
            "fingerprint": fingerprint,
            "classes": dataset.classes(),
            "rig": dataset.rig(),
            "frames": dataset.frames.len(),
            "left_out": dataset.problems.len(),
        },
    });
    write_json(&request.run.join(CONFIG), &config)
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let json = serde_json::to_vec_pretty(value).map_err(|source| {
        Error::training(
            format!("cannot encode {}: {source}", path.display()),
            "report this as a defect",
        )
    })?;
    files::write_atomically(path, &json)
}

impl fmt::Display for TrainSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (stage, seconds) in [
            ("detector", self.detector_seconds),
            ("distance", self.distance_seconds),
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
