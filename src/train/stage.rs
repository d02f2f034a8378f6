//! A stage of training on burn-train: what differs between the networks, and how a stage is launched,
//! watched, interrupted and resumed.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use burn::module::{Module, ModuleDisplay, ModuleVisitor, Param};
use burn::optim::ModuleOptimizer;
use burn::optim::lr_scheduler::module_lr_scheduler::ModuleLrScheduler;
use burn::tensor::{Device, Tensor};
use burn::train::{Learner, SupervisedTraining};
use image::RgbImage;

use super::checkpoint::{
    Patience, RecordSaver, SaveEveryEpoch, StageFolder, StageSaver, StageState,
};
use super::config::Schedule;
use super::devices::DeviceSet;
use super::loader::{CheckLoader, PassLoader, steps_per_epoch};
use super::log::{EpochRow, SharedLog};
use super::metrics::{Showcase, TrainingMetric, ValidationMetric};
use super::optimizer::AverageRule;
use super::reporting::{MetricsLog, ProgressRenderer, Report};
use super::schedule::schedule;
use super::trainee::{Failure, Trainee, TraineeOf};
use crate::error::{Error, Result};
use crate::progress::Progress;

/// How often the caller looks whether the user wants to stop.
const POLL: Duration = Duration::from_millis(50);
/// Stack of the training thread: as large as a main thread's.
const STACK_BYTES: usize = 8 << 20;

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
    /// Learning rate from which that of the biases comes to the others'; 0 rises with them.
    pub first_bias_rate: f64,
    /// Longest global gradient norm, if limited.
    pub clip_norm: Option<f64>,
    /// How averaged weights follow, if averaged.
    pub average: Option<AverageRule>,
    /// Validate every so many epochs.
    pub validate_every: u32,
    /// Stop after so many epochs without a better result; 0 never does.
    pub patience: u32,
    /// Keep the weights of so many last epochs in files of their own.
    pub keep_last: u32,
    /// The stage's settings as JSON text, to notice on resuming that they changed.
    pub settings: String,
    /// Fingerprint of the dataset, to notice on resuming that it is another one.
    pub dataset: String,
}

impl Steering {
    /// Two epochs' rise and eight epochs' fall, for tests.
    #[cfg(test)]
    pub fn example() -> Self {
        Self {
            seed: 1,
            epochs: 10,
            batch: 4,
            micro_batch: 2,
            learning_rate: 0.01,
            final_learning_rate: 0.1,
            schedule: Schedule::Cosine,
            warmup_epochs: 2.0,
            first_bias_rate: 0.0,
            clip_norm: None,
            average: None,
            validate_every: 2,
            patience: 0,
            keep_last: 0,
            settings: String::new(),
            dataset: String::new(),
        }
    }

    /// Steps over which the learning rate rises; the last epoch is never among them.
    pub fn warmup_steps(&self, steps_per_epoch: u64) -> f64 {
        let longest = f64::from(self.epochs.saturating_sub(1));
        self.warmup_epochs.min(longest) * steps_per_epoch as f64
    }

    /// Whether an epoch, counted from 1, ends with a validation.
    pub fn validates(&self, epoch: u32) -> bool {
        epoch.is_multiple_of(self.validate_every) || epoch == self.epochs
    }

    /// Epochs without a better result after so many epochs, when they are too many. An epoch that
    /// was not validated might have been better.
    pub fn gives_up_after(&self, epoch: u32, best: Option<(f64, u32)>) -> Option<u32> {
        let epochs = epoch.saturating_sub(best?.1);
        let in_vain = self.patience > 0 && epochs >= self.patience && self.validates(epoch);
        in_vain.then_some(epochs)
    }
}

/// The loss of one forward pass.
pub struct PassLoss {
    /// What to differentiate, `[1]`.
    pub total: Tensor<1>,
    /// The loss's terms per item, `[terms]`, to report; their sum is the loss.
    pub terms: Tensor<1>,
}

