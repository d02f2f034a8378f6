//! What happens around an optimiser step: averaged weights and clipping by the global norm.

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param, ParamGroup};
use burn::optim::decay::WeightDecayConfig;
use burn::optim::{AdamConfig, AdamWConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::Tensor;

use super::config::{OptimizerKind, Schedule};
pub use super::sgd::MomentumWarmup;
use super::sgd::WarmedSgd;
use crate::error::{Error, Result};

/// Adam's guard against division by zero.
const ADAM_EPSILON: f32 = 1e-8;

/// Adam's first decay rate, or the momentum, with which YOLO11 is trained.
const DETECTOR_MOMENTUM: f64 = 0.937;
/// The usual one, with which the paper's network is trained.
const DISTANCE_MOMENTUM: f64 = 0.9;

/// The detector's optimiser: moments decay at 0.937 and 0.999 (Adam), the momentum is 0.937 (SGD)
/// after its warm-up, and weight decay reaches convolution weights, not normalisation and biases.
///
/// # Errors
/// Never in practice: the group's pattern is constant.
pub fn detector_optimizer(
    kind: OptimizerKind,
    weight_decay: f64,
    warmup: Option<MomentumWarmup>,
) -> Result<ModuleOptimizer> {
    let plain = parameter_group("(gamma|beta|bias)$")?;
    let momentum = DETECTOR_MOMENTUM;
    Ok(match kind {
        OptimizerKind::Adam => {
            adam(momentum, weight_decay)
                .init()
                .with_group(plain, adam(momentum, 0.0).build(), None)
        }
        OptimizerKind::AdamW => adam_w(momentum, weight_decay).init().with_group(
            plain,
            adam_w(momentum, 0.0).build(),
            None,
        ),
        OptimizerKind::Sgd => {
            let sgd = |decay| WarmedSgd::new(momentum, warmup, decay);
            let decay = decay(weight_decay);
            ModuleOptimizer::from(sgd(decay.as_ref())).with_group(plain, sgd(None), None)
        }
    })
}

/// The distance network's optimiser: moments decay at 0.9 and 0.999 as in the paper (Adam), the
/// momentum is 0.9 (SGD), and nothing decays the weights.
pub fn distance_optimizer(kind: OptimizerKind) -> ModuleOptimizer {
    match kind {
        OptimizerKind::Adam => adam(DISTANCE_MOMENTUM, 0.0).init(),
        OptimizerKind::AdamW => adam_w(DISTANCE_MOMENTUM, 0.0).init(),
        OptimizerKind::Sgd => WarmedSgd::new(DISTANCE_MOMENTUM, None, None).into(),
    }
}

/// The parameters whose paths fit a pattern.
///
/// # Errors
/// A pattern that does not compile.
pub fn parameter_group(pattern: &str) -> Result<ParamGroup> {
    ParamGroup::from_regex(pattern).map_err(|source| {
        Error::training(
            format!("the parameter groups do not compile: {source:?}"),
            "report this as a defect",
        )
    })
}

/// Decay that is not there costs nothing, and adds nothing to a gradient.
fn decay(weight_decay: f64) -> Option<WeightDecayConfig> {
    (weight_decay > 0.0).then(|| WeightDecayConfig::new(weight_decay as f32))
}

fn adam(momentum: f64, weight_decay: f64) -> AdamConfig {
    AdamConfig::new()
        .with_beta_1(momentum as f32)
        .with_beta_2(0.999)
        .with_epsilon(ADAM_EPSILON)
        .with_weight_decay(decay(weight_decay))
}

fn adam_w(momentum: f64, weight_decay: f64) -> AdamWConfig {
    AdamWConfig::new()
        .with_beta_1(momentum as f32)
        .with_beta_2(0.999)
        .with_epsilon(ADAM_EPSILON)
        .with_weight_decay(weight_decay as f32)
}

/// Freezes every parameter whose module path starts with one of the names, running statistics
/// included.
///
/// # Errors
/// A name that fits no parameter, or names that leave nothing to train.
pub fn freeze<M: Module>(module: M, setting: &str, names: &[String]) -> Result<M> {
    let mut module = module;
    for name in names {
        let pattern = format!("^{}(\\.|$)", name.replace('.', "\\."));
        let group = ParamGroup::from_regex(&pattern);
        let paths = parameter_paths(&module);
        let fits = |path: &String| path.strip_prefix(name.as_str()).is_some_and(is_boundary);
        let group = match group {
            Ok(group) if paths.iter().any(fits) => group,
            _ => {
                let mut parts: Vec<&str> = paths
                    .iter()
                    .filter_map(|path| path.split('.').next())
                    .collect();
                parts.dedup();
                return Err(Error::value(
                    format!("{setting}: {name}"),
                    "there is no such part",
                    format!("give some of {}", parts.join(", ")),
                ));
            }
        };
        module = module.freeze_group(group);
    }
    if !names.is_empty() && !is_trainable(&module) {
        return Err(Error::value(
            setting.to_owned(),
            "freezes every part, so that there is nothing to train",
            "leave at least one part out",
        ));
    }
    Ok(module)
}

/// Whether any parameter still takes gradients.
fn is_trainable<M: Module>(module: &M) -> bool {
    struct Any(bool);
    impl ModuleVisitor for Any {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            self.0 |= param.val().is_require_grad();
        }
    }
    let mut any = Any(false);
    module.visit(&mut any);
    any.0
}

