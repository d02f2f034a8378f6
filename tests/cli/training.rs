//! Training that is killed, resumed, damaged, or started on something else.

use std::fs;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use super::{Outcome, Workplace, with_dataset};

/// Both networks, a few epochs, with everything random that training has.
const THREE_EPOCHS: &str = "
[detector]
scale = \"n\"
image_size = 64
epochs = 3
batch = 4
micro_batch = 2
optimizer = \"sgd\"
warmup_epochs = 2.0
warmup_bias_rate = 0.02
mosaic = 0.5
close_mosaic = 1
multi_scale = 0.4
validate_every = 2
[distance]
composite = \"324x162\"
epochs = 3
batch = 4
micro_batch = 2
ema_decay = 0.9
";

const TRAIN: &str = "train --config three.toml --data data";

fn with_settings() -> Workplace {
    let place = with_dataset();
    place.write("three.toml", THREE_EPOCHS);
    place
}

/// What a run learnt and wrote down: weights, and the table without its times.
fn learnt(run: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<(String, Vec<u8>)> = ["detector", "distance"]
        .iter()
        .flat_map(|stage| ["best", "last"].map(|which| format!("{stage}/{which}.safetensors")))
        .map(|name| {
            let bytes = fs::read(run.join(&name)).unwrap();
            (name, bytes)
        })
        .collect();
    let table = fs::read_to_string(run.join("metrics.csv")).unwrap();
    let mut rows = csv::Reader::from_reader(table.as_bytes());
    let timed = rows
        .headers()
        .unwrap()
        .iter()
        .position(|name| name == "images_per_second")
        .unwrap();
    let mut untimed = String::new();
    for row in rows.records() {
        for (column, value) in row.unwrap().iter().enumerate() {
            if column != timed {
                untimed.push_str(value);
                untimed.push(',');
            }
        }
        untimed.push('\n');
    }
    files.push(("metrics.csv".to_owned(), untimed.into_bytes()));
    files
}

fn start(place: &Workplace, line: &str) -> Child {
    place
        .command()
        .args(line.split_whitespace())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

#[test]
fn a_run_that_is_killed_again_and_again_learns_what_an_uninterrupted_one_does() {
    let place = with_settings();
    let begun = Instant::now();
    place.line(&format!("{TRAIN} --run whole")).success();
    let whole = begun.elapsed();
    let wanted = learnt(&place.path("whole"));

    // Twenty moments spread over a run, early and late ones mixed; a run that survives to its end is
    // compared, and another one is killed from then on.
    let (mut kills, mut runs) = (0_u32, 0_u32);
    let mut begins = true;
    while kills < 20 {
        let share = f64::from(kills * 7 % 20 + 1) / 22.0;
        let run = format!("killed-{runs}");
        let resume = if begins { "" } else { "--resume" };
        let mut child = start(&place, &format!("{TRAIN} --run {run} {resume}"));
        let wait = Duration::from_secs_f64(whole.as_secs_f64() * share * 0.6);
        let begun = Instant::now();
        while begun.elapsed() < wait && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(2));
        }
        if child.try_wait().unwrap().is_some() {
            Outcome::of(child.wait_with_output().unwrap()).success();
            assert_learnt_alike(&wanted, &learnt(&place.path(&run)), kills);
            runs += 1;
            begins = true;
            continue;
        }
        child.kill().unwrap();
        child.wait().unwrap();
        kills += 1;
        begins = false;
    }
    let run = format!("killed-{runs}");
    place
        .line(&format!("{TRAIN} --run {run} --resume"))
        .success();
    assert_learnt_alike(&wanted, &learnt(&place.path(&run)), kills);
}

fn assert_learnt_alike(wanted: &[(String, Vec<u8>)], got: &[(String, Vec<u8>)], kills: u32) {
    for ((name, wanted), (_, got)) in wanted.iter().zip(got) {
        let text =
            |bytes: &[u8]| String::from_utf8_lossy(&bytes[..bytes.len().min(2000)]).into_owned();
        assert!(
            wanted == got,
            "{name} differs after {kills} kills: {}\n{}",
            text(wanted),
            text(got)
        );
    }
}

#[test]
fn a_damaged_checkpoint_is_noticed_by_name() {
    let place = with_settings();
    let line = "train detector --config three.toml --data data --run r";
    place.line(line).success();
    let path = place.path("r/detector/resume/epoch-0003/optimizer.bpk");
    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&path, bytes).unwrap();
    place
        .line(&format!("{line} --resume"))
        .error_says(&["optimizer.bpk", "damaged", "resume"]);
}

#[test]
fn a_dataset_that_changed_between_runs_is_noticed() {
    let place = with_settings();
    let line = "train distance --config three.toml --data data --run r";
    place.line(line).success();
    let before = fs::read(place.path("r/config.json")).unwrap();
    let rows = fs::read_to_string(place.path("data/frames.csv")).unwrap();
    place.write("data/frames.csv", rows.replacen(",val,", ",train,", 1));
    place
        .line(&format!("{line} --resume"))
        .error_says(&["no longer the dataset", "--weights"]);
    assert_eq!(fs::read(place.path("r/config.json")).unwrap(), before);
}

