//! Trainings with other inputs, compared.

use std::fs;
use std::process::Stdio;
use std::time::{Duration, Instant};

use super::{Outcome, Workplace, files_below, with_dataset};

const ABLATE: &str = "ablate --config training.toml --data data --out out";

/// The rows of a table, each by the names of its columns.
fn rows(place: &Workplace, name: &str) -> Vec<Vec<(String, String)>> {
    let text = fs::read_to_string(place.path(name)).unwrap();
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers().unwrap().clone();
    let named = |record: csv::StringRecord| {
        let cells = header.iter().zip(record.iter());
        cells.map(|(k, v)| (k.to_owned(), v.to_owned())).collect()
    };
    reader
        .records()
        .map(|record| named(record.unwrap()))
        .collect()
}

fn cell<'a>(row: &'a [(String, String)], name: &str) -> &'a str {
    &row.iter().find(|(key, _)| key == name).unwrap().1
}

#[test]
fn every_variant_is_trained_measured_and_shown_beside_arithmetic() {
    let place = with_dataset();
    let said = place.line(ABLATE).success();
    let table = rows(&place, "out/ablation.csv");
    let all: Vec<_> = table
        .iter()
        .filter(|row| cell(row, "group") == "all")
        .collect();
    let trained: Vec<&str> = all
        .iter()
        .filter(|row| cell(row, "trained") == "true")
        .map(|row| cell(row, "name"))
        .collect();
    let variants = ["right-left", "right-right", "mono", "disparity", "surface"];
    assert_eq!(trained, variants);
    for variant in variants {
        assert!(said.contains(variant), "{variant} should be in: {said}");
        let run = place.path(format!("out/runs/{variant}-seed1"));
        assert!(run.join("distance/best.safetensors").exists());
        assert!(!run.join("detector").exists(), "no detector has a part");
    }
    for row in &all {
        let mre: f64 = cell(row, "mre_percent").parse().unwrap();
        assert!(mre.is_finite() && cell(row, "vehicles") == "2", "{row:?}");
    }
    for row in rows(&place, "out/differences.csv") {
        let against = cell(&row, "against");
        assert!(["right-left", "matching"].contains(&against) && against != cell(&row, "name"));
    }
    // Every figure can be computed again from the single estimates.
    for row in &all {
        let errors: Vec<f64> = rows(&place, "out/estimates.csv")
            .iter()
            .filter(|estimate| cell(estimate, "name") == cell(row, "name"))
            .map(|estimate| {
                let [is, said] = ["distance_m", "estimated_m"].map(|name| cell(estimate, name));
                let (is, said): (f64, f64) = (is.parse().unwrap(), said.parse().unwrap());
                100.0 * (said - is).abs() / is
            })
            .collect();
        let mre: f64 = cell(row, "mre_percent").parse().unwrap();
        let again = errors.iter().sum::<f64>() / errors.len() as f64;
        assert!((mre - again).abs() < 1e-6 * mre.max(1.0), "{mre} {again}");
    }
    let page = fs::read_to_string(place.path("out/ablation.html")).unwrap();
    for word in ["right-right", "surface", "<svg", "box_jitter"] {
        assert!(page.contains(word), "{word}");
    }
    for word in ["http://", "https://", "<script"] {
        let links = page.replace("http://www.w3.org/2000/svg", "");
        assert!(!links.contains(word), "{word}: the page needs no network");
    }
    let plot = fs::read_to_string(place.path("out/ablation.svg")).unwrap();
    assert!(plot.starts_with("<svg") && plot.contains("mono"));
}

#[test]
fn an_ablation_that_is_killed_goes_on_and_ends_as_an_uninterrupted_one() {
    let place = with_dataset();
    let line = |out: &str| {
        format!(
            "ablate --config training.toml --data data --out {out} --epochs 3 \
             --variants right-left,surface --seeds 1,2 --split val"
        )
    };
    let begun = Instant::now();
    place.line(&line("whole")).success();
    let whole = begun.elapsed();
    let mut kills = 0;
    for share in [0.3, 0.6, 0.5] {
        let mut child = place
            .command()
            .args(line("killed").split_whitespace())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let wait = whole.mul_f64(share);
        let begun = Instant::now();
        while begun.elapsed() < wait && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(2));
        }
        if child.try_wait().unwrap().is_none() {
            child.kill().unwrap();
            kills += 1;
        }
        child.wait().unwrap();
    }
    assert!(kills > 0, "nothing was killed");
    place.line(&line("killed")).success();
    for name in [
        "ablation.csv",
        "differences.csv",
        "estimates.csv",
        "ablation.svg",
    ] {
        let [wanted, got] =
            ["whole", "killed"].map(|out| fs::read(place.path(format!("{out}/{name}"))).unwrap());
        assert!(wanted == got, "{name} differs after {kills} kills");
    }
    // What is finished is left alone, and more seeds and variants join it.
    let weights = place.path("killed/runs/surface-seed1/distance/best.safetensors");
    let written = fs::metadata(&weights).unwrap().modified().unwrap();
    let more = line("killed")
        .replace("--seeds 1,2", "--seeds 1,3")
        .replace("right-left,", "mono,");
    place.line(&more).success();
    assert_eq!(fs::metadata(&weights).unwrap().modified().unwrap(), written);
    let names: Vec<String> = rows(&place, "killed/ablation.csv")
        .iter()
        .filter(|row| cell(row, "group") == "all" && cell(row, "seeds") == "2")
        .map(|row| cell(row, "name").to_owned())
        .collect();
    assert_eq!(names, ["mono", "surface"]);
}

