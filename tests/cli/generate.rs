//! Generation that is killed, grows, or is asked for more than pictures.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use super::binary::Workplace;

/// The files of a dataset by name.
fn content(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut content = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            for (inner, bytes) in self::content(&path) {
                content.insert(format!("{name}/{inner}"), bytes);
            }
        } else {
            content.insert(name, fs::read(&path).unwrap());
        }
    }
    content
}

#[cfg(unix)]
#[test]
fn a_killed_generation_goes_on_without_redoing_or_spoiling_a_frame() {
    let place = Workplace::new();
    let generate = |out: &str| format!("generate --config tiny.toml --out {out}");
    place.write(
        "tiny.toml",
        "frames = 24\nframes_per_scene = 4\nwidth = 160\nheight = 90\nvehicles = 3\n",
    );
    let mut child = place
        .command()
        .args(generate("killed").split_whitespace())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let begun = Instant::now();
    let frames = place.path("killed/frames");
    let written = || fs::read_dir(&frames).map_or(0, Iterator::count);
    while written() < 20 {
        assert!(
            begun.elapsed() < Duration::from_mins(2),
            "nothing was generated"
        );
        std::thread::sleep(Duration::from_millis(2));
    }
    // SIGKILL: the program cannot clean up.
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!place.path("killed/dataset.toml").exists());
    // When the whole frames were written; the others are redone.
    let times: Vec<_> = (0..24)
        .filter_map(|stamp| {
            let names = ["left_", "right_"].map(|side| format!("{side}{stamp:05}"));
            let files = names
                .iter()
                .flat_map(|n| [format!("{n}.png"), format!("{n}.txt")]);
            let times = files.map(|file| {
                let path = frames.join(file);
                let time = fs::metadata(&path).ok()?.modified().ok()?;
                Some((path, time))
            });
            times.collect::<Option<Vec<_>>>()
        })
        .flatten()
        .collect();
    let kept = times.len() / 4;
    let made = place.line(&generate("killed")).success();
    let expected = match kept {
        24 => "kept".to_owned(),
        _ => format!("24 frames (20 train, 4 val, 0 test), {kept} of them kept"),
    };
    assert!(made.contains(&expected), "{made} should say {expected}");
    for (path, time) in times {
        assert_eq!(fs::metadata(&path).unwrap().modified().unwrap(), time);
    }
    place.line(&generate("whole")).success();
    assert!(content(&place.path("killed")) == content(&place.path("whole")));
}

#[test]
fn a_dataset_grows_and_says_how_many_frames_it_has_now() {
    let place = Workplace::new();
    place.write("tiny.toml", super::TINY_DATASET);
    let generate = "generate --config tiny.toml --out d";
    place.line(generate).success();
    let made = place.line("generate --add 4 --out d").success();
    assert!(
        made.contains("dataset d: 12 frames") && made.contains("8 of them kept"),
        "{made}"
    );
    place
        .line(generate)
        .error_says(&["already holds these 10 frames"]);
    let made = place.line(&format!("{generate} --frames 12")).success();
    assert!(made.contains("dataset d: 14 frames"), "{made}");
    place.line("generate --add 4").error_says(&["--out"]);
    place
        .line("generate --add 4 --out d --seed 3")
        .error_says(&["--add", "--seed"]);
    place
        .line("generate --add 0 --out d")
        .error_says(&["frames = 0"]);
}

#[test]
fn the_cameras_are_given_by_flags_and_the_test_frames_can_be_left_out() {
    let place = Workplace::new();
    place.write("tiny.toml", super::TINY_DATASET);
    let made = place
        .line("generate --config tiny.toml --no-test --hfov-deg 60 --baseline-m 0.12 --out d")
        .success();
    assert!(
        made.contains("6 frames") && made.contains("0 test"),
        "{made}"
    );
    let info = fs::read_to_string(place.path("d/dataset.toml")).unwrap();
    for line in ["hfov_deg = 60.0", "baseline_m = 0.12"] {
        assert!(info.contains(line), "{line} should be in {info}");
    }
    assert!(!info.contains("distances_m"), "{info}");
    for (flag, word) in [
        ("--hfov-deg 170", "hfov_deg"),
        ("--baseline-m 0", "baseline_m"),
    ] {
        place
            .line(&format!("generate --config tiny.toml {flag} --out e"))
            .error_says(&[word]);
    }
    place
        .line("generate --add 4 --out d --no-test")
        .error_says(&["--add", "--no-test"]);
    assert!(!place.path("e").exists());
}

