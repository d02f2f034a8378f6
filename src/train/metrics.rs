//! What is measured while training, as metrics of burn-train.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::{Arc, PoisonError};
use std::time::Instant;

use burn::lr_scheduler::module_lr_scheduler::ModuleLearningRate;
use burn::tensor::TensorReadError;
use burn::train::metric::{
    Adaptor, Metric, MetricAttributes, MetricMetadata, MetricName, Numeric, NumericAttributes,
    NumericEntry, SerializedEntry,
};

use super::log::SharedLog;
use super::stage::Recipe;
use super::trainee::{CheckReport, Failure, Norms, PassReport, Shown};
use crate::error::Error;

/// The loss: the sum of its terms.
pub const LOSS: &str = "loss/total";
/// Learning rate of the last step.
pub const LEARNING_RATE: &str = "train/learning_rate";
/// Mean global gradient norm before clipping.
pub const GRADIENT_NORM: &str = "train/gradient_norm";
/// Training items per second.
pub const IMAGES_PER_SECOND: &str = "train/images_per_second";

/// Shares of a step add up to 1, but for rounding.
const WHOLE_STEP: f64 = 1.0 - 1e-6;

impl Adaptor<PassReport> for PassReport {
    fn adapt(&self) -> Self {
        self.clone()
    }
}

/// The files of some items in an epoch, in words.
type FilesOf = Arc<dyn Fn(u32, &[usize]) -> String + Send + Sync>;

/// What a training metric reads from the passes.
#[derive(Clone)]
enum Reading {
    /// The sum of all terms, which must stay finite; how to name the files of an epoch's items.
    Loss(Failure, FilesOf),
    /// One term.
    Term(usize),
    LearningRate,
    GradientNorm(Norms),
    ImagesPerSecond,
}

/// A number of the training passes: step by step where it has one for a step, and of the epoch.
#[derive(Clone)]
pub struct TrainingMetric {
    name: MetricName,
    reading: Reading,
    /// Share of the step at hand that is done, and what its passes add up to.
    step: [f64; 2],
    /// Items of the step at hand and of the epoch.
    items: [usize; 2],
    /// Value of the last step.
    value: Option<f64>,
    /// Sum over the items of the epoch.
    sum: f64,
    /// When the epoch began and its last pass was over.
    times: Option<[Instant; 2]>,
    /// Value of the epoch.
    result: f64,
}

impl TrainingMetric {
    fn new(name: &str, reading: Reading) -> Self {
        Self {
            name: Arc::new(name.to_owned()),
            reading,
            step: [0.0; 2],
            items: [0; 2],
            value: None,
            sum: 0.0,
            times: None,
            result: f64::NAN,
        }
    }

    /// All of a recipe.
    pub fn all<R: Recipe>(recipe: &Arc<R>, failure: &Failure, norms: &Norms) -> Vec<Self> {
        let names = Arc::clone(recipe);
        let named: FilesOf = Arc::new(move |epoch, items| files_of(&*names, epoch, items));
        let mut all = vec![Self::new(LOSS, Reading::Loss(failure.clone(), named))];
        // A single term is the loss itself.
        if R::TERMS.len() > 1 {
            let terms = R::TERMS.iter().enumerate();
            all.extend(terms.map(|(index, name)| Self::new(name, Reading::Term(index))));
        }
        all.extend([
            Self::new(LEARNING_RATE, Reading::LearningRate),
            Self::new(GRADIENT_NORM, Reading::GradientNorm(Arc::clone(norms))),
            Self::new(IMAGES_PER_SECOND, Reading::ImagesPerSecond),
        ]);
        all
    }

    /// What a pass adds, per item.
    fn read(&self, pass: &PassReport, metadata: &MetricMetadata) -> f64 {
        match &self.reading {
            Reading::Loss(..) => pass.terms.iter().sum(),
            Reading::Term(index) => pass.terms.get(*index).copied().unwrap_or(f64::NAN),
            Reading::LearningRate => metadata
                .lr
                .as_ref()
                .map_or(f64::NAN, ModuleLearningRate::base),
            Reading::GradientNorm(_) | Reading::ImagesPerSecond => f64::NAN,
        }
    }

