//! The twin-branch ranging network against reference numbers: every block, the result, the loss
//! and its gradients.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "tests panic and report where the library must not"
)]

mod support;

use burn::tensor::{Device, Tensor, TensorData};
use support::fixture::{Fixture, assert_abs, assert_close};
use support::formula::{self, Fill};
use support::{devices, network};
use twinsight::ranging::{RangingConfig, RangingNetwork, ranging_loss};

/// The network that a fixture describes, filled, and its two inputs.
fn network_and_input(
    fixture: &Fixture,
    device: &Device,
) -> (RangingConfig, RangingNetwork, Tensor<4>, Tensor<2>) {
    let shape: [usize; 4] = fixture.meta_sizes("input_shape").try_into().unwrap();
    let [batch, _, height, width] = shape;
    let config = RangingConfig::new(height, width);
    let network = config.init(device).unwrap();
    let network = network::fill(network, &Fill::from_fixture(fixture), str::to_owned);
    let key = fixture.meta_text("image_key");
    let pixels = formula::composite_batch(&key, batch, height, width);
    let composite = Tensor::from_data(TensorData::new(pixels, shape), device);
    let geometry = network::tensor(fixture, "in.size", device);
    (config, network, composite, geometry)
}

/// The features of every block, of the hidden layers, and the result.
fn check_forward(name: &str, device_name: &str, device: &Device) {
    let fixture = Fixture::load(name);
    let (config, network, composite, geometry) = network_and_input(&fixture, device);
    assert_eq!(
        vec![config.features() as i64],
        fixture.i64("out.features_count").1
    );
    let what = |part: &str| format!("{part} of {name} on {device_name}");
    let close = |actual: &[f64], part: &str| {
        let expected = fixture.values(&format!("out.{part}"));
        assert_close(actual, &expected, 1e-4, &what(part));
    };
    let [batch, ..] = composite.dims();
    let features = network.features(composite.clone());
    assert_eq!(features.blocks.len(), 5);
    for (index, block) in features.blocks.iter().enumerate() {
        for (start, pooling) in [(0, "max"), (batch, "avg")] {
            let pathway = block.clone().narrow(0, start, batch);
            close(
                &network::summary(&pathway),
                &format!("sum.block.{index}.{pooling}"),
            );
        }
    }
    close(&network::summary(&features.flat), "sum.features");
    close(&network::summary(&features.fc1), "sum.fc1");
    close(&network::summary(&features.fc2), "sum.fc2");
    let distances = network.forward(composite, geometry);
    assert_eq!(distances.dims(), [batch, 1]);
    let (_, expected) = fixture.f32("out.prediction");
    assert_close(
        &network::values(&distances),
        &expected,
        1e-4,
        &what("prediction"),
    );
}

#[test]
fn the_full_composite_gives_the_reference_distance() {
    check_forward("distance_828x414", "flex", &devices::flex());
}

#[test]
fn two_small_composites_give_the_reference_distances_on_every_device() {
    for (device_name, device) in devices::every() {
        check_forward("distance_340x170_b2", device_name, &device);
    }
}

#[test]
fn three_convolutions_of_the_first_block_are_one_of_seven_by_seven() {
    let fixture = Fixture::load("distance_828x414");
    for (device_name, device) in devices::every() {
        let (_, network, ..) = network_and_input(&fixture, &device);
        let (weight, bias) = network.merged_first_block();
        let (shape, expected) = fixture.f32("out.merged7x7.weight");
        assert_eq!(weight.dims().to_vec(), shape);
        assert_close(&network::values(&weight), &expected, 1e-5, device_name);
        let (_, expected) = fixture.f32("out.merged7x7.bias");
        assert_close(&network::values(&bias), &expected, 1e-5, device_name);
    }
}

/// The loss of near or far targets and its gradients.
fn check_loss(case: &str, device_name: &str, device: &Device) {
    let fixture = Fixture::load("distance_340x170_b2");
    let device = device.clone().autodiff();
    let (_, network, composite, geometry) = network_and_input(&fixture, &device);
    let what = |part: &str| format!("{part} of {case} targets on {device_name}");
    let distances = network.forward(composite, geometry);
    let targets = network::tensor::<1>(&fixture, &format!("in.{case}.target"), &device);
    let loss = ranging_loss(distances, targets.unsqueeze_dim(1));
    let values = [&loss.total, &loss.mse, &loss.msre].map(|loss| network::values(loss)[0]);
    let (_, expected) = fixture.f32(&format!("out.{case}.loss_mse_msre"));
    assert_close(&values, &expected, 1e-4, &what("loss"));

    let gradients = network::gradients(&network, &loss.total.backward(), str::to_owned);
    let names = fixture.meta_texts("param_names");
    assert_eq!(names.len(), gradients.len());
    let norms: Vec<f64> = names
        .iter()
        .map(|name| network::norm(&gradients[name]))
        .collect();
    let expected_norms = fixture.values(&format!("out.{case}.grad_norm_per_param"));
    assert_close(&norms, &expected_norms, 1e-3, &what("gradient norms"));
    let total = norms.iter().map(|norm| norm * norm).sum::<f64>().sqrt();
    let expected = fixture.scalar(&format!("out.{case}.grad_norm_total"));
    assert_close(&[total], &[expected], 1e-3, &what("total gradient norm"));

    let first = fixture.names_after(&format!("out.{case}.grad8."));
    assert!(!first.is_empty());
    for name in first {
        let gradient = &gradients[&name];
        let expected = fixture.values(&format!("out.{case}.grad8.{name}"));
        let norm = names
            .iter()
            .zip(&expected_norms)
            .find(|(n, _)| **n == name)
            .unwrap()
            .1;
        // Nearly tied windows of the maximum pooling may pass their gradient to another pixel.
        let tolerance = 0.02 * norm / (gradient.len() as f64).sqrt();
        assert_abs(
            &gradient[..expected.len()],
            &expected,
            tolerance,
            &what(&name),
        );
    }
}

#[test]
fn near_targets_are_learnt_by_their_relative_error_on_every_device() {
    for (device_name, device) in devices::every() {
        check_loss("near", device_name, &device);
    }
}

#[test]
fn far_targets_are_learnt_by_their_absolute_error() {
    check_loss("far", "flex", &devices::flex());
}