/// What differs between the networks.
pub trait Recipe: Send + Sync + 'static {
    /// The network.
    type Model: Module + ModuleDisplay + 'static;

    /// Loaded and augmented items, ready for a forward pass.
    type Batch: Send + 'static;

    /// What examines validation items: the network as users run it.
    type Judge: Send + Sync + 'static;

    /// What it found on some items.
    type Findings: Clone + Send + Sync + 'static;

    /// Folder and log name of the stage.
    const STAGE: &'static str;

    /// Tags of the loss's terms.
    const TERMS: &'static [&'static str];

    /// Tags of the validation's numbers.
    const SCORES: &'static [&'static str];

    /// Number of training items.
    fn items(&self) -> usize;

    /// The files that an item is made of in an epoch, for messages.
    fn item_files(&self, epoch: u32, item: usize) -> Vec<PathBuf>;

    /// Loads and augments items. Runs beside the steps; the result depends on nothing but the seed,
    /// the epoch and the items.
    ///
    /// # Errors
    /// An item that cannot be loaded.
    fn load(&self, epoch: u32, items: &[usize]) -> Result<Self::Batch>;

    /// The loss of loaded items on the network's device; `share` is their part of the optimiser
    /// step.
    ///
    /// # Errors
    /// A device that fails.
    fn loss(&self, model: &Self::Model, batch: Self::Batch, share: f64) -> Result<PassLoss>;

    /// Number of validation items.
    fn checks(&self) -> usize;

    /// Validation items that are examined at once.
    fn check_batch(&self) -> usize;

    /// Takes an inference copy of the network into service.
    ///
    /// # Errors
    /// A device that fails.
    fn judge(&self, model: &Self::Model) -> Result<Self::Judge>;

    /// Examines validation items.
    ///
    /// # Errors
    /// An item that cannot be loaded, or a device that fails.
    fn examine(&self, judge: &Self::Judge, items: Range<usize>) -> Result<Self::Findings>;

    /// What was found on no items.
    fn no_findings(&self) -> Self::Findings;

    /// Adds what was found on more items.
    fn merge(findings: &mut Self::Findings, more: &Self::Findings);

    /// What turns gradients into steps, the first so many of them warming up.
    ///
    /// # Errors
    /// Never in practice.
    fn optimizer(&self, warmup_steps: f64) -> Result<ModuleOptimizer>;

    /// The numbers of [`Recipe::SCORES`]; none where nothing was examined.
    fn scores(findings: &Self::Findings) -> Option<Vec<f64>>;

    /// The score that tells the best epoch, and 1 if larger is better, -1 if smaller is.
    fn merit(&self) -> (&'static str, f64);

    /// Pictures, by tag, of what a judge makes of some validation items.
    ///
    /// # Errors
    /// An item that cannot be loaded, or a device that fails.
    fn pictures(&self, judge: &Self::Judge) -> Result<Vec<(String, RgbImage)>>;

    /// The validation result of a row in a few words; empty without validation.
    fn describe(row: &EpochRow) -> String;

    /// Saves an inference copy of the model for users.
    ///
    /// # Errors
    /// A file that cannot be written.
    fn save(&self, model: &Self::Model, path: &Path) -> Result<()>;
}

/// The device that a module's weights are on, with gradients if it has them.
pub fn device_of<M: Module>(module: &M) -> Device {
    struct First(Option<Device>);
    impl ModuleVisitor for First {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if self.0.is_none() {
                self.0 = Some(param.lazy_device());
            }
        }
    }
    let mut first = First(None);
    module.visit(&mut first);
    first.0.unwrap_or_default()
}

/// A stage before it runs.
pub struct PreparedStage<R: Recipe> {
    /// What is trained, on what.
    pub recipe: Arc<R>,
    /// How.
    pub steering: Steering,
    /// The network to start from.
    pub network: R::Model,
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
    /// Devices that share the training; the first one validates.
    pub devices: &'a DeviceSet,
    /// The run's logs.
    pub log: SharedLog,
    /// Who listens.
    pub progress: &'a dyn Progress,
}

