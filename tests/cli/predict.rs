//! `predict` on many frames: what it reads, what it writes, and what it does when something is
//! broken.

use std::fs;
use std::io::{BufRead as _, BufReader};
use std::process::{Child, ChildStdout, Command, Stdio};

use image::{Rgb, RgbImage, imageops};
use serde_json::Value;

use super::untrained::{texture, write_run};
use super::{Outcome, Workplace, files_below};

/// Everything that networks which never learnt have any idea of, two vehicles at most.
pub const SEES: &str = "predict --run run --confidence 0.0001 --max-detections 2";

/// Left and right image of a pair.
pub fn pair(number: u32) -> [RgbImage; 2] {
    [0, 2].map(|shift| texture(64, 36, number, shift))
}

/// A place with a run of fresh networks and a folder `data` of so many pairs.
pub fn with_pairs(count: u32) -> Workplace {
    let place = Workplace::new();
    write_run(&place.path("run"), 64);
    fs::create_dir(place.path("data")).unwrap();
    for number in 0..count {
        for (side, image) in ["left", "right"].iter().zip(pair(number)) {
            image
                .save(place.path(format!("data/{side}_{number:05}.png")))
                .unwrap();
        }
    }
    place
}

pub fn lines(text: &str) -> Vec<Value> {
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

/// What was found in each frame.
pub fn vehicles(lines: &[Value]) -> Vec<&Value> {
    lines.iter().map(|line| &line["vehicles"]).collect()
}

pub fn save(place: &Workplace, name: &str, image: &RgbImage) {
    let path = place.path(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    image.save(path).unwrap();
}

/// Both images of a pair in one picture.
pub fn stacked([left, right]: &[RgbImage; 2], is_side_by_side: bool) -> RgbImage {
    let (width, height) = left.dimensions();
    let (x, y) = if is_side_by_side {
        (width, 0)
    } else {
        (0, height)
    };
    let mut both = RgbImage::new(width + x, height + y);
    imageops::replace(&mut both, left, 0, 0);
    imageops::replace(&mut both, right, i64::from(x), i64::from(y));
    both
}

#[test]
fn every_kind_of_input_gives_the_same_results() {
    let place = with_pairs(3);
    for number in 0..3 {
        let images = pair(number);
        save(&place, &format!("l/{number}.png"), &images[0]);
        save(&place, &format!("r/{number}.png"), &images[1]);
        save(&place, &format!("kitti/image_2/{number}.png"), &images[0]);
        save(&place, &format!("kitti/image_3/{number}.png"), &images[1]);
        save(
            &place,
            &format!("wide/{number}.png"),
            &stacked(&images, true),
        );
        save(
            &place,
            &format!("high/{number}.png"),
            &stacked(&images, false),
        );
    }
    let run = |input: &str| place.line(&format!("{SEES} {input}")).success();
    let expected = lines(&run("data"));
    assert_eq!(expected.len(), 3);
    assert!(
        vehicles(&expected)
            .iter()
            .any(|of| of[0]["distance_m"].is_number())
    );
    for input in [
        "l r",
        "kitti",
        "data/left_%05d.png data/right_%05d.png",
        "wide --layout side-by-side",
        "high --layout top-bottom",
        "high/%d.png --layout top-bottom",
        "data --jsonl -",
    ] {
        assert_eq!(
            vehicles(&lines(&run(input))),
            vehicles(&expected),
            "{input}"
        );
    }
    for (number, expected) in vehicles(&expected).into_iter().enumerate() {
        for input in [
            format!("l/{number}.png r/{number}.png"),
            format!("wide/{number}.png --layout side-by-side"),
        ] {
            let one: Value = serde_json::from_str(&run(&input)).unwrap();
            assert_eq!(&one["vehicles"], expected, "{input}");
        }
    }
}

#[test]
fn broken_frames_are_named_with_their_reasons_and_the_others_are_measured() {
    let place = with_pairs(100);
    let data = |name: &str| place.path(format!("data/{name}"));
    let whole = fs::read(data("left_00010.png")).unwrap();
    fs::write(data("left_00010.png"), "").unwrap();
    fs::write(data("right_00025.png"), &whole[..whole.len() / 2]).unwrap();
    fs::write(data("left_00040.png"), "no picture").unwrap();
    fs::remove_file(data("right_00055.png")).unwrap();
    RgbImage::new(48, 27).save(data("right_00070.png")).unwrap();
    let mut huge = whole.clone();
    huge[16..24].copy_from_slice(&[0, 1, 0, 0, 0, 1, 0, 0]);
    let sum = crc32fast::hash(&huge[12..29]);
    huge[29..33].copy_from_slice(&sum.to_be_bytes());
    fs::write(data("left_00085.png"), huge).unwrap();
    let broken = [
        ("00010", "empty"),
        ("00025", "cannot be decoded"),
        ("00040", "is not a PNG, JPEG, BMP, WebP or TIFF image"),
        ("00055", "no right image"),
        ("00070", "48x27"),
        ("00085", "too large"),
    ];

    let command = format!("{SEES} data --batch 3 --jsonl a.jsonl --csv a.csv --annotate seen");
    let outcome = place.line(&command);
    for (frame, reason) in broken {
        let is_named =
            |line: &str| line.contains(&format!("failed: {frame}: ")) && line.contains(reason);
        assert!(
            outcome.stderr.lines().any(is_named),
            "{frame} {reason}: {}",
            outcome.stderr
        );
    }
    for words in [
        "94 of 100 frames measured",
        "6 frames failed",
        "images/s",
        "detect",
    ] {
        assert!(
            outcome.stderr.contains(words),
            "{words}: {}",
            outcome.stderr
        );
    }
    assert_eq!(outcome.success(), "", "the lines went to the file");

    let results = lines(&fs::read_to_string(place.path("a.jsonl")).unwrap());
    assert_eq!(results.len(), 100);
    for (number, line) in results.iter().enumerate() {
        let name = format!("{number:05}");
        assert_eq!(line["frame"], *name);
        let reason = broken.iter().find(|(frame, _)| *frame == name);
        match reason {
            Some((_, reason)) => assert!(line["error"].as_str().unwrap().contains(reason)),
            None => assert!(line["vehicles"].is_array() && line["error"].is_null()),
        }
    }
    assert_eq!(files_below(&place.path("seen")), 94);
    let rows = fs::read_to_string(place.path("a.csv")).unwrap();
    let count: usize = vehicles(&results)
        .iter()
        .filter_map(|of| Some(of.as_array()?.len()))
        .sum();
    assert_eq!(rows.lines().count(), 1 + count);

    place
        .line("predict --run run data --strict --jsonl b.jsonl")
        .error_says(&["6 of 100 frames", "--strict", "failed: 00010"]);
    let kept = fs::read_to_string(place.path("b.jsonl")).unwrap();
    assert_eq!(kept.lines().count(), 100);
}

#[test]
fn where_no_frame_can_be_used_it_is_an_error() {
    let place = with_pairs(2);
    for number in 0..2 {
        fs::write(place.path(format!("data/left_{number:05}.png")), "").unwrap();
    }
    let outcome = place.line("predict --run run data");
    assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
    assert!(
        outcome.stderr.contains("not a single one"),
        "{}",
        outcome.stderr
    );
    assert_eq!(lines(&outcome.stdout).len(), 2);
}

#[test]
fn a_frame_without_vehicles_has_an_empty_list() {
    let place = with_pairs(2);
    let outcome = place.line("predict --run run data --confidence 1 --csv -");
    assert!(
        outcome.stderr.contains("2 frames without any"),
        "{}",
        outcome.stderr
    );
    let table = outcome.success();
    assert!(
        table.starts_with("frame,") && table.lines().count() == 1,
        "{table}"
    );
    let quiet = place.line("--quiet predict --run run data --confidence 1");
    assert_eq!(quiet.stderr, "");
    assert!(
        lines(&quiet.success())
            .iter()
            .all(|line| line["vehicles"] == Value::Array(vec![]))
    );
}

#[test]
fn a_vehicle_that_one_image_shows_is_reported_as_asked() {
    let place = with_pairs(0);
    save(&place, "l.png", &texture(64, 36, 1, 0));
    save(&place, "r.png", &RgbImage::from_pixel(64, 36, Rgb([9; 3])));
    for (how, is_kept) in [("drop", false), ("search", false), ("keep", true)] {
        let asked = format!("{SEES} l.png r.png --ranger paper --single-sided {how}");
        let json = place.line(&asked);
        let json: Value = serde_json::from_str(&json.success()).unwrap();
        assert_eq!(json["vehicles"], Value::Array(vec![]));
        let alone = &json["without_distance"];
        assert_eq!(alone.is_array(), is_kept, "{how}: {json}");
        if is_kept {
            assert_eq!(alone[0]["detected_in"], "left");
            assert!(alone[0]["box"]["x_min"].is_number() && alone[0]["distance_m"].is_null());
        }
    }
    let asked = format!("{SEES} l.png r.png --ranger paper --single-sided keep --csv -");
    let table = place.line(&asked);
    let table = table.success();
    assert!(table.lines().nth(1).unwrap().contains(",left,"), "{table}");
    // The posterior has an answer for what only one image shows: its size, and a wide interval.
    let json = place.line(&format!("{SEES} l.png r.png")).success();
    let json: Value = serde_json::from_str(&json).unwrap();
    let vehicles = json["vehicles"].as_array().unwrap();
    assert!(!vehicles.is_empty(), "{json}");
    for vehicle in vehicles {
        let metres = |name: &str| vehicle[name].as_f64().unwrap();
        let width_m = metres("distance_high_m") - metres("distance_low_m");
        assert!(width_m > 0.2 * metres("distance_m"), "{vehicle}");
    }
}

#[test]
fn the_distance_comes_with_its_interval_its_witnesses_and_its_disparity() {
    let place = with_pairs(2);
    let found = lines(&place.line(&format!("{SEES} data")).success());
    let mut count = 0;
    for vehicle in vehicles(&found)
        .iter()
        .flat_map(|of| of.as_array().unwrap())
    {
        let middle = |side: &str| {
            let edge = |edge: &str| vehicle[side][edge].as_f64().unwrap();
            f64::midpoint(edge("x_min"), edge("x_max"))
        };
        let disparity_px = vehicle["disparity_px"].as_f64().unwrap();
        // Boxes at a border of the image are clipped.
        if vehicle["right"]["x_min"].as_f64().unwrap() > 0.0 {
            assert!((middle("left") - middle("right") - disparity_px).abs() < 1e-6);
        }
        assert!(disparity_px > 0.0, "{vehicle}");
        let metres = |name: &str| vehicle[name].as_f64().unwrap();
        let (low_m, high_m) = (metres("distance_low_m"), metres("distance_high_m"));
        assert!((low_m..high_m).contains(&metres("distance_m")), "{vehicle}");
        assert!(metres("distance_std_m") > 0.0 && metres("size_m") > 0.0);
        assert!(vehicle["network_m"].is_number());
        count += 1;
    }
    assert!(count > 0);
    let table = place.line(&format!("{SEES} data --csv -")).success();
    let mut rows = csv::Reader::from_reader(table.as_bytes());
    let columns = rows.headers().unwrap().clone();
    for name in [
        "distance_std_m",
        "distance_low_m",
        "distance_high_m",
        "size_m",
        "stereo_m",
    ] {
        assert!(columns.iter().any(|column| column == name), "{name}");
    }
    assert_eq!(rows.records().count(), count);
    let detected = format!("{SEES} data --pairing detect --single-sided drop");
    for line in lines(&place.line(&detected).success()) {
        for vehicle in line["vehicles"].as_array().unwrap() {
            assert!(vehicle["disparity_px"].is_null(), "{vehicle}");
        }
        assert!(line["error"].is_null());
    }
}

#[test]
fn what_is_strange_about_the_images_is_noted_once() {
    let place = with_pairs(3);
    let noted = |inputs: &str| {
        let outcome = place.line(&format!("{SEES} {inputs}"));
        let notes = outcome
            .stderr
            .lines()
            .filter(|line| line.contains("note: "));
        let notes: Vec<String> = notes.map(str::to_owned).collect();
        outcome.success();
        notes
    };
    assert_eq!(noted("data"), [""; 0]);
    for number in 3..7 {
        for side in ["left", "right"] {
            let image = texture(96, 40, number, 0);
            save(&place, &format!("data/{side}_{number:05}.png"), &image);
        }
    }
    let notes = noted("data --batch 2");
    let count = |words: &str| notes.iter().filter(|note| note.contains(words)).count();
    assert_eq!(count("96x40"), 1, "{notes:?}");
    assert_eq!(
        count("frame 00003: the left and the right image are the same"),
        1
    );
    assert_eq!(notes.len(), 2, "{notes:?}");
    let same = noted("data/left_00001.png data/left_00001.png");
    assert!(
        same.len() == 1 && same[0].contains("are the same"),
        "{same:?}"
    );
    let outcome = place.line(&format!("--quiet {SEES} data"));
    assert_eq!(outcome.stderr, "");
}

#[test]
fn a_region_is_typed_or_read_from_a_file() {
    let place = with_pairs(2);
    place.write("road.txt", "# all of it\n0,0\n64,0\n64,36\n0,36\n");
    place.write("road.json", "[[0,0],[64,0],[64,36],[0,36]]");
    let all = place.line(&format!("{SEES} data")).success();
    for region in ["road.txt", "road.json", "0,0 64,0 64,36 0,36"] {
        let args = SEES.split(' ').chain(["data", "--roi", region]);
        assert_eq!(place.run(args).success(), all, "{region}");
    }
    let args = SEES.split(' ').chain(["data", "--roi", "0,0 1,0 1,1"]);
    let corner = place.run(args).success();
    assert!(
        lines(&corner)
            .iter()
            .all(|line| line["vehicles"] == Value::Array(vec![]))
    );
}

#[test]
fn hostile_settings_are_refused_before_the_work() {
    let place = with_pairs(1);
    place.write("file", "x");
    for (args, words) in [
        ("--confidence NaN", &["from 0 to 1"][..]),
        ("--iou 1.5", &["1.5", "from 0 to 1"]),
        ("--iou=-0.1", &["-0.1", "from 0 to 1"]),
        ("--max-detections 0", &["--max-detections"]),
        ("--max-detections 99999999999", &["--max-detections"]),
        ("--batch 0", &["--batch"]),
        ("--batch 1000", &["--batch"]),
        ("--classes tank", &["tank", "car, truck"]),
        ("--classes car,", &["class \"\"", "car, truck"]),
        ("--roi 1,1", &["--roi", "three corners"]),
        ("--roi 0,0;1,1;2,2", &["--roi", "no area"]),
        ("--roi 0,0;NaN,1;2,2", &["--roi"]),
        ("--roi nothere.txt", &["nothere.txt", "check the path"]),
        ("--roi nothere", &["cannot read nothere", "check the path"]),
        ("--roi run", &["cannot read run"]),
        ("--roi file", &["--roi", "three corners"]),
        ("--single-sided maybe", &["maybe", "drop, search, keep"]),
        (
            "--layout diagonal",
            &["diagonal", "side-by-side, top-bottom"],
        ),
        ("--fps 5", &["--video"]),
        ("--video seen.gif", &["seen.gif", ".mp4"]),
        ("--video seen", &[".mp4"]),
        ("--jsonl - --csv -", &["standard output"]),
        ("--jsonl a --csv a", &["two kinds"]),
        ("--jsonl file/b/a", &["file/b"]),
        ("--annotate file", &["file", "folder"]),
    ] {
        let outcome = place.line(&format!("predict --run run data {args}"));
        outcome.error_says(words);
    }
    place.line("predict --run run").error_says(&["<INPUT>"]);
    place.line("predict --run run a b c").error_says(&["'c'"]);
}

/// A prediction whose first line has come, and the way to the others.
fn begun(place: &Workplace, line: &str) -> (Child, String, BufReader<ChildStdout>) {
    let mut command = place.command();
    command
        .args(line.split(' '))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut reader = BufReader::new(child.stdout.take().unwrap());
    let mut first = String::new();
    reader.read_line(&mut first).unwrap();
    (child, first, reader)
}

#[test]
fn a_reader_that_has_seen_enough_ends_it() {
    let place = with_pairs(40);
    let (child, first, reader) = begun(&place, "predict --run run data");
    drop(reader);
    let outcome = Outcome::of(child.wait_with_output().unwrap());
    assert_eq!(outcome.code, Some(0), "{}", outcome.stderr);
    assert_eq!(lines(&first)[0]["frame"], "00000");
}

#[cfg(unix)]
#[test]
fn ctrl_c_keeps_what_was_done() {
    let place = with_pairs(3000);
    let line = "predict --run run data --csv a.csv --annotate seen";
    let (child, _, reader) = begun(&place, line);
    let mut kill = Command::new("kill");
    let killed = kill.args(["-INT", &child.id().to_string()]).status();
    assert!(killed.unwrap().success());
    let count = 1 + reader.lines().count();
    let outcome = Outcome::of(child.wait_with_output().unwrap());
    assert_eq!(outcome.code, Some(130), "{}", outcome.stderr);
    let kept = format!("results of {count} frames are kept");
    assert!(outcome.stderr.contains(&kept), "{kept}: {}", outcome.stderr);
    assert!(count < 3000 && place.path("a.csv").exists());
    assert_eq!(files_below(&place.path("seen")), count);
    // Nothing half-written is left.
    let names = fs::read_dir(place.path("")).unwrap();
    let names = names.map(|entry| entry.unwrap().file_name());
    let is_hidden = |name: std::ffi::OsString| name.to_string_lossy().starts_with('.');
    assert!(!names.into_iter().any(is_hidden));
}
