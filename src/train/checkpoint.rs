//! Saving and resuming a stage of training: burn-train's checkpointers, into one folder an epoch
//! that counts as soon as it is complete.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use burn::lr_scheduler::LrSchedulerRecord;
use burn::module::Module as _;
use burn::optim::OptimizerRecord;
use burn::store::ModuleRecord;
use burn::train::checkpoint::{
    Checkpoint, Checkpointer, CheckpointerError, CheckpointingAction, CheckpointingStrategy,
};
use burn::train::metric::store::{Aggregate, EventStoreClient, Split};
use burn::train::{EarlyStoppingStrategy, LearnerModel};
use serde::{Deserialize, Serialize};

use super::stage::{Recipe, Steering};
use super::trainee::{Failure, TraineeOf};
use crate::error::{Error, Result};
use crate::files;

const MODEL: &str = "model.bpk";
const OPTIMIZER: &str = "optimizer.bpk";
const SCHEDULE: &str = "schedule.bpk";
/// What an epoch is resumed from, beside its state.
const RECORDS: [&str; 3] = [MODEL, OPTIMIZER, SCHEDULE];
const STATE: &str = "state.json";

/// How far a stage is.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct StageState {
    /// Finished epochs.
    pub epoch: u32,
    /// Optimiser steps taken.
    pub step: u64,
    /// Best validation result so far, the larger the better, and its epoch.
    pub best: Option<(f64, u32)>,
    /// Length and check sum of the files beside this one.
    pub files: BTreeMap<String, String>,
    /// The settings of the stage as JSON text, to notice that they changed.
    pub settings: String,
    /// Fingerprint of the dataset that the stage learns from.
    pub dataset: String,
    /// Check sum of all this.
    pub mark: String,
}

impl StageState {
    /// The state with the check sum that it must have.
    fn marked(mut self) -> Result<Self> {
        self.mark.clear();
        let text = serde_json::to_vec(&self).map_err(|source| unencodable(&source))?;
        self.mark = files::mark_of(&text);
        Ok(self)
    }
}

fn read_state(path: &Path) -> Result<StageState> {
    serde_json::from_str(&files::read_text(path)?).map_err(|source| {
        Error::training(
            format!("{} cannot be read: {source}", path.display()),
            DAMAGED,
        )
    })
}

fn unencodable(source: &serde_json::Error) -> Error {
    Error::training(
        format!("cannot encode the state: {source}"),
        "report this as a defect",
    )
}

/// What to do about something to resume from that is not what training saved.
const DAMAGED: &str = "restore it from a copy, or train into another --run (from this one's weights: --weights, \
     --distance-weights)";

/// The folder of a stage: weights for users, and what resuming needs.
#[derive(Debug, Clone)]
pub struct StageFolder {
    folder: PathBuf,
}

impl StageFolder {
    /// The folder of a stage in a run.
    pub fn new(run: &Path, stage: &str) -> Self {
        Self {
            folder: run.join(stage),
        }
    }

    /// Weights of the best epoch.
    pub fn best(&self) -> PathBuf {
        self.folder.join("best.safetensors")
    }

    /// Weights of the best epoch with their spreads corrected, of the size network.
    pub fn calibrated(&self) -> PathBuf {
        self.folder.join("witness.safetensors")
    }

    /// Weights of the last epoch.
    pub fn last(&self) -> PathBuf {
        self.folder.join("last.safetensors")
    }

    /// Weights of one of the last epochs, where they are kept.
    pub fn of_epoch(&self, epoch: u32) -> PathBuf {
        self.folder.join(format!("epoch-{epoch:04}.safetensors"))
    }

    /// Removes the kept weights of epochs before this one.
    ///
    /// # Errors
    /// A file that cannot be removed.
    pub fn drop_epochs_before(&self, first: u32) -> Result<()> {
        let entries = std::fs::read_dir(&self.folder).map_err(Error::io("read", &self.folder))?;
        for entry in entries {
            let path = entry.map_err(Error::io("read", &self.folder))?.path();
            let epoch = path
                .file_name()
                .and_then(|name| name.to_str()?.strip_prefix("epoch-"))
                .and_then(|name| name.strip_suffix(".safetensors")?.parse::<u32>().ok());
            if epoch.is_some_and(|epoch| epoch < first) {
                std::fs::remove_file(&path).map_err(Error::io("remove", &path))?;
            }
        }
        Ok(())
    }

