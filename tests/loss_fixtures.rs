//! The detector's loss against reference numbers: assignment, terms and gradients, from given
//! head outputs and through the whole network.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "tests panic and report where the library must not"
)]

mod support;

use std::collections::BTreeMap;

use burn::tensor::{Device, Tensor};
use support::fixture::{Fixture, assert_abs, assert_close};
use support::network::Extent;
use support::{devices, network};
use twinsight::detector::assign::complete_iou;
use twinsight::detector::decode::{Anchors, expected_sides};
use twinsight::detector::loss::{DetectionLoss, ImageTargets, LossGains, detection_loss};
use twinsight::detector::weights::tensor_name;
use twinsight::detector::{FlatOutput, Yolo11};

/// The predicted boxes, edges in pixels, image by image and anchor by anchor.
fn predicted_boxes(output: &FlatOutput, anchors: &Anchors) -> Vec<[f64; 4]> {
    let sides = network::values(&expected_sides(output.boxes.clone()));
    let count = anchors.len();
    let images = sides.chunks_exact(4 * count);
    images
        .flat_map(|sides| {
            (0..count).map(|anchor| {
                let [x, y] = anchors.points_grid[anchor].map(f64::from);
                let side = |index: usize| f64::from(sides[index * count + anchor]);
                let edges = [x - side(0), y - side(1), x + side(2), y + side(3)];
                edges.map(|edge| edge * f64::from(anchors.strides[anchor]))
            })
        })
        .collect()
}

/// Compares everything but gradients; returns what to differentiate.
fn check_loss(
    fixture: &Fixture,
    output: &FlatOutput,
    targets: &[ImageTargets],
    [batch, height, width]: Extent,
    tolerance: f64,
    what: &str,
) -> Tensor<1> {
    let [_, classes, _] = output.scores.dims();
    let anchors = Anchors::new(height, width);
    let loss = detection_loss(output, targets, &anchors, LossGains::default()).unwrap();
    let DetectionLoss {
        total,
        items,
        positives,
        weight_sum,
    } = loss;
    let close = |actual: &[f64], name: &str| {
        let expected = fixture.values(&format!("out.{name}"));
        assert_close(actual, &expected, tolerance, &format!("{name} of {what}"));
    };

    // Which anchors learn which targets: exactly.
    let rows: Vec<_> = positives
        .iter()
        .enumerate()
        .flat_map(|(image, positives)| positives.iter().map(move |positive| (image, *positive)))
        .collect();
    let exact = |name: &str, actual: Vec<usize>| {
        let (_, expected) = fixture.i64(&format!("out.{name}"));
        let actual: Vec<i64> = actual.into_iter().map(|n| n as i64).collect();
        assert_eq!(actual, expected, "{name} of {what}");
    };
    exact("fg_image", rows.iter().map(|(image, _)| *image).collect());
    exact("fg_anchor", rows.iter().map(|(_, p)| p.anchor).collect());
    exact("fg_gt_index", rows.iter().map(|(_, p)| p.target).collect());

    // How strongly they learn them.
    let weights: Vec<f64> = rows.iter().map(|(_, p)| p.weight).collect();
    close(&weights, "fg_weight");
    let mut per_image = vec![0.0; batch];
    let mut per_class = vec![0.0; classes];
    for (image, positive) in &rows {
        per_image[*image] += positive.weight;
        per_class[targets[*image].targets[positive.target].class] += positive.weight;
    }
    close(&per_image, "target_scores_sum_per_image");
    close(&per_class, "target_scores_per_class");
    close(&[weight_sum], "target_scores_sum");

    // Boxes and their overlap.
    let predicted = predicted_boxes(output, &anchors);
    close(&predicted.concat(), "pred_boxes_xyxy_px");
    let assigned: Vec<_> = rows
        .iter()
        .map(|(image, p)| targets[*image].targets[p.target].box_letterbox)
        .collect();
    close(&assigned.concat(), "fg_target_box_px");
    if !rows.is_empty() {
        let overlaps: Vec<f64> = rows
            .iter()
            .zip(&assigned)
            .map(|((image, p), &target)| {
                complete_iou(target, predicted[image * anchors.len() + p.anchor])
            })
            .collect();
        close(&overlaps, "fg_ciou");
    }

    // The terms.
    let items = items.map(|item| f64::from(network::values(&item)[0]));
    close(&items, "loss_items");
    close(&items.map(|item| item * batch as f64), "loss_vector");
    close(&[f64::from(network::values(&total)[0])], "loss_total");
    total
}

/// The loss of given head outputs and its gradient.
fn check_raw(name: &str, device_name: &str, device: &Device) {
    let fixture = Fixture::load(name);
    let what = format!("{name} on {device_name}");
    let device = device.clone().autodiff();
    let output = FlatOutput {
        boxes: network::tensor(&fixture, "in.boxes", &device).require_grad(),
        scores: network::tensor(&fixture, "in.scores", &device).require_grad(),
    };
    let size = fixture.meta_sizes("image_hw");
    let extent = [
        fixture.meta_number("batch").unwrap() as usize,
        size[0],
        size[1],
    ];
    let targets = network::targets(&fixture, extent);
    let gradients = check_loss(&fixture, &output, &targets, extent, 1e-4, &what).backward();
    for (tensor, name) in [
        (&output.boxes, "out.grad_boxes"),
        (&output.scores, "out.grad_scores"),
    ] {
        let (_, expected) = fixture.f32(name);
        let actual = network::values(&tensor.grad(&gradients).unwrap());
        assert_close(&actual, &expected, 1e-4, &format!("{name} of {what}"));
    }
}

