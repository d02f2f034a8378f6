//! `evaluate`'s tables and `report`'s page.

use std::fs;
use std::path::{Path, PathBuf};

use super::{Workplace, with_dataset};

/// A trained run `r` with an evaluation of the test frames of `data`.
fn with_evaluated_run() -> (Workplace, String) {
    let place = with_dataset();
    place
        .line("train --config training.toml --data data --run r")
        .success();
    // The lowest confidence, so that even this network sees something.
    let tables = place
        .line("evaluate --run r --data data --protocol paper --confidence 0.0001")
        .success();
    (place, tables)
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &target);
        } else {
            fs::copy(&path, &target).unwrap();
        }
    }
}

/// What stands between two texts, everywhere.
fn between<'a>(html: &'a str, start: &str, end: &str) -> Vec<&'a str> {
    let parts = html.split(start).skip(1);
    parts.map(|part| part.split(end).next().unwrap()).collect()
}

#[test]
fn every_table_is_a_csv_and_a_json_file_and_the_baselines_stand_beside_the_network() {
    let (place, tables) = with_evaluated_run();
    for word in [
        "network",
        "size",
        "triangulation",
        "matching",
        "fused",
        "by distance",
        "by sun",
    ] {
        assert!(tables.contains(word), "{word} in {tables}");
    }
    let folder = place.path("r/evaluation/data-test-0.0001");
    for name in [
        "vehicles",
        "distance",
        "differences",
        "reliability",
        "spread",
        "detection",
        "detection_curves",
        "coco",
        "confusion",
        "latency",
        "protocol",
        "protocol_methods",
        "protocol_missing",
    ] {
        let csv = fs::read_to_string(folder.join(format!("{name}.csv"))).unwrap();
        let json = fs::read_to_string(folder.join(format!("{name}.json"))).unwrap();
        let rows: Vec<serde_json::Value> = serde_json::from_str(&json).unwrap();
        assert_eq!(csv.lines().count(), rows.len() + 1, "{name}");
        for key in rows[0].as_object().unwrap().keys() {
            assert!(
                csv.lines()
                    .next()
                    .unwrap()
                    .split(',')
                    .any(|column| column == key),
                "{key}"
            );
        }
    }
    // Training ends with the validation frames.
    assert!(place.path("r/evaluation/data-val/evaluation.json").exists());
}

#[test]
fn the_protocol_says_which_of_its_frames_are_missing() {
    let (_, tables) = with_evaluated_run();
    assert!(
        tables.contains("0 of its 108 frames are in this split; 2 frames at other"),
        "{tables}"
    );
    assert!(
        tables.contains("15, 35, 55, 85, 105, 135, 155, 185, 200 m"),
        "{tables}"
    );
    let outcome = Workplace::new().line("evaluate --run r --data d --protocol paper --split val");
    outcome.error_says(&["--protocol", "--split"]);
}

#[test]
fn the_same_evaluation_writes_the_same_tables() {
    let (place, _) = with_evaluated_run();
    place
        .line("evaluate --run r --data data --confidence 0.0001 --out again")
        .success();
    for name in [
        "vehicles.csv",
        "distance.csv",
        "detection.csv",
        "coco.json",
        "protocol.csv",
    ] {
        let read = |folder: &str| fs::read(place.path(folder).join(name)).unwrap();
        assert!(
            read("again") == read("r/evaluation/data-test-0.0001"),
            "{name}"
        );
    }
}

#[test]
fn a_frame_that_cannot_be_read_is_named_left_out_and_counted() {
    let (place, _) = with_evaluated_run();
    let frames = fs::read_to_string(place.path("data/frames.csv")).unwrap();
    let broken = frames.lines().find(|line| line.contains(",test,")).unwrap();
    let stamp = broken.split(',').next().unwrap();
    place.write(&format!("data/frames/right_{stamp}.png"), "no image");
    let outcome = place.line("evaluate --run r --data data");
    assert!(
        outcome.stderr.contains(&format!("frame {stamp}")),
        "{}",
        outcome.stderr
    );
    assert!(outcome.success().contains("1 frames could not be read"));
}

#[test]
fn the_page_of_two_runs_needs_nothing_from_elsewhere_and_names_files_that_exist() {
    let (place, _) = with_evaluated_run();
    copy(&place.path("r"), &place.path("other <b>"));
    let outcome = place.run(["report", "r", "other <b>", "--out", "page/both.html"]);
    assert_eq!(outcome.stderr, "");
    outcome.success();
    let html = fs::read_to_string(place.path("page/both.html")).unwrap();
    for foreign in ["src=\"http", "<script", "@import", "url(", "<b>"] {
        assert!(!html.contains(foreign), "{foreign}");
    }
    assert!(html.contains("other &lt;b&gt;"));
    assert!(html.matches("<svg").count() >= 12);
    for text in [
        "Comparison",
        "mAP50",
        "Against r on data-test-0.0001",
        "triangulation",
        "Confusion",
    ] {
        assert!(html.contains(text), "{text}");
    }
    let sources = between(&html, "<p class=\"source\">", "</p>");
    assert!(sources.len() > 20);
    for source in sources.iter().flat_map(|source| source.split(", ")) {
        let source = source
            .replace("&lt;", "<")
            .replace("&gt;", ">")
            .replace("&#x2f;", "/");
        assert!(place.path(PathBuf::from(&source)).is_file(), "{source}");
    }
}

#[test]
fn the_page_of_a_run_without_an_evaluation_says_how_to_make_one() {
    let place = with_dataset();
    place
        .line("train distance --config training.toml --data data --run r")
        .success();
    let outcome = place.line("report r");
    assert!(
        outcome.stderr.contains("twinsight evaluate --run r"),
        "{}",
        outcome.stderr
    );
    assert_eq!(outcome.success(), "r/report.html\n");
    assert!(place.path("r/report.html").is_file());
    // And that one works.
    place.line("evaluate --run r --data data").success();
    assert_eq!(place.line("report r").stderr, "");
    // A run of an ablation is measured there.
    place.write("out/ablation.html", "");
    fs::create_dir_all(place.path("out/runs")).unwrap();
    fs::remove_dir_all(place.path("r/evaluation")).unwrap();
    copy(&place.path("r"), &place.path("out/runs/mono-seed1"));
    let outcome = place.line("report out/runs/mono-seed1");
    assert!(
        outcome.stderr.contains("out/ablation.html") && !outcome.stderr.contains("evaluate"),
        "{}",
        outcome.stderr
    );
    outcome.success();
}

#[test]
fn what_is_no_run_has_no_page() {
    let place = Workplace::new();
    place.line("report").error_says(&["<RUN>"]);
    place
        .line("report nowhere")
        .error_says(&["nowhere", "config.json", "train"]);
    place.write("r/config.json", "{}");
    place.write("r/evaluation/a/evaluation.json", "{}");
    place
        .line("report r")
        .error_says(&["evaluation.json", "twinsight evaluate"]);
    place.write("s/config.json", "{}");
    place.write("s/metrics.csv", "stage,epoch\ndetector,x\n");
    place.line("report s").error_says(&["metrics.csv"]);
}
