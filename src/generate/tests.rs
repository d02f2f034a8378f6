use std::collections::BTreeMap;
use std::fs;
use std::sync::atomic::{AtomicU32, Ordering};

use super::*;
use crate::dataset::StereoDataset;
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
    assert_eq!(one.len(), 6 * 4 + 2);
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
            assert_eq!(
                lines.iter().map(|l| l[9].as_str()).collect::<Vec<_>>(),
                ["sphere", "tight"]
            );
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
