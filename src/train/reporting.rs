//! From burn-train's events to the run's logs and to whoever watches.

use std::collections::{BTreeMap, HashMap};
use std::sync::PoisonError;
use std::sync::mpsc::Sender;

use burn::train::logger::{EvaluationProgressLogger, MetricLogger, TrainingProgressLogger};
use burn::train::metric::store::{EpochSummary, MetricsUpdate, Split};
use burn::train::metric::{MetricDefinition, MetricId, NumericEntry};
use burn::train::renderer::{
    EvaluationName, MetricState, MetricsRenderer, MetricsRendererEvaluation,
    MetricsRendererTraining,
};

use super::log::{EpochRow, SharedLog};
use super::metrics::LOSS;
use super::trainee::Failure;

/// What a training thread tells its caller.
#[derive(Debug)]
pub enum Report {
    /// A step was taken; the mean loss of the epoch so far.
    Step(f64),
    /// An epoch begins.
    Epoch(usize),
    /// A validation begins.
    Validating,
    /// To be kept in sight.
    Note(String),
}

/// Takes burn-train's metrics into `metrics.csv` and TensorBoard, and answers its questions about
/// earlier epochs.
pub struct MetricsLog {
    stage: &'static str,
    epochs: u32,
    describe: fn(&EpochRow) -> String,
    log: SharedLog,
    reports: Sender<Report>,
    failure: Failure,
    names: HashMap<MetricId, String>,
    /// Values of epochs, by epoch and name.
    values: BTreeMap<(usize, String), f64>,
    /// Optimiser steps taken.
    step: u64,
    row: EpochRow,
}

impl MetricsLog {
    /// A log of a stage that goes on after so many steps.
    pub fn new(
        stage: &'static str,
        epochs: u32,
        describe: fn(&EpochRow) -> String,
        log: SharedLog,
        reports: Sender<Report>,
        failure: Failure,
        step: u64,
    ) -> Self {
        Self {
            stage,
            epochs,
            describe,
            log,
            reports,
            failure,
            names: HashMap::new(),
            values: BTreeMap::new(),
            step,
            row: EpochRow::default(),
        }
    }
}

impl MetricLogger for MetricsLog {
    fn log(&mut self, update: MetricsUpdate, epoch: usize, _: &Split) {
        for entry in update.entries_numeric {
            let Some(name) = self.names.get(&entry.entry.metric_id) else {
                continue;
            };
            match entry.numeric_entry {
                Some(NumericEntry::Final(value)) if value.is_finite() => {
                    self.row.set(name, value);
                    self.values.insert((epoch, name.clone()), value);
                }
                Some(NumericEntry::Value(value)) if name == LOSS => {
                    self.step += 1;
                    let mut log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
                    if let Err(error) = log.add_step(self.stage, self.step, value) {
                        self.failure.set(error);
                    }
                }
                _ => {}
            }
        }
    }

    fn read_numeric(
        &mut self,
        name: &str,
        epoch: usize,
        _: &Split,
    ) -> Result<Vec<NumericEntry>, String> {
        let value = self.values.get(&(epoch, name.to_owned()));
        Ok(value
            .map(|&value| NumericEntry::Final(value))
            .into_iter()
            .collect())
    }

    fn log_metric_definition(&mut self, definition: MetricDefinition) {
        let name = definition.name.as_str().to_owned();
        self.names.insert(definition.metric_id, name);
    }

    fn log_epoch_summary(&mut self, summary: EpochSummary) {
        // The split that ends an epoch.
        if summary.split != Split::Valid {
            return;
        }
        let row = EpochRow {
            stage: self.stage.to_owned(),
            epoch: summary.epoch_number as u32,
            step: self.step,
            ..std::mem::take(&mut self.row)
        };
        let described = (self.describe)(&row);
        if !described.is_empty() {
            let note = format!(
                "{} epoch {}/{}: loss {:.3}{described}",
                self.stage, row.epoch, self.epochs, row.loss
            );
            // Nobody listens any more once the stage is being given up.
            let _ = self.reports.send(Report::Note(note));
        }
        let mut log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        if let Err(error) = log.add(row) {
            self.failure.set(error);
        }
    }
}

/// Takes burn-train's progress to the caller's.
pub struct ProgressRenderer {
    reports: Sender<Report>,
    loss: Option<MetricId>,
    epoch: usize,
}

impl ProgressRenderer {
    /// Reports to a channel.
    pub fn new(reports: Sender<Report>) -> Self {
        Self {
            reports,
            loss: None,
            epoch: 0,
        }
    }

    fn report(&self, report: Report) {
        // Nobody listens any more once the stage is being given up.
        let _ = self.reports.send(report);
    }
}

impl MetricsRendererTraining for ProgressRenderer {
    fn update_train(&mut self, state: MetricState) {
        if let MetricState::Numeric(entry, Some(NumericEntry::Value(_))) = state
            && self.loss.as_ref() == Some(&entry.metric_id)
        {
            let mean = entry.serialized_entry.serialized.parse();
            self.report(Report::Step(mean.unwrap_or(f64::NAN)));
        }
    }

    fn update_valid(&mut self, _: MetricState) {}
}

impl MetricsRenderer for ProgressRenderer {
    fn manual_close(&mut self) {}

    fn register_metric(&mut self, definition: MetricDefinition) {
        if definition.name.as_str() == LOSS {
            self.loss = Some(definition.metric_id);
        }
    }
}

impl TrainingProgressLogger for ProgressRenderer {
    fn start(&mut self, _: usize, starting_epoch: usize, _: Option<usize>, _: Option<&str>) {
        self.epoch = starting_epoch;
    }

    fn update_epoch(&mut self, epoch: usize) {
        self.epoch = epoch + 1;
    }

    fn start_split(&mut self, split: &str, _: usize) {
        if split == Split::Train.to_string() {
            self.report(Report::Epoch(self.epoch));
        } else {
            self.report(Report::Validating);
        }
    }

    fn update_split(&mut self, _: usize) {}

    fn end_split(&mut self) {}

    fn end(&mut self) {}

    fn log_event_training(&mut self, _: String) {}
}

// burn-train asks every renderer to show evaluations as well; training has none.
impl MetricsRendererEvaluation for ProgressRenderer {
    fn update_test(&mut self, _: EvaluationName, _: MetricState) {}
}

impl EvaluationProgressLogger for ProgressRenderer {
    fn start_global_progress(&mut self, _: usize) {}

    fn start_test(&mut self, _: &str, _: usize) {}

    fn update_test_progress(&mut self, _: usize) {}

    fn end_test(&mut self) {}

    fn end_global_progress(&mut self) {}

    fn log_event_evaluation(&mut self, _: String) {}
}
