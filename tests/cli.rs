//! The program as a user meets it: exit codes, what is printed where, and what errors say.
#![allow(clippy::unwrap_used, reason = "a test stops at whatever is unexpected")]

#[path = "cli/ablate.rs"]
mod ablate;
#[path = "support/binary.rs"]
mod binary;
#[path = "cli/calibrate.rs"]
mod calibrate;
#[path = "cli/calibration.rs"]
mod calibration;
#[path = "cli/evaluate.rs"]
mod evaluate;
#[path = "cli/formats.rs"]
mod formats;
#[path = "cli/generate.rs"]
mod generate;
#[path = "cli/outputs.rs"]
mod outputs;
#[path = "cli/pairing.rs"]
mod pairing;
#[path = "cli/predict.rs"]
mod predict;
#[path = "cli/report.rs"]
mod report;
#[path = "cli/training.rs"]
mod training;
#[path = "support/untrained.rs"]
mod untrained;
#[path = "cli/videos.rs"]
mod videos;
#[cfg(feature = "remote")]
#[path = "cli/worker.rs"]
mod worker;

use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use binary::{Outcome, Workplace};

const COMMANDS: [&str; 13] = [
    "generate",
    "import",
    "export",
    "validate",
    "inspect",
    "prepare",
    "train",
    "evaluate",
    "ablate",
    "report",
    "predict",
    "calibrate",
    "devices",
];
/// Commands that a build may lack.
const OPTIONAL_COMMANDS: &[&str] = if cfg!(feature = "remote") {
    &["worker"]
} else {
    &[]
};

