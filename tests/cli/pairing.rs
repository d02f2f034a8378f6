//! `--pairing`: the two ways to the boxes of the right image.

use std::fs;

use serde_json::Value;

use super::{Workplace, with_dataset};

#[test]
fn the_default_is_to_search_the_right_image() {
    let place = Workplace::new();
    for command in ["evaluate", "predict"] {
        let help = place.run([command, "--help"]).success();
        assert!(help.contains("--pairing") && help.contains("[default: search]"));
    }
}

#[test]
fn an_unknown_way_of_pairing_is_refused_with_the_known_ones() {
    let place = Workplace::new();
    for command in [
        "evaluate --run r --data d --pairing",
        "predict --run r a.png b.png --pairing",
    ] {
        for nonsense in ["both", "Search", "0"] {
            place
                .line(&format!("{command} {nonsense}"))
                .error_says(&[nonsense, "detect", "search"]);
        }
        place.line(command).error_says(&["--pairing"]);
    }
}

#[test]
fn both_ways_predict_and_evaluate_and_the_figures_say_which_it_was() {
    let place = with_dataset();
    place
        .line("train --config training.toml --data data --run r")
        .success();
    let pair = "data/frames/left_00001.png data/frames/right_00001.png";
    for mode in ["detect", "search"] {
        // The lowest confidence, so that even this network sees something.
        let predict = format!("predict --run r {pair} --confidence 0.0001 --pairing {mode}");
        let prediction = place.line(&predict).success();
        assert_eq!(place.line(&predict).success(), prediction, "the same again");
        let prediction: Value = serde_json::from_str(&prediction).unwrap();
        for vehicle in prediction["vehicles"].as_array().unwrap() {
            let edges = ["y_min", "y_max"].map(|edge| {
                let at = |side: &str| vehicle[side][edge].as_f64().unwrap();
                (at("left") - at("right")).abs()
            });
            // A box that was searched for is the left one, moved along its rows.
            assert!(
                mode == "detect" || edges.iter().all(|&apart| apart < 1e-6),
                "{vehicle}"
            );
            assert!(vehicle["distance_m"].is_number(), "{vehicle}");
        }

        let tables = place
            .line(&format!(
                "evaluate --run r --data data --pairing {mode} --json {mode}.json"
            ))
            .success();
        assert!(tables.contains(&format!("pairing {mode}")), "{tables}");
        let figures = fs::read(place.path(format!("{mode}.json"))).unwrap();
        let figures: Value = serde_json::from_slice(&figures).unwrap();
        assert_eq!(figures["pairing_mode"], mode);
    }
}
