//! What is written: in which format, and never over what is read or something else.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::predict::{SEES, pair, save, with_pairs};
use super::{Workplace, with_dataset};

/// Two pairs in `data`, and in `left` and `right`.
fn with_folders() -> Workplace {
    let place = with_pairs(2);
    for number in 0..2 {
        for (side, image) in ["left", "right"].iter().zip(pair(number)) {
            save(&place, &format!("{side}/{number}.png"), &image);
        }
    }
    place
}

/// Every file below a folder.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(contents(&path));
        } else {
            files.insert(path.clone(), fs::read(&path).unwrap());
        }
    }
    files
}

#[cfg(unix)]
#[test]
fn a_link_given_as_output_stays_and_what_it_leads_to_is_written() {
    use std::os::unix::fs::symlink;
    let place = with_folders();
    place.write("disk/old.jsonl", "old\n");
    symlink("disk/old.jsonl", place.path("out.jsonl")).unwrap();
    symlink("disk/new.csv", place.path("out.csv")).unwrap();
    symlink("disk/seen.png", place.path("seen.png")).unwrap();
    place.write("left/2.heic", "ftypheic");
    let outcome = place.line(&format!(
        "{SEES} left right --jsonl out.jsonl --csv out.csv"
    ));
    assert!(
        outcome.stderr.contains("left out 1 files"),
        "{}",
        outcome.stderr
    );
    assert!(outcome.stderr.contains("left/2.heic"), "{}", outcome.stderr);
    outcome.success();
    let line = format!("{SEES} left/0.png right/0.png --annotate seen.png");
    place.line(&line).success();
    for (link, target) in [
        ("out.jsonl", "disk/old.jsonl"),
        ("out.csv", "disk/new.csv"),
        ("seen.png", "disk/seen.png"),
    ] {
        let kind = fs::symlink_metadata(place.path(link)).unwrap().file_type();
        assert!(kind.is_symlink(), "{link}");
        assert_ne!(fs::read(place.path(target)).unwrap(), b"old\n", "{target}");
    }
    assert_eq!(fs::read_dir(place.path("disk")).unwrap().count(), 3);
    // Nor is a link a way to replace what is read.
    symlink("left/0.png", place.path("way.png")).unwrap();
    place
        .line(&format!("{SEES} left/0.png right/0.png --annotate way.png"))
        .error_says(&["way.png", "is read"]);
}

#[test]
fn a_prediction_replaces_neither_what_it_reads_nor_files_of_another_kind() {
    let place = with_folders();
    place.write("road.txt", "0,0 64,0 64,36 0,36");
    place.write("camera.txt", "32 0 31.5 0 32 17.5 0 0 1\n0.8\n");
    place.write("notes.md", "kept");
    place.write("run/config.json", "{}");
    let before = contents(&place.path(""));
    for (args, words) in [
        ("left/0.png right/0.png --annotate left/0.png", "is read"),
        (
            "left/0.png right/0.png --annotate right/../left/0.png",
            "is read",
        ),
        (
            "left/0.png --layout side-by-side --annotate left/0.png",
            "is read",
        ),
        ("left right --annotate left", "is read"),
        ("left right --annotate ./left/../right/", "is read"),
        (". --annotate right", "is read"),
        ("data --annotate data", "is read"),
        ("left/%d.png right/%d.png --annotate right", "is read"),
        ("left right --annotate seen.png", "a folder"),
        ("left right --csv left/0.png", "not a table"),
        ("left right --jsonl notes.md", "not JSON Lines"),
        (
            "left/0.png right/0.png --annotate notes.md",
            "not a picture",
        ),
        ("left right --csv run/detector/best.safetensors", "is read"),
        ("left right --jsonl run/config.json", "is read"),
        ("left right --roi road.txt --csv road.txt", "is read"),
        ("left right --calib camera.txt --csv camera.txt", "is read"),
        ("left right --csv a.csv --jsonl ./a.csv", "two kinds"),
        ("left/0.png right/0.png --annotate seen", "in .png or .jpg"),
        (
            "left/0.png right/0.png --annotate seen.gif",
            "in .png or .jpg",
        ),
    ] {
        let outcome = place.line(&format!("predict --run run {args}"));
        outcome.error_says(&[words, "; "]);
        assert!(contents(&place.path("")) == before, "{args} left a trace");
    }
}

#[test]
fn pages_and_figures_replace_neither_what_is_read_nor_files_of_another_kind() {
    let place = with_dataset();
    for file in ["config.json", "summary.json", "detector/best.safetensors"] {
        place.write(&format!("run/{file}"), "{}");
    }
    let before = contents(&place.path("run"));
    for (command, words) in [
        ("report run --out run/detector/best.safetensors", "is read"),
        ("report run --out training.toml", "ends in .html or .htm"),
        (
            "evaluate --run run --data data --json run/config.json",
            "is read",
        ),
        (
            "evaluate --run run --data data --json run/summary.json",
            "is read",
        ),
        (
            "evaluate --run run --data data --json data/frames.csv",
            "ends in .json",
        ),
    ] {
        place.line(command).error_says(&[words]);
    }
    assert!(contents(&place.path("run")) == before);
}

#[test]
fn earlier_results_of_the_same_kind_are_replaced() {
    let place = with_folders();
    for inputs in ["left right", "left/0.png right/0.png"] {
        let is_many = inputs == "left right";
        let seen = if is_many { "seen" } else { "seen.png" };
        let command = format!("{SEES} {inputs} --jsonl a.jsonl --csv a.csv --annotate {seen}");
        for _ in 0..2 {
            place.line(&command).success();
        }
        let lines = fs::read_to_string(place.path("a.jsonl")).unwrap();
        assert_eq!(lines.lines().count(), if is_many { 2 } else { 1 });
    }
}

#[test]
fn a_picture_has_the_format_of_its_name() {
    let place = with_folders();
    for (name, format) in [
        ("seen.png", image::ImageFormat::Png),
        ("seen.PNG", image::ImageFormat::Png),
        ("seen.jpg", image::ImageFormat::Jpeg),
        ("seen.JPEG", image::ImageFormat::Jpeg),
    ] {
        let pair = "left/0.png right/0.png";
        place
            .line(&format!("{SEES} {pair} --annotate {name}"))
            .success();
        let bytes = fs::read(place.path(name)).unwrap();
        assert_eq!(image::guess_format(&bytes).unwrap(), format, "{name}");
    }
}
