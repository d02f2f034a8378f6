//! Whole detectors against reference numbers: outputs, layers, parts, statistics, names, sizes.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "tests panic and report where the library must not"
)]

mod support;

use std::collections::BTreeMap;

use burn::module::{Module, ModuleVisitor, Param};
use burn::tensor::{Device, Tensor};
use support::fixture::{Fixture, assert_abs, assert_close, fixture_path};
use support::trace::Trace;
use support::{devices, network};
use twinsight::detector::decode::decode;
use twinsight::detector::weights::{load_detector, tensor_name};
use twinsight::detector::{RawOutput, Scale, Yolo11, Yolo11Config};
use twinsight::weights::StateDict;

/// Layers before the head.
const LAYERS: usize = 23;

/// Compares a detector's raw output and the summary of every layer.
fn check_forward(
    fixture: &Fixture,
    detector: &Yolo11,
    device: &Device,
    tolerance: f64,
    what: &str,
) -> RawOutput {
    let mut layers = BTreeMap::new();
    let raw =
        detector.forward_observed(network::detector_input(fixture, device), |layer, output| {
            layers.insert(layer, network::summary(output));
        });
    assert_eq!(layers.len(), LAYERS, "{what}");
    for (layer, summary) in layers {
        let expected = fixture.values(&format!("layer.{layer:02}"));
        assert_close(
            &summary,
            &expected,
            tolerance,
            &format!("layer {layer} of {what}"),
        );
    }
    for (level, output) in raw.levels.iter().enumerate() {
        let name = format!("raw.p{}", level + 3);
        let (shape, expected) = fixture.f32(&name);
        assert_eq!(output.dims().to_vec(), shape, "{name} of {what}");
        assert_close(
            &network::values(output),
            &expected,
            tolerance,
            &format!("{name} of {what}"),
        );
    }
    raw
}

/// Compares the decoded boxes and probabilities.
fn check_decoded(fixture: &Fixture, raw: &RawOutput, what: &str) {
    let decoded = decode(raw);
    let [batch, rows, anchors] = decoded.dims();
    let (shape, expected) = fixture.f32("decoded");
    assert_eq!(vec![batch, rows, anchors], shape, "{what}");
    let actual = network::values(&decoded);
    let images = actual
        .chunks_exact(rows * anchors)
        .zip(expected.chunks_exact(rows * anchors));
    for (actual, expected) in images {
        let (boxes, probabilities) = actual.split_at(4 * anchors);
        let (expected_boxes, expected_probabilities) = expected.split_at(4 * anchors);
        assert_abs(boxes, expected_boxes, 1e-2, &format!("boxes of {what}"));
        assert_abs(
            probabilities,
            expected_probabilities,
            5e-5,
            &format!("probabilities of {what}"),
        );
    }
}

/// A detector in evaluation mode: every layer, the raw and the decoded output.
fn check(name: &str, device_name: &str, device: &Device) {
    let fixture = Fixture::load(name);
    let detector = network::detector(&fixture, device);
    let what = format!("{name} on {device_name}");
    let raw = check_forward(&fixture, &detector, device, 1e-4, &what);
    check_decoded(&fixture, &raw, &what);
}

/// The summary of every part that the fixture lists.
fn check_parts(name: &str, parts: usize) {
    let fixture = Fixture::load(name);
    let device = devices::flex();
    let detector = network::detector(&fixture, &device);
    let trace = Trace::of(&detector, &network::detector_input(&fixture, &device));
    let listed = fixture.names_after("module.");
    assert_eq!(listed.len(), parts);
    for path in listed {
        let actual = trace
            .summaries
            .get(&path)
            .unwrap_or_else(|| panic!("{path} was not run"));
        let expected = fixture.values(&format!("module.{path}"));
        assert_close(actual, &expected, 1e-4, &format!("{path} of {name}"));
    }
}

#[test]
fn the_smallest_detector_gives_the_reference_output_on_every_device() {
    for (device_name, device) in devices::every() {
        check("yolo11n_nc1_64x96", device_name, &device);
    }
}

