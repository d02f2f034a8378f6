//! Saving and resuming a stage of training.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use burn::module::Module;
use burn::optim::ModuleOptimizer;
use burn::store::RecordError;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::files;

/// What resuming needs beside the state itself.
const RESUME_FILES: [&str; 3] = ["model.bpk", "average.bpk", "optimizer.bpk"];

/// How far a stage is.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct StageState {
    /// Finished epochs.
    pub epoch: u32,
    /// Optimiser steps taken.
    pub step: u64,
    /// Updates of the averaged weights.
    pub ema_updates: u64,
    /// Best validation result so far and its epoch.
    pub best: Option<(f64, u32)>,
    /// Length and check sum of the files beside this one.
    #[serde(default)]
    pub files: BTreeMap<String, String>,
    /// The settings of the stage as JSON text, to notice that they changed. Text, because numbers
    /// that are parsed and compared again may differ in their last bit.
    pub settings: String,
}

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

    /// Saves everything that resuming needs: written beside the old state, then exchanged, so that
    /// one complete state exists at any moment.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn save<M: Module>(
        &self,
        state: &StageState,
        model: &M,
        average: Option<M>,
        optimizer: &ModuleOptimizer,
    ) -> Result<()> {
        let fresh = self.folder.join("resume.new");
        let old = self.folder.join("resume.old");
        let current = self.resume();
        remove(&fresh)?;
        files::create_folder(&fresh)?;
        let broken = |path: &Path| {
            let path = path.to_path_buf();
            move |source: RecordError| Error::Io {
                action: "write",
                path,
                source: std::io::Error::other(source.to_string()),
            }
        };
        let path = fresh.join("model.bpk");
        model.clone().save_file(&path).map_err(broken(&path))?;
        if let Some(average) = average {
            let path = fresh.join("average.bpk");
            average.save_file(&path).map_err(broken(&path))?;
        }
        let path = fresh.join("optimizer.bpk");
        optimizer.save(&path).map_err(broken(&path))?;
        let mut state = state.clone();
        for name in RESUME_FILES {
            let path = fresh.join(name);
            if path.exists() {
                let mark = files::content_mark(&path)?;
                state.files.insert(name.to_owned(), mark);
            }
        }
        let json = serde_json::to_vec_pretty(&state).map_err(|source| {
            Error::training(
                format!("cannot encode the state: {source}"),
                "report this as a defect",
            )
        })?;
        files::write_atomically(fresh.join("state.json"), &json)?;
        remove(&old)?;
        if current.exists() {
            std::fs::rename(&current, &old).map_err(Error::io("rename", &current))?;
        }
        std::fs::rename(&fresh, &current).map_err(Error::io("rename", &fresh))?;
        remove(&old)
    }

    /// The state to resume from, if there is one.
    ///
    /// # Errors
    /// A state that cannot be read, or that belongs to other settings.
    pub fn state(&self, settings: &str) -> Result<Option<StageState>> {
        let (current, old) = (self.resume(), self.folder.join("resume.old"));
        if !current.exists() && old.exists() {
            // A stop between the two renames of `save`.
            std::fs::rename(&old, &current).map_err(Error::io("rename", &old))?;
        }
        let path = current.join("state.json");
        if !path.exists() {
            return Ok(None);
        }
        let text = files::read_text(&path)?;
        let state: StageState = serde_json::from_str(&text).map_err(|source| {
            Error::training(
                format!("{} cannot be read: {source}", path.display()),
                "delete the folder to start the stage afresh",
            )
        })?;
        if state.settings != settings {
            return Err(Error::training(
                format!("{} belongs to a run with other settings", path.display()),
                "resume with the settings of the run's config.json, or train into another --run",
            ));
        }
        for (name, mark) in &state.files {
            let path = current.join(name);
            if !path.exists() || files::content_mark(&path)? != *mark {
                return Err(Error::weights(
                    path,
                    "is missing or damaged: it is not what training saved",
                    "restore it from a copy, or delete the `resume` folder to start the stage afresh",
                ));
            }
        }
        Ok(Some(state))
    }

    /// Loads model, averaged model and optimiser as they were saved.
    ///
    /// # Errors
    /// A file that cannot be read or does not fit.
    pub fn load<M: Module>(
        &self,
        model: M,
        average: Option<M>,
        optimizer: ModuleOptimizer,
    ) -> Result<(M, Option<M>, ModuleOptimizer)> {
        let resume = self.resume();
        let broken = |path: &Path| {
            let path = path.to_path_buf();
            move |source: RecordError| {
                Error::weights(
                    path,
                    format!("cannot be loaded: {source}"),
                    "delete the `resume` folder beside it to start the stage afresh",
                )
            }
        };
        let path = resume.join("model.bpk");
        let model = model.try_load_file(&path).map_err(broken(&path))?;
        let path = resume.join("average.bpk");
        let average = average
            .map(|average| average.try_load_file(&path))
            .transpose()
            .map_err(broken(&path))?;
        let path = resume.join("optimizer.bpk");
        let optimizer = optimizer.load(&path).map_err(broken(&path))?;
        Ok((model, average, optimizer))
    }
}

fn remove(folder: &Path) -> Result<()> {
    if folder.exists() {
        std::fs::remove_dir_all(folder).map_err(Error::io("remove", folder))?;
    }
    Ok(())
}
