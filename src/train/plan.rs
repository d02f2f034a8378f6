//! What a training would take, measured on a few steps of it.

use std::fmt;
use std::fs;

use std::sync::Arc;
use std::time::Instant;

use burn::data::dataloader::DataLoader as _;
use burn::module::{Module as _, ModuleDisplay};
use burn::optim::GradientsAccumulator;
use burn::tensor::ExecutionError;
use burn::train::{ItemLazy as _, Learner};
use serde::Serialize;

use super::detector::DetectorRecipe;
use super::devices::DeviceSet;
use super::distance::DistanceRecipe;
use super::loader::{Pass, PassLoader, steps_per_epoch};
use super::run::{Stage, TrainRequest, open_dataset};
use super::schedule::schedule;
use super::size::SizeRecipe;
use super::stage::{PreparedStage, Recipe, Steering, device_of};
use super::trainee::{Failure, Trainee, TraineeOf};
use crate::error::{Error, Result};
use crate::progress::Progress;

/// Rounds of measurement; the fastest step of each kind counts.
const ROUNDS: usize = 5;
/// No round begins after so many seconds, once there were two.
const LONGEST_SECONDS: f64 = 20.0;
/// Steps of a round without loading beside them, and with it.
const STEPS: usize = 2;

/// What training one network would take.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StagePlan {
    /// "detector", "distance" or "size".
    pub stage: String,
    /// Trained and frozen numbers of the network.
    pub parameters: usize,
    /// Training images or vehicles.
    pub items: usize,
    /// Passes over them.
    pub epochs: u32,
    /// Optimiser steps in all.
    pub steps: u64,
    /// Seconds of a step's forward and backward passes alone, its data loaded beforehand.
    pub pass_seconds: f64,
    /// Seconds of the whole step: with clipping, optimiser and averaged weights.
    pub step_seconds: f64,
    /// Seconds of loading a step's data, with nothing beside it.
    pub load_seconds: f64,
    /// Seconds from step to step, the next one's data loaded beside it as training does.
    pub whole_seconds: f64,
    /// Most memory that the process held during the measured steps, MiB; unknown where the system
    /// does not say. Memory of a graphics card is not in it.
    pub peak_mib: Option<u64>,
}

impl StagePlan {
    /// Seconds of all steps, without validation.
    pub fn seconds(&self) -> f64 {
        self.steps as f64 * self.whole_seconds
    }

    /// Throughput of training as a share of that of the forward and backward passes alone: what
    /// loading, augmentation, clipping, optimiser and averaged weights leave of it.
    pub fn throughput_ratio(&self) -> f64 {
        self.pass_seconds / self.whole_seconds
    }
}

/// What a run would take.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrainPlan {
    /// Its stages in order.
    pub stages: Vec<StagePlan>,
}

/// Measures a few steps of a training without writing anything into the run folder. Composites
/// that the dataset lacks are prepared, as training would.
///
/// # Errors
/// Whatever would stop the training at its start.
pub fn plan(request: &TrainRequest, progress: &dyn Progress) -> Result<TrainPlan> {
    let (dataset, devices) = open_dataset(request, progress)?;
    let device = devices.main();
    let mut stages = Vec::new();
    if request.stage != Stage::Distance {
        let stage = DetectorRecipe::prepared(request.config, &dataset, false, device, progress)?;
        stages.push(measure(stage, &devices)?);
    }
    if request.stage != Stage::Detector {
        let stage =
            DistanceRecipe::prepared(request.config, &dataset, None, false, device, progress)?;
        stages.push(measure(stage, &devices)?);
    }
    if request.trains(SizeRecipe::STAGE) {
        let stage = SizeRecipe::prepared(request.config, &dataset, device, progress)?;
        stages.push(measure(stage, &devices)?);
    }
    Ok(TrainPlan { stages })
}

/// Measures a few steps on the first device; several devices share a step's items.
fn measure<R: Recipe>(stage: PreparedStage<R>, devices: &DeviceSet) -> Result<StagePlan> {
    forget_peak();
    let PreparedStage {
        recipe,
        steering,
        network,
    } = stage;
    let parameters = network.num_params();
    let items = recipe.items();
    let steps_per_epoch = steps_per_epoch(items, steering.batch, devices.len());
    let failure = Failure::default();
    let trainee = Trainee::new(
        Arc::clone(&recipe),
        &steering,
        network,
        0,
        devices,
        failure.clone(),
    );
    let optimizer = recipe.optimizer(steering.warmup_steps(steps_per_epoch))?;
    let rates = schedule(&steering, steps_per_epoch)?;
    let mut measured = Measured {
        learner: Learner::new(trainee, optimizer, rates),
        recipe,
        batch: (steering.batch / devices.len()).min(items).max(1),
        micro_batch: steering.micro_batch,
        failure,
    };
    let [mut pass_seconds, mut step_seconds, mut load_seconds] = [f64::INFINITY; 3];
    let mut whole_seconds = f64::INFINITY;
    let started = Instant::now();
    for round in 0..ROUNDS {
        if round >= 2 && started.elapsed().as_secs_f64() > LONGEST_SECONDS {
            break;
        }
        for _ in 0..STEPS {
            let begun = Instant::now();
            let passes = measured.load()?;
            load_seconds = load_seconds.min(begun.elapsed().as_secs_f64());
            let [passing, step] = measured.step(passes)?;
            pass_seconds = pass_seconds.min(passing);
            step_seconds = step_seconds.min(step);
        }
        let whole = measured.loading_step(&steering, devices)?;
        whole_seconds = whole_seconds.min(whole.unwrap_or(f64::INFINITY));
    }
    if whole_seconds.is_infinite() {
        // An epoch of one step loads nothing beside it.
        whole_seconds = load_seconds + step_seconds;
    }
    Ok(StagePlan {
        stage: R::STAGE.to_owned(),
        parameters,
        items,
        epochs: steering.epochs,
        steps: u64::from(steering.epochs) * steps_per_epoch,
        pass_seconds,
        step_seconds,
        load_seconds,
        whole_seconds,
        peak_mib: peak_mib(),
    })
}