#[test]
fn a_dry_run_says_what_training_would_take_and_leaves_no_run() {
    let place = with_settings();
    let said = place.line(&format!("{TRAIN} --run r --dry-run")).success();
    for word in [
        "detector",
        "distance",
        "parameters",
        "MiB",
        "Nothing was trained",
    ] {
        assert!(said.contains(word), "{word} should be in: {said}");
    }
    assert!(!place.path("r").exists());
    place
        .line("train --dry-run")
        .error_says(&["datasets/quick", "generate"]);
}

#[test]
fn training_goes_on_from_given_weights_with_frozen_parts() {
    let place = with_settings();
    place.line(&format!("{TRAIN} --run first")).success();
    place.write(
        "frozen.toml",
        format!("{THREE_EPOCHS}freeze = [\"blocks\", \"fc1\", \"fc2\"]\n"),
    );
    place
        .line(
            "train distance --config frozen.toml --data data --run second \
             --distance-weights first/distance/best.safetensors",
        )
        .success();
    let weights = |run: &str| {
        let path = place.path(format!("{run}/distance/best.safetensors"));
        let bytes = fs::read(path).unwrap();
        let tensors = safetensors::SafeTensors::deserialize(&bytes).unwrap();
        let mut all: Vec<(String, Vec<u8>)> = tensors
            .tensors()
            .into_iter()
            .map(|(name, tensor)| (name, tensor.data().to_vec()))
            .collect();
        all.sort();
        all
    };
    for ((name, first), (_, second)) in weights("first").iter().zip(weights("second")) {
        assert_eq!(*first == second, !name.starts_with("out."), "{name}");
    }

    place.write(
        "unknown.toml",
        format!("{THREE_EPOCHS}freeze = [\"wheels\"]\n"),
    );
    place
        .line("train distance --config unknown.toml --data data --run third")
        .error_says(&["wheels", "blocks, fc1, fc2, out"]);
    place.write(
        "all.toml",
        format!("{THREE_EPOCHS}freeze = [\"blocks\", \"fc1\", \"fc2\", \"out\"]\n"),
    );
    place
        .line("train distance --config all.toml --data data --run fourth")
        .error_says(&["distance.freeze", "nothing to train"]);
}

#[test]
fn training_stops_early_and_keeps_the_last_epochs() {
    let place = with_settings();
    place.write(
        "early.toml",
        THREE_EPOCHS
            .replace(
                "[distance]",
                "[distance]\npatience = 1\nkeep_last = 2\nlearning_rate = 1e-9",
            )
            .replace("epochs = 3", "epochs = 9"),
    );
    place
        .line("train distance --config early.toml --data data --run r")
        .success();
    let table = fs::read_to_string(place.path("r/metrics.csv")).unwrap();
    let epochs = table.lines().count() - 1;
    assert!(epochs < 9, "{table}");
    let kept = |epoch: usize| {
        place
            .path(format!("r/distance/epoch-{epoch:04}.safetensors"))
            .exists()
    };
    assert!(kept(epochs));
    assert!(epochs < 2 || kept(epochs - 1));
    assert!(epochs < 3 || !kept(epochs - 2));
}

#[test]
fn the_distance_network_can_be_trained_on_the_boxes_of_its_own_detector() {
    let place = with_dataset();
    place.write(
        "own.toml",
        format!("{}\nboxes = \"detector\"\n", super::TINY_TRAINING),
    );
    let line = "train distance --config own.toml --data data --run r";
    place
        .line(line)
        .error_says(&["detector", "train detector --run r"]);
    place
        .line(&line.replace("train distance", "train"))
        .success();
    let boxes = fs::read(place.path("r/distance/detector_boxes.json")).unwrap();
    let weights = fs::read(place.path("r/distance/best.safetensors")).unwrap();
    // The same boxes again, found anew: the same training.
    place
        .line(
            &line
                .replace("--run r", "--run s")
                .replace("train distance", "train"),
        )
        .success();
    assert_eq!(
        boxes,
        fs::read(place.path("s/distance/detector_boxes.json")).unwrap()
    );
    assert_eq!(
        weights,
        fs::read(place.path("s/distance/best.safetensors")).unwrap()
    );
    place.line(&format!("{line} --resume")).success();
    // Another detector's boxes are another training.
    place
        .line("train detector --config own.toml --data data --run t --seed 7")
        .success();
    let weights = ["t", "r"].map(|run| place.path(format!("{run}/detector/best.safetensors")));
    fs::copy(&weights[0], &weights[1]).unwrap();
    place
        .line(&format!("{line} --resume"))
        .error_says(&["settings"]);
}

#[test]
fn a_loss_that_is_no_number_stops_the_run_and_names_the_files() {
    let place = with_settings();
    let settings = THREE_EPOCHS.replace("ema_decay = 0.9", "ema_decay = 0.9\nlearning_rate = 1.0");
    place.write("steep.toml", settings.replace("epochs = 3", "epochs = 40"));
    place
        .line("train distance --config steep.toml --data data --run r")
        .error_says(&[
            "the distance loss is",
            "in epoch",
            "left_000",
            "learning rate",
        ]);
    assert!(!place.path("r/summary.json").exists());
}