fn is_boundary(rest: &str) -> bool {
    rest.is_empty() || rest.starts_with('.')
}

/// The paths of all floating parameters, such as `layer0.conv.weight`.
fn parameter_paths<M: Module>(module: &M) -> Vec<String> {
    struct Paths {
        stack: Vec<String>,
        found: Vec<String>,
    }
    impl ModuleVisitor for Paths {
        fn visit_float<const D: usize>(&mut self, _: &Param<Tensor<D>>) {
            self.found.push(self.stack.join("."));
        }
        fn enter_module(&mut self, name: &str, _: &str) {
            self.stack.push(name.to_owned());
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.stack.pop();
        }
    }
    let mut paths = Paths {
        stack: Vec::new(),
        found: Vec::new(),
    };
    module.visit(&mut paths);
    paths.found
}

/// Factor of the learning rate after so many epochs (fractions allowed) of `epochs`.
pub fn schedule_factor(schedule: Schedule, epoch: f64, epochs: f64, last: f64) -> f64 {
    match schedule {
        Schedule::Linear => (1.0 - epoch / epochs).max(0.0) * (1.0 - last) + last,
        Schedule::Cosine => {
            1.0 + (last - 1.0) * (1.0 - (std::f64::consts::PI * epoch / epochs).cos()) / 2.0
        }
    }
}

/// A value of the warm-up, which goes in a straight line from `first` to `last` over so many steps
/// (yolo11.md, section 8.2).
pub fn warmed_up(first: f64, last: f64, step: f64, steps: f64) -> f64 {
    let share = if steps > 0.0 {
        (step / steps).min(1.0)
    } else {
        1.0
    };
    first + (last - first) * share
}

/// Decay of the averaged weights at update number `update` (from 1): short at first.
pub fn ema_decay(longest: f64, ramp: f64, update: u64) -> f64 {
    longest * (1.0 - (-(update as f64) / ramp).exp())
}

/// How averaged weights follow a network (yolo11.md, section 8.3).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AverageRule {
    /// Decay after many updates.
    pub longest: f64,
    /// Updates over which the decay rises.
    pub ramp: f64,
}

impl AverageRule {
    /// Moves averages, those of [`flat_values`] at first, towards a module's present weights; updates
    /// count from 1.
    pub fn update<M: Module>(
        self,
        averages: Vec<Tensor<1>>,
        module: &M,
        update: u64,
    ) -> Vec<Tensor<1>> {
        let decay = ema_decay(self.longest, self.ramp, update);
        let values = averages.into_iter().zip(flat_values(module));
        values
            .map(|(average, value)| {
                // In this form the average of what never changes stays what it is, to the bit.
                average.clone() + (value - average).mul_scalar(1.0 - decay)
            })
            .collect()
    }
}

/// A module with other floating tensors, running statistics included: those of [`flat_values`].
pub fn with_values<M: Module>(module: M, values: &[Tensor<1>]) -> M {
    struct Fill<'a>(std::slice::Iter<'a, Tensor<1>>);
    impl ModuleMapper for Fill<'_> {
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            match self.0.next() {
                Some(value) => param.map(|tensor| value.clone().reshape(tensor.dims())),
                None => param,
            }
        }
    }
    module.map(&mut Fill(values.iter()))
}

/// The weights of a module by their paths, biases and normalisation left out.
///
/// # Errors
/// A device that fails.
pub fn named_weights<M: Module>(module: &M) -> Result<Vec<(String, Vec<f32>)>> {
    let named = parameter_paths(module).into_iter().zip(flat_values(module));
    named
        .filter(|(path, _)| path.ends_with("weight"))
        .map(|(path, tensor)| {
            let values = tensor
                .try_into_vec_as::<f32>()
                .map_err(|source| Error::training(source.to_string(), "try another device"))?;
            Ok((path, values))
        })
        .collect()
}

