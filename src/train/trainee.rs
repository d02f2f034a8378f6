//! A network in training as burn-train's strategies drive it: a step, what follows a step, and
//! validation.

use std::fmt;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Instant;

use burn::module::{Module, ModuleDisplay, Param, ParamId};
use burn::optim::lr_scheduler::module_lr_scheduler::ModuleLearningRate;
use burn::optim::{GradientsParams, ModuleOptimizer};
use burn::tensor::{ExecutionError, Tensor};
use burn::train::{InferenceStep, Interrupter, ItemLazy, TrainOutput, TrainStep};
use image::RgbImage;

use super::devices::DeviceSet;
use super::loader::{Check, Pass};
use super::metrics::{files_of, not_finite};
use super::optimizer::{
    AverageRule, clip_gradients, flat_values, initialize, named_weights, with_values,
};
use super::running::SharedTraining;
use super::stage::{Recipe, Steering};
use crate::error::Error;

/// The first error of a stage. It stops the loop, which knows errors of its own kinds only.
#[derive(Clone, Default)]
pub struct Failure {
    error: Arc<Mutex<Option<Error>>>,
    /// What stops the loop.
    pub interrupter: Interrupter,
}

impl Failure {
    /// Stops the loop because of an error; the first one counts.
    pub fn set(&self, error: Error) {
        let mut slot = self.error.lock().unwrap_or_else(PoisonError::into_inner);
        slot.get_or_insert(error);
        self.interrupter.stop(Some("an error"));
    }

    /// The error, if there was one.
    pub fn take(&self) -> Option<Error> {
        let mut slot = self.error.lock().unwrap_or_else(PoisonError::into_inner);
        slot.take()
    }
}

/// Gradient norms of the steps since they were last taken.
pub type Norms = Arc<Mutex<Vec<f64>>>;

/// A pass of the step at hand, to tell what made its gradient.
struct Trace {
    epoch: u32,
    items: Vec<usize>,
    /// The loss's terms, before they are read back.
    terms: Tensor<1>,
}

/// What a step needs beside the network.
pub struct Course<R: Recipe> {
    /// Loss, loading and validation.
    pub recipe: Arc<R>,
    /// Longest global gradient norm.
    longest: f64,
    /// How averaged weights follow.
    average: Option<AverageRule>,
    /// Optimiser steps taken.
    pub steps: u64,
    /// What several devices share.
    shared: Option<Arc<SharedTraining>>,
    /// Where the gradient norms go.
    pub norms: Norms,
    /// The passes of the step at hand, of all devices.
    traces: Arc<Mutex<Vec<Trace>>>,
    /// Where errors go.
    pub failure: Failure,
    /// What validates; made once per validation, of its inference copy.
    judge: OnceLock<Option<Arc<R::Judge>>>,
}

impl<R: Recipe> Course<R> {
    fn trace(&self, pass: &PassReport, terms: Tensor<1>) {
        let mut traces = self.traces.lock().unwrap_or_else(PoisonError::into_inner);
        traces.push(Trace {
            epoch: pass.epoch,
            items: pass.items.clone(),
            terms,
        });
    }

    fn take_traces(&self) -> Vec<Trace> {
        std::mem::take(&mut *self.traces.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Stops the loop because of a gradient that is no number, and names the passes to blame: one
    /// whose loss is none, else all.
    fn refuse_gradient(&self, norm: f64, passes: Vec<Trace>) {
        let epoch = passes.first().map_or(0, |pass| pass.epoch);
        let stage = R::STAGE;
        let mut items = Vec::new();
        for pass in passes {
            let loss: f64 = match pass.terms.try_into_vec_as::<f64>() {
                Ok(terms) => terms.iter().sum(),
                Err(_) => f64::NAN,
            };
            if !loss.is_finite() {
                let files = files_of(&*self.recipe, epoch, &pass.items);
                let value = format!("the {stage} loss is {loss}");
                return self
                    .failure
                    .set(not_finite(&value, epoch, self.steps, &files));
            }
            items.extend(pass.items);
        }
        let files = files_of(&*self.recipe, epoch, &items);
        let value = format!("the norm of the {stage} gradient is {norm}");
        self.failure
            .set(not_finite(&value, epoch, self.steps, &files));
    }
}

impl<R: Recipe> Clone for Course<R> {
    fn clone(&self) -> Self {
        Self {
            recipe: Arc::clone(&self.recipe),
            longest: self.longest,
            average: self.average,
            steps: self.steps,
            shared: self.shared.clone(),
            norms: Arc::clone(&self.norms),
            traces: Arc::clone(&self.traces),
            failure: self.failure.clone(),
            // Another copy has other weights.
            judge: OnceLock::new(),
        }
    }
}

impl<R: Recipe> fmt::Debug for Course<R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Course")
            .field("stage", &R::STAGE)
            .field("steps", &self.steps)
            .finish_non_exhaustive()
    }
}