#[test]
fn a_folder_of_other_files_is_refused_and_left_alone() {
    let place = super::with_dataset();
    place.write("notes/diary.txt", "mine");
    place.line("export yolo data --out yolo").success();
    for line in [
        "generate --config tiny.toml --out notes",
        "import yolo yolo --out notes",
        "export yolo data --out notes",
    ] {
        place
            .line(line)
            .error_says(&["notes", "diary.txt", "folder"]);
    }
    assert_eq!(content(&place.path("notes")).len(), 1);
    // A file that keeps an empty folder in a repository is no content.
    place.write("kept/.gitkeep", "");
    place
        .line("generate --config tiny.toml --out kept")
        .success();
}

#[test]
fn a_generated_dataset_of_crowded_streets_has_nothing_wrong_and_its_tables_join_as_text() {
    let place = Workplace::new();
    place.write("tiny.toml", super::TINY_DATASET);
    place
        .line(
            "generate --config tiny.toml --no-test --frames 24 --vehicles 10 --size 256x144 --out d",
        )
        .success();
    let checked = place.line("validate d").success();
    assert!(checked.contains("nothing wrong"), "{checked}");
    let labels = fs::read_dir(place.path("d/frames")).unwrap();
    let hidden = labels
        .filter_map(|entry| fs::read_to_string(entry.unwrap().path()).ok())
        .flat_map(|text| text.lines().map(str::to_owned).collect::<Vec<_>>())
        .filter(|line| line.contains("tight 0."))
        .count();
    assert!(hidden > 60, "only {hidden} boxes of partly hidden vehicles");
    let objects = fs::read_to_string(place.path("d/objects.csv")).unwrap();
    let frames = fs::read_to_string(place.path("d/frames.csv")).unwrap();
    let stamp = |line: &str| line.split(',').next().unwrap().to_owned();
    let known: Vec<String> = frames.lines().map(stamp).collect();
    assert!(
        objects.lines().all(|line| known.contains(&stamp(line))),
        "{objects}"
    );
}

#[test]
fn extra_outputs_and_vehicles_are_asked_for_by_name() {
    let place = Workplace::new();
    place.write("tiny.toml", super::TINY_DATASET);
    place
        .line("generate --config tiny.toml --vehicles 2-3 --outputs depth,poses --out d")
        .success();
    let content = content(&place.path("d"));
    let count = |folder: &str| {
        content
            .keys()
            .filter(|name| name.starts_with(folder))
            .count()
    };
    assert_eq!(
        (count("depth/"), count("disparity/"), count("frames/")),
        (16, 0, 32)
    );
    assert!(content.contains_key("poses.csv") && content.contains_key("objects.csv"));
    place
        .line("generate --outputs colour --out o")
        .error_says(&["colour", "disparity"]);
    place
        .line("generate --vehicles few --out o")
        .error_says(&["few", "4-8"]);
    place
        .line("generate --vehicles 8-4 --out o")
        .error_says(&["vehicles = [8, 4]"]);
    assert!(!place.path("o").exists());
}

#[test]
fn assets_that_cannot_be_used_are_named_before_anything_is_written() {
    let place = Workplace::new();
    place.write("tiny.toml", super::TINY_DATASET);
    let generate = "generate --config tiny.toml --out d --assets";
    place
        .line(&format!("{generate} nowhere"))
        .error_says(&["nowhere", "is no folder"]);
    std::fs::create_dir(place.path("empty")).unwrap();
    place
        .line(&format!("{generate} empty"))
        .error_says(&["no vehicles and no props"]);
    place.write("broken/vehicles/car.glb", b"glTF and then nothing");
    place
        .line(&format!("{generate} broken"))
        .error_says(&["car.glb", "export"]);
    place.write("flat/vehicles/car.gltf", r#"{"asset": {"version": "2.0"}}"#);
    place
        .line(&format!("{generate} flat"))
        .error_says(&["car.gltf", "has no scene"]);
    // A body of the configuration may come from the folder that the command line names.
    let brick = format!(
        "{}[appearance]\nbodies = [\"brick\"]\n",
        super::TINY_DATASET
    );
    place.write("brick.toml", brick);
    place
        .line("generate --config brick.toml --out d")
        .error_says(&["brick", "--assets"]);
    place
        .line("generate --config brick.toml --out d --assets broken")
        .error_says(&["car.glb", "export"]);
    assert!(!place.path("d").exists());
    place.line("generate --config tiny.toml --out d").success();
    place
        .line("generate --add 2 --out d --assets broken")
        .error_says(&["without assets"]);
}
