//! Finding the dataset that a run was trained on.
//!
//! A run's `config.json` holds the path as it was typed, which leads elsewhere from another folder,
//! or to another dataset of the same name; and the dataset's fingerprint, which tells.

use std::path::{Path, PathBuf};

use crate::dataset::StereoDataset;
use crate::progress::Silent;
use crate::train::{SavedRun, TrainConfig};

/// What a run says of the dataset that it was trained on.
struct Trained {
    path: PathBuf,
    fingerprint: Option<String>,
    /// Frames that training left out.
    left_out: usize,
    config: TrainConfig,
}

/// Where the dataset is that a run was trained on.
pub(super) enum TrainingData {
    /// It is the one that is evaluated.
    Evaluated,
    /// It is another one, divided as the run divided it.
    Other(Box<StereoDataset>),
    /// It is not where it was, or something else is there.
    Lost(PathBuf),
    /// The run does not say.
    Unknown,
}

impl TrainingData {
    /// Looks for the dataset: the evaluated one, then the run's path from the working folder, then
    /// from the folders that hold the run. One counts that has the run's fingerprint; runs of older
    /// versions have none, and the path has to do.
    pub fn find(run: &Path, evaluated: &StereoDataset) -> Self {
        let Some(trained) = Trained::read(run) else {
            return Self::Unknown;
        };
        if trained.is_evaluated(evaluated) {
            return Self::Evaluated;
        }
        let found = trained
            .places(run)
            .into_iter()
            .filter(|place| place.join("dataset.toml").is_file())
            .find_map(|place| {
                let mut dataset = StereoDataset::open(place).ok()?;
                if let Some(split) = trained.config.split {
                    dataset.resplit(split, trained.config.seed).ok()?;
                }
                trained.is_it(&dataset).then_some(dataset)
            });
        found.map_or(Self::Lost(trained.path), |dataset| {
            Self::Other(Box::new(dataset))
        })
    }
}

impl Trained {
    fn read(run: &Path) -> Option<Self> {
        let saved = SavedRun::read(run).ok()??;
        Some(Self {
            path: saved.data,
            fingerprint: saved.dataset.fingerprint,
            left_out: saved.dataset.left_out,
            config: saved.config,
        })
    }

    /// Where the dataset may be.
    fn places(&self, run: &Path) -> Vec<PathBuf> {
        let mut places = vec![self.path.clone()];
        if let Ok(run) = run.canonicalize()
            && self.path.is_relative()
        {
            places.extend(run.ancestors().skip(1).map(|above| above.join(&self.path)));
        }
        places
    }

    fn is_evaluated(&self, evaluated: &StereoDataset) -> bool {
        if self.fingerprint.is_some() {
            return self.is_it(evaluated);
        }
        let [a, b] = [&self.path, &evaluated.folder].map(|path| path.canonicalize());
        matches!((a, b), (Ok(a), Ok(b)) if a == b)
    }

    fn is_it(&self, dataset: &StereoDataset) -> bool {
        let Some(fingerprint) = &self.fingerprint else {
            return true;
        };
        let is_same =
            |dataset: &StereoDataset| dataset.fingerprint().is_ok_and(|of| of == *fingerprint);
        if is_same(dataset) {
            return true;
        }
        // Training leaves out frames whose images are broken, which only decoding tells.
        if self.left_out <= dataset.problems.len() {
            return false;
        }
        let mut checked = dataset.clone();
        checked.check_images(&Silent).is_ok() && is_same(&checked)
    }
}