    fn refuse_not_finite(&self, loss: f64, pass: &PassReport) {
        if let Reading::Loss(failure, name) = &self.reading
            && !loss.is_finite()
        {
            let names = name(pass.epoch, &pass.items);
            let value = format!("the {} loss is {loss}", pass.stage);
            failure.set(not_finite(&value, pass.epoch, pass.step, &names));
        }
    }
}

/// The files of items, by name.
pub fn files_of<R: Recipe>(recipe: &R, epoch: u32, items: &[usize]) -> String {
    let files: BTreeSet<PathBuf> = items
        .iter()
        .flat_map(|&item| recipe.item_files(epoch, item))
        .collect();
    let names: Vec<String> = files
        .iter()
        .map(|file| file.display().to_string())
        .collect();
    names.join(", ")
}

/// A number that is none any more, in an epoch and step that count from 0.
pub fn not_finite(value: &str, epoch: u32, step: u64, files: &str) -> Error {
    Error::training(
        format!(
            "{value} in epoch {}, step {}, on {files}",
            epoch + 1,
            step + 1
        ),
        "check these files; else train into another --run with a lower learning rate (from this one's \
         weights: --weights, --distance-weights)",
    )
}

fn entry(value: f64) -> SerializedEntry {
    SerializedEntry::new(format!("{value:.3}"), value.to_string())
}

impl Metric for TrainingMetric {
    type Input = PassReport;

    fn name(&self) -> MetricName {
        Arc::clone(&self.name)
    }

    fn attributes(&self) -> MetricAttributes {
        NumericAttributes {
            unit: None,
            higher_is_better: false,
        }
        .into()
    }

    fn update(
        &mut self,
        pass: &PassReport,
        metadata: &MetricMetadata,
    ) -> Result<SerializedEntry, TensorReadError> {
        let reading = self.read(pass, metadata);
        self.refuse_not_finite(reading, pass);
        self.step[0] += pass.share;
        self.step[1] += pass.share * reading;
        self.items[0] += pass.items.len();
        let began = self.times.map_or(pass.times[0], |times| times[0]);
        self.times = Some([began, pass.times[1]]);
        self.value = None;
        if self.step[0] >= WHOLE_STEP {
            let value = match self.reading {
                // The rate is that of the step from its last pass on.
                Reading::LearningRate => reading,
                _ => self.step[1],
            };
            self.value = Some(value);
            self.sum += value * self.items[0] as f64;
            self.items[1] += self.items[0];
            self.items[0] = 0;
            self.step = [0.0; 2];
        }
        Ok(entry(self.sum / self.items[1].max(1) as f64))
    }

    fn compute(&mut self) -> Result<SerializedEntry, TensorReadError> {
        let items = self.items[1] as f64;
        self.result = match &self.reading {
            Reading::Loss(..) | Reading::Term(_) => self.sum / items.max(1.0),
            Reading::LearningRate => self.value.unwrap_or(f64::NAN),
            Reading::GradientNorm(norms) => {
                let mut norms = norms.lock().unwrap_or_else(PoisonError::into_inner);
                let norms = std::mem::take(&mut *norms);
                norms.iter().sum::<f64>() / norms.len() as f64
            }
            Reading::ImagesPerSecond => self.times.map_or(f64::NAN, |[began, over]| {
                items / over.saturating_duration_since(began).as_secs_f64()
            }),
        };
        Ok(entry(self.result))
    }

    fn clear(&mut self) {
        *self = Self {
            result: self.result,
            ..Self::new(&self.name, self.reading.clone())
        };
    }
}

impl Numeric for TrainingMetric {
    fn value(&self) -> Option<NumericEntry> {
        matches!(self.reading, Reading::Loss(..))
            .then_some(self.value)
            .flatten()
            .map(NumericEntry::Value)
    }

    fn running_value(&self) -> Option<NumericEntry> {
        None
    }

    fn final_value(&self) -> NumericEntry {
        NumericEntry::Final(self.result)
    }
}

