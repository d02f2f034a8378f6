use burn::tensor::Device;
use image::{Rgb, RgbImage};

use super::*;
use crate::dataset::BoxKind;
use crate::dataset::fixture::Fixture;
use crate::progress::Silent;
use crate::ranging::Readout;
use crate::train::TrainConfig;

/// A texture without repetition, moved to the left.
fn texture(shift: u32) -> RgbImage {
    RgbImage::from_fn(320, 180, |x, y| {
        let mixed = ((x + shift) * 7919 + y * 104_729).wrapping_mul(2_654_435_761);
        Rgb([(mixed >> 24) as u8; 3])
    })
}

fn recipe(fixture: &Fixture, change: impl Fn(&mut TrainConfig)) -> DistanceRecipe {
    let mut config = TrainConfig::preset("quick").unwrap();
    config.distance.disparity = true;
    config.distance.readout = Readout::Surface;
    change(&mut config);
    DistanceRecipe::new(&config, &fixture.open(), None, &Device::flex(), &Silent).unwrap()
}

#[test]
fn the_mirrored_pair_shows_the_same_surface() {
    let rig = StereoRig::from_hfov(320, 180, 90.0, 0.8).unwrap();
    let images = [texture(0), texture(14)];
    for x in [120.0, 160.0, 230.5] {
        let sighting = Sighting {
            images: [&images[0], &images[1]],
            boxes: [x, x - 14.0].map(|x| PixelBox::from_center([x, 80.0], 60.0, 60.0)),
        };
        let [plain, mirrored] =
            [false, true].map(|is_mirrored| measured_m(&sighting, &rig, is_mirrored).unwrap());
        assert!((plain / mirrored - 1.0).abs() < 1e-3, "{plain} {mirrored}");
    }
}

#[test]
fn the_rows_around_a_vehicle_are_all_that_its_mirrored_surface_depends_on() {
    let rig = StereoRig::from_hfov(320, 180, 90.0, 0.8).unwrap();
    let images = [texture(0), texture(9)];
    let [left, right] = images.each_ref().map(image::imageops::flip_horizontal);
    // Small and large, in the middle, and reaching over every side.
    for (x, y, side) in [
        (150.0, 90.0, 9.0),
        (150.3, 90.6, 33.0),
        (140.0, 80.0, 150.0),
        (30.0, 12.0, 40.0),
        (290.0, 171.0, 40.0),
        (150.0, 2.0, 14.0),
    ] {
        let boxes = [x, x - 9.0].map(|x| PixelBox::from_center([x, y], side, side));
        let sighting = Sighting {
            images: [&images[0], &images[1]],
            boxes,
        };
        let whole = Sighting {
            images: [&right, &left],
            boxes: [boxes[1], boxes[0]].map(|area| area.mirrored(320.0)),
        };
        let found = measured_m(&sighting, &rig, true);
        let of_whole = surface_m(&whole, &rig.mirrored());
        assert_eq!(found.is_some(), of_whole.is_some());
        if let (Some(found), Some(of_whole)) = (found, of_whole) {
            assert!((found / of_whole - 1.0).abs() < 1e-6, "{found} {of_whole}");
        }
    }
}

#[test]
fn what_is_loaded_depends_on_seed_epoch_and_vehicle_alone() {
    let fixture = Fixture::lawful(10);
    let all: Vec<usize> = (0..4).collect();
    let load = |recipe: &DistanceRecipe, epoch: u32, items: &[usize]| {
        let vehicles: Vec<Vehicle> = items.iter().map(|&i| recipe.train[i].clone()).collect();
        recipe.composites(&vehicles, Some((epoch, items))).unwrap()
    };
    let [one, another] = [0, 0].map(|_| recipe(&fixture, |_| ()));
    let whole = load(&one, 3, &all);
    // Other neighbours in the batch, another order, another recipe, one thread.
    let single = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    let pair = single.install(|| load(&another, 3, &[2, 0]));
    let values = one.settings.composite.plane_values();
    assert_eq!(pair.planes[..values], whole.planes[2 * values..3 * values]);
    assert_eq!(pair.readings[0], whole.readings[2]);
    assert_eq!(pair.readings[1], whole.readings[0]);
    let later = load(&one, 4, &all);
    assert_ne!(later.readings, whole.readings, "boxes move every epoch");
}

