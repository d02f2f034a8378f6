//! Training that is killed, resumed, damaged, or started on something else.

use std::fs;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use super::{Outcome, Workplace, with_dataset};

/// Both networks, a few epochs, with everything random that training has.
const THREE_EPOCHS: &str = "
box_kind = \"sphere\"
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
[size]
epochs = 3
batch = 8
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
        .chain(["best", "last", "witness"].map(|which| format!("size/{which}.safetensors")))
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

/// Epochs of the detector, the distance network and the size network that a run has saved.
fn saved_epochs(run: &Path) -> [u32; 3] {
    ["detector", "distance", "size"].map(|stage| {
        let Ok(entries) = fs::read_dir(run.join(stage).join("resume")) else {
            return 0;
        };
        let epochs = entries.filter_map(|entry| {
            let path = entry.unwrap().path();
            let name = path.file_name()?.to_str()?;
            let epoch: u32 = name.strip_prefix("epoch-")?.parse().ok()?;
            path.join("state.json").exists().then_some(epoch)
        });
        epochs.max().unwrap_or(0)
    })
}

/// Fails where a resumed run goes on from other epochs than those that were saved.
fn assert_goes_on(saved: [u32; 3], stderr: &str, is_over: bool) {
    for (stage, epoch) in ["detector", "distance", "size"].iter().zip(saved) {
        let begin = format!("{stage}: resuming after epoch ");
        let said = stderr
            .lines()
            .find_map(|line| line.trim().strip_prefix(&begin));
        let wanted = (epoch > 0).then(|| epoch.to_string());
        if said.is_some() || is_over {
            assert_eq!(said.map(str::to_owned), wanted, "{stage}: {stderr}");
        }
    }
}

#[test]
fn a_run_that_is_killed_again_and_again_learns_what_an_uninterrupted_one_does() {
    let place = with_dataset();
    place.write(
        "three.toml",
        THREE_EPOCHS.replace("epochs = 3", "epochs = 6"),
    );
    let begun = Instant::now();
    place.line(&format!("{TRAIN} --run whole")).success();
    let whole = begun.elapsed();
    let wanted = learnt(&place.path("whole"));

    // Twenty moments spread over a run, early and late ones mixed; a run that survives to its end is
    // compared, and another one is killed from then on.
    let (mut kills, mut runs) = (0_u32, 0_u32);
    let mut begins = true;
    let mut kills_of_stage = [0, 0];
    while kills < 20 {
        let share = f64::from(kills * 7 % 20 + 1) / 22.0;
        let run = format!("killed-{runs}");
        let resume = if begins { "" } else { "--resume" };
        let saved = saved_epochs(&place.path(&run));
        let mut child = start(&place, &format!("{TRAIN} --run {run} {resume}"));
        let wait = Duration::from_secs_f64(whole.as_secs_f64() * share * 0.6);
        let begun = Instant::now();
        while begun.elapsed() < wait && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(2));
        }
        if child.try_wait().unwrap().is_some() {
            let outcome = Outcome::of(child.wait_with_output().unwrap());
            assert_goes_on(saved, &outcome.stderr, true);
            outcome.success();
            assert_learnt_alike(&wanted, &learnt(&place.path(&run)), kills);
            runs += 1;
            begins = true;
            continue;
        }
        child.kill().unwrap();
        let outcome = Outcome::of(child.wait_with_output().unwrap());
        assert_goes_on(saved, &outcome.stderr, false);
        let [detector, ..] = saved_epochs(&place.path(&run));
        kills_of_stage[usize::from(detector == 6)] += 1;
        kills += 1;
        begins = false;
    }
    assert!(
        kills_of_stage.iter().all(|&kills| kills > 1),
        "both networks are to be hit: {kills_of_stage:?}"
    );
    let run = format!("killed-{runs}");
    let saved = saved_epochs(&place.path(&run));
    let outcome = place.line(&format!("{TRAIN} --run {run} --resume"));
    assert_goes_on(saved, &outcome.stderr, true);
    outcome.success();
    assert_learnt_alike(&wanted, &learnt(&place.path(&run)), kills);
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_a_run_with_what_is_saved_and_how_to_go_on() {
    let place = with_dataset();
    place.write(
        "long.toml",
        THREE_EPOCHS.replace("epochs = 3", "epochs = 500"),
    );
    let mut child = start(
        &place,
        "train detector --config long.toml --data data --run r",
    );
    while saved_epochs(&place.path("r"))[0] == 0 {
        assert!(child.try_wait().unwrap().is_none(), "ended by itself");
        std::thread::sleep(Duration::from_millis(5));
    }
    // Another process must not meddle with the run meanwhile.
    place
        .line("train detector --config long.toml --data data --run r --resume")
        .error_says(&["another process", "r", "--run"]);
    let interrupt = std::process::Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(interrupt.unwrap().success());
    let outcome = Outcome::of(child.wait_with_output().unwrap());
    assert_eq!(outcome.code, Some(130), "{}", outcome.stderr);
    let [epoch, ..] = saved_epochs(&place.path("r"));
    for words in [&format!("saved up to epoch {epoch}"), "--resume"] {
        assert!(outcome.stderr.contains(words), "{}", outcome.stderr);
    }
}

