//! A run's files.

use std::path::{Path, PathBuf};

use super::parts::{Block, Picture, Section};
use crate::error::{Error, Result};
use crate::evaluate::{Evaluation, ExampleKind, evaluations, read};
use crate::files;
use crate::page;
use crate::train::{EpochRow, StageFolder};

/// The page of an ablation.
const ABLATION_PAGE: &str = "ablation.html";

/// A run with everything that a page shows of it.
pub(super) struct Run {
    /// Its folder's name.
    pub name: String,
    pub folder: PathBuf,
    /// Its place among the runs, which gives its colour.
    pub number: usize,
    /// `config.json` as it is.
    pub config: String,
    /// `metrics.csv`; empty where there is none.
    pub epochs: Vec<EpochRow>,
    pub evaluations: Vec<Evaluated>,
}

/// An evaluation of a run.
pub(super) struct Evaluated {
    /// Its folder's name.
    pub name: String,
    pub folder: PathBuf,
    pub evaluation: Evaluation,
}

impl Run {
    /// Reads a run's files.
    ///
    /// # Errors
    /// A folder without `config.json`, or a file that cannot be read.
    pub fn open(folder: &Path, number: usize) -> Result<Self> {
        let config = folder.join("config.json");
        if !config.is_file() {
            return Err(Error::value(
                format!("run {}", folder.display()),
                "is no run: it has no config.json",
                "give the folder that `twinsight train` wrote",
            ));
        }
        let evaluations = evaluations(folder)?
            .into_iter()
            .map(|folder| {
                Ok(Evaluated {
                    name: name_of(&folder),
                    evaluation: read(&folder)?,
                    folder,
                })
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(Self {
            name: name_of(folder),
            folder: folder.to_path_buf(),
            number,
            config: files::read_text(config)?,
            epochs: epochs(&folder.join("metrics.csv"))?,
            evaluations,
        })
    }

    /// What to say of a run that was not evaluated; None for one that was, and for one without a
    /// trained network, which cannot be.
    pub fn without_evaluation(&self) -> Option<String> {
        let is_trained = |stage| StageFolder::new(&self.folder, stage).best().exists();
        let trained = ["detector", "distance"].into_iter().any(is_trained);
        if !self.evaluations.is_empty() || !trained {
            return None;
        }
        // `<ablation>/runs/<variant>-seed<N>`
        let above = self.folder.canonicalize().ok();
        let page = above.and_then(|run| Some(run.parent()?.parent()?.join(ABLATION_PAGE)));
        Some(match page.filter(|page| page.is_file()) {
            Some(page) => format!(
                "{} is part of an ablation, whose figures are in {}",
                self.name,
                page.display()
            ),
            None => format!(
                "{} has no evaluation: twinsight evaluate --run {} --data DATASET",
                self.name,
                self.folder.display()
            ),
        })
    }

    /// A file of the run, as a page names it.
    pub fn file(&self, name: &str) -> String {
        self.folder.join(name).display().to_string()
    }
}

impl Evaluated {
    /// A file of the evaluation, as a page names it.
    pub fn file(&self, name: &str) -> String {
        self.folder.join(name).display().to_string()
    }

    /// Adds the pictures; one that is gone is left out.
    pub fn add_pictures(&self, section: &mut Section) -> Result<()> {
        for kind in ExampleKind::ALL {
            let mut pictures = Vec::new();
            let rows = &self.evaluation.tables.examples;
            for row in rows.iter().filter(|row| row.kind == kind) {
                let path = self.folder.join(&row.picture);
                if !path.exists() {
                    continue;
                }
                let bytes = std::fs::read(&path).map_err(Error::io("read", &path))?;
                let error = row
                    .error_percent
                    .map(|percent| format!(", {percent:+.1} %"));
                let score = row.score.map(|score| format!(", score {score:.2}"));
                pictures.push(Picture {
                    caption: format!(
                        "frame {:05}{}{}",
                        row.frame,
                        error.unwrap_or_default(),
                        score.unwrap_or_default()
                    ),
                    jpeg: page::base64(&bytes),
                });
            }
            if !pictures.is_empty() {
                section.blocks.push(Block::Pictures {
                    title: match kind {
                        ExampleKind::Worst => {
                            "Largest errors of the pipeline: label green, detection red"
                        }
                        ExampleKind::Best => {
                            "Smallest errors of the pipeline: label green, detection red"
                        }
                        ExampleKind::Missed => "Missed: the largest",
                        ExampleKind::False => "Seen where none is labelled: the most certain",
                    }
                    .to_owned(),
                    pictures,
                    source: self.file("examples.csv"),
                });
            }
        }
        Ok(())
    }
}

/// The last part of a path; the whole path where it has none.
fn name_of(folder: &Path) -> String {
    let path = folder
        .canonicalize()
        .unwrap_or_else(|_| folder.to_path_buf());
    let name = path
        .file_name()
        .map(|name| name.to_string_lossy().into_owned());
    name.unwrap_or_else(|| folder.display().to_string())
}

fn epochs(path: &Path) -> Result<Vec<EpochRow>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let text = files::read_text(path)?;
    csv::Reader::from_reader(text.as_bytes())
        .deserialize()
        .collect::<Result<_, csv::Error>>()
        .map_err(|source| {
            let line = source
                .position()
                .map(|position| format!(": line {} cannot be read", position.line()));
            Error::value(
                path.display().to_string(),
                format!("is not a metrics table{}", line.unwrap_or_default()),
                "restore the file that `train` wrote",
            )
        })
}
