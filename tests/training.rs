//! Both trainings through the library: what they learn, and that devices agree.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "tests panic and report where the library must not"
)]

#[path = "support/devices.rs"]
mod devices;

use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use twinsight::device::DeviceName;
use twinsight::generate::{GenerateConfig, generate};
use twinsight::progress::Silent;
use twinsight::train::{EpochRow, Stage, TrainConfig, TrainRequest, train};

/// Twelve frames of 192x108 with one near vehicle each: eight train, four validate.
const FRAMES: &str = "
seed = 3
frames = 12
frames_per_scene = 1
vehicles = 1
width = 192
height = 108
distance_max_m = 14.0
samples_per_pixel = 1
val_fraction = 0.34
[test]
distances_m = [12.0]
suns = [\"noon\"]
views = [\"front\"]
scenes = 1
";

/// No augmentation, no averaging: what is shown is what is to be learnt.
const PLAIN: &str = "
box_kind = \"sphere\"
cache_mib = 64
[size]
epochs = 0
[detector]
scale = \"n\"
image_size = 192
epochs = 2
batch = 8
micro_batch = 8
warmup_epochs = 1.0
ema_decay = 0.0
hsv = [0.0, 0.0, 0.0]
zoom = 0.0
shift = 0.0
flip = 0.0
validate_every = 1000
[distance]
composite = \"324x162\"
epochs = 2
batch = 8
micro_batch = 4
warmup_epochs = 0.0
box_jitter = 0.0
photometric = 0.0
flip = 0.0
ema_decay = 0.0
validate_every = 1000
";

/// Burn draws first weights from one generator a process, so that two trainings at once are not
/// reproducible: one at a time.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Losses of [`the_losses_of_a_small_run_are_what_they_were`]: the detector's four epochs, then the
/// distance network's.
const LOSSES: [f64; 8] = [
    2.964_402_616,
    5.272_262_067,
    8.834_279_000,
    9.170_691_848,
    17.364_678_383,
    797.538_726_807,
    909.765_712_738,
    290.800_106_049,
];

fn dataset(folder: &Path) {
    let path = folder.join("frames.toml");
    std::fs::write(&path, FRAMES).unwrap();
    let config = GenerateConfig::from_toml_file(&path).unwrap();
    generate(&config, &folder.join("data"), &Silent).unwrap();
}

fn run(
    folder: &Path,
    name: &str,
    stage: Stage,
    changes: &str,
    device: DeviceName,
) -> Vec<EpochRow> {
    run_on(folder, name, stage, changes, &[device])
}

fn run_on(
    folder: &Path,
    name: &str,
    stage: Stage,
    changes: &str,
    devices: &[DeviceName],
) -> Vec<EpochRow> {
    let mut table: toml::Table = toml::from_str(PLAIN).unwrap();
    let changes: toml::Table = toml::from_str(changes).unwrap();
    for (section, values) in changes {
        for (key, value) in values.as_table().unwrap() {
            let section = table[&section].as_table_mut().unwrap();
            section.insert(key.clone(), value.clone());
        }
    }
    let config = TrainConfig::resolve(Some("quick"), None, &table).unwrap();
    let run = folder.join(name);
    train(
        &TrainRequest {
            config: &config,
            data: &folder.join("data"),
            run: &run,
            stage,
            resume: false,
            devices,
        },
        &Silent,
    )
    .unwrap();
    csv::Reader::from_path(run.join("metrics.csv"))
        .unwrap()
        .deserialize()
        .map(Result::unwrap)
        .collect()
}

#[test]
fn eight_frames_are_learnt_by_heart() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    dataset(folder.path());
    let rows = run(
        folder.path(),
        "detector",
        Stage::Detector,
        "detector = { epochs = 60, learning_rate = 0.002 }",
        DeviceName::FLEX,
    );
    let (first, last) = (&rows[0], &rows[rows.len() - 1]);
    println!("detector {first:?}\n{last:?}");
    assert!(last.box_loss.unwrap() < 0.05 * first.box_loss.unwrap());
    assert!(last.class_loss.unwrap() < 0.1 * first.class_loss.unwrap());
    // An edge between two bins has a distribution, whose entropy no network gets below.
    assert!(last.distribution_loss.unwrap() < 0.3 * first.distribution_loss.unwrap());
    let rows = run(
        folder.path(),
        "distance",
        Stage::Distance,
        "distance = { epochs = 120 }",
        DeviceName::FLEX,
    );
    println!("distance {:?}", rows[rows.len() - 1]);
    // The larger one of squared metres and squared percent.
    assert!(
        rows[rows.len() - 1].loss < 1e-3,
        "{:?}",
        rows[rows.len() - 1]
    );
}

#[test]
fn the_losses_of_a_small_run_are_what_they_were() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    dataset(folder.path());
    let rows = run(
        folder.path(),
        "run",
        Stage::All,
        "detector = { image_size = 96, epochs = 4 }\ndistance = { epochs = 4, photometric = 0.1 }",
        DeviceName::FLEX,
    );
    let losses: Vec<f64> = rows.iter().map(|row| row.loss).collect();
    println!("{losses:?}");
    assert_eq!(losses.len(), LOSSES.len());
    for (loss, expected) in losses.iter().zip(LOSSES) {
        // Vectors of another width add in another order.
        assert!((loss / expected - 1.0).abs() < 1e-2, "{losses:?}");
    }
}