/// A network with its averaged weights; both are in a checkpoint's module record.
#[derive(Module, Debug)]
pub struct Trainee<N: Module, C: Clone + fmt::Debug + Send + Sync> {
    /// The network.
    pub network: N,
    /// Its averaged weights, flat, in the order of traversal; none where they are not averaged.
    average: Vec<Param<Tensor<1>>>,
    /// Everything else.
    #[module(skip)]
    pub course: C,
}

/// The trainee of a recipe.
pub type TraineeOf<R> = Trainee<<R as Recipe>::Model, Course<R>>;

impl<R: Recipe> TraineeOf<R> {
    /// A network that has taken so many steps.
    pub fn new(
        recipe: Arc<R>,
        steering: &Steering,
        network: R::Model,
        steps: u64,
        devices: &DeviceSet,
        failure: Failure,
    ) -> Self {
        initialize(&network);
        let average = match steering.average {
            Some(_) => flat_values(&network)
                .into_iter()
                .map(|values| Param::initialized(ParamId::new(), Tensor::from_inner(values)))
                .collect(),
            None => Vec::new(),
        };
        Self {
            network,
            average,
            course: Course {
                recipe,
                longest: steering.clip_norm.unwrap_or(f64::INFINITY),
                average: steering.average,
                steps,
                shared: SharedTraining::between(devices).map(Arc::new),
                norms: Norms::default(),
                traces: Arc::default(),
                failure,
                judge: OnceLock::new(),
            },
        }
    }

    /// An inference copy of the network: with the averaged weights where there are some.
    pub fn usable(&self) -> R::Model {
        if self.average.is_empty() {
            return self.network.valid();
        }
        with_values(self.network.valid(), &self.averages())
    }

    /// The averaged weights, free of autodiff.
    fn averages(&self) -> Vec<Tensor<1>> {
        let values = self.average.iter();
        values
            .map(|values| values.val().without_autodiff())
            .collect()
    }

    /// What validates this copy.
    fn judge(&self) -> Option<Arc<R::Judge>> {
        let judge = self.course.judge.get_or_init(|| {
            let judge = self.course.recipe.judge(&self.usable());
            judge
                .map_err(|error| self.course.failure.set(error))
                .ok()
                .map(Arc::new)
        });
        judge.clone()
    }
}

/// What came of one pass.
#[derive(Clone)]
pub struct PassReport {
    /// The stage.
    pub stage: &'static str,
    /// The epoch, from 0.
    pub epoch: u32,
    /// The optimiser step, from 0.
    pub step: u64,
    /// The recipe's loss terms per item, of which the loss is the sum.
    pub terms: Vec<f64>,
    /// The terms before they are read back from the device.
    unread: Option<Tensor<1>>,
    /// The items.
    pub items: Vec<usize>,
    /// Their part of the optimiser step.
    pub share: f64,
    /// When the epoch began, and when the pass was over.
    pub times: [Instant; 2],
}

impl ItemLazy for PassReport {
    fn sync(mut self) -> Result<Self, ExecutionError> {
        if let Some(terms) = self.unread.take() {
            self.terms =
                terms
                    .try_into_vec_as::<f64>()
                    .map_err(|source| ExecutionError::WithContext {
                        reason: format!("the loss cannot be read back: {source}"),
                    })?;
        }
        Ok(self)
    }
}