/// Every floating tensor, flattened and free of autodiff, in the order of traversal.
pub fn flat_values<M: Module>(module: &M) -> Vec<Tensor<1>> {
    struct Collect(Vec<Tensor<1>>);
    impl ModuleVisitor for Collect {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let tensor = param.val().without_autodiff();
            let count = tensor.shape().num_elements();
            self.0.push(tensor.reshape([count]));
        }
    }
    let mut collect = Collect(Vec::new());
    // A network in training keeps its latest running statistics aside; its copy has them.
    module.valid().visit(&mut collect);
    collect.0
}

/// Draws every lazily initialised parameter now, so that it depends on the seed alone.
pub fn initialize<M: Module>(module: &M) {
    flat_values(module);
}

/// Scales all gradients so that their global L2 norm is at most `longest`, and returns the norm
/// before: all of them are multiplied by `min(1, longest / (norm + 1e-6))`.
///
/// # Errors
/// Gradients that cannot be read back from the device.
pub fn clip_gradients<M: Module>(
    module: &M,
    grads: GradientsParams,
    longest: f64,
) -> Result<(GradientsParams, f64)> {
    struct Squares<'a> {
        grads: &'a GradientsParams,
        sums: Vec<Tensor<1>>,
    }
    impl ModuleVisitor for Squares<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(grad) = self.grads.get::<D>(param.id) {
                self.sums.push(grad.square().sum());
            }
        }
    }
    struct Scale {
        grads: GradientsParams,
        factor: f64,
    }
    impl ModuleVisitor for Scale {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(grad) = self.grads.remove::<D>(param.id) {
                self.grads.register(param.id, grad.mul_scalar(self.factor));
            }
        }
    }
    let mut squares = Squares {
        grads: &grads,
        sums: Vec::new(),
    };
    module.visit(&mut squares);
    if squares.sums.is_empty() {
        return Ok((grads, 0.0));
    }
    let norm = scalar(&Tensor::cat(squares.sums, 0).sum())?.sqrt();
    let factor = (longest / (norm + 1e-6)).min(1.0);
    if factor >= 1.0 {
        return Ok((grads, norm));
    }
    let mut scale = Scale { grads, factor };
    module.visit(&mut scale);
    Ok((scale.grads, norm))
}

/// Reads one number back from the device.
///
/// # Errors
/// A device that fails.
pub fn scalar(tensor: &Tensor<1>) -> Result<f64> {
    tensor.clone().try_into_scalar::<f64>().map_err(|source| {
        Error::training(
            format!("cannot read a number back from the device: {source}"),
            "try a smaller batch or another device",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::DenseConfig;
    use burn::tensor::Device;

    #[test]
    fn both_schedules_start_at_one_and_end_at_the_last_rate() {
        for schedule in [Schedule::Linear, Schedule::Cosine] {
            assert!((schedule_factor(schedule, 0.0, 30.0, 0.01) - 1.0).abs() < 1e-12);
            assert!((schedule_factor(schedule, 30.0, 30.0, 0.01) - 0.01).abs() < 1e-12);
        }
    }

    #[test]
    fn clipping_brings_the_global_norm_to_the_limit_and_leaves_short_gradients_alone() {
        let device = Device::flex().autodiff();
        let layer = DenseConfig::new(3, 2).init(&device);
        let grads = |factor: f64| {
            let input = Tensor::<2>::full([4, 3], factor, &device);
            let loss = layer.forward(input).sum();
            GradientsParams::from_grads(loss.backward(), &layer)
        };
        let (clipped, before) = clip_gradients(&layer, grads(100.0), 1.0).unwrap();
        assert!(before > 1.0);
        let (_, after) = clip_gradients(&layer, clipped, 1e9).unwrap();
        assert!((after - 1.0).abs() < 1e-5, "{after}");
        let (_, short) = clip_gradients(&layer, grads(0.0), 10.0).unwrap();
        assert!((short - 4.0 * 2.0_f64.sqrt()).abs() < 1e-5, "{short}");
    }

    #[test]
    fn averaged_weights_of_a_still_module_are_the_module() {
        let device = Device::flex();
        let layer = DenseConfig::new(3, 2).init(&device);
        let rule = AverageRule {
            longest: 0.9,
            ramp: 10.0,
        };
        let averages = rule.update(flat_values(&layer), &layer, 1);
        let difference = (with_values(layer.clone(), &averages).weight.val() - layer.weight.val())
            .abs()
            .max();
        assert!(difference.into_scalar::<f32>() < 1e-6);
    }
}
