//! What the distance network owes to its inputs: the same training with other inputs, compared on
//! the same vehicles.
//!
//! [`ablate`] trains the distance network once for each [`Variant`] and seed, on the same vehicles in
//! the same order, measures labelled vehicles with all of them and with the arithmetic of
//! [`Baselines`], and writes tables, a plot and a page. The detector has no part in it: boxes are
//! those of the labels, in training moved at random as a detector's errors do.
//!
//! Every training is a run of its own below `runs`, and goes on where it stopped.

mod judge;
mod page;
mod show;
mod tables;
mod variant;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::dataset::{Split, StereoDataset};
use crate::device::DeviceName;
use crate::error::{Error, Result};
use crate::evaluate::{Baselines, write_json, write_table};
use crate::files;
use crate::progress::Progress;
use crate::train::{
    Stage, StageFolder, StagePlan, TrainConfig, TrainPlan, TrainRequest, plan, saved_config, train,
};

pub use tables::{AblationDifference, AblationRow, Estimate};
pub use variant::Variant;

/// The settings that every training of a folder has in common.
const SETTINGS: &str = "settings.json";

/// The folder of the trainings.
const RUNS: &str = "runs";

/// What to compare, on what, and where to.
#[derive(Debug, Clone, Copy)]
pub struct AblateRequest<'a> {
    /// Settings of all trainings; inputs, disparity, readout and seed are the variant's.
    pub config: &'a TrainConfig,
    /// Dataset folder.
    pub data: &'a Path,
    /// Folder for the runs, tables and pages.
    pub out: &'a Path,
    /// What to train.
    pub variants: &'a [Variant],
    /// Seeds of the trainings; with several, figures are over all of them.
    pub seeds: &'a [u64],
    /// Split that is measured.
    pub split: Split,
    /// Where to compute: one device, or several that share every batch.
    pub devices: &'a [DeviceName],
}

/// What an ablation came to.
#[derive(Debug, Clone, Serialize)]
pub struct Ablation {
    /// Version of the program.
    pub version: String,
    /// Dataset folder.
    pub data: PathBuf,
    /// Split that was measured.
    pub split: Split,
    /// Folder of the runs, tables and pages.
    pub out: PathBuf,
    /// Frames measured.
    pub frames: usize,
    /// Frames that could not be read.
    pub left_out: usize,
    /// Labelled vehicles in them.
    pub vehicles: usize,
    /// Seeds of the trainings.
    pub seeds: Vec<u64>,
    /// What the bootstrap draws: "scene" or "frame".
    pub unit: String,
    /// How many there are.
    pub units: usize,
    /// Its draws.
    pub draws: usize,
    /// Settings that all trainings have in common.
    pub config: TrainConfig,
    /// Constants of the baselines.
    pub baselines: Option<Baselines>,
    /// Every variant and baseline, over all vehicles and by distance.
    pub rows: Vec<AblationRow>,
    /// Every variant and baseline against the first variant, and every variant against matching, on
    /// the same vehicles.
    pub differences: Vec<AblationDifference>,
}

/// Trains what is not trained yet, measures, and writes `ablation.csv`, `differences.csv` and
/// `estimates.csv`, each as JSON too, `ablation.svg` and `ablation.html`.
///
/// # Errors
/// Settings, a dataset or a folder that cannot be used, a device that fails, and
/// [`Error::Interrupted`], after which the same request goes on.
pub fn ablate(request: &AblateRequest, progress: &dyn Progress) -> Result<Ablation> {
    let dataset = open(request)?;
    claim_folder(request, &dataset)?;
    let mut trained = Vec::new();
    let total = request.variants.len() * request.seeds.len();
    for &seed in request.seeds {
        for &variant in request.variants {
            let run = run_folder(request.out, variant, seed);
            progress.note(&format!(
                "training {} of {total}: {variant}, seed {seed}",
                trained.len() + 1
            ));
            train_run(request, variant, seed, &run, progress)?;
            trained.push((variant, seed, StageFolder::new(&run, "distance").best()));
        }
    }
    let (ablation, estimates) = judge::judge(request, &dataset, &trained, progress)?;
    write_table(request.out, "estimates", &estimates)?;
    write_table(request.out, "differences", &ablation.differences)?;
    write_table(request.out, "ablation", &ablation.rows)?;
    page::write(&ablation)?;
    write_json(&request.out.join("summary.json"), &ablation)?;
    Ok(ablation)
}