/// A dataset that is made in a moment.
const TINY_DATASET: &str = "
frames = 6
frames_per_scene = 3
vehicles = 1
width = 128
height = 72
distance_max_m = 15.0
samples_per_pixel = 1
val_fraction = 0.34
[test]
distances_m = [12.0]
suns = [\"noon\"]
views = [\"front\", \"rear\"]
scenes = 1
";

/// A training that shows everything but learns nothing, in seconds.
const TINY_TRAINING: &str = "
box_kind = \"sphere\"
[detector]
scale = \"n\"
image_size = 64
epochs = 1
batch = 4
micro_batch = 4
[distance]
composite = \"324x162\"
epochs = 1
batch = 4
micro_batch = 4
";

/// A folder with a tiny dataset `data` and the settings of a tiny training, `training.toml`.
fn with_dataset() -> Workplace {
    let place = Workplace::new();
    place.write("tiny.toml", TINY_DATASET);
    place.write("training.toml", TINY_TRAINING);
    place
        .line("generate --config tiny.toml --out data")
        .success();
    place
}

/// The number of files below a folder.
fn files_below(folder: &Path) -> usize {
    let entries = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    entries
        .map(|path| if path.is_dir() { files_below(&path) } else { 1 })
        .sum()
}

#[test]
fn the_help_of_every_command_is_a_manual_with_an_example() {
    let place = Workplace::new();
    let manual = place.line("--help").success();
    for command in COMMANDS.iter().chain(OPTIONAL_COMMANDS) {
        assert!(
            manual.contains(&format!("\n  {command} ")),
            "{command} should be listed"
        );
        let help = place.run([*command, "--help"]).success();
        assert!(help.contains("Examples:") && help.contains(&format!("twinsight {command}")));
        assert_eq!(place.run(["help", *command]).success(), help);
    }
}

#[test]
fn defaults_are_shown_in_the_help() {
    let place = Workplace::new();
    for (command, default) in [
        ("generate", "quick"),
        ("prepare", "340x170"),
        ("train", "flex"),
        ("evaluate", "test"),
        ("predict", "0.35"),
    ] {
        let help = place.run([command, "--help"]).success();
        assert!(
            help.contains(&format!("[default: {default}]")),
            "{default} of {command}"
        );
    }
}

#[test]
fn the_version_is_that_of_the_package() {
    let version = Workplace::new().line("--version").success();
    assert_eq!(
        version,
        format!("twinsight {}\n", env!("CARGO_PKG_VERSION"))
    );
}

#[test]
fn a_missing_command_and_an_unknown_option_are_usage_errors() {
    let place = Workplace::new();
    assert_eq!(place.line("").code, Some(2));
    place.line("train --fast").error_says(&["--fast"]);
}

#[test]
fn the_device_list_has_every_kind_and_the_processor_is_ready() {
    let place = Workplace::new();
    let mut command = place.command();
    command.arg("devices");
    command.env_remove("XDG_RUNTIME_DIR").env_remove("DISPLAY");
    let outcome = Outcome::of(command.output().unwrap());
    assert_eq!(outcome.stderr, "", "drivers have nothing to say");
    let list = outcome.success();
    for kind in ["flex", "ndarray", "wgpu", "cuda"] {
        assert!(
            list.lines().any(|line| line.starts_with(kind)),
            "{kind} in {list}"
        );
    }
    assert!(list.starts_with("flex     ready"), "{list}");
}

#[test]
fn an_unknown_device_is_refused_with_the_known_ones() {
    let place = Workplace::new();
    for command in [
        "train",
        "evaluate --run r --data d",
        "predict --run r a.png b.png",
    ] {
        place.line(&format!("{command} --device tpu")).error_says(&[
            "\"tpu\"",
            "flex, ndarray, wgpu or cuda",
            "twinsight devices",
        ]);
    }
}

#[test]
fn a_device_that_this_machine_does_not_have_is_refused_before_anything_is_made() {
    let place = Workplace::new();
    place
        .line("train --device flex:3")
        .error_says(&["device flex:3", "--device flex"]);
    assert_eq!(files_below(&place.path("")), 0);
}

#[test]
fn an_unknown_preset_is_refused_with_the_known_ones() {
    let place = Workplace::new();
    for command in ["generate", "train"] {
        place
            .run([command, "--preset", "huge"])
            .error_says(&["huge", "quick", "paper"]);
    }
}

#[test]
fn a_preset_and_a_configuration_of_a_dataset_exclude_each_other() {
    let place = Workplace::new();
    place
        .line("generate --preset quick --config a.toml")
        .error_says(&["--preset", "--config"]);
}

#[test]
fn a_size_that_cannot_be_used_is_refused() {
    let place = Workplace::new();
    for size in ["640", "640x", "ax3", "-5x4", "64.5x64"] {
        place
            .run(["generate", &format!("--size={size}"), "--out", "o"])
            .error_says(&[size, "width x height"]);
    }
    place.line("generate --size 0x0 --out o").error_says(&["0"]);
    place
        .line("prepare data --composite 100x50")
        .error_says(&["100x50", "324x162"]);
    assert!(!place.path("o").exists());
}

#[test]
fn a_number_out_of_range_is_refused_by_name() {
    let place = Workplace::new();
    place
        .line("generate --frames 0 --out o")
        .error_says(&["frames = 0"]);
    place.line("generate --seed -1").error_says(&["-1"]);
    place
        .line("train --epochs 0")
        .error_says(&["detector.epochs = 0"]);
    place
        .line("train --learning-rate NaN")
        .error_says(&["learning_rate = NaN"]);
    place.line("train --scale xxl").error_says(&["xxl"]);
    place
        .line("predict --run r a.png b.png --confidence 1.5")
        .error_says(&["1.5", "from 0 to 1"]);
    assert_eq!(files_below(&place.path("")), 0);
}

#[test]
fn an_unknown_setting_in_a_configuration_is_named_with_its_file() {
    let place = Workplace::new();
    place.write("my.toml", "framez = 3\n");
    place
        .line("generate --config my.toml")
        .error_says(&["my.toml", "framez"]);
    place.write("my.toml", "[detector]\nepoch = 3\n");
    place
        .line("train --config my.toml")
        .error_says(&["my.toml", "epoch"]);
}

#[test]
fn a_configuration_that_is_missing_or_no_toml_is_named() {
    let place = Workplace::new();
    place.write("broken.toml", "frames = = 3");
    for command in ["generate", "train"] {
        place
            .run([command, "--config", "nowhere.toml"])
            .error_says(&["nowhere.toml", "check the path"]);
        place
            .run([command, "--config", "broken.toml"])
            .error_says(&["broken.toml"]);
    }
}

#[test]
fn generating_prints_what_was_made_and_a_finished_dataset_is_never_overwritten() {
    let place = Workplace::new();
    place.write("tiny.toml", TINY_DATASET);
    let made = place
        .line("generate --config tiny.toml --frames 3 --seed 5")
        .success();
    assert!(
        made.starts_with("dataset datasets/tiny: 5 frames"),
        "{made}"
    );
    assert!(place.path("datasets/tiny/frames.csv").exists());
    place
        .line("generate --config tiny.toml --frames 4")
        .error_says(&["datasets/tiny", "another folder"]);
}

#[test]
fn quiet_leaves_nothing_on_standard_error() {
    let place = Workplace::new();
    place.write("tiny.toml", TINY_DATASET);
    let outcome = place.line("--quiet generate --config tiny.toml --out d");
    assert_eq!(outcome.stderr, "");
    assert!(outcome.success().contains("8 frames"));
}

#[test]
fn an_output_folder_below_a_file_is_refused() {
    let place = with_dataset();
    place
        .line("generate --config tiny.toml --out tiny.toml/x")
        .error_says(&["tiny.toml/x", "cannot create"]);
    place
        .line("train --config training.toml --data data --run tiny.toml/x")
        .error_says(&["tiny.toml/x", "cannot create"]);
}

#[test]
fn a_place_where_a_file_cannot_be_written_is_refused_before_the_work() {
    let place = with_dataset();
    place
        .line("evaluate --run nowhere --data data --json tiny.toml/x/a.json")
        .error_says(&["tiny.toml/x"]);
    place
        .line("evaluate --run nowhere --data data --json data")
        .error_says(&["is a folder"]);
    place
        .line("predict --run nowhere a.png b.png --annotate data")
        .error_says(&["is a folder"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_behind_standard_output_is_an_error() {
    let place = with_dataset();
    for args in [&["prepare", "data"][..], &["--help"]] {
        let full = fs::OpenOptions::new()
            .write(true)
            .open("/dev/full")
            .unwrap();
        let output = place.command().args(args).stdout(full).output().unwrap();
        Outcome::of(output).error_says(&["standard output", "free some space"]);
    }
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let place = with_dataset();
    for args in [&["devices"][..], &["--help"], &["prepare", "data"]] {
        let mut command = place.command();
        command
            .args(args)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        drop(child.stdout.take());
        let outcome = Outcome::of(child.wait_with_output().unwrap());
        assert_eq!(outcome.code, Some(0), "{args:?}: {}", outcome.stderr);
    }
}

#[test]
fn an_empty_or_missing_dataset_folder_is_named() {
    let place = Workplace::new();
    fs::create_dir(place.path("empty")).unwrap();
    for folder in ["empty", "nowhere"] {
        place.run(["prepare", folder]).error_says(&[folder]);
        place
            .run(["train", "--data", folder, "--run", "r"])
            .error_says(&[folder]);
    }
}

#[test]
fn preparing_leaves_a_broken_frame_out_and_says_so() {
    let place = with_dataset();
    let image = place.path("data/frames/left_00001.png");
    let bytes = fs::read(&image).unwrap();
    fs::write(&image, &bytes[..bytes.len() / 2]).unwrap();
    let outcome = place.line("prepare data --composite 324x162");
    assert!(
        outcome.stderr.contains("left_00001.png"),
        "{}",
        outcome.stderr
    );
    let report = outcome.success();
    assert!(report.contains("test of 324x162"), "{report}");
    let tight = place
        .line("prepare data --composite 324x162 --box-kind tight")
        .success();
    assert!(tight.contains("tight"), "{tight}");
}

#[test]
fn a_pair_that_cannot_be_used_is_refused_by_name() {
    let place = Workplace::new();
    let left = place.write_image("left.png", 96, 54);
    place.write_image("right.png", 96, 54);
    place.write_image("small.png", 48, 27);
    let bytes = fs::read(left).unwrap();
    place.write("truncated.png", &bytes[..bytes.len() / 2]);
    place.write("text.png", "no image");
    place.write("nothing.png", "");
    for (pair, words) in [
        (
            "left.png small.png",
            &["left.png", "96x54", "small.png", "48x27"][..],
        ),
        (
            "truncated.png right.png",
            &["truncated.png", "cannot be decoded"],
        ),
        (
            "left.png text.png",
            &["text.png", "not a PNG, JPEG, BMP, WebP or TIFF"],
        ),
        ("nothing.png right.png", &["nothing.png", "empty"]),
        ("left.png nowhere.png", &["nowhere.png", "check the path"]),
    ] {
        place
            .line(&format!("predict --run r {pair}"))
            .error_says(words);
    }
    place
        .line("predict --run r left.png right.png")
        .error_says(&["run r", "no such folder", "twinsight train --run r"]);
    place.write("runs/a/config.json", "{}");
    place
        .line("predict --run runs/b left.png right.png")
        .error_says(&["run runs/b", "no such folder", "give one of runs/a"]);
    place
        .line("predict --run runs/a left.png right.png")
        .error_says(&["runs/a/detector", "twinsight train detector --run runs/a"]);
}

#[test]
fn evaluating_a_run_that_is_missing_names_it() {
    let place = with_dataset();
    place
        .line("evaluate --run nowhere --data data")
        .error_says(&["nowhere"]);
}

#[test]
fn weights_that_cannot_be_used_are_named_before_the_training() {
    let place = with_dataset();
    let train = "train --config training.toml --data data --run r --weights";
    place
        .line(&format!("{train} nowhere.safetensors"))
        .error_says(&["nowhere.safetensors"]);
    place.write("other.safetensors", "no weights");
    place
        .line(&format!("{train} other.safetensors"))
        .error_says(&["other.safetensors"]);
    place.write("other.pt", "no weights");
    place.line(&format!("{train} other.pt")).error_says(&[
        "other.pt",
        "never executed",
        "safetensors",
    ]);
}

#[test]
fn training_ends_with_the_commands_to_go_on_and_they_work() {
    let place = with_dataset();
    let train = "train --config training.toml --data data --run runs/a";
    let report = place.line(train).success();
    assert!(report.contains("run folder:   runs/a"), "{report}");
    assert!(report.contains("tensorboard --logdir runs/a"), "{report}");
    let next = report
        .lines()
        .find_map(|line| line.strip_prefix("next command: "))
        .unwrap();
    let mut words = next.split_whitespace();
    assert_eq!(words.next(), Some(env!("CARGO_BIN_EXE_twinsight")));

    // The lowest confidence, so that even this network sees something.
    let outcome = place.run(words.chain(["--confidence", "0.0001", "--annotate", "seen/a.png"]));
    assert_eq!(outcome.stderr, "");
    let prediction: serde_json::Value = serde_json::from_str(&outcome.success()).unwrap();
    assert!(
        prediction["left"]
            .as_str()
            .unwrap()
            .starts_with("data/frames/left_")
    );
    for vehicle in prediction["vehicles"].as_array().unwrap() {
        assert_eq!(vehicle["class"], "car");
        assert!(vehicle["distance_m"].is_number() && vehicle["left"]["x_min"].is_number());
    }
    assert_eq!(
        image::open(place.path("seen/a.png")).unwrap().width(),
        2 * 128
    );

    let tables = place
        .line("evaluate --run runs/a --data data --json figures/a.json")
        .success();
    for word in [
        "precision",
        "recall",
        "mAP50",
        "MAE",
        "RMSE",
        "MRE",
        "missed",
    ] {
        assert!(tables.contains(word), "{word} in {tables}");
    }
    let figures = fs::read_to_string(place.path("figures/a.json")).unwrap();
    let figures: serde_json::Value = serde_json::from_str(&figures).unwrap();
    assert_eq!(figures["split"], "test");
}

#[test]
fn a_run_that_exists_is_only_touched_to_resume_or_to_add_the_other_network() {
    let place = with_dataset();
    let settings = "--config training.toml --data data --run r";
    let report = place.line(&format!("train distance {settings}")).success();
    let next = report
        .lines()
        .find_map(|line| line.strip_prefix("next command: "))
        .unwrap();
    assert!(
        next.contains("train detector") && next.contains("--run r"),
        "{next}"
    );
    let before = fs::read(place.path("r/distance/best.safetensors")).unwrap();
    for stage in ["distance", "all"] {
        place
            .line(&format!("train {stage} {settings}"))
            .error_says(&["run r", "exists already", "--resume", "--run"]);
    }
    assert_eq!(
        fs::read(place.path("r/distance/best.safetensors")).unwrap(),
        before
    );

    place.run(next.split_whitespace().skip(1)).success();
    place.line(&format!("train {settings} --resume")).success();

    let config = fs::read(place.path("r/config.json")).unwrap();
    place
        .line(&format!("train {settings} --resume --seed 77"))
        .error_says(&["other settings", "seed was 1 and is 77", "--run"]);
    assert_eq!(fs::read(place.path("r/config.json")).unwrap(), config);
}

#[test]
fn a_run_goes_on_with_its_own_settings_and_dataset() {
    let place = with_dataset();
    place
        .line("train --config training.toml --data data --run r")
        .success();
    let config = fs::read(place.path("r/config.json")).unwrap();
    place.line("train --run r --resume").success();
    assert_eq!(fs::read(place.path("r/config.json")).unwrap(), config);
    place
        .line("train --run r --resume --detector-epochs 77")
        .error_says(&["detector.epochs was", "is 77"]);
    fs::rename(place.path("data"), place.path("elsewhere")).unwrap();
    place
        .line("train --run r --resume")
        .error_says(&["data", "is not there", "--data"]);
    place
        .line("train --run r --resume --data elsewhere")
        .success();
}

#[test]
fn printed_settings_are_a_configuration() {
    let place = with_dataset();
    let printed = place
        .line("train --config training.toml --seed 5 --print-config")
        .success();
    assert!(printed.contains("[distance]"), "{printed}");
    place.write("mine.toml", &printed);
    let again = place
        .line("train --config mine.toml --print-config")
        .success();
    assert_eq!(again, printed);
    assert!(!place.path("checkpoints").exists());
}

#[test]
fn labels_without_distance_are_noticed_before_anything_is_trained() {
    let place = with_dataset();
    for entry in fs::read_dir(place.path("data/frames")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "txt") {
            continue;
        }
        let labels = fs::read_to_string(&path).unwrap();
        let without = labels.lines().map(|line| {
            let mut fields: Vec<&str> = line.split(' ').collect();
            if !line.starts_with('#') {
                fields[8] = "-";
            }
            fields.join(" ")
        });
        fs::write(&path, without.collect::<Vec<_>>().join("\n")).unwrap();
    }
    place
        .line("train --config training.toml --data data --run r")
        .error_says(&["data", "and a distance", "train detector"]);
    assert!(!place.path("r/detector").exists());
}

#[test]
fn a_run_that_divided_the_frames_anew_is_evaluated_on_the_frames_it_did_not_train_on() {
    let place = with_dataset();
    // The dataset itself keeps nothing for validation.
    let frames = fs::read_to_string(place.path("data/frames.csv")).unwrap();
    assert!(frames.contains(",val,"), "{frames}");
    place.write("data/frames.csv", frames.replace(",val,", ",train,"));
    place.write("anew.toml", format!("split = \"frame\"\n{TINY_TRAINING}"));
    place
        .line("train --config anew.toml --data data --run r")
        .success();
    place
        .line("evaluate --run r --data data --split val --json again.json")
        .success();
    let read = |file: &str| -> serde_json::Value {
        serde_json::from_slice(&fs::read(place.path(file)).unwrap()).unwrap()
    };
    let (trained, again) = (read("r/summary.json"), read("again.json"));
    for part in ["frames", "detection", "true_boxes", "pipeline"] {
        assert!(!again[part].is_null(), "{again}");
        assert_eq!(trained["evaluation"][part], again[part], "{part}");
    }
}

#[test]
fn weights_of_the_wrong_network_and_damaged_ones_are_refused_by_name() {
    let place = with_dataset();
    place
        .line("train --config training.toml --data data --run r")
        .success();
    let pair = "data/frames/left_00001.png data/frames/right_00001.png";
    let (detector, distance) = (
        place.path("r/detector/best.safetensors"),
        place.path("r/distance/best.safetensors"),
    );
    let weights = fs::read(&distance).unwrap();

    place
        .line("train --config training.toml --data data --run s --weights r/distance/best.safetensors")
        .error_says(&["distance/best.safetensors"]);
    fs::copy(&detector, &distance).unwrap();
    place
        .line(&format!("predict --run r {pair}"))
        .error_says(&["distance/best.safetensors"]);
    fs::write(&distance, &weights[..weights.len() / 2]).unwrap();
    place
        .line(&format!("predict --run r {pair}"))
        .error_says(&["distance/best.safetensors", "truncated"]);
    fs::remove_file(&distance).unwrap();
    place
        .line(&format!("predict --run r {pair}"))
        .error_says(&["distance", "train"]);
}

#[cfg(unix)]
#[test]
fn ctrl_c_stops_with_130_and_the_same_command_goes_on() {
    let place = Workplace::new();
    let generate = "generate --frames 40 --size 128x72 --out d";
    let mut command = place.command();
    command
        .args(generate.split_whitespace())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let child = command.spawn().unwrap();
    let begun = Instant::now();
    while !place.path("d/generating.toml").exists() {
        assert!(
            begun.elapsed() < Duration::from_mins(1),
            "nothing was generated"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
    let id = child.id().to_string();
    assert!(
        std::process::Command::new("kill")
            .args(["-INT", &id])
            .status()
            .unwrap()
            .success()
    );
    let outcome = Outcome::of(child.wait_with_output().unwrap());
    assert_eq!(
        (outcome.code, outcome.stdout.as_str()),
        (Some(130), ""),
        "{}",
        outcome.stderr
    );
    assert!(
        outcome.stderr.contains("interrupted; "),
        "{}",
        outcome.stderr
    );
    let made = place.line(generate).success();
    assert!(made.contains("76 frames"), "{made}");
}
