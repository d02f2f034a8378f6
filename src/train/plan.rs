//! What a training would take, measured on a few steps of it.

use std::fmt;
use std::fs;

use burn::module::Module;
use burn::optim::ModuleOptimizer;
use serde::Serialize;

use super::detector::DetectorRecipe;
use super::distance::DistanceRecipe;
use super::learner::Learner;
use super::optimizer::{detector_optimizer, distance_optimizer};
use super::run::{Stage, TrainRequest, open_dataset};
use super::stage::{Recipe, Steering};
use crate::error::Result;
use crate::progress::Progress;

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
    /// Seconds of a step, its data loaded beforehand.
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
    let (dataset, device) = open_dataset(request, progress)?;
    let mut stages = Vec::new();
    if request.stage != Stage::Distance {
        let recipe = DetectorRecipe::new(request.config, &dataset, &device)?;
        let settings = &request.config.detector;
        let optimizer = detector_optimizer(settings.optimizer, settings.weight_decay)?;
        let model = recipe.model(progress)?;
        stages.push(measure(&recipe, &recipe.steering(), model, optimizer)?);
    }
    if request.stage != Stage::Detector {
        let recipe = DistanceRecipe::new(request.config, &dataset, None, &device, progress)?;
        let optimizer = distance_optimizer(request.config.distance.optimizer);
        let model = recipe.model(progress)?;
        stages.push(measure(&recipe, &recipe.steering(), model, optimizer)?);
    }
    Ok(TrainPlan { stages })
}

fn measure<R: Recipe>(
    recipe: &R,
    steering: &Steering,
    model: R::Model,
    optimizer: ModuleOptimizer,
) -> Result<StagePlan> {
    forget_peak();
    let parameters = model.num_params();
    let mut learner = Learner::new(model, optimizer, steering);
    let [step_seconds, load_seconds] = learner.time_step(recipe, steering)?;
    let items = recipe.items();
    let steps = u64::from(steering.epochs) * items.div_ceil(steering.batch) as u64;
    Ok(StagePlan {
        stage: R::STAGE.to_owned(),
        parameters,
        items,
        epochs: steering.epochs,
        steps,
        step_seconds,
        load_seconds,
        peak_mib: peak_mib(),
    })
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
            "{:<12}{:>12}{:>9}{:>8}{:>9}{:>10}{:>10}{:>10}{:>10}",
            "network",
            "parameters",
            "items",
            "epochs",
            "steps",
            "step s",
            "load s",
            "minutes",
            "MiB"
        )?;
        for stage in &self.stages {
            let peak = stage.peak_mib.map_or("?".to_owned(), |mib| mib.to_string());
            writeln!(
                f,
                "{:<12}{:>12}{:>9}{:>8}{:>9}{:>10.3}{:>10.3}{:>10.1}{:>10}",
                stage.stage,
                stage.parameters,
                stage.items,
                stage.epochs,
                stage.steps,
                stage.step_seconds,
                stage.load_seconds,
                stage.seconds() / 60.0,
                peak
            )?;
        }
        write!(
            f,
            "\nMeasured on three steps of each network. Loading overlaps the step; validation is not \
             in the minutes.\nNothing was trained."
        )
    }
}
