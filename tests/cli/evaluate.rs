//! What `evaluate` can judge, on which datasets, and where it writes.

use std::fs;

use serde_json::Value;

use super::{Workplace, with_dataset};

fn figures(place: &Workplace, folder: &str) -> Value {
    let path = place.path(folder).join("evaluation.json");
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// Single images of the dataset with its square boxes, `single`, and stereo pairs with tight ones,
/// `tight`.
fn with_imports(place: &Workplace) {
    for line in [
        "export yolo data --box-kind sphere --out sphere-yolo",
        "import yolo sphere-yolo --single --out single",
        "export yolo data --distance --out tight-yolo",
        "import yolo tight-yolo --out tight",
    ] {
        place.line(line).success();
    }
}

#[test]
fn a_detector_alone_is_judged_by_what_it_finds_in_pairs_and_in_single_images() {
    let place = with_dataset();
    with_imports(&place);
    place
        .line("train detector --config training.toml --data data --run r")
        .success();
    for data in ["data", "single"] {
        let line = format!("evaluate --run r --data {data}");
        let said = place.line(&line).success();
        assert!(said.contains("no distance network"), "{said}");
        assert!(
            said.contains("detector ") && !said.contains("pipeline"),
            "{said}"
        );
        let figures = figures(&place, &format!("r/evaluation/{data}-test"));
        assert_eq!(figures["networks"], "detector");
        assert!(
            figures["detection"]["targets"].as_u64() > Some(0),
            "{figures}"
        );
        assert!(figures["pipeline"].is_null() && figures["true_boxes"].is_null());
    }
    assert_eq!(place.line("report r").stderr, "");
}

#[test]
fn a_distance_network_alone_is_judged_on_labelled_boxes() {
    let place = with_dataset();
    with_imports(&place);
    place
        .line("train distance --config training.toml --data data --run r")
        .success();
    let said = place.line("evaluate --run r --data data").success();
    assert!(
        said.contains("true boxes") && said.contains("no detector"),
        "{said}"
    );
    let figures = figures(&place, "r/evaluation/data-test");
    assert_eq!(figures["networks"], "distance");
    assert_eq!(figures["true_boxes"]["count"], 2, "{figures}");
    assert!(figures["pipeline"].is_null() && figures["detection"].is_null());
    let table = fs::read_to_string(place.path("r/evaluation/data-test/distance.csv")).unwrap();
    assert!(
        table.contains("true boxes,network,all") && !table.contains("pipeline,"),
        "{table}"
    );
    place
        .line("evaluate --run r --data single")
        .error_says(&["single images", "stereo"]);
}

#[test]
fn a_dataset_with_another_kind_of_box_is_refused_and_nothing_is_written() {
    let place = with_dataset();
    with_imports(&place);
    place
        .line("train --config training.toml --data data --run r")
        .success();
    place
        .line("evaluate --run r --data tight")
        .error_says(&["has no sphere boxes, only tight", "--box-kind tight"]);
    assert!(!place.path("r/evaluation/tight-test").exists());
}

#[test]
fn another_comparison_replaces_nothing_and_the_figures_are_printed_as_json() {
    let place = with_dataset();
    place
        .line("train --config training.toml --data data --run r")
        .success();
    let before = figures(&place, "r/evaluation/data-val");
    let line =
        "evaluate --run r --data data --split val --pairing detect --confidence 0.30 --json -";
    let printed: Value = serde_json::from_str(&place.line(line).success()).unwrap();
    assert_eq!(
        printed,
        figures(&place, "r/evaluation/data-val-detect-0.30")
    );
    assert_eq!(printed["pairing_mode"], "detect");
    assert_eq!(before, figures(&place, "r/evaluation/data-val"));
    assert!(!place.path("-").exists());
    // Both stand on the page.
    place.line("report r").success();
    let page = fs::read_to_string(place.path("r/report.html")).unwrap();
    for name in ["r: data-val<", "r: data-val-detect-0.30<"] {
        assert!(page.contains(name), "{name}");
    }
}

#[test]
fn the_training_dataset_is_known_by_its_content_wherever_the_command_is_given() {
    let place = with_dataset();
    place
        .line("train --config training.toml --data data --run runs/r")
        .success();
    let evaluate = |folder: &str, arguments: &str| {
        let output = place
            .command()
            .current_dir(place.path(folder))
            .args(arguments.split_whitespace())
            .output()
            .unwrap();
        let notes = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{notes}");
        notes
    };
    // The path in config.json leads nowhere from here, and it is the same dataset.
    let notes = evaluate("data", "evaluate --run ../runs/r --data . --out ../a");
    assert!(!notes.contains("baselines"), "{notes}");
    // Another dataset of the same name, below another folder, is not taken for it.
    place
        .line("generate --config tiny.toml --seed 9 --out elsewhere/data")
        .success();
    let notes = evaluate(
        "elsewhere",
        "evaluate --run ../runs/r --data data --out ../b",
    );
    assert!(notes.contains("the run was trained on"), "{notes}");
    let fitted_on = |folder: &str| {
        let path = figures(&place, folder)["baselines"]["fitted_on"].clone();
        place
            .path("elsewhere")
            .join(path.as_str().unwrap())
            .canonicalize()
            .unwrap()
    };
    assert_eq!(fitted_on("b"), place.path("data").canonicalize().unwrap());
    // Without it the evaluated dataset has to do, and that is said.
    fs::rename(place.path("data"), place.path("gone")).unwrap();
    let notes = evaluate(
        "elsewhere",
        "evaluate --run ../runs/r --data data --out ../c",
    );
    assert!(notes.contains("favours"), "{notes}");
}
