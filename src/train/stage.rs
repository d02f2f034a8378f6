//! The training loop, one for both networks: epochs, steps, accumulation, validation, saving.

use std::path::Path;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::Scope;
use std::time::Instant;

use burn::module::Module;
use burn::optim::ModuleOptimizer;
use burn::tensor::Tensor;
use burn_dataset::transform::ShuffledDataset;
use burn_dataset::{Dataset, InMemDataset};

use super::checkpoint::{StageFolder, StageState};
use super::config::Schedule;
use super::learner::{Learner, StepError, StepOutcome};
use super::log::{EpochRow, RunLog};
use super::optimizer::{named_weights, schedule_factor};
use crate::error::{Error, Result};
use crate::progress::Progress;

/// Passes that wait for their step, at most.
const LOADED_AHEAD: usize = 1;

/// The numbers that steer a stage.
#[derive(Debug, Clone)]
pub struct Steering {
    /// Seed of the data's order; the recipe's own randomness follows from it too.
    pub seed: u64,
    /// Passes over the data.
    pub epochs: u32,
    /// Items per optimiser step.
    pub batch: usize,
    /// Items per forward pass.
    pub micro_batch: usize,
    /// First learning rate.
    pub learning_rate: f64,
    /// Last learning rate as a share of the first.
    pub final_learning_rate: f64,
    /// How it falls.
    pub schedule: Schedule,
    /// Epochs over which it rises.
    pub warmup_epochs: f64,
    /// Longest global gradient norm, if limited.
    pub clip_norm: Option<f64>,
    /// Decay and ramp of averaged weights, if averaged.
    pub average: Option<(f64, f64)>,
    /// Validate every so many epochs.
    pub validate_every: u32,
    /// Stop after so many epochs without a better result; 0 never does.
    pub patience: u32,
    /// Keep the weights of so many last epochs in files of their own.
    pub keep_last: u32,
    /// The stage's settings as JSON text, to notice on resuming that they changed.
    pub settings: String,
}

impl Steering {
    /// Epochs without a better result, when they are too many.
    fn epochs_in_vain(&self, state: &StageState) -> Option<u32> {
        let (_, best) = state.best?;
        let epochs = state.epoch.saturating_sub(best);
        (self.patience > 0 && epochs >= self.patience).then_some(epochs)
    }
}

/// The loss of one forward pass.
pub struct PassLoss {
    /// What to differentiate, `[1]`.
    pub total: Tensor<1>,
    /// The loss to report, per item.
    pub reported: f64,
    /// Further terms to report, in the recipe's order.
    pub terms: Vec<f64>,
}

/// What differs between the networks.
pub trait Recipe: Sync {
    /// The network.
    type Model: Module;

    /// Loaded and augmented items, ready for a forward pass.
    type Batch: Send;

    /// Folder and log name of the stage.
    const STAGE: &'static str;

    /// Number of training items.
    fn items(&self) -> usize;

    /// What an item is called in messages: its files.
    fn item_name(&self, item: usize) -> String;

    /// Loads and augments items. Runs beside the steps; the result depends on nothing but the seed,
    /// the epoch and the items.
    ///
    /// # Errors
    /// An item that cannot be loaded.
    fn load(&self, epoch: u32, items: &[usize]) -> Result<Self::Batch>;

    /// The loss of loaded items; `share` is their part of the optimiser step.
    ///
    /// # Errors
    /// A device that fails.
    fn loss(&self, model: &Self::Model, batch: Self::Batch, share: f64) -> Result<PassLoss>;

    /// Writes a finished epoch's loss terms into its row.
    fn report_terms(&self, terms: &[f64], row: &mut EpochRow);

    /// Validates an inference copy of the model; the larger the result the better.
    ///
    /// # Errors
    /// An item that cannot be loaded, or a device that fails.
    fn validate(&self, model: &Self::Model, row: &mut EpochRow) -> Result<Option<f64>>;

    /// Pictures of what an inference copy of the model makes of some validation items.
    ///
    /// # Errors
    /// An item that cannot be loaded, or a device that fails.
    fn show(&self, model: &Self::Model, log: &mut RunLog, step: u64) -> Result<()>;

    /// The validation result of a row in a few words.
    fn describe(&self, row: &EpochRow) -> String;

    /// Saves an inference copy of the model for users.
    ///
    /// # Errors
    /// A file that cannot be written.
    fn save(&self, model: &Self::Model, path: &Path) -> Result<()>;
}

/// What a finished stage reports.
#[derive(Debug, Clone, PartialEq)]
pub struct StageResult {
    /// Best validation result and its epoch.
    pub best: Option<(f64, u32)>,
    /// Seconds of this call.
    pub seconds: f64,
}

/// Where a stage runs and reports.
pub struct StagePlace<'a> {
    /// Run folder.
    pub run: &'a Path,
    /// Go on from where a stopped run was.
    pub resume: bool,
    /// The run's logs.
    pub log: &'a mut RunLog,
    /// Who listens.
    pub progress: &'a dyn Progress,
}

