//! Optimiser steps, averaged weights and learning rates against reference numbers.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "tests panic and report where the library must not"
)]

mod support;

use burn::module::{Module, Param, ParamGroup};
use burn::optim::decay::WeightDecayConfig;
use burn::optim::momentum::MomentumConfig;
use burn::optim::{GradientsParams, ModuleOptimizer, SgdConfig};
use burn::tensor::{Device, Tensor, TensorData};
use support::fixture::{Fixture, assert_abs, assert_close};
use support::{devices, network};
use twinsight::detector::Yolo11;
use twinsight::detector::decode::Anchors;
use twinsight::detector::loss::{LossGains, detection_loss};
use twinsight::detector::weights::tensor_name;
use twinsight::train::optimizer::{
    AverageRule, clip_gradients, detector_optimizer, distance_optimizer, ema_decay, flat_values,
    schedule_factor, warmed_up, with_values,
};
use twinsight::train::{OptimizerKind, Schedule};
use twinsight::weights::StateDict;

/// The reference's averaging.
const AVERAGE: AverageRule = AverageRule {
    longest: 0.9999,
    ramp: 2000.0,
};

/// One weight, so named that it belongs to the group with weight decay.
#[derive(Module, Debug)]
struct One<const D: usize> {
    weight: Param<Tensor<D>>,
}

impl<const D: usize> One<D> {
    fn new(values: &[f32], shape: [usize; D], device: &Device) -> Self {
        let tensor = Tensor::from_data(TensorData::new(values.to_vec(), shape), device);
        Self {
            weight: Param::from_tensor(tensor),
        }
    }
}

/// Follows an optimiser through the fixture's gradients.
fn check_optimizer(name: &str, rate: f64, mut optimizer: ModuleOptimizer) {
    let fixture = Fixture::load("optim");
    let device = devices::flex().autodiff();
    let (_, start) = fixture.f32(&format!("{name}.init"));
    let (shape, grads) = fixture.f32(&format!("{name}.grads"));
    let (_, expected) = fixture.f32(&format!("{name}.values"));
    let shape = [shape[1], shape[2]];
    let count = shape[0] * shape[1];
    let mut module = One::new(&start, shape, &device);
    for (step, (grad, expected)) in grads
        .chunks_exact(count)
        .zip(expected.chunks_exact(count))
        .enumerate()
    {
        let mut params = GradientsParams::new();
        let grad = TensorData::new(grad.to_vec(), shape);
        params.register(
            module.weight.id,
            Tensor::<2>::from_data(grad, &devices::flex()),
        );
        module = optimizer.step(rate, module, params);
        let values = network::values(&module.weight.val());
        assert_abs(&values, expected, 1e-6, &format!("{name}, step {step}"));
    }
}

#[test]
fn the_distance_networks_adam_takes_the_reference_steps() {
    check_optimizer("adam", 0.001, distance_optimizer(OptimizerKind::Adam));
}

#[test]
fn the_detectors_adam_takes_the_reference_steps_with_weight_decay() {
    check_optimizer(
        "adam_ultra",
        0.001,
        detector_optimizer(OptimizerKind::Adam, 5e-4, None).unwrap(),
    );
}

#[test]
fn stochastic_gradient_descent_takes_the_reference_steps() {
    let sgd = detector_optimizer(OptimizerKind::Sgd, 5e-4, None).unwrap();
    check_optimizer("sgd", 0.01, sgd);
}

#[test]
fn the_warm_up_follows_the_reference() {
    let fixture = Fixture::load("optim");
    let (_, iterations) = fixture.i64("warmup.ni");
    let (_, expected) = fixture.f64("warmup.bias_lr_other_lr_momentum_accumulate_f64");
    // The fixture's parameters; rates change by whole epochs there.
    let (rate, first_bias_rate, steps, steps_per_epoch) = (0.01, 0.1, 150.0, 50);
    for (&iteration, expected) in iterations.iter().zip(expected.chunks_exact(4)) {
        let epoch = (iteration / steps_per_epoch) as f64;
        let full = rate * schedule_factor(Schedule::Linear, epoch, 100.0, 0.01);
        let at = |first, last| warmed_up(first, last, iteration as f64, steps);
        // The last column, how many batches make a step, is a setting here (batch, micro_batch).
        let values = [at(first_bias_rate, full), at(0.0, full), at(0.8, 0.937)];
        assert_abs(
            &values,
            &expected[..3],
            1e-9,
            &format!("iteration {iteration}"),
        );
    }
}

