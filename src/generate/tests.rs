use std::collections::BTreeMap;
use std::fs;
use std::sync::atomic::{AtomicU32, Ordering};

use super::*;
use crate::dataset::{BoxKind, Label, StereoDataset, read_objects_csv};
use crate::progress::Silent;

fn tiny() -> GenerateConfig {
    GenerateConfig {
        frames: 6,
        frames_per_scene: 3,
        width: 128,
        height: 72,
        distance_max_m: 30.0,
        val_fraction: 0.5,
        ..GenerateConfig::default()
    }
}

/// Every file below a folder by its relative path.
fn content(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().display().to_string();
                files.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    files
}

/// Asks to stop after some frames.
struct StopAfter {
    frames: u32,
    seen: AtomicU32,
}

impl Progress for StopAfter {
    fn begin(&self, _: &str, _: u64) {}
    fn advance(&self, _: u64) {
        self.seen.fetch_add(1, Ordering::Relaxed);
    }
    fn status(&self, _: &str) {}
    fn note(&self, _: &str) {}
    fn end(&self) {}
    fn interrupted(&self) -> bool {
        self.seen.load(Ordering::Relaxed) >= self.frames
    }
}

#[test]
fn one_thread_and_many_write_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let [one, many] = [1, 3].map(|threads| {
        let out = folder.path().join(threads.to_string());
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let report = pool.install(|| generate(&tiny(), &out, &Silent)).unwrap();
        assert_eq!(
            (report.frames, report.train, report.val, report.reused),
            (6, 3, 3, 0)
        );
        content(&out)
    });
    assert_eq!(one.len(), 6 * 4 + 3);
    assert!(one == many, "files differ between one thread and three");
}

#[test]
fn a_stopped_run_goes_on_and_ends_with_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, stopped] = ["whole", "stopped"].map(|name| folder.path().join(name));
    generate(&tiny(), &whole, &Silent).unwrap();
    let stop = StopAfter {
        frames: 4,
        seen: AtomicU32::new(0),
    };
    let error = generate(&tiny(), &stopped, &stop).unwrap_err();
    assert!(matches!(error, Error::Interrupted { .. }), "{error}");
    assert!(!stopped.join("dataset.toml").exists() && !stopped.join("frames.csv").exists());

    let other = GenerateConfig { seed: 2, ..tiny() };
    let message = generate(&other, &stopped, &Silent).unwrap_err().to_string();
    assert!(message.contains("other settings"), "{message}");

    let written: Vec<String> = content(&stopped)
        .into_keys()
        .filter(|name| name.ends_with("png"))
        .collect();
    fs::remove_file(stopped.join(&written[0])).unwrap();
    let report = generate(&tiny(), &stopped, &Silent).unwrap();
    assert!(report.reused >= 3 && report.reused < 6, "{report:?}");
    assert!(
        content(&whole) == content(&stopped),
        "files differ after going on"
    );
}

#[test]
fn a_finished_dataset_is_never_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let config = GenerateConfig {
        frames: 1,
        ..tiny()
    };
    generate(&config, folder.path(), &Silent).unwrap();
    let before = content(folder.path());
    let message = generate(&config, folder.path(), &Silent)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("never overwritten") && message.contains("another folder"),
        "{message}"
    );
    assert!(before == content(folder.path()));
}