    /// Creates the folder.
    ///
    /// # Errors
    /// A folder that cannot be created.
    pub fn create(&self) -> Result<()> {
        files::create_folder(&self.folder)
    }

    fn resume(&self) -> PathBuf {
        self.folder.join("resume")
    }

    fn resume_epoch(&self, epoch: usize) -> PathBuf {
        self.resume().join(format!("epoch-{epoch:04}"))
    }

    /// Folders of epochs in `resume`, complete or not, by epoch.
    fn resume_epochs(&self) -> Result<BTreeMap<u32, PathBuf>> {
        let resume = self.resume();
        if !resume.exists() {
            return Ok(BTreeMap::new());
        }
        let mut epochs = BTreeMap::new();
        for entry in std::fs::read_dir(&resume).map_err(Error::io("read", &resume))? {
            let path = entry.map_err(Error::io("read", &resume))?.path();
            let name = path.file_name().and_then(|name| name.to_str());
            let epoch = name.and_then(|name| name.strip_prefix("epoch-")?.parse().ok());
            if let Some(epoch) = epoch {
                epochs.insert(epoch, path);
            }
        }
        Ok(epochs)
    }

    /// The last epoch that is complete, and its folder.
    fn complete_epoch(&self) -> Result<Option<(u32, PathBuf)>> {
        let epochs = self.resume_epochs()?;
        Ok(epochs
            .into_iter()
            .rfind(|(_, folder)| folder.join(STATE).exists()))
    }

    /// Fingerprint of the dataset that the stage was started on, if it has saved an epoch.
    ///
    /// # Errors
    /// A state that cannot be read.
    pub fn dataset(&self) -> Result<Option<String>> {
        let Some((_, folder)) = self.complete_epoch()? else {
            return Ok(None);
        };
        Ok(Some(read_state(&folder.join(STATE))?.dataset))
    }

    /// The state to resume from, if there is one: the last complete epoch.
    ///
    /// # Errors
    /// A state that cannot be read, that belongs to other settings, or that is missing though the
    /// stage has saved one before.
    pub fn state(&self, steering: &Steering) -> Result<Option<StageState>> {
        if self.resume().join(STATE).exists() {
            return Err(Error::training(
                format!("{} was saved by an older version", self.resume().display()),
                "train into another --run from this one's weights (--weights, --distance-weights)",
            ));
        }
        let Some((epoch, folder)) = self.complete_epoch()? else {
            // Weights are written shortly before the first epoch is complete.
            if self.last().exists() && !self.resume_epoch(1).exists() {
                return Err(Error::training(
                    format!(
                        "{} has weights, but nothing to go on from in {}",
                        self.folder.display(),
                        self.resume().display()
                    ),
                    DAMAGED,
                ));
            }
            return Ok(None);
        };
        let path = folder.join(STATE);
        let state = read_state(&path)?;
        if state.epoch != epoch || state.clone().marked()?.mark != state.mark {
            return Err(Error::training(
                format!(
                    "{} is damaged: it is not what training saved",
                    path.display()
                ),
                DAMAGED,
            ));
        }
        if state.settings != steering.settings {
            return Err(Error::training(
                format!("{} belongs to a run with other settings", path.display()),
                "resume with the settings of the run's config.json, or train into another --run",
            ));
        }
        for name in RECORDS {
            let path = folder.join(name);
            let mark = state.files.get(name);
            if !path.exists() || mark != Some(&files::content_mark(&path)?) {
                return Err(Error::weights(
                    path,
                    "is missing or damaged: it is not what training saved",
                    DAMAGED,
                ));
            }
        }
        Ok(Some(state))
    }

    /// Removes everything to resume from, for a stage that starts afresh.
    ///
    /// # Errors
    /// A folder that cannot be removed.
    pub fn forget(&self) -> Result<()> {
        remove(&self.resume())
    }
}

/// Saves the epochs of a stage: what burn-train's three checkpointers write becomes one state, and
/// weights for users beside it.
pub struct StageSaver<R: Recipe> {
    folder: StageFolder,
    recipe: Arc<R>,
    steering: Steering,
    steps_per_epoch: u64,
    /// A copy of the network that records are read into.
    template: Mutex<TraineeOf<R>>,
    progress: Mutex<Saving>,
    failure: Failure,
}