/// Trains a stage from its start or from where a stopped run left it.
///
/// # Errors
/// Whatever stops it: [`Error::Interrupted`] on the user's wish (the state of the last finished
/// epoch is saved), a loss that is no longer finite, a file or device that fails.
pub fn run_stage<R: Recipe>(
    recipe: &R,
    steering: &Steering,
    model: R::Model,
    optimizer: ModuleOptimizer,
    place: StagePlace,
) -> Result<StageResult> {
    let StagePlace {
        run,
        resume,
        log,
        progress,
    } = place;
    let started = Instant::now();
    let folder = StageFolder::new(run, R::STAGE);
    folder.create()?;
    let mut learner = Learner::new(model, optimizer, steering);
    let mut state = StageState {
        settings: steering.settings.clone(),
        ..StageState::default()
    };
    if resume && let Some(saved) = folder.state(&steering.settings)? {
        learner = learner.restored(&folder, steering, &saved)?;
        state = saved;
        progress.note(&format!(
            "{}: resuming after epoch {}",
            R::STAGE,
            state.epoch
        ));
    }
    log.rewind(R::STAGE, state.epoch);

    let items = recipe.items();
    let steps_per_epoch = items.div_ceil(steering.batch) as u64;
    let remaining = u64::from(steering.epochs.saturating_sub(state.epoch)) * steps_per_epoch;
    progress.begin(R::STAGE, remaining);
    let mut trainer = Trainer {
        recipe,
        steering,
        steps_per_epoch,
        log,
        progress,
    };
    while state.epoch < steering.epochs {
        if let Some(epochs) = steering.epochs_in_vain(&state) {
            progress.note(&format!(
                "{}: stopped after epoch {}, {epochs} epochs without a better result",
                R::STAGE,
                state.epoch
            ));
            break;
        }
        let epoch = state.epoch;
        let mut row = trainer.epoch(&mut learner, &mut state)?;
        state.epoch = epoch + 1;
        let usable = learner.usable();
        if state.epoch.is_multiple_of(steering.validate_every) || state.epoch == steering.epochs {
            progress.status("validating");
            let result = recipe.validate(&usable, &mut row)?;
            let improves = match (result, state.best) {
                (Some(result), Some((best, _))) => result > best,
                (Some(_), None) => true,
                (None, _) => state.epoch == steering.epochs && state.best.is_none(),
            };
            if improves {
                recipe.save(&usable, &folder.best())?;
                state.best = result.map(|result| (result, state.epoch));
            }
            progress.note(&format!(
                "{} epoch {}/{}: loss {:.3}{}",
                R::STAGE,
                state.epoch,
                steering.epochs,
                row.loss,
                recipe.describe(&row)
            ));
            recipe.show(&usable, trainer.log, state.step)?;
            for (path, values) in named_weights(&usable)? {
                let tag = format!("weights/{path}");
                trainer
                    .log
                    .add_histogram(R::STAGE, &tag, state.step, &values);
            }
        }
        trainer.log.add(row)?;
        recipe.save(&usable, &folder.last())?;
        if steering.keep_last > 0 {
            recipe.save(&usable, &folder.of_epoch(state.epoch))?;
            folder.drop_epochs_before((state.epoch + 1).saturating_sub(steering.keep_last))?;
        }
        state.ema_updates = learner
            .average
            .as_ref()
            .map_or(0, |average| average.updates);
        let shadow = learner.average.is_some().then_some(usable);
        folder.save(&state, &learner.model, shadow, &learner.optimizer)?;
    }
    progress.end();
    Ok(StageResult {
        best: state.best,
        seconds: started.elapsed().as_secs_f64(),
    })
}

/// The parts of a stage that do not change from epoch to epoch.
struct Trainer<'a, R: Recipe> {
    recipe: &'a R,
    steering: &'a Steering,
    steps_per_epoch: u64,
    log: &'a mut RunLog,
    progress: &'a dyn Progress,
}

impl<'a, R: Recipe> Trainer<'a, R> {
    /// One pass over the data.
    fn epoch(
        &mut self,
        learner: &mut Learner<R::Model>,
        state: &mut StageState,
    ) -> Result<EpochRow> {
        let steering = self.steering;
        let started = Instant::now();
        let order = shuffled(self.recipe.items(), steering.seed, state.epoch);
        let mut sums = EpochSums::default();
        std::thread::scope(|scope| {
            let batches = self.loader(scope, &order, state.epoch);
            self.steps(&order, &batches, learner, state, &mut sums)
        })?;
        let mut row = EpochRow {
            stage: R::STAGE.to_owned(),
            epoch: state.epoch + 1,
            step: state.step,
            learning_rate: sums.learning_rate,
            loss: sums.loss / sums.items.max(1) as f64,
            gradient_norm: Some(sums.gradient_norm / sums.steps.max(1) as f64),
            images_per_second: sums.items as f64 / started.elapsed().as_secs_f64(),
            ..EpochRow::default()
        };
        let terms: Vec<f64> = sums
            .terms
            .iter()
            .map(|sum| sum / sums.items.max(1) as f64)
            .collect();
        self.recipe.report_terms(&terms, &mut row);
        Ok(row)
    }