impl<F> Adaptor<Option<Arc<F>>> for CheckReport<F> {
    fn adapt(&self) -> Option<Arc<F>> {
        self.findings.clone()
    }
}

/// A number of a whole validation, such as mAP50.
pub struct ValidationMetric<R: Recipe> {
    name: MetricName,
    index: usize,
    findings: R::Findings,
    nothing: R::Findings,
    result: f64,
}

impl<R: Recipe> Clone for ValidationMetric<R> {
    fn clone(&self) -> Self {
        Self {
            name: Arc::clone(&self.name),
            index: self.index,
            findings: self.findings.clone(),
            nothing: self.nothing.clone(),
            result: self.result,
        }
    }
}

impl<R: Recipe> ValidationMetric<R> {
    /// All of a recipe.
    pub fn all(recipe: &R) -> Vec<Self> {
        let scores = R::SCORES.iter().enumerate();
        scores
            .map(|(index, name)| Self {
                name: Arc::new((*name).to_owned()),
                index,
                findings: recipe.no_findings(),
                nothing: recipe.no_findings(),
                result: f64::NAN,
            })
            .collect()
    }
}

impl<R: Recipe> Metric for ValidationMetric<R> {
    type Input = Option<Arc<R::Findings>>;

    fn name(&self) -> MetricName {
        Arc::clone(&self.name)
    }

    fn attributes(&self) -> MetricAttributes {
        NumericAttributes::default().into()
    }

    fn update(
        &mut self,
        findings: &Self::Input,
        _: &MetricMetadata,
    ) -> Result<SerializedEntry, TensorReadError> {
        if let Some(findings) = findings {
            R::merge(&mut self.findings, findings);
        }
        Ok(SerializedEntry::not_available(None))
    }

    fn compute(&mut self) -> Result<SerializedEntry, TensorReadError> {
        // No validation in this epoch, or nothing to validate on.
        self.result = R::scores(&self.findings).map_or(f64::NAN, |scores| scores[self.index]);
        let text = self.result.to_string();
        Ok(SerializedEntry::new(text.clone(), text))
    }

    fn clear(&mut self) {
        self.findings = self.nothing.clone();
    }
}

impl<R: Recipe> Numeric for ValidationMetric<R> {
    fn value(&self) -> Option<NumericEntry> {
        None
    }

    fn running_value(&self) -> Option<NumericEntry> {
        None
    }

    fn final_value(&self) -> NumericEntry {
        NumericEntry::Final(self.result)
    }
}

/// What a validation shows, if these items are those it shows.
pub struct MayShow(Option<Arc<Shown>>);

impl<F> Adaptor<MayShow> for CheckReport<F> {
    fn adapt(&self) -> MayShow {
        MayShow(self.shown.clone())
    }
}

/// Takes pictures and weights of a validation into the log.
#[derive(Clone)]
pub struct Showcase {
    stage: &'static str,
    log: SharedLog,
    failure: Failure,
}

impl Showcase {
    /// Into a log, under a stage's name.
    pub fn new(stage: &'static str, log: SharedLog, failure: Failure) -> Self {
        Self {
            stage,
            log,
            failure,
        }
    }

    fn show(&self, shown: &Shown) -> crate::error::Result<()> {
        let mut log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        for (tag, picture) in &shown.pictures {
            log.add_picture(self.stage, tag, shown.step, picture)?;
        }
        for (path, values) in &shown.weights {
            log.add_histogram(self.stage, &format!("weights/{path}"), shown.step, values)?;
        }
        Ok(())
    }
}

impl Metric for Showcase {
    type Input = MayShow;

    fn name(&self) -> MetricName {
        Arc::new("pictures".to_owned())
    }

    fn update(
        &mut self,
        MayShow(shown): &MayShow,
        _: &MetricMetadata,
    ) -> Result<SerializedEntry, TensorReadError> {
        if let Some(shown) = shown
            && let Err(error) = self.show(shown)
        {
            self.failure.set(error);
        }
        Ok(SerializedEntry::not_available(None))
    }

    fn compute(&mut self) -> Result<SerializedEntry, TensorReadError> {
        Ok(SerializedEntry::not_available(None))
    }

    fn clear(&mut self) {}
}