#[derive(Default)]
struct Saving {
    /// Best result and its epoch so far.
    best: Option<(f64, u32)>,
    /// Whether something counts as the best weights already.
    has_best: bool,
    /// Epochs that are being saved.
    epochs: BTreeMap<usize, SavedSoFar>,
    /// Epochs whose weights are the best so far.
    improved: Option<usize>,
}

/// An epoch of which some records are written.
#[derive(Default)]
struct SavedSoFar {
    /// The best result by then.
    best: Option<(f64, u32)>,
    /// Marks of the records that are written.
    files: BTreeMap<String, String>,
}

impl<R: Recipe> StageSaver<R> {
    /// A saver that goes on after a state.
    pub fn new(
        folder: StageFolder,
        steering: Steering,
        steps_per_epoch: u64,
        trainee: &TraineeOf<R>,
        state: &StageState,
    ) -> Self
    where
        TraineeOf<R>: LearnerModel,
    {
        Self {
            // Only a copy for inference has running statistics of its own.
            template: Mutex::new(trainee.valid()),
            recipe: Arc::clone(&trainee.course.recipe),
            steering,
            steps_per_epoch,
            progress: Mutex::new(Saving {
                best: state.best,
                has_best: state.best.is_some() || folder.best().exists() && state.epoch > 0,
                ..Saving::default()
            }),
            folder,
            failure: trainee.course.failure.clone(),
        }
    }

    fn progress(&self) -> MutexGuard<'_, Saving> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The numbers that steer the stage.
    pub fn steering(&self) -> &Steering {
        &self.steering
    }

    /// Best result and its epoch.
    pub fn best(&self) -> Option<(f64, u32)> {
        self.progress().best
    }

    /// Notes the result of an epoch before it is saved.
    fn judge(&self, epoch: usize, result: Option<f64>) {
        let mut progress = self.progress();
        let result = result.filter(|result| result.is_finite());
        let improves = match (result, progress.best) {
            (Some(result), Some((best, _))) => result > best,
            (Some(_), None) => true,
            // Without validation the last weights count.
            (None, _) => epoch == self.steering.epochs as usize && !progress.has_best,
        };
        if improves {
            progress.best = result.map(|result| (result, epoch as u32));
            progress.has_best = true;
            progress.improved = Some(epoch);
        }
        let best = progress.best;
        let saving = SavedSoFar {
            best,
            ..SavedSoFar::default()
        };
        progress.epochs.insert(epoch, saving);
    }

    /// Writes one of the records of an epoch; the last of them completes it.
    fn save<C: Checkpoint>(&self, epoch: usize, name: &str, record: C) -> Result<()> {
        let folder = self.folder.resume_epoch(epoch);
        files::create_folder(&folder)?;
        let path = folder.join(name);
        let partial = folder.join(format!("{name}.partial"));
        record
            .save(partial.clone())
            .map_err(|source| broken("write", &path, &source))?;
        std::fs::rename(&partial, &path).map_err(Error::io("rename", &partial))?;
        let mark = files::content_mark(&path)?;
        if name == MODEL {
            self.save_weights(epoch, &path)?;
        }
        let mut progress = self.progress();
        let Some(saved) = progress.epochs.get_mut(&epoch) else {
            return Ok(());
        };
        saved.files.insert(name.to_owned(), mark);
        if saved.files.len() < RECORDS.len() {
            return Ok(());
        }
        let SavedSoFar { best, files } = progress.epochs.remove(&epoch).unwrap_or_default();
        drop(progress);
        let state = StageState {
            epoch: epoch as u32,
            step: epoch as u64 * self.steps_per_epoch,
            best,
            files,
            settings: self.steering.settings.clone(),
            dataset: self.steering.dataset.clone(),
            mark: String::new(),
        }
        .marked()?;
        let json = serde_json::to_vec_pretty(&state).map_err(|source| unencodable(&source))?;
        files::write_atomically(folder.join(STATE), &json)?;
        files::sync_folder(&folder)?;
        // Only now, after a power cut too, are the epochs before it superfluous.
        for (earlier, folder) in self.folder.resume_epochs()? {
            if (earlier as usize) < epoch {
                remove(&folder)?;
            }
        }
        Ok(())
    }

