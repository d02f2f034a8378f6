//! What a dataset folder holds already, and which frames a run is to make.
//!
//! A dataset grows in parts: the first run makes the first part, and each addition another one
//! with scenes and stamps of its own, so that nothing of the earlier parts changes.

use std::path::Path;

use serde::Deserialize as _;

use super::config::GenerateConfig;
use super::write::{Folder, MARKER};
use crate::error::{Error, Result};

/// The frames that one run makes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Part {
    /// 0 for the first run, then counting.
    pub index: u64,
    /// Number of its first scene.
    pub first_scene: u32,
    /// Its first stamp.
    pub first_stamp: u64,
    /// Training and validation frames.
    pub frames: u32,
}

impl Part {
    /// The part that a dataset begins with.
    pub fn first(config: &GenerateConfig) -> Self {
        Self {
            index: 0,
            first_scene: 0,
            first_stamp: 0,
            frames: config.frames,
        }
    }
}

/// How a dataset of the generator came about.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct History {
    /// The settings of its first part.
    pub config: GenerateConfig,
    /// Frames of the parts that were added since.
    pub added: Vec<u32>,
}

impl History {
    /// A dataset of one part.
    pub fn new(config: &GenerateConfig) -> Self {
        Self {
            config: config.clone(),
            added: Vec::new(),
        }
    }

    /// The table in `dataset.toml` and in the marker.
    pub fn to_table(&self) -> Result<toml::Table> {
        let settings = toml::Table::try_from(&self.config).map_err(|error| {
            Error::dataset("dataset.toml", error.to_string(), "report this as a bug")
        })?;
        let mut table = toml::Table::new();
        table.insert("program".to_owned(), "twinsight generate".into());
        table.insert("version".to_owned(), env!("CARGO_PKG_VERSION").into());
        if !self.added.is_empty() {
            let added: Vec<toml::Value> = self.added.iter().map(|&n| i64::from(n).into()).collect();
            table.insert("added".to_owned(), added.into());
        }
        table.insert("settings".to_owned(), settings.into());
        Ok(table)
    }

    /// Reads such a table; None where another program or version wrote it.
    pub fn from_table(table: &toml::Table) -> Option<Self> {
        let config = GenerateConfig::deserialize(table.get("settings")?.clone()).ok()?;
        let added = match table.get("added") {
            Some(added) => Vec::<u32>::deserialize(added.clone()).ok()?,
            None => Vec::new(),
        };
        let history = Self { config, added };
        // What does not come back unchanged has settings that this version does not know.
        (history.to_table().ok()? == *table).then_some(history)
    }

    /// Training and validation frames of all parts.
    fn frames(&self) -> u64 {
        u64::from(self.config.frames) + self.added.iter().map(|&n| u64::from(n)).sum::<u64>()
    }

    /// The last part.
    fn last_part(&self) -> Part {
        let mut part = Part::first(&self.config);
        let (mut scenes, mut frames) = (self.config.scenes(), u64::from(self.config.frames));
        if let Some(test) = &self.config.test {
            scenes += test.scenes;
            frames += test.frames() as u64;
        }
        for &added in &self.added {
            part = Part {
                index: part.index + 1,
                first_scene: part.first_scene + scenes,
                first_stamp: part.first_stamp + frames,
                frames: added,
            };
            scenes = self.config.scenes_of(added);
            frames = u64::from(added);
        }
        part
    }
}

/// What a run has to do in a folder.
#[derive(Debug, Clone)]
pub(super) struct Task {
    /// The dataset as it will be.
    pub history: History,
    /// The frames to make.
    pub part: Part,
}

impl Task {
    fn of(history: History) -> Self {
        Self {
            part: history.last_part(),
            history,
        }
    }