#[test]
fn an_epoch_of_both_networks_is_the_same_on_every_device() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    dataset(folder.path());
    let small = "image_size = 64, epochs = 1, batch = 16, micro_batch = 16";
    let start = format!("detector = {{ {small} }}\ndistance = {{ epochs = 1 }}");
    run(folder.path(), "start", Stage::All, &start, DeviceName::FLEX);
    // Every device draws other first weights, so all start from the same files.
    let weights = |stage: &str| {
        folder
            .path()
            .join(format!("start/{stage}/last.safetensors"))
    };
    let settings = format!(
        "detector = {{ {small}, weights = {:?} }}\n\
         distance = {{ epochs = 1, micro_batch = 8, weights = {:?} }}",
        weights("detector"),
        weights("distance"),
    );
    let losses = |name: &str| -> Vec<f64> {
        let device = name.parse().unwrap();
        let begun = std::time::Instant::now();
        let rows = run(folder.path(), name, Stage::All, &settings, device);
        println!("{name}: {:.0} s", begun.elapsed().as_secs_f64());
        rows.iter()
            .flat_map(|row| [row.loss, row.gradient_norm.unwrap()])
            .collect()
    };
    let expected = losses("flex");
    for (name, _) in &devices::every()[1..] {
        for (value, expected) in losses(name).iter().zip(&expected) {
            // 32-bit sums in another order, through a whole network and back.
            assert!(
                (value / expected - 1.0).abs() < 1e-2,
                "{value} on {name}, {expected} on flex"
            );
        }
    }
}

/// Burn adds up what the devices compute in the order in which it arrives, so agreement is as good as
/// rounding lets it be; what differs by design is batch normalisation, over each device's own part.
#[test]
fn two_devices_that_share_a_training_learn_what_one_does() {
    if cfg!(not(feature = "ndarray")) {
        println!("skipped: a build with the feature ndarray has a second device");
        return;
    }
    let _turn = alone();
    let folder = tempfile::tempdir().unwrap();
    dataset(folder.path());
    let settings = "detector = { image_size = 64, batch = 8, micro_batch = 4 }\n\
                    distance = { batch = 8, micro_batch = 4 }";
    let pair: Vec<DeviceName> = ["flex", "ndarray"]
        .map(|name| name.parse().unwrap())
        .to_vec();
    let run = |name, stage, devices| run_on(folder.path(), name, stage, settings, devices);
    let alone = run("alone", Stage::Distance, &[DeviceName::FLEX]);
    let shared = run("shared", Stage::Distance, &pair);
    assert_eq!(alone.len(), shared.len());
    for (one, two) in alone.iter().zip(&shared) {
        assert_eq!((one.epoch, one.step), (two.epoch, two.step));
        // Two steps on a loss that is far from its minimum.
        let apart = (one.loss - two.loss).abs() / one.loss;
        assert!(apart < 1e-2, "{} alone, {} shared", one.loss, two.loss);
    }

    // With batch normalisation: the same again, to the bit, for nothing depends on who comes first.
    let [first, second] = ["first", "second"].map(|name| {
        let rows = run(name, Stage::Detector, &pair);
        let path = folder.path().join(name).join("detector/last.safetensors");
        let losses: Vec<f64> = rows.iter().map(|row| row.loss).collect();
        (losses, std::fs::read(path).unwrap())
    });
    assert_eq!(first.0, second.0);
    assert!(first.1 == second.1, "the weights differ");
}