/// A stage that takes steps to be timed.
struct Measured<R: Recipe>
where
    R::Model: ModuleDisplay,
{
    learner: Learner<TraineeOf<R>>,
    recipe: Arc<R>,
    /// Items of a device's step.
    batch: usize,
    micro_batch: usize,
    failure: Failure,
}

impl<R: Recipe> Measured<R> {
    /// The passes of a step.
    fn load(&self) -> Result<Vec<Pass<R::Batch>>> {
        let epoch_started = Instant::now();
        let items: Vec<usize> = (0..self.batch).collect();
        let passes = items.chunks(self.micro_batch).map(|items| {
            Ok(Pass {
                batch: self.recipe.load(0, items)?,
                items: items.to_vec(),
                share: items.len() as f64 / self.batch as f64,
                epoch: 0,
                epoch_started,
            })
        });
        passes.collect()
    }

    /// Seconds of a step's passes, and of the step.
    fn step(&mut self, passes: impl IntoIterator<Item = Pass<R::Batch>>) -> Result<[f64; 2]> {
        let started = Instant::now();
        let mut accumulator = GradientsAccumulator::new();
        for pass in passes {
            let output = self.learner.train_step(pass);
            accumulator.accumulate(&self.learner.model(), output.grads);
            let report = output.item.sync().map_err(|source| device_error(&source))?;
            let loss: f64 = report.terms.iter().sum();
            if !loss.is_finite() {
                return Err(Error::training(
                    format!("the first loss is {loss}"),
                    "start from other weights",
                ));
            }
        }
        let device = device_of(&self.learner.model().network);
        device.sync().map_err(|source| device_error(&source))?;
        let passing = started.elapsed().as_secs_f64();
        self.learner.lr_step();
        self.learner.optimizer_step(accumulator.grads());
        device.sync().map_err(|source| device_error(&source))?;
        let step = started.elapsed().as_secs_f64();
        self.failure.take().map_or(Ok([passing, step]), Err)
    }

    /// Seconds of the fastest step with the next one's data loaded beside it; none in an epoch of one
    /// step.
    fn loading_step(&mut self, steering: &Steering, devices: &DeviceSet) -> Result<Option<f64>> {
        let full_steps = self.recipe.items() / steering.batch;
        let steps = STEPS.min(full_steps.saturating_sub(1));
        if steps == 0 {
            return Ok(None);
        }
        let recipe = Arc::clone(&self.recipe);
        let loader = PassLoader::new(recipe, steering, devices.len(), 0, self.failure.clone());
        let own = loader.slice(0, 0);
        // An error of the loader ends them and is the failure that the step reports.
        let mut passes = own.iter().filter_map(std::result::Result::ok);
        let passes_per_step = self.batch.div_ceil(self.micro_batch);
        // The first one waits for its data.
        self.step(passes.by_ref().take(passes_per_step))?;
        let mut least = f64::INFINITY;
        for _ in 0..steps {
            let started = Instant::now();
            self.step(passes.by_ref().take(passes_per_step))?;
            least = least.min(started.elapsed().as_secs_f64());
        }
        Ok(Some(least))
    }
}

fn device_error(source: &ExecutionError) -> Error {
    Error::training(source.to_string(), "try a smaller batch or another device")
}

/// Lets the system count the peak anew, where it can (Linux).
fn forget_peak() {
    // A system that cannot reports a peak that is too high, never one that is too low.
    let _ = fs::write("/proc/self/clear_refs", "5");
}

/// Most memory that the process has held, MiB (Linux).
fn peak_mib() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024)
}

impl fmt::Display for TrainPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:<12}{:>12}{:>9}{:>8}{:>9}{:>10}{:>10}{:>10}{:>10}{:>8}{:>10}{:>8}",
            "network",
            "parameters",
            "items",
            "epochs",
            "steps",
            "passes s",
            "step s",
            "load s",
            "whole s",
            "ratio",
            "minutes",
            "MiB"
        )?;
        for stage in &self.stages {
            let peak = stage.peak_mib.map_or("?".to_owned(), |mib| mib.to_string());
            writeln!(
                f,
                "{:<12}{:>12}{:>9}{:>8}{:>9}{:>10.3}{:>10.3}{:>10.3}{:>10.3}{:>8.2}{:>10.1}{:>8}",
                stage.stage,
                stage.parameters,
                stage.items,
                stage.epochs,
                stage.steps,
                stage.pass_seconds,
                stage.step_seconds,
                stage.load_seconds,
                stage.whole_seconds,
                stage.throughput_ratio(),
                stage.seconds() / 60.0,
                peak
            )?;
        }
        write!(
            f,
            "\nMeasured on a few steps of each network. Passes are forward and backward alone; a step has clipping, \
             optimiser and averaged weights too; whole is from step to step with the next one's data loaded \
             beside it. The ratio of passes to whole is the share of the bare network's throughput that training \
             reaches. Validation is not in the minutes, and of the decoded images that stay in memory (up to \
             cache_mib) only those of these steps are in the MiB.\nNothing was trained."
        )
    }
}