#[test]
fn what_to_resume_from_is_not_replaced_by_a_fresh_start_when_it_is_lost_or_changed() {
    let place = with_settings();
    let line = "train detector --config three.toml --data data --run r";
    place.line(line).success();
    let weights = fs::read(place.path("r/detector/best.safetensors")).unwrap();
    let state = place.path("r/detector/resume/epoch-0003/state.json");
    let text = fs::read_to_string(&state).unwrap();
    fs::write(&state, text.replace("\"step\": ", "\"step\": 1")).unwrap();
    place
        .line(&format!("{line} --resume"))
        .error_says(&["state.json", "damaged"]);
    fs::remove_file(&state).unwrap();
    place
        .line(&format!("{line} --resume"))
        .error_says(&["nothing to go on from", "--weights"]);
    fs::remove_dir_all(place.path("r/detector/resume")).unwrap();
    place
        .line(&format!("{line} --resume"))
        .error_says(&["nothing to go on from", "--weights"]);
    let after = fs::read(place.path("r/detector/best.safetensors")).unwrap();
    assert_eq!(after, weights);
}

#[test]
fn a_second_network_leaves_the_first_ones_settings_and_dataset_alone() {
    let place = with_settings();
    // Digits that a careless reader of numbers changes in the last bit.
    let line = "train detector --config three.toml --data data --run r --detector-epochs 2 \
                --learning-rate 0.0019433567169983138";
    place.line(line).success();
    let line = "train distance --config three.toml --data data --run r";
    place
        .line(&format!("{line} --seed 9"))
        .error_says(&["seed was 1 and is 9", "--run"]);
    place.line(line).success();
    let config = fs::read_to_string(place.path("r/config.json")).unwrap();
    let config: serde_json::Value = serde_json::from_str(&config).unwrap();
    assert_eq!(config["config"]["detector"]["epochs"], 2);
    assert_eq!(config["config"]["distance"]["epochs"], 3);
    place.line("train --run r --resume").success();

    // Another dataset is noticed for the network that was started on this one.
    let rows = fs::read_to_string(place.path("data/frames.csv")).unwrap();
    place.write("data/frames.csv", rows.replacen(",val,", ",train,", 1));
    place.line("train detector --run r --resume").error_says(&[
        "no longer the dataset",
        "detector",
        "--weights",
    ]);
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
                "[distance]\npatience = 2\nkeep_last = 2\nlearning_rate = 1e-9\nvalidate_every = 3",
            )
            .replace("epochs = 3", "epochs = 19"),
    );
    place
        .line("train distance --config early.toml --data data --run r")
        .success();
    let table = fs::read_to_string(place.path("r/metrics.csv")).unwrap();
    let mut rows = csv::Reader::from_reader(table.as_bytes());
    let columns = rows.headers().unwrap().clone();
    let column = columns
        .iter()
        .position(|name| name == "mre_percent")
        .unwrap();
    let errors: Vec<Option<f64>> = rows
        .records()
        .map(Result::unwrap)
        .filter(|row| &row[0] == "distance")
        .map(|row| row[column].parse().ok())
        .collect();
    let epochs = errors.len();
    assert!(epochs < 19, "{table}");
    // Only validated epochs can be in vain: the run ends with the first that is no better.
    assert_eq!(epochs % 3, 0, "{table}");
    let validated: Vec<f64> = errors.iter().flatten().copied().collect();
    let (last, before) = validated.split_last().unwrap();
    assert!(before.windows(2).all(|pair| pair[1] < pair[0]), "{table}");
    assert!(last >= before.last().unwrap(), "{table}");
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
fn resuming_a_run_that_is_not_there_starts_nothing_and_names_those_that_are() {
    let place = Workplace::new();
    place.write("checkpoints/mine/config.json", "{}");
    for line in [
        "train --run checkpoints/mien --resume",
        "-q train --run checkpoints/mien --resume",
        "train --resume",
        "train --run checkpoints --resume",
    ] {
        place
            .line(line)
            .error_says(&["run checkpoints", "--resume"]);
    }
    place
        .line("train --run checkpoints/mien --resume")
        .error_says(&["no such run", "there are checkpoints/mine"]);
    assert_eq!(super::files_below(&place.path("")), 1);
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