    /// Writes what users take: the last weights, the best ones, those of the last epochs.
    fn save_weights(&self, epoch: usize, record: &Path) -> Result<()> {
        let unreadable = |source: burn::store::RecordError| {
            broken("read", record, &CheckpointerError::Record(source))
        };
        let loaded = ModuleRecord::load(record).map_err(unreadable)?;
        let mut template = self.template.lock().unwrap_or_else(PoisonError::into_inner);
        let trainee = template
            .clone()
            .try_load_record(loaded)
            .map_err(unreadable)?;
        let usable = trainee.usable();
        *template = trainee;
        drop(template);
        let improved = self.progress().improved == Some(epoch);
        if improved {
            self.recipe.save(&usable, &self.folder.best())?;
        }
        let keep_last = self.steering.keep_last;
        if keep_last > 0 {
            let epoch = epoch as u32;
            self.recipe.save(&usable, &self.folder.of_epoch(epoch))?;
            self.folder
                .drop_epochs_before((epoch + 1).saturating_sub(keep_last))?;
        }
        self.recipe.save(&usable, &self.folder.last())
    }
}

fn broken(action: &'static str, path: &Path, source: &CheckpointerError) -> Error {
    Error::Io {
        action,
        path: path.to_path_buf(),
        source: std::io::Error::other(source.to_string()),
    }
}

/// One of burn-train's checkpointers: the model's, the optimiser's or the schedule's.
pub struct RecordSaver<R: Recipe> {
    saver: Arc<StageSaver<R>>,
    name: &'static str,
}

impl<R: Recipe> RecordSaver<R> {
    /// All three, in that order.
    pub fn all(saver: &Arc<StageSaver<R>>) -> [Self; 3] {
        RECORDS.map(|name| Self {
            saver: Arc::clone(saver),
            name,
        })
    }
}

/// Implemented for the three records alone: a blanket implementation would reach beyond them.
macro_rules! saves {
    ($($record:ty),*) => {$(
        impl<R: Recipe> Checkpointer<$record> for RecordSaver<R> {
            fn save(&self, epoch: usize, record: $record) -> std::result::Result<(), CheckpointerError> {
                if let Err(error) = self.saver.save(epoch, self.name, record) {
                    self.saver.failure.set(error);
                }
                Ok(())
            }

            /// Earlier epochs are removed when a later one is complete.
            fn delete(&self, _: usize) -> std::result::Result<(), CheckpointerError> {
                Ok(())
            }

            fn restore(&self, epoch: usize) -> std::result::Result<$record, CheckpointerError> {
                <$record as Checkpoint>::load(self.saver.folder.resume_epoch(epoch).join(self.name))
            }
        }
    )*};
}
saves!(ModuleRecord, OptimizerRecord, LrSchedulerRecord);

/// Saves every epoch and notes which is the best.
pub struct SaveEveryEpoch<R: Recipe>(pub Arc<StageSaver<R>>);

impl<R: Recipe> CheckpointingStrategy for SaveEveryEpoch<R> {
    fn checkpointing(
        &mut self,
        epoch: usize,
        store: &EventStoreClient,
    ) -> Vec<CheckpointingAction> {
        let (name, sign) = self.0.recipe.merit();
        let score = store.find_metric(name, epoch, Aggregate::Mean, &Split::Valid);
        self.0.judge(epoch, score.map(|score| sign * score));
        vec![CheckpointingAction::Save]
    }
}

/// Stops after too many epochs without a better result. Unlike burn-train's own it knows the results
/// from before a resumption.
pub struct Patience<R: Recipe>(pub Arc<StageSaver<R>>);

impl<R: Recipe> Clone for Patience<R> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<R: Recipe> EarlyStoppingStrategy for Patience<R> {
    fn should_stop(&mut self, epoch: usize, _: &EventStoreClient) -> bool {
        self.0
            .steering
            .gives_up_after(epoch as u32, self.0.best())
            .is_some()
    }
}

fn remove(folder: &Path) -> Result<()> {
    if folder.exists() {
        std::fs::remove_dir_all(folder).map_err(Error::io("remove", folder))?;
    }
    Ok(())
}