impl<R: Recipe> TrainStep for TraineeOf<R>
where
    R::Model: ModuleDisplay,
{
    type Input = Pass<R::Batch>;
    type Output = PassReport;

    fn step(&self, pass: Pass<R::Batch>) -> TrainOutput<PassReport> {
        let recipe = &self.course.recipe;
        let mut report = PassReport {
            stage: R::STAGE,
            epoch: pass.epoch,
            step: self.course.steps,
            terms: Vec::new(),
            unread: None,
            items: pass.items,
            share: pass.share,
            times: [pass.epoch_started; 2],
        };
        let shared = self.course.shared.as_ref();
        let private = shared.map(|shared| shared.private(&self.network));
        let network = private.as_ref().unwrap_or(&self.network);
        let grads = match recipe.loss(network, pass.batch, pass.share) {
            Ok(loss) => {
                let terms = loss.terms.without_autodiff();
                self.course.trace(&report, terms.clone());
                report.unread = Some(terms);
                if let Some((shared, private)) = shared.zip(private.as_ref()) {
                    shared.keep(private);
                }
                GradientsParams::from_grads(loss.total.backward(), network)
            }
            Err(error) => {
                self.course.failure.set(error);
                GradientsParams::new()
            }
        };
        report.times[1] = Instant::now();
        TrainOutput {
            grads,
            item: report,
        }
    }

    /// Clips the gradients by their global norm, takes the step and moves the averaged weights.
    fn optimize(
        self,
        optimizer: &mut ModuleOptimizer,
        rate: ModuleLearningRate,
        grads: GradientsParams,
    ) -> Self {
        let (grads, norm) = match clip_gradients(&self.network, grads, self.course.longest) {
            Ok(clipped) => clipped,
            Err(error) => {
                self.course.failure.set(error);
                return self;
            }
        };
        let traces = self.course.take_traces();
        if !norm.is_finite() {
            self.course.refuse_gradient(norm, traces);
            return self;
        }
        let mut norms = self
            .course
            .norms
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        norms.push(norm);
        drop(norms);
        let mut settled = self;
        if let Some(shared) = settled.course.shared.clone() {
            settled.network = shared.settle(&settled.network);
        }
        let mut trained = optimizer.step(rate, settled, grads);
        trained.course.steps += 1;
        if let Some(rule) = trained.course.average {
            let ids: Vec<ParamId> = trained.average.iter().map(|values| values.id).collect();
            let values = rule.update(trained.averages(), &trained.network, trained.course.steps);
            trained.average = ids
                .into_iter()
                .zip(values)
                .map(|(id, values)| Param::initialized(id, Tensor::from_inner(values)))
                .collect();
        }
        trained
    }
}

/// What came of some validation items.
pub struct CheckReport<F> {
    /// The recipe's findings; none after an error.
    pub findings: Option<Arc<F>>,
    /// What to show of them.
    pub shown: Option<Arc<Shown>>,
}

/// What a validation shows.
pub struct Shown {
    /// Optimiser steps taken.
    pub step: u64,
    /// Pictures by tag.
    pub pictures: Vec<(String, RgbImage)>,
    /// Weights by path.
    pub weights: Vec<(String, Vec<f32>)>,
}

impl<F: Send + Sync> ItemLazy for CheckReport<F> {
    fn sync(self) -> Result<Self, ExecutionError> {
        Ok(self)
    }
}

impl<R: Recipe> InferenceStep for TraineeOf<R>
where
    R::Model: ModuleDisplay,
{
    type Input = Check;
    type Output = CheckReport<R::Findings>;

    fn step(&self, check: Check) -> CheckReport<R::Findings> {
        let nothing = CheckReport {
            findings: None,
            shown: None,
        };
        let Some(judge) = self.judge() else {
            return nothing;
        };
        let recipe = &self.course.recipe;
        let examined = recipe.examine(&judge, check.items).and_then(|findings| {
            let shown = if check.shows {
                Some(Arc::new(Shown {
                    step: self.course.steps,
                    pictures: recipe.pictures(&judge)?,
                    weights: named_weights(&self.usable())?,
                }))
            } else {
                None
            };
            Ok(CheckReport {
                findings: Some(Arc::new(findings)),
                shown,
            })
        });
        examined.unwrap_or_else(|error| {
            self.course.failure.set(error);
            nothing
        })
    }
}