    /// Starts a thread that loads the passes of an epoch in order, a little ahead of the steps. It
    /// ends when the receiver is dropped.
    fn loader<'scope>(
        &self,
        scope: &'scope Scope<'scope, '_>,
        order: &'scope [usize],
        epoch: u32,
    ) -> Receiver<Result<R::Batch>>
    where
        'a: 'scope,
        R::Batch: 'scope,
    {
        let (sender, receiver) = sync_channel(LOADED_AHEAD);
        let (recipe, steering) = (self.recipe, self.steering);
        scope.spawn(move || {
            for batch in order.chunks(steering.batch) {
                for items in batch.chunks(steering.micro_batch) {
                    if sender.send(recipe.load(epoch, items)).is_err() {
                        return;
                    }
                }
            }
        });
        receiver
    }

    /// The optimiser steps of an epoch.
    fn steps(
        &mut self,
        order: &[usize],
        batches: &Receiver<Result<R::Batch>>,
        learner: &mut Learner<R::Model>,
        state: &mut StageState,
        sums: &mut EpochSums,
    ) -> Result<()> {
        let steering = self.steering;
        for batch in order.chunks(steering.batch) {
            if self.progress.interrupted() {
                self.progress.end();
                return Err(Error::Interrupted {
                    resume: format!(
                        "{} is saved up to epoch {}; run the same command with --resume to go on",
                        R::STAGE,
                        state.epoch
                    ),
                });
            }
            let rate = self.learning_rate(state.step);
            let next = || {
                batches
                    .recv()
                    .unwrap_or_else(|_| unreachable!("the loader sends every pass or an error"))
            };
            let step = learner.step(self.recipe, steering, rate, batch, next);
            let step = step.map_err(|error| match error {
                StepError::Other(error) => error,
                StepError::NotFinite(reported, items) => {
                    self.progress.end();
                    self.not_finite(reported, &items, state)
                }
            })?;
            sums.add(&step, batch.len());
            sums.learning_rate = rate;
            state.step += 1;
            self.log.add_step(R::STAGE, state.step, step.loss);
            self.progress.status(&format!(
                "epoch {}/{} loss {:.3}",
                state.epoch + 1,
                steering.epochs,
                sums.loss / sums.items as f64
            ));
            self.progress.advance(1);
        }
        Ok(())
    }

    /// The learning rate of a step: a straight rise, then the schedule.
    fn learning_rate(&self, step: u64) -> f64 {
        let steering = self.steering;
        let epoch = step as f64 / self.steps_per_epoch.max(1) as f64;
        let last = steering.final_learning_rate;
        let factor = schedule_factor(steering.schedule, epoch, f64::from(steering.epochs), last);
        let rise =
            (step + 1) as f64 / (steering.warmup_epochs * self.steps_per_epoch as f64).max(1.0);
        steering.learning_rate * factor * rise.min(1.0)
    }

    fn not_finite(&self, loss: f64, items: &[usize], state: &StageState) -> Error {
        let names: Vec<String> = items
            .iter()
            .map(|&item| self.recipe.item_name(item))
            .collect();
        Error::training(
            format!(
                "the {} loss is {loss} in epoch {}, step {}, on {}",
                R::STAGE,
                state.epoch + 1,
                state.step + 1,
                names.join(", ")
            ),
            "check these files; else lower the learning rate and --resume",
        )
    }
}

/// Running sums over an epoch.
#[derive(Debug, Default)]
struct EpochSums {
    loss: f64,
    terms: Vec<f64>,
    gradient_norm: f64,
    steps: u64,
    items: usize,
    learning_rate: f64,
}

impl EpochSums {
    fn add(&mut self, step: &StepOutcome, items: usize) {
        let weight = items as f64;
        self.loss += step.loss * weight;
        self.terms.resize(step.terms.len(), 0.0);
        for (sum, term) in self.terms.iter_mut().zip(&step.terms) {
            *sum += term * weight;
        }
        self.gradient_norm += step.gradient_norm;
        self.steps += 1;
        self.items += items;
    }
}

/// The order of the items in an epoch: it depends on seed and epoch alone.
fn shuffled(items: usize, seed: u64, epoch: u32) -> Vec<usize> {
    let seed = seed
        .wrapping_mul(0x9E37_79B9_7F4A_7C15)
        .wrapping_add(u64::from(epoch));
    let order = ShuffledDataset::new(InMemDataset::new((0..items).collect()), seed);
    (0..order.len())
        .filter_map(|index| order.get(index).ok())
        .collect()
}