#[test]
fn labelled_centres_keep_the_disparity_law_and_boxes_lie_around_them() {
    let folder = tempfile::tempdir().unwrap();
    let config = tiny();
    let rig = config.rig().unwrap();
    generate(&config, folder.path(), &Silent).unwrap();
    let table = fs::read_to_string(folder.path().join("frames.csv")).unwrap();
    assert!(
        table.starts_with("stamp,split,scene,sun,view,azimuth_deg,elevation_deg,distance_m\n"),
        "{table}"
    );
    for row in table.lines().skip(1) {
        let fields: Vec<&str> = row.split(',').collect();
        let stamp: u64 = fields[0].parse().unwrap();
        let distance_m: f64 = fields[7].parse().unwrap();
        assert!((config.distance_min_m..=config.distance_max_m).contains(&distance_m));
        let [left, right] = ["left", "right"].map(|side| {
            let text =
                fs::read_to_string(folder.path().join(format!("frames/{side}_{stamp:05}.txt")))
                    .unwrap();
            let lines: Vec<Vec<String>> = text
                .lines()
                .filter(|line| !line.starts_with('#'))
                .map(|line| line.split(' ').map(str::to_owned).collect())
                .collect();
            let names: Vec<[&str; 2]> = lines.iter().map(|l| [&*l[0], &*l[9]]).collect();
            assert_eq!(names[..2], [["0", "sphere"], ["0", "tight"]]);
            let number = |line: usize, field: usize| lines[line][field].parse::<f64>().unwrap();
            assert_eq!(number(0, 8), distance_m);
            assert!(number(0, 10) >= config.min_visible - 0.1);
            // The sphere's square is around the centre, and the tight box around what can be seen.
            assert!((f64::midpoint(number(0, 2), number(0, 4)) - number(0, 6)).abs() < 2e-4);
            if number(1, 10) > 0.95 {
                assert!(number(1, 2) < number(0, 6) && number(1, 4) > number(0, 6));
                assert!(number(1, 3) < number(0, 7) && number(1, 5) > number(0, 7));
            }
            [number(0, 6), number(0, 7)]
        });
        assert!((left[1] - right[1]).abs() < 1e-9);
        // From disparity and position back to the distance.
        let z = rig.depth_m(left[0] - right[0]);
        let [x, y, _] = rig.left.camera_from_pixel(left);
        let point = [x * z - rig.baseline_m / 2.0, y * z, z];
        let pixels = rig.pixels_from_rig(point).unwrap();
        assert!((pixels[0][0] - pixels[1][0] - rig.disparity_px(z)).abs() < 1e-6);
        let back = point.iter().map(|v| v * v).sum::<f64>().sqrt();
        // Files keep a ten-thousandth of a pixel, which is 2 mm at 30 m with this rig's focal length.
        assert!((back - distance_m).abs() < 4e-3, "{back} {distance_m}");
    }
}

#[test]
fn every_labelled_vehicle_keeps_the_laws_and_has_its_row_in_objects_csv() {
    let folder = tempfile::tempdir().unwrap();
    let config = tiny();
    let rig = config.rig().unwrap();
    generate(&config, folder.path(), &Silent).unwrap();
    let dataset = StereoDataset::open(folder.path()).unwrap();
    let objects = read_objects_csv(folder.path().join("objects.csv")).unwrap();
    let mut pairs = 0;
    for frame in &dataset.frames {
        for vehicle in frame.vehicles(BoxKind::Tight) {
            pairs += 1;
            let object = objects
                .iter()
                .find(|o| o.stamp == frame.row.stamp && o.id == vehicle.id)
                .unwrap();
            assert!((object.distance_m - vehicle.distance_m).abs() < 1e-9);
            let [x, y, z] = [object.x_m, object.y_m, object.z_m];
            assert!((libm::hypot(libm::hypot(x, y), z) - vehicle.distance_m).abs() < 1e-3);
            let [left, right] = [vehicle.left.center_pixel, vehicle.right.center_pixel];
            assert!((left[1] - right[1]).abs() < 1e-9);
            // Both are rounded: to a tenth of a millimetre and to a ten-thousandth of a pixel.
            assert!((left[0] - right[0] - rig.disparity_px(z)).abs() < 2e-3);
            let [expected, _] = rig.pixels_from_rig([x, y, z]).unwrap();
            assert!((0..2).all(|i| (left[i] - expected[i]).abs() < 2e-3));
            let forward = [object.forward_x, object.forward_y, object.forward_z];
            let length = forward.iter().map(|v| v * v).sum::<f64>();
            assert!((length - 1.0).abs() < 1e-3, "{forward:?}");
            // Right of the image is right of the rig, whatever its pitch.
            let sine = object.yaw_deg.to_radians().sin();
            assert!((sine - object.forward_x).abs() < 1e-3, "{object:?}");
        }
        let target = objects.iter().find(|o| o.stamp == frame.row.stamp).unwrap();
        let turn = target.azimuth_deg - frame.row.azimuth_deg.unwrap();
        assert!(turn.abs() < 1e-3 || (turn.abs() - 360.0).abs() < 1e-3);
        assert!((target.elevation_deg - frame.row.elevation_deg.unwrap()).abs() < 1e-3);
    }
    assert!(
        pairs >= 12,
        "only {pairs} pairs in {} frames",
        dataset.frames.len()
    );
}

