//! What a run writes down: `metrics.csv` and TensorBoard events.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tensorboard_rs::summary_writer::SummaryWriter;

use crate::error::{Error, Result};
use crate::files;

/// One epoch of one stage; what a stage does not have is empty.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct EpochRow {
    /// "detector" or "distance".
    pub stage: String,
    /// Finished epochs, from 1.
    pub epoch: u32,
    /// Optimiser steps since the start of the stage.
    pub step: u64,
    /// Learning rate of the epoch's last step.
    pub learning_rate: f64,
    /// Mean training loss.
    pub loss: f64,
    /// Box term of the detector's loss.
    pub box_loss: Option<f64>,
    /// Class term.
    pub class_loss: Option<f64>,
    /// Distribution term.
    pub distribution_loss: Option<f64>,
    /// Mean global gradient norm before clipping.
    pub gradient_norm: Option<f64>,
    /// Images or composites trained on per second.
    pub images_per_second: f64,
    /// Validation precision.
    pub precision: Option<f64>,
    /// Validation recall.
    pub recall: Option<f64>,
    /// Validation average precision at IoU 0.50.
    pub map50: Option<f64>,
    /// Validation average precision over IoU 0.50 to 0.95.
    pub map50_95: Option<f64>,
    /// Validation mean absolute error, metres.
    pub mae_m: Option<f64>,
    /// Validation root mean squared error, metres.
    pub rmse_m: Option<f64>,
    /// Validation mean relative error, percent.
    pub mre_percent: Option<f64>,
}

impl EpochRow {
    /// The numbers to plot, by tag.
    fn scalars(&self) -> Vec<(&'static str, f64)> {
        let always = [
            ("loss/total", Some(self.loss)),
            ("loss/box", self.box_loss),
            ("loss/class", self.class_loss),
            ("loss/distribution", self.distribution_loss),
            ("train/learning_rate", Some(self.learning_rate)),
            ("train/gradient_norm", self.gradient_norm),
            ("train/images_per_second", Some(self.images_per_second)),
            ("validation/precision", self.precision),
            ("validation/recall", self.recall),
            ("validation/map50", self.map50),
            ("validation/map50_95", self.map50_95),
            ("validation/mae_m", self.mae_m),
            ("validation/rmse_m", self.rmse_m),
            ("validation/mre_percent", self.mre_percent),
        ];
        always
            .into_iter()
            .filter_map(|(tag, value)| Some((tag, value?)))
            .collect()
    }
}

/// The logs of a run folder.
pub struct RunLog {
    csv: PathBuf,
    rows: Vec<EpochRow>,
    events: SummaryWriter,
}

impl RunLog {
    /// Opens the logs of a run, keeping the rows it has.
    ///
    /// # Errors
    /// A folder that cannot be written, or a `metrics.csv` that cannot be read.
    pub fn open(run: &Path) -> Result<Self> {
        let csv = run.join("metrics.csv");
        let mut rows = Vec::new();
        if csv.exists() {
            let text = files::read_text(&csv)?;
            for row in csv::Reader::from_reader(text.as_bytes()).deserialize() {
                rows.push(row.map_err(|source| {
                    Error::value(
                        csv.display().to_string(),
                        format!("is not a metrics table: {source}"),
                        "move it away and resume",
                    )
                })?);
            }
        }
        // The writer panics when it cannot create its file, so make sure that it can.
        let folder = run.join("tensorboard");
        files::create_folder(&folder)?;
        let probe = folder.join("probe");
        files::write_atomically(&probe, b"")?;
        std::fs::remove_file(&probe).map_err(Error::io("remove", &probe))?;
        Ok(Self {
            csv,
            rows,
            events: SummaryWriter::new(&folder),
        })
    }

    /// Forgets the rows of a stage after an epoch: those of a run that is resumed from there.
    pub fn rewind(&mut self, stage: &str, epoch: u32) {
        self.rows
            .retain(|row| row.stage != stage || row.epoch <= epoch);
    }

    /// Adds an epoch to both logs.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn add(&mut self, row: EpochRow) -> Result<()> {
        let step = usize::try_from(row.step).unwrap_or(usize::MAX);
        for (tag, value) in row.scalars() {
            self.events
                .add_scalar(&format!("{}/{tag}", row.stage), value as f32, step);
        }
        self.events.flush();
        self.rows.push(row);
        let broken = |source: csv::Error| {
            Error::value("metrics.csv", source.to_string(), "report this as a defect")
        };
        let mut writer = csv::Writer::from_writer(Vec::new());
        for row in &self.rows {
            writer.serialize(row).map_err(broken)?;
        }
        let bytes = writer
            .into_inner()
            .map_err(|source| broken(source.into_error().into()))?;
        files::write_atomically(&self.csv, &bytes)
    }

    /// The loss of single steps, for TensorBoard only.
    pub fn add_step(&mut self, stage: &str, step: u64, loss: f64) {
        let step = usize::try_from(step).unwrap_or(usize::MAX);
        self.events
            .add_scalar(&format!("{stage}/step/loss"), loss as f32, step);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(stage: &str, epoch: u32) -> EpochRow {
        EpochRow {
            stage: stage.into(),
            epoch,
            loss: 1.5,
            ..EpochRow::default()
        }
    }

    #[test]
    fn rows_survive_reopening_and_rewinding_drops_later_epochs_of_that_stage() {
        let folder = tempfile::tempdir().unwrap();
        let mut log = RunLog::open(folder.path()).unwrap();
        for row in [row("detector", 1), row("detector", 2), row("distance", 1)] {
            log.add(row).unwrap();
        }
        let mut log = RunLog::open(folder.path()).unwrap();
        assert_eq!(log.rows.len(), 3);
        log.rewind("detector", 1);
        let left: Vec<_> = log
            .rows
            .iter()
            .map(|row| (row.stage.as_str(), row.epoch))
            .collect();
        assert_eq!(left, [("detector", 1), ("distance", 1)]);
    }
}
