//! Letterbox and non-maximum suppression against the reference numbers, exactly.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "tests panic and report where the library must not"
)]

mod support;

use image::RgbImage;
use serde_json::Value;
use support::fixture::{Fixture, assert_abs};
use support::formula;
use twinsight::detector::nms::{NmsConfig, non_maximum_suppression};
use twinsight::geometry::PixelBox;
use twinsight::geometry::letterbox::{Enlarging, Frame, Letterbox, Size, resize_bilinear};

/// The settings of a fixture's cases by name.
fn cases(fixture: &Fixture) -> Vec<(String, Value)> {
    let cases = fixture.meta("cases").unwrap();
    let cases = cases.as_object().unwrap();
    cases
        .iter()
        .map(|(name, case)| (name.clone(), case.clone()))
        .collect()
}

/// The letterbox fixture's image cases, or its inverse mappings.
fn letterbox_cases(fixture: &Fixture, inverse: bool) -> Vec<(String, Value)> {
    let mut cases = cases(fixture);
    cases.retain(|(name, _)| name.starts_with("inv_") == inverse);
    cases
}

/// A size that is stored as (height, width).
fn size(value: &Value) -> Size {
    let side = |i: usize| value[i].as_u64().unwrap() as u32;
    Size::new(side(1), side(0))
}

fn letterbox(case: &Value) -> Letterbox {
    let frame = if case["auto"].as_bool().unwrap_or(false) {
        let stride = case["stride"].as_u64().unwrap() as u32;
        Frame::MinimumRectangle { stride }
    } else {
        Frame::Exact
    };
    let enlarging = if case["scaleup"].as_bool().unwrap_or(true) {
        Enlarging::Allowed
    } else {
        Enlarging::Forbidden
    };
    Letterbox::new(
        size(&case["in_hw"]),
        size(&case["target_hw"]),
        frame,
        enlarging,
    )
    .unwrap()
}

fn picture(fixture: &Fixture, tensor: &str) -> RgbImage {
    let (shape, pixels) = fixture.u8(tensor);
    RgbImage::from_raw(shape[1] as u32, shape[0] as u32, pixels).unwrap()
}

#[test]
fn letterbox_geometry_is_exact() {
    let fixture = Fixture::load("letterbox");
    let cases = letterbox_cases(&fixture, false);
    assert_eq!(cases.len(), 6);
    for (name, case) in cases {
        let l = letterbox(&case);
        let geometry = [
            l.resized.width,
            l.resized.height,
            l.top,
            l.bottom,
            l.left,
            l.right,
        ];
        let (_, expected) = fixture.i64(&format!("{name}.geom"));
        assert_eq!(geometry.map(i64::from).to_vec(), expected, "case {name}");
        let (_, ratios) = fixture.f64(&format!("{name}.ratio_f64"));
        assert_eq!(ratios, [l.ratio, l.ratio], "case {name}");
    }
}

#[test]
fn letterboxed_pixels_are_exact() {
    let fixture = Fixture::load("letterbox");
    for (name, case) in letterbox_cases(&fixture, false) {
        let original = picture(&fixture, &format!("{name}.in"));
        let key = case["image_key"].as_str().unwrap();
        let (height, width) = (original.height() as usize, original.width() as usize);
        assert_eq!(
            original.as_raw(),
            &formula::image_interleaved(key, 3, height, width)
        );

        let l = letterbox(&case);
        let expected = picture(&fixture, &format!("{name}.out"));
        assert_eq!(l.apply(&original).unwrap(), expected, "case {name}");

        let area = l.size().area();
        let mut planes = vec![0.0; 3 * area];
        l.write_planes(&original, &mut planes).unwrap();
        for (i, pixel) in expected.pixels().enumerate() {
            for c in 0..3 {
                assert_eq!(
                    planes[c * area + i],
                    f32::from(pixel[c]) / 255.0,
                    "case {name}"
                );
            }
        }

        let resized = resize_bilinear(&original, l.resized);
        let inner =
            image::imageops::crop_imm(&expected, l.left, l.top, l.resized.width, l.resized.height);
        assert_eq!(resized, inner.to_image(), "case {name}");
    }
}

#[test]
fn boxes_map_back_to_the_original_image() {
    let fixture = Fixture::load("letterbox");
    let cases = letterbox_cases(&fixture, true);
    assert_eq!(cases.len(), 2);
    for (name, case) in cases {
        let (original, target) = (size(&case["original_hw"]), size(&case["letterboxed_hw"]));
        let l = Letterbox::new(original, target, Frame::Exact, Enlarging::Allowed).unwrap();
        let boxes = fixture.values(&format!("{name}.boxes_in"));
        let expected = fixture.values(&format!("{name}.boxes_out"));
        let (boxes, _) = boxes.as_chunks::<4>();
        let back: Vec<f64> = boxes
            .iter()
            .map(|&[x0, y0, x1, y1]| l.pixel_from_letterbox(&PixelBox::new(x0, y0, x1, y1)))
            .flat_map(|b| [b.x_min, b.y_min, b.x_max, b.y_max])
            .collect();
        assert_abs(&back, &expected, 1e-3, &name);
    }
}

#[test]
fn the_same_boxes_stay_in_the_same_order() {
    let fixture = Fixture::load("nms");
    let cases = cases(&fixture);
    assert_eq!(cases.len(), 5);
    for (name, case) in cases {
        let config = NmsConfig {
            confidence: case["conf"].as_f64().unwrap() as f32,
            iou: case["iou"].as_f64().unwrap(),
            multi_label: case["multi_label"].as_bool().unwrap(),
            class_agnostic: case["agnostic"].as_bool().unwrap(),
            max_detections: case["max_det"].as_u64().unwrap() as usize,
            ..NmsConfig::prediction()
        };
        let classes = case["nc"].as_u64().unwrap() as usize;
        let (_, decoded) = fixture.f32(&format!("{name}.in"));
        let kept = non_maximum_suppression(&decoded, classes, &config).unwrap();

        let anchors: Vec<i64> = kept.iter().map(|c| c.anchor as i64).collect();
        assert_eq!(
            anchors,
            fixture.i64(&format!("{name}.kept_index")).1,
            "case {name}"
        );
        let kept_classes: Vec<i64> = kept.iter().map(|c| c.class as i64).collect();
        assert_eq!(
            kept_classes,
            fixture.i64(&format!("{name}.kept_class")).1,
            "case {name}"
        );
        let rows: Vec<f64> = kept
            .iter()
            .flat_map(|c| {
                let b = c.box_letterbox;
                let score = f64::from(c.score);
                [b.x_min, b.y_min, b.x_max, b.y_max, score, c.class as f64]
            })
            .collect();
        assert_eq!(rows, fixture.values(&format!("{name}.kept")), "case {name}");
    }
}