/// Trains a stage from its start or from where a stopped run left it.
///
/// # Errors
/// Whatever stops it: [`Error::Interrupted`] on the user's wish (the state of the last finished
/// epoch is saved), a loss that is no longer finite, a file or device that fails.
pub fn run_stage<R: Recipe>(prepared: PreparedStage<R>, place: &StagePlace) -> Result<StageResult> {
    let steering = prepared.steering.clone();
    let started = Instant::now();
    let progress = place.progress;
    let folder = StageFolder::new(place.run, R::STAGE);
    folder.create()?;
    let mut state = StageState::default();
    if !place.resume {
        folder.forget()?;
    } else if let Some(saved) = folder.state(&steering)? {
        state = saved;
        progress.note(&format!(
            "{}: resuming after epoch {}",
            R::STAGE,
            state.epoch
        ));
    }
    let mut log = place.log.lock().unwrap_or_else(PoisonError::into_inner);
    log.rewind(R::STAGE, state.epoch);
    drop(log);

    let finished = state.epoch;
    let in_vain = steering.gives_up_after(finished, state.best).is_some();
    let best = if finished < steering.epochs && !in_vain {
        Launch::new(prepared, &state, place)?.run(place)?
    } else {
        state.best
    };
    if let Some(epochs) = best.and_then(|_| stopped_in_vain(&folder, &steering)) {
        progress.note(&format!(
            "{}: stopped early, {epochs} epochs without a better result",
            R::STAGE
        ));
    }
    Ok(StageResult {
        best,
        seconds: started.elapsed().as_secs_f64(),
    })
}

/// Epochs without a better result that ended a stage early, if they did.
fn stopped_in_vain(folder: &StageFolder, steering: &Steering) -> Option<u32> {
    let state = folder.state(steering).ok()??;
    if state.epoch >= steering.epochs {
        return None;
    }
    steering.gives_up_after(state.epoch, state.best)
}

/// A stage made ready.
struct Launch<R: Recipe> {
    recipe: Arc<R>,
    steering: Steering,
    trainee: TraineeOf<R>,
    optimizer: ModuleOptimizer,
    schedule: ModuleLrScheduler,
    saver: Arc<StageSaver<R>>,
    failure: Failure,
    finished: u32,
    step: u64,
    steps_per_epoch: u64,
}

impl<R: Recipe> Launch<R> {
    fn new(prepared: PreparedStage<R>, state: &StageState, place: &StagePlace) -> Result<Self> {
        let PreparedStage {
            recipe,
            steering,
            network,
        } = prepared;
        let devices = place.devices.len();
        let steps_per_epoch = steps_per_epoch(recipe.items(), steering.batch, devices);
        let failure = Failure::default();
        let trainee = Trainee::new(
            Arc::clone(&recipe),
            &steering,
            network,
            state.step,
            place.devices,
            failure.clone(),
        );
        let saver = StageSaver::new(
            StageFolder::new(place.run, R::STAGE),
            steering.clone(),
            steps_per_epoch,
            &trainee,
            state,
        );
        Ok(Self {
            optimizer: recipe.optimizer(steering.warmup_steps(steps_per_epoch))?,
            schedule: schedule(&steering, steps_per_epoch)?,
            recipe,
            steering,
            trainee,
            saver: Arc::new(saver),
            failure,
            finished: state.epoch,
            step: state.step,
            steps_per_epoch,
        })
    }

    /// Runs burn-train's loop on a thread of its own and tells the caller how it goes.
    fn run(self, place: &StagePlace) -> Result<Option<(f64, u32)>> {
        let (failure, saver) = (self.failure.clone(), Arc::clone(&self.saver));
        let (epochs, step, finished) = (self.steering.epochs, self.step, self.finished);
        let steps = u64::from(epochs - finished) * self.steps_per_epoch;
        let (reports, incoming) = channel();
        let log = Arc::clone(&place.log);
        let devices = place.devices.clone();
        let training = std::thread::Builder::new()
            .name(R::STAGE.to_owned())
            .stack_size(STACK_BYTES)
            .spawn(move || {
                let renderer = ProgressRenderer::new(reports.clone());
                let metrics = MetricsLog::new(
                    R::STAGE,
                    epochs,
                    R::describe,
                    Arc::clone(&log),
                    reports,
                    self.failure.clone(),
                    step,
                );
                self.launch(&devices, renderer, metrics, log)
            })
            .map_err(Error::io("start", "the training thread"))?;
        place.progress.begin(R::STAGE, steps);
        let interrupted = relay(&incoming, epochs, &failure, place.progress);
        place.progress.end();
        let problem = match training.join() {
            Ok(problem) => problem,
            Err(panic) => Some(panic_text(panic.as_ref())),
        };
        if let Some(error) = failure.take() {
            return Err(error);
        }
        if let Some(problem) = problem {
            return Err(Error::training(
                format!("training the {} stopped: {problem}", R::STAGE),
                "mend what it names and --resume, or train into another --run with a smaller batch or on \
                 another device",
            ));
        }
        let folder = StageFolder::new(place.run, R::STAGE);
        if interrupted {
            let saved = folder.state(saver.steering())?;
            return Err(Error::Interrupted {
                resume: format!(
                    "{} is saved up to epoch {}; run the same command with --resume to go on",
                    R::STAGE,
                    saved.map_or(0, |state| state.epoch)
                ),
            });
        }
        Ok(saver.best())
    }