#[test]
fn a_detector_of_80_classes_gives_the_reference_output() {
    check("yolo11n_nc80_64x96", "flex", &devices::flex());
}

#[test]
fn a_batch_of_two_gives_the_reference_output() {
    check("yolo11n_nc80_128x160", "flex", &devices::flex());
}

#[test]
fn the_small_detector_gives_the_reference_output() {
    check("yolo11s_nc1_64x96", "flex", &devices::flex());
}

#[test]
fn the_medium_detector_gives_the_reference_output() {
    check("yolo11m_nc1_64x96", "flex", &devices::flex());
}

#[test]
fn every_part_of_the_smallest_detector_gives_the_reference_output() {
    check_parts("yolo11n_nc80_64x96", 277);
}

#[test]
fn every_part_of_the_medium_detector_gives_the_reference_output() {
    check_parts("yolo11m_nc1_64x96", 367);
}

#[test]
fn training_normalises_by_the_batch_and_updates_the_running_statistics() {
    let fixture = Fixture::load("yolo11n_nc80_train_128x160");
    let device = devices::flex().autodiff();
    let detector = network::detector(&fixture, &device);
    check_forward(
        &fixture,
        &detector,
        &device,
        1e-3,
        "the detector in training",
    );
    let listed = fixture.names_after("after.");
    assert_eq!(listed.len(), 14);
    // Both the network in training and its copy for evaluation know the latest statistics. The
    // training one is asked first: making the copy brings it up to date.
    for (whose, state) in [
        ("training", StateDict::of(&detector, tensor_name)),
        ("evaluation", StateDict::of(&detector.valid(), tensor_name)),
    ] {
        for name in &listed {
            let (_, actual) = &state.tensors[name];
            let (_, expected) = fixture.f32(&format!("after.{name}"));
            assert_close(actual, &expected, 1e-5, &format!("{name} in {whose}"));
        }
    }
}

#[test]
fn folding_after_a_training_pass_uses_the_latest_statistics() {
    let fixture = Fixture::load("yolo11n_nc80_train_128x160");
    let device = devices::flex().autodiff();
    let trained = || {
        let detector = network::detector(&fixture, &device);
        detector.forward(network::detector_input(&fixture, &device));
        detector
    };
    let folded = StateDict::of(&trained().folded(), tensor_name);
    let expected = StateDict::of(&trained().valid().folded(), tensor_name);
    for (name, (_, values)) in &expected.tensors {
        assert_close(&folded.tensors[name].1, values, 1e-6, name);
    }
}

#[test]
fn a_folded_detector_gives_the_same_output() {
    for name in ["yolo11n_nc1_64x96", "yolo11m_nc1_64x96"] {
        let fixture = Fixture::load(name);
        let device = devices::flex();
        let folded = network::detector(&fixture, &device).folded();
        let state = StateDict::of(&folded, tensor_name);
        assert!(state.tensors.keys().all(|name| !name.contains(".bn.")));
        let raw = check_forward(&fixture, &folded, &device, 1e-4, &format!("{name}, folded"));
        let plain = network::detector(&fixture, &device);
        let plain = plain.forward(network::detector_input(&fixture, &device));
        for (folded, plain) in raw.levels.iter().zip(&plain.levels) {
            assert_close(
                &network::values(folded),
                &network::values(plain),
                1e-4,
                name,
            );
        }
        check_decoded(&fixture, &raw, name);
        // Loaded from its file it is the same function, whatever weights it was made with first.
        let classes = 1;
        let (loaded, report) = load_detector(&state, folded_scale(name), classes, &device).unwrap();
        assert!(report.folded);
        let loaded = loaded.forward(network::detector_input(&fixture, &device));
        for (loaded, folded) in loaded.levels.iter().zip(&raw.levels) {
            assert_eq!(network::values(loaded), network::values(folded), "{name}");
        }
    }
}

