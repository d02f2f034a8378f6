//! What a run writes down: `metrics.csv` and TensorBoard events.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use image::RgbImage;
use serde::{Deserialize, Serialize};
use tensorboard_rs::summary_writer::{FileWriter, SummaryWriter};

use super::events::Events;
use crate::error::{Error, Result};
use crate::files;

/// One epoch of one stage; what a stage does not have is empty.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct EpochRow {
    /// "detector", "distance" or "size".
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
    /// Log-size term of the size network's loss.
    #[serde(default)]
    pub log_size_loss: Option<f64>,
    /// Extent term.
    #[serde(default)]
    pub extent_loss: Option<f64>,
    /// Pose term.
    #[serde(default)]
    pub pose_loss: Option<f64>,
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
    /// Validation root mean squared error of the log-size.
    #[serde(default)]
    pub log_size_rms: Option<f64>,
    /// Share of its 68 % intervals that hold the truth.
    #[serde(default)]
    pub log_size_within_68: Option<f64>,
    /// Share of its 95 % intervals that hold the truth.
    #[serde(default)]
    pub log_size_within_95: Option<f64>,
    /// Validation root mean squared error of the extent along the line of sight, metres.
    #[serde(default)]
    pub extent_rms_m: Option<f64>,
    /// Share of its 68 % intervals that hold the truth.
    #[serde(default)]
    pub extent_within_68: Option<f64>,
    /// Share of its 95 % intervals that hold the truth.
    #[serde(default)]
    pub extent_within_95: Option<f64>,
    /// Validation negative log-likelihood of both.
    #[serde(default)]
    pub size_nll: Option<f64>,
}

impl EpochRow {
    /// Sets the number of a tag; a tag that the table does not have is left out.
    pub fn set(&mut self, tag: &str, value: f64) {
        let optional = match tag {
            "loss/total" => return self.loss = value,
            "train/learning_rate" => return self.learning_rate = value,
            "train/images_per_second" => return self.images_per_second = value,
            "loss/box" => &mut self.box_loss,
            "loss/class" => &mut self.class_loss,
            "loss/distribution" => &mut self.distribution_loss,
            "loss/log_size" => &mut self.log_size_loss,
            "loss/extent" => &mut self.extent_loss,
            "loss/pose" => &mut self.pose_loss,
            "train/gradient_norm" => &mut self.gradient_norm,
            "validation/precision" => &mut self.precision,
            "validation/recall" => &mut self.recall,
            "validation/map50" => &mut self.map50,
            "validation/map50_95" => &mut self.map50_95,
            "validation/mae_m" => &mut self.mae_m,
            "validation/rmse_m" => &mut self.rmse_m,
            "validation/mre_percent" => &mut self.mre_percent,
            "validation/log_size_rms" => &mut self.log_size_rms,
            "validation/log_size_within_68" => &mut self.log_size_within_68,
            "validation/log_size_within_95" => &mut self.log_size_within_95,
            "validation/extent_rms_m" => &mut self.extent_rms_m,
            "validation/extent_within_68" => &mut self.extent_within_68,
            "validation/extent_within_95" => &mut self.extent_within_95,
            "validation/size_nll" => &mut self.size_nll,
            _ => return,
        };
        *optional = Some(value);
    }

    /// The numbers to plot, by tag.
    fn scalars(&self) -> Vec<(&'static str, f64)> {
        let always = [
            ("loss/total", Some(self.loss)),
            ("loss/box", self.box_loss),
            ("loss/class", self.class_loss),
            ("loss/distribution", self.distribution_loss),
            ("loss/log_size", self.log_size_loss),
            ("loss/extent", self.extent_loss),
            ("loss/pose", self.pose_loss),
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
            ("validation/log_size_rms", self.log_size_rms),
            ("validation/log_size_within_68", self.log_size_within_68),
            ("validation/log_size_within_95", self.log_size_within_95),
            ("validation/extent_rms_m", self.extent_rms_m),
            ("validation/extent_within_68", self.extent_within_68),
            ("validation/extent_within_95", self.extent_within_95),
            ("validation/size_nll", self.size_nll),
        ];
        always
            .into_iter()
            .filter_map(|(tag, value)| Some((tag, value?)))
            .collect()
    }
}

/// A run's logs, for the threads of training.
pub type SharedLog = Arc<Mutex<RunLog>>;

