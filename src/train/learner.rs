//! A network in training with its optimiser and averaged weights: what a step changes.

use std::time::Instant;

use burn::module::Module;
use burn::optim::{GradientsAccumulator, GradientsParams, ModuleOptimizer};

use super::checkpoint::{StageFolder, StageState};
use super::optimizer::{AveragedWeights, clip_gradients, initialize};
use super::stage::{Recipe, Steering};
use crate::error::{Error, Result};

/// What a step changes.
pub struct Learner<M> {
    /// The network.
    pub model: M,
    /// What turns its gradients into steps.
    pub optimizer: ModuleOptimizer,
    /// Its averaged weights, where they are averaged.
    pub average: Option<AveragedWeights>,
}

/// What came of a step.
#[derive(Debug)]
pub struct StepOutcome {
    /// Mean loss over the items.
    pub loss: f64,
    /// Mean of the recipe's further terms.
    pub terms: Vec<f64>,
    /// Global norm of the gradients before they were clipped.
    pub gradient_norm: f64,
}

/// Why a step was not taken.
#[derive(Debug)]
pub enum StepError {
    /// The loss of these items is not a finite number.
    NotFinite(f64, Vec<usize>),
    /// Anything else.
    Other(Error),
}

impl From<Error> for StepError {
    fn from(error: Error) -> Self {
        Self::Other(error)
    }
}

impl<M: Module> Learner<M> {
    /// A network before its first step.
    pub fn new(model: M, optimizer: ModuleOptimizer, steering: &Steering) -> Self {
        initialize(&model);
        let average = steering
            .average
            .map(|(decay, ramp)| AveragedWeights::new(&model, decay, ramp));
        Self {
            model,
            optimizer,
            average,
        }
    }

    /// The network as a stopped run left it.
    ///
    /// # Errors
    /// Files that cannot be read or do not fit.
    pub fn restored(
        self,
        folder: &StageFolder,
        steering: &Steering,
        state: &StageState,
    ) -> Result<Self> {
        let shadow = self.average.as_ref().map(|a| a.module(&self.model));
        let (model, shadow, optimizer) = folder.load(self.model, shadow, self.optimizer)?;
        let average = steering.average.zip(shadow).map(|((decay, ramp), shadow)| {
            let mut average = AveragedWeights::new(&shadow, decay, ramp);
            average.updates = state.ema_updates;
            average
        });
        Ok(Self {
            model,
            optimizer,
            average,
        })
    }

    /// An inference copy: with the averaged weights where there are some.
    pub fn usable(&self) -> M {
        match &self.average {
            Some(average) => average.module(&self.model),
            None => self.model.valid(),
        }
    }

    /// One optimiser step on a batch of items; `next` gives the batch's passes one by one, loaded.
    ///
    /// # Errors
    /// A loss that is not finite, items that cannot be loaded, a device that fails.
    pub fn step<R: Recipe<Model = M>>(
        &mut self,
        recipe: &R,
        steering: &Steering,
        learning_rate: f64,
        batch: &[usize],
        mut next: impl FnMut() -> Result<R::Batch>,
    ) -> std::result::Result<StepOutcome, StepError> {
        let mut accumulator = GradientsAccumulator::new();
        let mut outcome = StepOutcome {
            loss: 0.0,
            terms: Vec::new(),
            gradient_norm: 0.0,
        };
        for items in batch.chunks(steering.micro_batch) {
            let share = items.len() as f64 / batch.len() as f64;
            let pass = recipe.loss(&self.model, next()?, share)?;
            if !pass.reported.is_finite() {
                return Err(StepError::NotFinite(pass.reported, items.to_vec()));
            }
            outcome.loss += share * pass.reported;
            outcome.terms.resize(pass.terms.len(), 0.0);
            for (sum, term) in outcome.terms.iter_mut().zip(&pass.terms) {
                *sum += share * term;
            }
            let grads = GradientsParams::from_grads(pass.total.backward(), &self.model);
            accumulator.accumulate(&self.model, grads);
        }
        let longest = steering.clip_norm.unwrap_or(f64::INFINITY);
        let (grads, norm) = clip_gradients(&self.model, accumulator.grads(), longest)?;
        outcome.gradient_norm = norm;
        self.model = self
            .optimizer
            .step(learning_rate, self.model.clone(), grads);
        if let Some(average) = &mut self.average {
            average.update(&self.model);
        }
        Ok(outcome)
    }

    /// Seconds of a step with data that is loaded beforehand, and of loading its data: the least of
    /// a few. The network is changed by them.
    ///
    /// # Errors
    /// As [`Learner::step`].
    pub fn time_step<R: Recipe<Model = M>>(
        &mut self,
        recipe: &R,
        steering: &Steering,
    ) -> Result<[f64; 2]> {
        const ROUNDS: usize = 3;
        let items: Vec<usize> = (0..recipe.items().min(steering.batch)).collect();
        let mut least = [f64::INFINITY; 2];
        for _ in 0..ROUNDS {
            let started = Instant::now();
            let mut passes = Vec::new();
            for items in items.chunks(steering.micro_batch) {
                passes.push(recipe.load(0, items)?);
            }
            let loading = started.elapsed().as_secs_f64();
            let mut passes = passes.into_iter();
            let started = Instant::now();
            let step = self.step(recipe, steering, 0.0, &items, || {
                passes
                    .next()
                    .ok_or_else(|| Error::training("a pass is missing", "report this as a defect"))
            });
            step.map_err(|error| match error {
                StepError::Other(error) => error,
                StepError::NotFinite(loss, _) => Error::training(
                    format!("the first loss is {loss}"),
                    "start from other weights",
                ),
            })?;
            let stepping = started.elapsed().as_secs_f64();
            least = [least[0].min(stepping), least[1].min(loading)];
        }
        Ok(least)
    }
}