#[test]
fn averaged_weights_follow_the_reference() {
    let fixture = Fixture::load("optim");
    let updates = fixture.i64("ema.updates").1;
    let decays: Vec<f64> = updates
        .iter()
        .map(|&update| ema_decay(0.9999, 2000.0, update as u64))
        .collect();
    assert_abs(&decays, &fixture.f64("ema.decay_f64").1, 1e-12, "decay");

    let device = devices::flex();
    let (_, start) = fixture.f32("ema.start");
    let (_, models) = fixture.f32("ema.model");
    let (_, averages) = fixture.f64("ema.average_f64");
    let mut values = flat_values(&One::new(&start, [4], &device));
    let steps = models.chunks_exact(4).zip(averages.chunks_exact(4));
    for (update, (model, expected)) in (1..).zip(steps) {
        let model = One::new(model, [4], &device);
        values = AVERAGE.update(values, &model, update);
        let values = network::values(&with_values(model, &values).weight.val());
        assert_abs(&values, expected, 1e-6, "averaged weights");
    }
}

#[test]
fn learning_rates_fall_as_in_the_reference() {
    let fixture = Fixture::load("optim");
    let (_, epochs) = fixture.i64("lr.epoch");
    for (schedule, name) in [
        (Schedule::Linear, "lr.linear_f64"),
        (Schedule::Cosine, "lr.cosine_f64"),
    ] {
        let factors: Vec<f64> = epochs
            .iter()
            .map(|&epoch| schedule_factor(schedule, epoch as f64, 100.0, 0.01))
            .collect();
        assert_abs(&factors, &fixture.f64(name).1, 1e-9, name);
    }
}

/// The first numbers of some tensors, by name.
fn check_first(fixture: &Fixture, prefix: &str, model: &Yolo11) {
    let state = StateDict::of(model, tensor_name);
    for name in fixture.names_after(prefix) {
        let (_, expected) = fixture.f32(&format!("{prefix}{name}"));
        let values = &state.tensors[&name].1[..expected.len()];
        assert_close(values, &expected, 1e-4, &format!("{prefix}{name}"));
    }
}

#[test]
fn three_clipped_steps_through_the_network_end_at_the_reference_weights_and_statistics() {
    let fixture = Fixture::load("loss_net_n_nc1_train");
    let device = devices::flex().autodiff();
    let shape = fixture.meta_sizes("input_shape");
    let extent = [shape[0], shape[2], shape[3]];
    let mut targets = network::targets(&fixture, extent);
    // As in the test of the gradients: one predicted edge lies on its target's edge to within
    // rounding, where the overlap's gradient jumps.
    targets[0].targets[1].box_letterbox[0] += 0.004;
    let anchors = Anchors::new(extent[1], extent[2]);
    let input = network::detector_input(&fixture, &device);
    let mut model = network::detector(&fixture, &device);
    let mut average = flat_values(&model);
    let mut updates = 0;
    let momentum = MomentumConfig::new()
        .with_momentum(0.9)
        .with_dampening(0.0)
        .with_nesterov(true);
    let sgd = SgdConfig::new().with_momentum(Some(momentum));
    let decay = WeightDecayConfig::new(5e-4);
    let mut optimizer = sgd
        .clone()
        .with_weight_decay(Some(decay))
        .init()
        .with_group(
            ParamGroup::from_regex(r"(gamma|beta|bias)$").unwrap(),
            sgd.build(),
            None,
        );

    let mut items = Vec::new();
    let mut norms = Vec::new();
    for step in 0..4 {
        let output = model.forward(input.clone()).flatten();
        let loss = detection_loss(&output, &targets, &anchors, LossGains::default()).unwrap();
        items.extend(
            loss.items
                .iter()
                .map(|item| item.clone().into_scalar::<f32>()),
        );
        if step == 3 {
            break;
        }
        let grads = GradientsParams::from_grads(loss.total.backward(), &model);
        let (grads, norm) = clip_gradients(&model, grads, 10.0).unwrap();
        norms.push(norm);
        model = optimizer.step(0.001, model, grads);
        updates += 1;
        average = AVERAGE.update(average, &model, updates);
    }
    assert_close(
        &items,
        &fixture.f32("out.steps.loss_items").1,
        5e-3,
        "losses",
    );
    let expected = fixture.f32("out.steps.grad_norm_before_clip").1;
    assert_close(&norms, &expected, 5e-3, "gradient norms");
    check_first(&fixture, "out.steps.param4.", &model);
    check_first(
        &fixture,
        "out.steps.ema4.",
        &with_values(model.valid(), &average),
    );
    let state = StateDict::of(&model, tensor_name);
    for (name, tensor) in [("bn_mean", "running_mean"), ("bn_var", "running_var")] {
        let values = &state.tensors[&format!("model.0.bn.{tensor}")].1;
        let expected = fixture.f32(&format!("out.steps.{name}.model.0.bn")).1;
        assert_close(values, &expected, 1e-4, name);
    }
}