#[test]
fn what_cannot_be_compared_is_refused_before_anything_is_trained() {
    let place = with_dataset();
    let refused = |line: &str, words: &[&str]| {
        place.line(line).error_says(words);
        assert!(!place.path("out/runs").exists(), "{line}");
    };
    refused(
        &format!("{ABLATE} --variants left-left"),
        &["left-left", "right-left"],
    );
    refused(&format!("{ABLATE} --seeds one"), &["one"]);
    refused(&format!("{ABLATE} --epochs 0"), &["distance.epochs = 0"]);
    refused(
        "ablate --config training.toml --data nowhere --out out",
        &["nowhere"],
    );
    place.write(
        "surface.toml",
        "[distance]\nreadout = \"surface\"\ndisparity = true\n",
    );
    refused(
        "ablate --config surface.toml --data data --out out",
        &["distance.readout", "another readout"],
    );
    place.write("split.toml", "split = \"scene\"\n");
    refused(
        "ablate --config split.toml --data data --out out --seeds 4",
        &["seeds", "`split`"],
    );
    place.write("mine/notes.txt", "not an ablation");
    refused(
        "ablate --config training.toml --data data --out mine",
        &["mine", "not empty", "--out"],
    );
    place.write("file", "");
    refused(
        "ablate --config training.toml --data data --out file",
        &["file"],
    );
}

#[test]
fn other_settings_and_another_dataset_need_another_folder() {
    let place = with_dataset();
    let line = format!("{ABLATE} --variants mono --split val");
    place.line(&line).success();
    let before = files_below(&place.path("out"));
    place
        .line(&format!("{line} --epochs 2"))
        .error_says(&["out", "other settings", "--out"]);
    let rows = fs::read_to_string(place.path("data/frames.csv")).unwrap();
    place.write("data/frames.csv", rows.replacen(",val,", ",train,", 1));
    place.line(&line).error_says(&["another dataset", "--out"]);
    place.write("out/settings.json", "{");
    place.line(&line).error_says(&["settings.json", "restore"]);
    assert_eq!(files_below(&place.path("out")), before);
}

#[test]
fn a_dry_run_of_an_ablation_measures_every_variant_and_leaves_nothing() {
    let place = with_dataset();
    let said = place.line(&format!("{ABLATE} --dry-run")).success();
    for word in [
        "right-left",
        "right-right",
        "mono",
        "disparity",
        "surface",
        "Nothing was trained",
    ] {
        assert!(said.contains(word), "{word} should be in: {said}");
    }
    assert!(!place.path("out").exists());
}

#[test]
fn a_network_that_was_trained_with_the_disparity_is_used_with_it() {
    let place = with_dataset();
    place.write(
        "surface.toml",
        format!(
            "{}\ndisparity = true\nreadout = \"surface\"\n",
            super::TINY_TRAINING
        ),
    );
    place
        .line("train --config surface.toml --data data --run r")
        .success();
    let said = place
        .line("evaluate --run r --data data --split val")
        .success();
    assert!(said.contains("network"), "{said}");
    let outcome: Outcome = place.line(
        "predict --run r --confidence 0.0 data/frames/left_00000.png data/frames/right_00000.png",
    );
    outcome.success();
    // Weights say what they were trained with.
    place
        .line("train distance --config training.toml --data data --run s --distance-weights r/distance/best.safetensors")
        .error_says(&["best.safetensors", "readout"]);
    place
        .line("train distance --config inconsistent.toml --data data --run s")
        .error_says(&["inconsistent.toml"]);
    place.write("inconsistent.toml", "[distance]\nreadout = \"surface\"\n");
    place
        .line("train distance --config inconsistent.toml --data data --run s")
        .error_says(&["distance.readout", "distance.disparity = true"]);
}