fn folded_scale(name: &str) -> Scale {
    if name.starts_with("yolo11n") {
        Scale::N
    } else {
        Scale::M
    }
}

#[test]
fn weights_whose_names_have_a_prefix_are_the_same_detector() {
    let device = devices::flex();
    let state = StateDict::of(&Yolo11Config::new(Scale::N, 2).init(&device), tensor_name);
    for prefix in ["model.", "module.", "ema.", "module.model."] {
        let mut renamed = state.clone();
        let tensors = std::mem::take(&mut renamed.tensors).into_iter();
        renamed.tensors = tensors
            .map(|(name, tensor)| (format!("{prefix}{name}"), tensor))
            .collect();
        let (loaded, report) = load_detector(&renamed, Scale::N, 2, &device).unwrap();
        assert!(!report.classes_reset, "{prefix}");
        let loaded = StateDict::of(&loaded, tensor_name);
        assert!(loaded.tensors == state.tensors, "{prefix}");
    }
}

#[test]
fn the_names_and_shapes_of_all_tensors_are_the_published_ones() {
    for scale in Scale::ALL {
        let path = fixture_path(&format!("state_dict/yolo11{scale}_nc80.csv"));
        let mut reader = csv::Reader::from_path(path).unwrap();
        let mut expected = BTreeMap::new();
        for row in reader.records() {
            let row = row.unwrap();
            // Neither a counter nor the constant bins are trained.
            if row[0].ends_with("num_batches_tracked") || row[0].ends_with("dfl.conv.weight") {
                continue;
            }
            let shape: Vec<usize> = row[2].split('x').map(|n| n.parse().unwrap()).collect();
            expected.insert(row[0].to_owned(), shape);
        }
        assert!(expected.len() > 400);
        let detector = Yolo11Config::new(scale, 80).init(&devices::flex());
        let tensors = StateDict::of(&detector, tensor_name).tensors;
        let actual = tensors
            .into_iter()
            .map(|(name, (shape, _))| (name, shape))
            .collect();
        assert_eq!(expected, actual, "YOLO11{scale}");
    }
}

/// Trained numbers of a detector: all but the running statistics.
fn parameters(detector: &Yolo11) -> usize {
    struct Count {
        path: Vec<String>,
        total: usize,
    }
    impl ModuleVisitor for Count {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if self
                .path
                .last()
                .is_some_and(|name| !name.starts_with("running_"))
            {
                self.total += param.lazy_shape().num_elements();
            }
        }
        fn enter_module(&mut self, name: &str, _: &str) {
            self.path.push(name.to_owned());
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.pop();
        }
    }
    let mut count = Count {
        path: Vec::new(),
        total: 0,
    };
    detector.visit(&mut count);
    count.total
}

#[test]
fn every_size_has_the_published_number_of_parameters() {
    // The published numbers count the 16 constant bins of the box distributions.
    const BINS: usize = 16;
    for (scale, classes, expected, expected_folded) in [
        (Scale::N, 80, 2_624_080, 2_616_248),
        (Scale::S, 80, 9_458_752, 9_443_760),
        (Scale::M, 80, 20_114_688, 20_091_712),
        (Scale::L, 80, 25_372_160, 25_340_992),
        (Scale::X, 80, 56_966_176, 56_919_424),
        (Scale::N, 1, 2_590_035, 2_582_347),
        (Scale::S, 1, 9_428_179, 9_413_187),
        (Scale::M, 1, 20_053_779, 20_030_803),
        (Scale::L, 1, 25_311_251, 25_280_083),
        (Scale::X, 1, 56_874_931, 56_828_179),
    ] {
        let detector = Yolo11Config::new(scale, classes).init(&devices::flex());
        assert_eq!(
            parameters(&detector) + BINS,
            expected,
            "{scale}, {classes} classes"
        );
        let folded = parameters(&detector.folded());
        assert_eq!(
            folded + BINS,
            expected_folded,
            "{scale}, {classes} classes, folded"
        );
    }
}
