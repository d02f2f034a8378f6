//! The number formula against published constants and stored vectors, bit for bit.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "tests panic and report where the library must not"
)]

mod support;

use serde_json::Value;
use support::fixture::fixture_path;
use support::formula::{self, Fill};

fn vectors() -> Value {
    let text = std::fs::read_to_string(fixture_path("formula_vectors.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

fn hex(value: &Value) -> u64 {
    let text = value.as_str().unwrap();
    u64::from_str_radix(text.strip_prefix("0x").unwrap(), 16).unwrap()
}

fn list(value: &Value) -> &Vec<Value> {
    value.as_array().unwrap()
}

fn sizes(value: &Value) -> Vec<usize> {
    list(value)
        .iter()
        .map(|v| v.as_u64().unwrap() as usize)
        .collect()
}

fn fill(vectors: &Value) -> Fill {
    Fill::new(
        vectors["tag"].as_str().unwrap(),
        vectors["gain"].as_f64().unwrap(),
        vectors["head_gain"].as_f64().unwrap(),
        vectors["qk_boost"].as_f64().unwrap(),
    )
}

#[test]
fn hashes_and_generator_match_the_published_constants() {
    assert_eq!(formula::hash(""), 0xcbf2_9ce4_8422_2325);
    assert_eq!(formula::hash("a"), 0xaf63_dc4c_8601_ec8c);
    assert_eq!(formula::hash("foobar"), 0x8594_4171_f739_67e8);
    assert_eq!(formula::mix(0, 0), 0xe220_a839_7b1d_cdaf);
    assert_eq!(formula::mix(0, 1), 0x6e78_9e6a_a1b9_65f4);
}

#[test]
fn every_stored_hash_is_reproduced() {
    let vectors = vectors();
    assert!(list(&vectors["fnv1a64"]).len() >= 6);
    for entry in list(&vectors["fnv1a64"]) {
        let text = entry["text"].as_str().unwrap();
        assert_eq!(formula::hash(text), hex(&entry["hash"]), "{text}");
    }
}

#[test]
fn the_first_bits_numbers_and_bytes_of_a_key_are_exact() {
    let vectors = vectors();
    let stored = &vectors["mix"];
    let key = stored["key"].as_str().unwrap();
    let count = list(&stored["z"]).len();
    assert!(count >= 6);
    let units = formula::units(key, count);
    let bytes = formula::bytes(key, count);
    for i in 0..count {
        assert_eq!(
            formula::mix(formula::hash(key), i as u64),
            hex(&stored["z"][i])
        );
        assert_eq!(
            u64::from(units[i].to_bits()),
            hex(&stored["unit_f32_bits"][i])
        );
        assert_eq!(units[i], stored["unit"][i].as_f64().unwrap() as f32);
        assert_eq!(u64::from(bytes[i]), stored["byte"][i].as_u64().unwrap());
    }
}

#[test]
fn parameters_of_every_rule_are_exact() {
    let vectors = vectors();
    let fill = fill(&vectors);
    assert!(list(&vectors["params"]).len() >= 13);
    for stored in list(&vectors["params"]) {
        let name = stored["name"].as_str().unwrap();
        let shape = sizes(&stored["shape"]);
        let values = fill.parameter(name, &shape);
        for (j, i) in sizes(&stored["index"]).into_iter().enumerate() {
            let bits = hex(&stored["value_f32_bits"][j]);
            assert_eq!(u64::from(values[i].to_bits()), bits, "{name}[{i}]");
            assert_eq!(values[i], stored["value"][j].as_f64().unwrap() as f32);
        }
        let sum: f64 = values.iter().map(|&v| f64::from(v)).sum();
        let expected = stored["sum_f64"].as_f64().unwrap();
        // The order of a sum of up to 33,000 numbers shows in the last digits only.
        assert!(
            (sum - expected).abs() < 1e-9,
            "{name}: {sum} is not {expected}"
        );
        if let Some(bits) = stored.get("scale_f32_bits") {
            let is_head = stored["rule"] == "head_weight";
            let gain = if is_head { fill.head_gain } else { fill.gain };
            assert_eq!(
                u64::from(Fill::scale(gain, &shape).to_bits()),
                hex(bits),
                "{name}"
            );
        }
    }
}

#[test]
fn constant_buffers_are_zeros_and_a_ramp() {
    let fill = fill(&vectors());
    let tracked = "model.0.bn.num_batches_tracked";
    assert_eq!(fill.parameter(tracked, &[]), [0.0]);
    let ramp = fill.parameter("model.23.dfl.conv.weight", &[1, 16, 1, 1]);
    assert_eq!(ramp, (0u8..16).map(f32::from).collect::<Vec<_>>());
}

#[test]
fn pictures_are_exact() {
    let vectors = vectors();
    let stored = &vectors["image"];
    let key = stored["key"].as_str().unwrap();
    let [channels, height, width] = sizes(&stored["channels_height_width"])[..] else {
        panic!("three sizes");
    };
    let pixels = formula::image(key, channels, height, width);
    let interleaved = formula::image_interleaved(key, channels, height, width);
    for (j, point) in list(&stored["points_c_y_x"]).iter().enumerate() {
        let [c, y, x] = sizes(point)[..] else {
            panic!("three coordinates");
        };
        let byte = stored["bytes"][j].as_u64().unwrap();
        assert_eq!(u64::from(pixels[(c * height + y) * width + x]), byte);
        assert_eq!(u64::from(interleaved[(y * width + x) * channels + c]), byte);
    }
    let sum: u64 = pixels.iter().map(|&p| u64::from(p)).sum();
    assert_eq!(sum, stored["sum"].as_u64().unwrap());

    let input = formula::image_batch("img-a", 1, height, width);
    assert_eq!(
        u64::from(input[0].to_bits()),
        hex(&stored["float_of_first_f32_bits"])
    );
}

#[test]
fn a_summary_is_26_numbers_with_the_mean_first() {
    let values: Vec<f32> = (0u8..32).map(f32::from).collect();
    let summary = formula::summary(&values);
    assert_eq!(summary.len(), 26);
    assert_eq!(summary[0], 15.5);
    assert!((summary[1] - ((32.0 * 32.0 - 1.0f64) / 12.0).sqrt()).abs() < 1e-12);
    assert_eq!(summary[9], 7.0);
    assert_eq!(summary[25], 30.0);
}

#[test]
fn a_composite_holds_the_right_crop_above_the_left_one() {
    let composite = formula::composite_batch("dimg-a", 2, 8, 5);
    assert_eq!(composite.len(), 2 * 3 * 8 * 5);
    let right = formula::image("dimg-a.1.right", 3, 4, 5);
    let left = formula::image("dimg-a.1.left", 3, 4, 5);
    let sample = &composite[3 * 8 * 5..];
    assert_eq!(sample[40], f32::from(right[20]) / 255.0);
    assert_eq!(sample[40 + 20], f32::from(left[20]) / 255.0);
}