/// The logs of a run folder.
pub struct RunLog {
    csv: PathBuf,
    rows: Vec<EpochRow>,
    events: Events<SummaryWriter>,
    /// Pictures go through the inner writer, into a file of their own.
    pictures: Events<FileWriter>,
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
        let folder = run.join("tensorboard");
        Ok(Self {
            csv,
            rows,
            events: Events::begin(&folder, |folder| SummaryWriter::new(folder))?,
            pictures: Events::begin(&folder.join("pictures"), |folder| FileWriter::new(folder))?,
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
        self.events.write(|events| {
            for (tag, value) in row.scalars() {
                events.add_scalar(&format!("{}/{tag}", row.stage), value as f32, step);
            }
            events.flush();
        })?;
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

    /// A picture for TensorBoard.
    ///
    /// # Errors
    /// A full disk.
    pub fn add_picture(
        &mut self,
        stage: &str,
        tag: &str,
        step: u64,
        picture: &RgbImage,
    ) -> Result<()> {
        let (width, height) = picture.dimensions();
        // The writer wants rows of RGB pixels and takes the sides as width, height; it then
        // writes them down the wrong way round.
        let sides = [3, width as usize, height as usize];
        let tag = format!("{stage}/{tag}");
        let mut summary = tensorboard_rs::summary::image(&tag, picture.as_raw(), &sides);
        for value in summary.mut_value().iter_mut() {
            value.mut_image().set_width(width.cast_signed());
            value.mut_image().set_height(height.cast_signed());
        }
        let step = usize::try_from(step).unwrap_or(usize::MAX);
        self.pictures.write(|pictures| {
            pictures.add_summary(summary, step);
            pictures.flush();
        })
    }

    /// A histogram of numbers for TensorBoard.
    ///
    /// # Errors
    /// A full disk.
    pub fn add_histogram(
        &mut self,
        stage: &str,
        tag: &str,
        step: u64,
        values: &[f32],
    ) -> Result<()> {
        let Some(histogram) = Histogram::of(values) else {
            return Ok(());
        };
        let step = usize::try_from(step).unwrap_or(usize::MAX);
        self.events.write(|events| {
            events.add_histogram_raw(
                &format!("{stage}/{tag}"),
                histogram.min,
                histogram.max,
                histogram.count,
                histogram.sum,
                histogram.sum_squares,
                &histogram.limits,
                &histogram.counts,
                step,
            );
        })
    }

    /// The loss of single steps, for TensorBoard only.
    ///
    /// # Errors
    /// A full disk.
    pub fn add_step(&mut self, stage: &str, step: u64, loss: f64) -> Result<()> {
        let step = usize::try_from(step).unwrap_or(usize::MAX);
        let tag = format!("{stage}/step/loss");
        self.events
            .write(|events| events.add_scalar(&tag, loss as f32, step))
    }
}

/// Numbers counted in equal steps between the smallest and the largest.
#[derive(Debug, PartialEq)]
struct Histogram {
    min: f64,
    max: f64,
    count: f64,
    sum: f64,
    sum_squares: f64,
    /// Upper limits of the steps, and how many numbers fall into each.
    limits: Vec<f64>,
    counts: Vec<f64>,
}

impl Histogram {
    const STEPS: usize = 40;

    /// None for no finite numbers.
    fn of(values: &[f32]) -> Option<Self> {
        let finite = || {
            values
                .iter()
                .map(|&v| f64::from(v))
                .filter(|v| v.is_finite())
        };
        let min = finite().reduce(f64::min)?;
        let max = finite().reduce(f64::max)?;
        let step = ((max - min) / Self::STEPS as f64).max(f64::from(f32::MIN_POSITIVE));
        let mut counts = vec![0.0; Self::STEPS];
        for value in finite() {
            let index = ((value - min) / step) as usize;
            counts[index.min(Self::STEPS - 1)] += 1.0;
        }
        Some(Self {
            min,
            max,
            count: finite().count() as f64,
            sum: finite().sum(),
            sum_squares: finite().map(|value| value * value).sum(),
            limits: (1..=Self::STEPS).map(|i| min + step * i as f64).collect(),
            counts,
        })
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
    fn a_histogram_counts_every_finite_number_once() {
        let histogram = Histogram::of(&[0.0, 1.0, 1.0, 4.0, f32::NAN]).unwrap();
        assert_eq!(
            (histogram.min, histogram.max, histogram.count),
            (0.0, 4.0, 4.0)
        );
        assert_eq!(histogram.counts.iter().sum::<f64>(), 4.0);
        assert_eq!(histogram.counts[10], 2.0);
        assert!(Histogram::of(&[f32::NAN]).is_none());
        let still = Histogram::of(&[2.0; 3]).unwrap();
        assert_eq!(still.counts[0], 3.0);
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