#[test]
fn hidden_small_and_far_vehicles_are_labelled_but_ignored() {
    let folder = tempfile::tempdir().unwrap();
    let config = GenerateConfig {
        frames: 8,
        frames_per_scene: 2,
        distance_max_m: 25.0,
        vehicles: VehicleCount::exactly(10),
        ..tiny()
    };
    generate(&config, folder.path(), &Silent).unwrap();
    let dataset = StereoDataset::open(folder.path()).unwrap();
    let labels: Vec<&Label> = dataset
        .frames
        .iter()
        .flat_map(|frame| frame.left.labels_of(BoxKind::Tight))
        .collect();
    let is_far = |label: &Label| !(10.0..=25.0).contains(&label.distance_m.unwrap());
    for label in &labels {
        let [width, height] = [label.box_pixel.width(), label.box_pixel.height()];
        // Files keep four decimals of what decided.
        let expected = is_far(label)
            || label.visible.unwrap() < config.ignore_below_visible
            || width.max(height) < config.ignore_below_px;
        assert_eq!(label.ignored, expected, "{label:?}");
    }
    assert!(labels.iter().any(|label| label.ignored));
    assert!(labels.iter().any(|label| !label.ignored && label.id > 0));
    let all: usize = dataset
        .frames
        .iter()
        .map(|frame| frame.left.boxes(BoxKind::Tight, &dataset.rig().left).len())
        .sum();
    assert_eq!(all, labels.iter().filter(|label| !label.ignored).count());
}

#[test]
fn a_scene_of_one_vehicle_has_labels_of_one_vehicle_and_the_same_city() {
    let folder = tempfile::tempdir().unwrap();
    let config = GenerateConfig {
        frames: 2,
        vehicles: VehicleCount::exactly(1),
        ..tiny()
    };
    generate(&config, folder.path(), &Silent).unwrap();
    let dataset = StereoDataset::open(folder.path()).unwrap();
    for frame in &dataset.frames {
        let labels: Vec<(u32, bool)> = frame
            .left
            .labels
            .iter()
            .map(|label| (label.id, label.ignored))
            .collect();
        assert_eq!(labels, [(0, false), (0, false)]);
    }
    let [alone, among] = [1, 5].map(|vehicles| {
        let scene = Scene::draw_with_traffic(config.seed, 0, 60.0, vehicles, 30.0);
        (scene.target().center_world, scene.city.mesh.triangles.len())
    });
    assert_eq!(alone, among);
}

#[test]
fn the_reader_finds_nothing_wrong_with_a_generated_dataset() {
    let folder = tempfile::tempdir().unwrap();
    generate(&tiny(), folder.path(), &Silent).unwrap();
    let mut dataset = StereoDataset::open(folder.path()).unwrap();
    dataset.check_images(&Silent).unwrap();
    assert!(dataset.problems.is_empty(), "{:?}", dataset.problems);
    assert_eq!(dataset.frames.len(), 6);
}

#[test]
fn a_folder_that_cannot_be_written_is_an_error_that_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let blocked = folder.path().join("file");
    fs::write(&blocked, "").unwrap();
    let message = generate(&tiny(), &blocked.join("dataset"), &Silent)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("cannot create folder") && message.contains("dataset"),
        "{message}"
    );
}