    /// Burn-train's loop; the reason why it failed, if it did.
    fn launch(
        self,
        devices: &DeviceSet,
        renderer: ProgressRenderer,
        metrics: MetricsLog,
        log: SharedLog,
    ) -> Option<String> {
        let steering = &self.steering;
        let passes = PassLoader::new(
            Arc::clone(&self.recipe),
            steering,
            devices.len(),
            self.finished,
            self.failure.clone(),
        );
        let checks = CheckLoader::new(
            self.recipe.checks(),
            self.recipe.check_batch(),
            steering,
            self.finished,
        );
        let [models, optimizers, schedules] = RecordSaver::all(&self.saver);
        let mut training = SupervisedTraining::new("", Arc::new(passes), Arc::new(checks))
            .num_epochs(steering.epochs as usize)
            .with_interrupter(self.failure.interrupter.clone())
            .renderer(Box::new(renderer))
            .with_metric_logger(metrics)
            .with_application_logger(None)
            .with_custom_checkpointers(models, optimizers, schedules)
            .with_checkpointing_strategy(SaveEveryEpoch(Arc::clone(&self.saver)))
            .early_stopping(Patience(Arc::clone(&self.saver)))
            .metric_valid(Showcase::new(R::STAGE, log, self.failure.clone()))
            .with_training_strategy(devices.strategy().into());
        let norms = &self.trainee.course.norms;
        for metric in TrainingMetric::all(&self.recipe, &self.failure, norms) {
            training = training.metric_train_numeric(metric);
        }
        for metric in ValidationMetric::all(&*self.recipe) {
            training = training.metric_valid_numeric(metric);
        }
        let passes_per_step = (steering.batch / devices.len()).div_ceil(steering.micro_batch);
        if passes_per_step > 1 {
            training = training.grads_accumulation(passes_per_step);
        }
        if self.finished > 0 {
            training = training.checkpoint(self.finished as usize);
        }
        let learner = Learner::new(self.trainee, self.optimizer, self.schedule);
        let result = training.launch(learner);
        result.error.map(|error| error.to_string())
    }
}

/// Passes reports on until the training is over; whether the user asked to stop.
fn relay(
    incoming: &Receiver<Report>,
    epochs: u32,
    failure: &Failure,
    progress: &dyn Progress,
) -> bool {
    let (mut epoch, mut interrupted) = (0, false);
    loop {
        match incoming.recv_timeout(POLL) {
            Ok(Report::Epoch(number)) => epoch = number,
            Ok(Report::Step(loss)) => {
                progress.status(&format!("epoch {epoch}/{epochs} loss {loss:.3}"));
                progress.advance(1);
            }
            Ok(Report::Validating) => progress.status("validating"),
            Ok(Report::Note(text)) => progress.note(&text),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return interrupted,
        }
        if !interrupted && progress.interrupted() {
            interrupted = true;
            failure.interrupter.stop(Some("interrupted"));
        }
    }
}

fn panic_text(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().cloned();
    text.or_else(|| panic.downcast_ref::<&str>().map(|&text| text.to_owned()))
        .unwrap_or_else(|| "for a reason that it did not tell".to_owned())
}