#[test]
fn a_surface_is_measured_once_where_boxes_do_not_move() {
    let fixture = Fixture::lawful(10);
    let still = recipe(&fixture, |config| config.distance.box_jitter = 0.0);
    let items = [0, 1];
    still
        .composites(&still.train[..2], Some((0, &items)))
        .unwrap();
    still.composites(&still.train[..2], None).unwrap();
    for vehicle in &still.train[..2] {
        assert!(vehicle.surfaces_m[0].get().is_some());
    }
    let moved = recipe(&fixture, |_| ());
    moved
        .composites(&moved.train[..2], Some((0, &items)))
        .unwrap();
    assert!(moved.train[0].surfaces_m.iter().all(|m| m.get().is_none()));
}

#[test]
fn the_empty_half_of_mono_stays_empty_under_every_change() {
    let fixture = Fixture::lawful(10);
    let mono = recipe(&fixture, |config| {
        config.distance.inputs = Crops::Mono;
        config.distance.photometric = 0.5;
        config.distance.flip = 0.5;
    });
    let size = mono.settings.composite;
    let half = size.width as usize * size.width as usize;
    for epoch in 0..4 {
        let loaded = mono
            .composites(&mono.train[..2], Some((epoch, &[0, 1])))
            .unwrap();
        for plane in loaded.planes.chunks_exact(2 * half) {
            assert!(plane[half..].iter().all(|value| *value == 0.0));
            assert!(plane[..half].iter().any(|value| *value != 0.0));
        }
    }
}

/// A run folder whose detector found one vehicle of the dataset, a little beside its labels.
fn run_with_detected(fixture: &Fixture, frame: u64, found: [PixelBox; 2]) -> tempfile::TempDir {
    let run = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = run.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    };
    write("detector/best.safetensors", "never loaded");
    let mark = crate::files::content_mark(run.path().join("detector/best.safetensors")).unwrap();
    let saved = serde_json::json!({
        "detector": mark,
        "fingerprint": fixture.open().fingerprint().unwrap(),
        "kind": "sphere",
        "vehicles": [{ "frame": frame, "id": 0, "left": found[0], "right": found[1] }],
    });
    write("distance/detector_boxes.json", &saved.to_string());
    run
}

fn detector_config() -> TrainConfig {
    let mut config = TrainConfig::preset("quick").unwrap();
    config.box_kind = BoxKind::Sphere;
    config.distance.boxes = crate::train::TrainingBoxes::Detector;
    config.distance.flip = 0.0;
    config
}

#[test]
fn boxes_of_the_detector_stand_for_the_labelled_ones_and_do_not_move() {
    let fixture = Fixture::lawful(10);
    let dataset = fixture.open();
    let found = [[20.0, 21.5], [18.0, 19.5]].map(|[x, y]| PixelBox::new(x, y, x + 14.0, y + 13.0));
    let stamp = dataset.split(crate::dataset::Split::Train)[0].row.stamp;
    let run = run_with_detected(&fixture, stamp, found);
    let recipe = DistanceRecipe::new(
        &detector_config(),
        &dataset,
        Some(run.path()),
        &Device::flex(),
        &Silent,
    )
    .unwrap();
    assert_eq!(recipe.train[0].boxes(), found);
    assert_eq!(recipe.train[1].detected, None);
    let readings = |epoch: u32| {
        let loaded = recipe.composites(&recipe.train[..2], Some((epoch, &[0, 1])));
        loaded.unwrap().readings
    };
    let [early, late] = [0, 1].map(readings);
    assert_eq!(early[0], late[0]);
    assert_ne!(early[1], late[1]);
    // The labels' boxes still judge.
    assert!(recipe.val.iter().all(|vehicle| vehicle.detected.is_none()));
}

#[test]
fn boxes_of_another_detector_are_found_anew_and_a_missing_detector_is_named() {
    let fixture = Fixture::lawful(10);
    let found = [PixelBox::new(20.0, 20.0, 30.0, 30.0); 2];
    let run = run_with_detected(&fixture, 1, found);
    let refusal = |run: &std::path::Path| {
        let device = Device::flex();
        let recipe = DistanceRecipe::new(
            &detector_config(),
            &fixture.open(),
            Some(run),
            &device,
            &Silent,
        );
        recipe.err().unwrap().to_string()
    };
    let weights = run.path().join("detector/best.safetensors");
    std::fs::write(&weights, "another one").unwrap();
    assert!(refusal(run.path()).contains("best.safetensors"));
    std::fs::remove_file(&weights).unwrap();
    let message = refusal(run.path());
    assert!(message.contains("twinsight train detector"), "{message}");
}
