//! Nesterov's momentum that rises over the first steps.

use burn::optim::decay::{WeightDecay, WeightDecayConfig};
use burn::optim::momentum::{Momentum, MomentumConfig, MomentumState};
use burn::optim::{LearningRate, Optimizer, RecordState, StateSink, StateSource, join_path};
use burn::tensor::{Device, Tensor};

use super::optimizer::warmed_up;

/// Names in an optimiser's record.
const VELOCITY: &str = "momentum";
const UPDATES: &str = "updates";

/// How momentum rises from its first value to its own, in a straight line (yolo11.md, section 8.2).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MomentumWarmup {
    /// Momentum of the first step.
    pub first: f64,
    /// Steps over which it rises.
    pub steps: f64,
}

/// Stochastic gradient descent with Nesterov's momentum, without the dampening that Burn adds, with
/// L2 decay added to the gradient.
///
/// Burn's own has one momentum for all steps.
#[derive(Clone)]
pub struct WarmedSgd {
    momentum: f64,
    warmup: Option<MomentumWarmup>,
    weight_decay: Option<WeightDecay>,
}

impl WarmedSgd {
    /// With this momentum after the warm-up.
    pub fn new(
        momentum: f64,
        warmup: Option<MomentumWarmup>,
        decay: Option<&WeightDecayConfig>,
    ) -> Self {
        Self {
            momentum,
            warmup,
            weight_decay: decay.map(WeightDecay::new),
        }
    }

    /// The momentum of a parameter's update, counted from 0.
    fn momentum(&self, update: u64) -> f64 {
        self.warmup.map_or(self.momentum, |warmup| {
            // As the rates: that of the step's end.
            let step = (update + 1) as f64;
            warmed_up(warmup.first, self.momentum, step, warmup.steps)
        })
    }
}

/// A parameter's velocity and its updates so far.
#[derive(Clone)]
pub struct WarmedSgdState<const D: usize> {
    velocity: MomentumState<D>,
    updates: u64,
}

impl Optimizer for WarmedSgd {
    type State<const D: usize> = WarmedSgdState<D>;

    fn step<const D: usize>(
        &self,
        rate: LearningRate,
        tensor: Tensor<D>,
        grad: Tensor<D>,
        state: Option<WarmedSgdState<D>>,
    ) -> (Tensor<D>, Option<WarmedSgdState<D>>) {
        let (velocity, updates) = state.map_or((None, 0), |s| (Some(s.velocity), s.updates));
        let grad = match &self.weight_decay {
            Some(decay) => decay.transform(grad, tensor.clone()),
            None => grad,
        };
        let momentum = Momentum::new(&MomentumConfig {
            momentum: self.momentum(updates),
            dampening: 0.0,
            nesterov: true,
        });
        let (grad, velocity) = momentum.transform(grad, velocity);
        let state = WarmedSgdState {
            velocity,
            updates: updates + 1,
        };
        (tensor - grad.mul_scalar(rate), Some(state))
    }

    fn to_device<const D: usize>(state: WarmedSgdState<D>, device: &Device) -> WarmedSgdState<D> {
        WarmedSgdState {
            velocity: state.velocity.to_device(device),
            updates: state.updates,
        }
    }
}

impl<const D: usize> RecordState for WarmedSgdState<D> {
    fn state_flatten(&self, prefix: &str, out: &mut StateSink) {
        self.velocity
            .state_flatten(&join_path(prefix, VELOCITY), out);
        out.push_scalar(prefix, UPDATES, self.updates.into());
    }

    fn state_unflatten(prefix: &str, source: &mut StateSource, device: &Device) -> Option<Self> {
        let path = join_path(prefix, VELOCITY);
        Some(Self {
            velocity: MomentumState::state_unflatten(&path, source, device)?,
            updates: source.take_scalar(prefix, UPDATES)?.try_into().ok()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::{Dense, DenseConfig};
    use burn::module::Module as _;
    use burn::optim::{GradientsParams, ModuleOptimizer};

    const WARMUP: MomentumWarmup = MomentumWarmup {
        first: 0.8,
        steps: 4.0,
    };

    fn optimizer() -> ModuleOptimizer {
        ModuleOptimizer::from(WarmedSgd::new(0.937, Some(WARMUP), None))
    }

    /// A step with a gradient of one everywhere.
    fn step(optimizer: &mut ModuleOptimizer, layer: Dense) -> Dense {
        let sum = layer.weight.val().sum() + layer.bias.val().sum();
        let grads = GradientsParams::from_grads(sum.backward(), &layer);
        optimizer.step(0.1, layer, grads)
    }

    fn first(layer: &Dense) -> f64 {
        let weight = layer.weight.val().without_autodiff();
        weight.try_into_vec_as::<f64>().unwrap()[0]
    }

    #[test]
    fn the_momentum_rises_in_a_straight_line_and_stays() {
        let momenta: Vec<f64> = (0..6)
            .map(|update| WarmedSgd::new(0.9, Some(WARMUP), None).momentum(update))
            .collect();
        for (momentum, expected) in momenta.iter().zip([0.825, 0.85, 0.875, 0.9, 0.9, 0.9]) {
            assert!((momentum - expected).abs() < 1e-12, "{momenta:?}");
        }
    }

    #[test]
    fn steps_follow_nesterovs_rule_with_the_rising_momentum() {
        let mut layer = DenseConfig::new(2, 2).init(&Device::flex().autodiff());
        let mut optimizer = optimizer();
        let (mut weight, mut velocity) = (first(&layer), 0.0);
        for update in 0..6 {
            layer = step(&mut optimizer, layer);
            let risen = ((f64::from(update) + 1.0) / 4.0).min(1.0);
            let momentum = 0.8 + 0.137 * risen;
            velocity = momentum * velocity + 1.0;
            weight -= 0.1 * (1.0 + momentum * velocity);
            assert!((first(&layer) - weight).abs() < 1e-5, "update {update}");
        }
    }

    #[test]
    fn a_restored_optimiser_goes_on_where_the_saved_one_was() {
        let device = Device::flex().autodiff();
        let mut saved = optimizer();
        let mut layer = DenseConfig::new(2, 2).init(&device);
        for _ in 0..2 {
            layer = step(&mut saved, layer);
        }
        let bytes = saved.clone().into_bytes().unwrap();
        let mut restored = optimizer().from_bytes(bytes).unwrap();
        let other = layer.clone();
        let (a, b) = (step(&mut saved, layer), step(&mut restored, other));
        assert_eq!(first(&a), first(&b));
        assert_eq!(a.num_params(), 6);
    }
}
