//! Memory does not grow with the number of pairs. The only test of its process, which is measured.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, reason = "a test stops at whatever is unexpected")]

#[path = "support/untrained.rs"]
mod untrained;

use std::fs;
use std::path::Path;
use std::sync::{Arc, Mutex};

use image::RgbImage;
use twinsight::imaging::save_png;
use twinsight::pairing::PairingMode;
use twinsight::pipeline::VehicleFilter;
use twinsight::predict::{CsvFile, FrameRecord, JsonLines, Sink, predict};
use twinsight::progress::Silent;
use twinsight::sources::FrameSource;
use twinsight::{DeviceName, PredictOptions, Result, StereoRanger};

use untrained::{texture, write_run};

const MIB: u64 = 1 << 20;

/// Resident memory of this process, bytes.
fn resident() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status
        .lines()
        .find(|line| line.starts_with("VmRSS:"))
        .unwrap();
    let kib: u64 = line.split_whitespace().nth(1).unwrap().parse().unwrap();
    kib << 10
}

/// One vehicle a pair at most.
fn ranger(run: &Path, confidence: f32) -> StereoRanger {
    let options = PredictOptions {
        confidence,
        pairing_mode: PairingMode::Search,
        ..PredictOptions::default()
    };
    let filter = VehicleFilter {
        max_vehicles: Some(1),
        ..VehicleFilter::default()
    };
    StereoRanger::load(run, &DeviceName::FLEX.open().unwrap())
        .unwrap()
        .with_options(options)
        .with_filter(filter)
        .unwrap()
}

/// Ten thousand estimates in a loop; in every fiftieth there is a vehicle, whose network is large.
fn estimates_in_a_loop(run: &Path) {
    let (empty, full) = (ranger(run, 1.0), ranger(run, 1e-4));
    let [left, right] = [0, 2].map(|shift| texture(32, 18, 1, shift));
    let (mut settled, mut vehicles) = (0, 0);
    for i in 0..10_000 {
        if i == 500 {
            settled = resident();
        }
        let ranger = if i % 50 == 0 { &full } else { &empty };
        vehicles += ranger.estimate(&left, &right).unwrap().len();
    }
    let grown = resident().saturating_sub(settled);
    assert!(vehicles >= 100, "{vehicles} vehicles");
    assert!(grown < 10 * MIB, "grew by {grown} bytes");
}

/// Notes the resident memory at each frame.
struct Memory(Arc<Mutex<Vec<u64>>>);

impl Sink for Memory {
    fn take(&mut self, _: &FrameRecord, _: Option<[&RgbImage; 2]>) -> Result<()> {
        self.0.lock().unwrap().push(resident());
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        Ok(())
    }
}

/// A folder of a thousand pairs that would take a hundred times the allowance if they were kept.
fn frames_of_a_folder(run: &Path, folder: &Path) {
    let data = folder.join("pairs");
    fs::create_dir(&data).unwrap();
    let first = ["left_0.png", "right_0.png"].map(|name| data.join(name));
    for (path, shift) in first.iter().zip([0, 2]) {
        save_png(path, &texture(640, 360, 1, shift)).unwrap();
    }
    for i in 1..1000 {
        for (path, side) in first.iter().zip(["left", "right"]) {
            let copy = data.join(format!("{side}_{i}.png"));
            fs::hard_link(path, &copy).unwrap();
        }
    }
    // Every tenth is broken.
    for i in (5..1000).step_by(10) {
        let path = data.join(format!("right_{i}.png"));
        fs::remove_file(&path).unwrap();
        fs::write(path, "no picture").unwrap();
    }
    let memory = Arc::default();
    let mut sinks: Vec<Box<dyn Sink>> = vec![
        Box::new(JsonLines::create(&folder.join("a.jsonl")).unwrap()),
        Box::new(CsvFile::create(&folder.join("a.csv")).unwrap()),
        Box::new(Memory(Arc::clone(&memory))),
    ];
    let frames = FrameSource::open(&[data], None)
        .unwrap()
        .read_ahead(4)
        .unwrap();
    let summary = predict(&ranger(run, 1.0), frames, 2, &mut sinks, &Silent).unwrap();
    assert_eq!((summary.frames, summary.failed), (1000, 100));
    for sink in sinks {
        sink.finish().unwrap();
    }
    let lines = fs::read_to_string(folder.join("a.jsonl")).unwrap();
    assert_eq!(lines.lines().count(), 1000);
    let memory = memory.lock().unwrap();
    let grown = memory[999].saturating_sub(memory[200]);
    assert!(grown < 10 * MIB, "grew by {grown} bytes");
}

#[test]
fn memory_does_not_grow_with_the_number_of_pairs() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    write_run(&run, 32);
    estimates_in_a_loop(&run);
    frames_of_a_folder(&run, folder.path());
}