    /// The task of making a dataset with these settings, or of bringing the one in the folder to
    /// their number of frames.
    ///
    /// # Errors
    /// A folder with other contents.
    pub fn generate(config: &GenerateConfig, root: &Path) -> Result<Self> {
        let folder = Folder::read(root)?;
        let config = &with_recorded_assets(config, &folder, root)?;
        let Some(made_by) = &folder.made_by else {
            if folder.marker.is_none()
                && let Some(content) = &folder.content
            {
                return Err(Error::dataset(
                    root,
                    format!(
                        "holds other files, such as {content}, and no dataset of these settings"
                    ),
                    "choose a new or empty folder",
                ));
            }
            let task = Self::of(History::new(config));
            task.check_marker(&folder, root)?;
            return Ok(task);
        };
        let Some(mut history) = History::from_table(made_by) else {
            return Err(occupied(root));
        };
        let same = GenerateConfig {
            frames: history.config.frames,
            ..config.clone()
        };
        if same != history.config {
            return Err(occupied(root));
        }
        let present = history.frames();
        if folder.marker.as_ref() == Some(made_by) {
            // Stopped between the last two steps of an addition.
            return Ok(Self::of(history));
        }
        let missing = u64::from(config.frames).saturating_sub(present);
        if missing == 0 {
            return Err(Error::dataset(
                root,
                format!("already holds these {present} frames; a dataset is never overwritten"),
                "ask for more frames to add some, or choose another folder",
            ));
        }
        // Both numbers are below the 32-bit number of frames that was asked for.
        history.added.push(missing as u32);
        let task = Self::of(history);
        task.check_marker(&folder, root)?;
        Ok(task)
    }

    /// The task of adding frames to the dataset in a folder, with the settings that made it.
    ///
    /// # Errors
    /// A folder without a finished dataset of this program and version.
    pub fn extend(root: &Path, frames: u32) -> Result<Self> {
        let folder = Folder::read(root)?;
        let Some(made_by) = &folder.made_by else {
            return Err(Error::dataset(
                root,
                "holds no finished dataset to which frames could be added",
                "generate one first, or finish it with the command that began it",
            ));
        };
        let Some(mut history) = History::from_table(made_by) else {
            return Err(Error::dataset(
                root,
                "was not made by this version of the generator",
                "frames can be added only by the program that made the others",
            ));
        };
        if folder.marker.as_ref() == Some(made_by) {
            return Ok(Self::of(history));
        }
        history.added.push(frames);
        let task = Self::of(history);
        task.check_marker(&folder, root)?;
        Ok(task)
    }

    /// Refuses a folder in which something else was begun.
    fn check_marker(&self, folder: &Folder, root: &Path) -> Result<()> {
        match &folder.marker {
            Some(marker) if *marker != self.history.to_table()? => Err(Error::dataset(
                root,
                "was begun with other settings or another version of the program",
                format!("use the settings in {MARKER}, or delete the folder or choose another one"),
            )),
            _ => Ok(()),
        }
    }
}

/// The settings with the folder of assets that the dataset knows: the same assets may have moved.
///
/// # Errors
/// Other assets than the dataset's.
fn with_recorded_assets(
    config: &GenerateConfig,
    folder: &Folder,
    root: &Path,
) -> Result<GenerateConfig> {
    let recorded = folder.made_by.as_ref().or(folder.marker.as_ref());
    let recorded = recorded.and_then(History::from_table);
    let mut config = config.clone();
    if let Some(ours) = &mut config.assets
        && let Some(theirs) = recorded.and_then(|history| history.config.assets)
    {
        if ours.digest != theirs.digest {
            return Err(Error::dataset(
                root,
                format!(
                    "was made with other assets than {} has now",
                    ours.folder.display()
                ),
                "bring the files back as they were, or choose another folder for the dataset",
            ));
        }
        ours.folder = theirs.folder;
    }
    Ok(config)
}

fn occupied(root: &Path) -> Error {
    Error::dataset(
        root,
        "already holds a dataset, which is never overwritten",
        "choose another folder or delete this one",
    )
}