/// Measures a few steps of every variant's training; writes nothing but missing composites.
///
/// # Errors
/// Whatever would stop the first training at its start.
pub fn plan_ablation(request: &AblateRequest, progress: &dyn Progress) -> Result<TrainPlan> {
    open(request)?;
    let mut stages = Vec::new();
    for &variant in request.variants {
        let config = variant.configure(request.config, request.config.seed)?;
        let run = run_folder(request.out, variant, config.seed);
        let of = plan(&train_request(request, &config, &run), progress)?;
        stages.extend(of.stages.into_iter().map(|stage| StagePlan {
            stage: variant.word().to_owned(),
            ..stage
        }));
    }
    Ok(TrainPlan { stages })
}

fn run_folder(out: &Path, variant: Variant, seed: u64) -> PathBuf {
    out.join(RUNS).join(format!("{variant}-seed{seed}"))
}

fn train_request<'a>(
    request: &'a AblateRequest,
    config: &'a TrainConfig,
    run: &'a Path,
) -> TrainRequest<'a> {
    TrainRequest {
        config,
        data: request.data,
        run,
        stage: Stage::Distance,
        resume: true,
        devices: request.devices,
    }
}

/// Trains a run from where it is; one that is finished is left alone.
fn train_run(
    request: &AblateRequest,
    variant: Variant,
    seed: u64,
    run: &Path,
    progress: &dyn Progress,
) -> Result<()> {
    let config = variant.configure(request.config, seed)?;
    // Written at the end of a training alone.
    let is_finished = run.join("summary.json").exists()
        && StageFolder::new(run, "distance").best().exists()
        && saved_config(run)?.is_some_and(|saved| saved == config);
    if is_finished {
        return Ok(());
    }
    match train(&train_request(request, &config, run), progress) {
        Err(Error::Interrupted { .. }) => Err(Error::Interrupted {
            resume: "finished trainings and epochs are saved; run the same command again to go on"
                .to_owned(),
        }),
        other => other.map(drop),
    }
}

/// Opens the dataset, divided as the settings say, and finds out before hours of training what would
/// stop the measurement after them.
fn open(request: &AblateRequest) -> Result<StereoDataset> {
    if request.variants.is_empty() || request.seeds.is_empty() {
        return Err(Error::value(
            "ablation",
            "there is nothing to train",
            "give at least one variant and one seed",
        ));
    }
    for &variant in request.variants {
        variant.configure(request.config, request.config.seed)?;
    }
    let has_other_seeds = request
        .seeds
        .iter()
        .any(|seed| *seed != request.config.seed);
    if request.config.split.is_some() && has_other_seeds {
        return Err(Error::value(
            "seeds",
            "the settings divide frames anew by their seed: with another one, networks would learn \
             from different frames",
            "take `split` out of the settings, or give the settings' seed alone",
        ));
    }
    let mut dataset = StereoDataset::open(request.data)?;
    if let Some(split) = request.config.split {
        dataset.resplit(split, request.config.seed)?;
    }
    let kind = request.config.box_kind;
    let count = |split| -> usize {
        let frames = dataset.split(split).into_iter();
        frames.map(|frame| frame.vehicles(kind).len()).sum()
    };
    for split in [Split::Train, request.split] {
        if count(split) == 0 {
            return Err(Error::dataset(
                &dataset.folder,
                format!("has no vehicle with {kind} boxes in both images with split {split}"),
                "give another --split or --data",
            ));
        }
    }
    Ok(dataset)
}

/// What every training of a folder shares.
#[derive(Serialize, Deserialize)]
struct Settings {
    data: PathBuf,
    fingerprint: String,
    config: TrainConfig,
}

/// Refuses a folder that belongs to something else, and to other settings or another dataset.
fn claim_folder(request: &AblateRequest, dataset: &StereoDataset) -> Result<()> {
    let out = request.out;
    let path = out.join(SETTINGS);
    let settings = Settings {
        data: request.data.to_path_buf(),
        fingerprint: dataset.fingerprint()?,
        config: request.config.clone(),
    };
    let refuse = |problem: &str| {
        Err(Error::value(
            out.display().to_string(),
            problem.to_owned(),
            "give another --out, or remove it",
        ))
    };
    let is_ours = path.exists();
    // Nothing was trained under settings that were refused or corrected at once.
    if is_ours && out.join(RUNS).exists() {
        let saved: Settings =
            serde_json::from_str(&files::read_text(&path)?).map_err(|source| {
                Error::value(
                    path.display().to_string(),
                    format!("does not hold an ablation's settings: {source}"),
                    "restore the file, or give another --out",
                )
            })?;
        if saved.config != settings.config {
            return refuse("holds an ablation with other settings");
        }
        if saved.fingerprint != settings.fingerprint {
            return refuse(
                "holds an ablation of another dataset, or of this one before it changed",
            );
        }
        return Ok(());
    }
    let holds_anything =
        out.is_dir() && std::fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some());
    if holds_anything && !is_ours {
        return refuse("is not empty, and holds no ablation");
    }
    files::create_folder(out)?;
    write_json(&path, &settings)
}