#[test]
fn one_class_with_targets_below_the_floor_is_assigned_and_weighed_as_in_the_reference() {
    for (device_name, device) in devices::every() {
        check_raw("loss_raw_nc1_128x160", device_name, &device);
    }
}

#[test]
fn a_target_beyond_the_largest_side_is_clamped_as_in_the_reference() {
    for (device_name, device) in devices::every() {
        check_raw("loss_raw_nc1_large_160x288", device_name, &device);
    }
}

#[test]
fn contested_anchors_go_to_the_target_of_the_reference() {
    for (device_name, device) in devices::every() {
        check_raw("loss_raw_nc2_crowd_128x128", device_name, &device);
    }
}

#[test]
fn three_classes_give_the_reference_loss_and_gradient() {
    for (device_name, device) in devices::every() {
        check_raw("loss_raw_nc3_128x160", device_name, &device);
    }
}

#[test]
fn a_batch_without_targets_gives_the_reference_loss_and_gradient() {
    for (device_name, device) in devices::every() {
        check_raw("loss_raw_nc3_96x64_no_targets", device_name, &device);
    }
}

/// Loss and gradients of a detector; `prepare` may change it and the targets.
fn check_network(name: &str, prepare: fn(Yolo11, &mut [ImageTargets]) -> Yolo11) {
    let fixture = Fixture::load(name);
    let device = devices::flex().autodiff();
    let shape = fixture.meta_sizes("input_shape");
    let extent = [shape[0], shape[2], shape[3]];
    let mut targets = network::targets(&fixture, extent);
    let detector = prepare(network::detector(&fixture, &device), &mut targets);
    let output = detector
        .forward(network::detector_input(&fixture, &device))
        .flatten();
    let total = check_loss(&fixture, &output, &targets, extent, 2e-3, name);
    let gradients = network::gradients(&detector, &total.backward(), tensor_name);
    check_gradients(&fixture, &gradients, name);
}

/// Compares the gradients' norms and the first numbers of some.
fn check_gradients(fixture: &Fixture, gradients: &BTreeMap<String, Vec<f32>>, what: &str) {
    let names = fixture.meta_texts("grad_norm_per_param_names");
    assert_eq!(names.len(), gradients.len(), "{what}");
    let norms: Vec<f64> = names
        .iter()
        .map(|name| network::norm(&gradients[name]))
        .collect();
    let close = |actual: &[f64], name: &str| {
        let expected = fixture.values(&format!("out.{name}"));
        assert_close(actual, &expected, 2e-3, &format!("{name} of {what}"));
    };
    close(&norms, "grad_norm_per_param");

    let mut total = 0.0;
    let mut groups = BTreeMap::from([("weight", 0.0), ("norm_weight", 0.0), ("bias", 0.0)]);
    let mut layers = [0.0; 24];
    for (name, norm) in names.iter().zip(&norms) {
        let square = norm * norm;
        let group = if name.rsplit('.').next() == Some("bias") {
            "bias"
        } else if name.ends_with(".bn.weight") {
            "norm_weight"
        } else {
            "weight"
        };
        let layer: usize = name.split('.').nth(1).unwrap().parse().unwrap();
        total += square;
        layers[layer] += square;
        *groups.get_mut(group).unwrap() += square;
    }
    close(&[f64::sqrt(total)], "grad_norm_total");
    close(&layers.map(f64::sqrt), "grad_norm_layer");
    for (group, square) in groups {
        close(&[f64::sqrt(square)], &format!("grad_norm_group.{group}"));
    }

    let first = fixture.names_after("out.grad4.");
    assert!(!first.is_empty());
    for name in first {
        let gradient = &gradients[&name];
        let expected = fixture.values(&format!("out.grad4.{name}"));
        let largest = expected
            .iter()
            .fold(0.0, |largest, v| f64::max(largest, v.abs()));
        let typical = network::norm(gradient) / (gradient.len() as f64).sqrt();
        let tolerance = f64::max(5e-3 * largest, 0.02 * typical);
        let actual = &gradient[..expected.len()];
        assert_abs(
            actual,
            &expected,
            tolerance,
            &format!("gradient of {name} of {what}"),
        );
    }
}

#[test]
fn gradients_through_the_network_in_training_match_for_one_class() {
    check_network("loss_net_n_nc1_train", |detector, targets| {
        // One predicted box begins 0.0004 pixels left of its target, less than what rounding in
        // the forward pass moves it by (0.0005 pixels, typically). The gradient of their overlap
        // jumps where the edges meet, so the target is moved out of the way.
        targets[0].targets[1].box_letterbox[0] += 0.004;
        detector
    });
}

#[test]
fn gradients_through_the_network_in_training_match_for_three_classes() {
    check_network("loss_net_n_nc3_train", |detector, _| detector);
}

#[test]
fn gradients_through_fixed_normalisation_match() {
    check_network("loss_net_n_nc1_frozen_bn", |detector, _| {
        network::freeze_normalisation(detector)
    });
}
