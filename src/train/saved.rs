//! What a run folder remembers of how it was trained, and what of it must not change.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;

use super::config::TrainConfig;
use super::detector::DetectorRecipe;
use super::distance::DistanceRecipe;
use super::run::{STAGES, TrainRequest};
use super::size::SizeRecipe;
use super::stage::Recipe as _;
use crate::dataset::StereoDataset;
use crate::device::DeviceName;
use crate::error::{Error, Result};
use crate::evaluate::write_json;
use crate::files;

/// File of a run's settings.
pub(crate) const CONFIG: &str = "config.json";

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
    /// The dataset as it was then.
    #[serde(default)]
    pub(crate) dataset: SavedDataset,
}

/// What a run remembers of the content of its dataset; nothing, in runs of older versions.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
pub(crate) struct SavedDataset {
    pub fingerprint: Option<String>,
    /// Frames that training left out.
    #[serde(default)]
    pub left_out: usize,
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

/// Refuses to go on with a dataset that is no longer what a network was started on.
///
/// # Errors
/// Names network and dataset.
pub(super) fn refuse_changed_data(request: &TrainRequest, fingerprint: &str) -> Result<()> {
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
pub(super) fn refuse_other_settings(request: &TrainRequest) -> Result<()> {
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
pub(super) fn write_config(
    request: &TrainRequest,
    dataset: &StereoDataset,
    fingerprint: &str,
) -> Result<()> {
    let mut config = request.config.clone();
    if let Some(saved) = saved_config(request.run)? {
        let keeps = |stage: &str| request.has(stage) && !request.trains(stage);
        if keeps(DetectorRecipe::STAGE) {
            config.detector = saved.detector;
        }
        if keeps(DistanceRecipe::STAGE) {
            config.distance = saved.distance;
        }
        if keeps(SizeRecipe::STAGE) {
            config.size = saved.size;
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
