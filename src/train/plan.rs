//! What a training would take, measured on a few steps of it.

use std::fmt;
use std::fs;

use std::sync::Arc;
use std::time::Instant;

use burn::module::Module as _;
use burn::optim::GradientsAccumulator;
use burn::train::{ItemLazy as _, Learner};
use serde::Serialize;

use super::detector::DetectorRecipe;
use super::devices::DeviceSet;
use super::distance::DistanceRecipe;
use super::loader::{Pass, steps_per_epoch};
use super::run::{Stage, TrainRequest, open_dataset};
use super::schedule::RiseAndFall;
use super::stage::{PreparedStage, Recipe, device_of};
use super::trainee::{Failure, Trainee, TraineeOf};
use crate::error::{Error, Result};
use crate::progress::Progress;

/// Steps that are measured; the fastest counts.
const ROUNDS: usize = 3;

/// What training one network would take.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StagePlan {
    /// "detector" or "distance".
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
    /// Seconds of loading a step's data, which happens during the step before.
    pub load_seconds: f64,
    /// Most memory that the process held during the measured steps, MiB; unknown where the system
    /// does not say. Memory of a graphics card is not in it.
    pub peak_mib: Option<u64>,
}

impl StagePlan {
    /// Seconds of all steps, without validation.
    pub fn seconds(&self) -> f64 {
        self.steps as f64 * self.step_seconds.max(self.load_seconds)
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
        let stage = DetectorRecipe::prepared(request.config, &dataset, device, progress)?;
        stages.push(measure(stage, &devices)?);
    }
    if request.stage != Stage::Detector {
        let stage = DistanceRecipe::prepared(request.config, &dataset, None, device, progress)?;
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
        optimizer,
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
    let schedule = RiseAndFall::new(steering.clone(), steps_per_epoch);
    let mut learner = Learner::new(trainee, optimizer, schedule);
    let batch = (steering.batch / devices.len()).min(items).max(1);
    let mut least = [f64::INFINITY; 3];
    for _ in 0..ROUNDS {
        let seconds = time_step(&mut learner, &*recipe, batch, steering.micro_batch)?;
        if let Some(error) = failure.take() {
            return Err(error);
        }
        for (least, seconds) in least.iter_mut().zip(seconds) {
            *least = least.min(seconds);
        }
    }
    let [pass_seconds, step_seconds, load_seconds] = least;
    Ok(StagePlan {
        stage: R::STAGE.to_owned(),
        parameters,
        items,
        epochs: steering.epochs,
        steps: u64::from(steering.epochs) * steps_per_epoch,
        pass_seconds,
        step_seconds,
        load_seconds,
        peak_mib: peak_mib(),
    })
}

/// Seconds of the passes of a step with data that is loaded beforehand, of the whole step, and of
/// loading its data.
fn time_step<R: Recipe>(
    learner: &mut Learner<TraineeOf<R>>,
    recipe: &R,
    batch: usize,
    micro_batch: usize,
) -> Result<[f64; 3]> {
    let started = Instant::now();
    let items: Vec<usize> = (0..batch).collect();
    let mut passes = Vec::new();
    for items in items.chunks(micro_batch) {
        passes.push(Pass {
            batch: recipe.load(0, items)?,
            items: items.to_vec(),
            share: items.len() as f64 / batch as f64,
            epoch: 0,
            epoch_started: started,
        });
    }
    let loading = started.elapsed().as_secs_f64();
    let started = Instant::now();
    let mut accumulator = GradientsAccumulator::new();
    for pass in passes {
        let output = learner.train_step(pass);
        accumulator.accumulate(&learner.model(), output.grads);
        let report = output.item.sync().map_err(|source| {
            Error::training(source.to_string(), "try a smaller batch or another device")
        })?;
        let loss: f64 = report.terms.iter().sum();
        if !loss.is_finite() {
            return Err(Error::training(
                format!("the first loss is {loss}"),
                "start from other weights",
            ));
        }
    }
    let synced = device_of(&learner.model().network).sync();
    synced.map_err(|source| {
        Error::training(source.to_string(), "try a smaller batch or another device")
    })?;
    let passing = started.elapsed().as_secs_f64();
    learner.lr_step();
    learner.optimizer_step(accumulator.grads());
    Ok([passing, started.elapsed().as_secs_f64(), loading])
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
            "{:<12}{:>12}{:>9}{:>8}{:>9}{:>10}{:>10}{:>10}{:>10}{:>10}",
            "network",
            "parameters",
            "items",
            "epochs",
            "steps",
            "passes s",
            "step s",
            "load s",
            "minutes",
            "MiB"
        )?;
        for stage in &self.stages {
            let peak = stage.peak_mib.map_or("?".to_owned(), |mib| mib.to_string());
            writeln!(
                f,
                "{:<12}{:>12}{:>9}{:>8}{:>9}{:>10.3}{:>10.3}{:>10.3}{:>10.1}{:>10}",
                stage.stage,
                stage.parameters,
                stage.items,
                stage.epochs,
                stage.steps,
                stage.pass_seconds,
                stage.step_seconds,
                stage.load_seconds,
                stage.seconds() / 60.0,
                peak
            )?;
        }
        write!(
            f,
            "\nMeasured on three steps of each network; passes are forward and backward alone. Loading \
             overlaps the step; validation is not in the minutes.\nNothing was trained."
        )
    }
}
