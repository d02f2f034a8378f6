//! Predictions through the library: batches, filters, frames that cannot be used.
#![allow(clippy::unwrap_used, reason = "a test stops at whatever is unexpected")]

#[path = "support/untrained.rs"]
mod untrained;

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use image::RgbImage;
use tempfile::TempDir;
use twinsight::pairing::PairingMode;
use twinsight::pipeline::{DetectedIn, SingleSided, VehicleFilter};
use twinsight::predict::{FrameRecord, Outcome, Sink, predict};
use twinsight::progress::{Progress, Silent};
use twinsight::ranging::RangerKind;
use twinsight::sources::StereoFrame;
use twinsight::{DeviceName, Error, PredictOptions, Result, StereoRanger, Vehicle};

use untrained::{texture, write_run};

/// Everything that the detector has any idea of.
fn all(pairing_mode: PairingMode) -> PredictOptions {
    PredictOptions {
        confidence: 1e-4,
        iou: 0.2,
        pairing_mode,
        ..PredictOptions::default()
    }
}

fn ranger(folder: &TempDir) -> StereoRanger {
    write_run(folder.path(), 64);
    StereoRanger::load(folder.path(), &DeviceName::FLEX.open().unwrap()).unwrap()
}

/// Textured pairs, the right image being the left one moved.
fn pairs(sizes: &[[u32; 2]]) -> Vec<[RgbImage; 2]> {
    (0..)
        .zip(sizes)
        .map(|(seed, [width, height])| [0, 2].map(|shift| texture(*width, *height, seed, shift)))
        .collect()
}

fn borrowed(pairs: &[[RgbImage; 2]]) -> Vec<[&RgbImage; 2]> {
    pairs.iter().map(|[left, right]| [left, right]).collect()
}

fn numbers(vehicle: &Vehicle) -> [f64; 10] {
    let (l, r) = (&vehicle.left, &vehicle.right);
    [
        l.x_min,
        l.y_min,
        l.x_max,
        l.y_max,
        r.x_min,
        r.y_min,
        r.x_max,
        r.y_max,
        f64::from(vehicle.score),
        vehicle.distance_m,
    ]
}

#[test]
fn a_batch_gives_what_single_estimates_give() {
    let folder = tempfile::tempdir().unwrap();
    let ranger = ranger(&folder);
    let pairs = pairs(&[[64, 36], [64, 36], [96, 54], [64, 36], [64, 36]]);
    for mode in PairingMode::ALL {
        let ranger = ranger.clone().with_options(all(mode));
        let together = ranger.estimate_batch(&borrowed(&pairs)).unwrap();
        assert_eq!(together.len(), pairs.len());
        let mut vehicles = 0;
        for (i, ([left, right], batched)) in pairs.iter().zip(&together).enumerate() {
            let alone = ranger.estimate(left, right).unwrap();
            assert_eq!(alone.len(), batched.len(), "pair {i} with {mode}");
            for (a, b) in alone.iter().zip(batched) {
                for (a, b) in numbers(a).into_iter().zip(numbers(b)) {
                    // Sums of floats in another order.
                    assert!(
                        (a - b).abs() <= 1e-3 * a.abs().max(1.0),
                        "pair {i}, {mode}: {a} {b}"
                    );
                }
                assert_eq!((&a.class, a.detected_in), (&b.class, b.detected_in));
            }
            vehicles += alone.len();
        }
        assert!(vehicles > 0, "something to compare with {mode}");
    }
    assert!(ranger.estimate_batch(&[]).unwrap().is_empty());
}

#[test]
fn without_vehicles_the_list_is_empty() {
    let folder = tempfile::tempdir().unwrap();
    let options = PredictOptions {
        confidence: 1.0,
        ..PredictOptions::default()
    };
    let ranger = ranger(&folder).with_options(options);
    let [left, right] = &pairs(&[[64, 36]])[0];
    assert_eq!(ranger.estimate(left, right).unwrap(), []);
}

#[test]
fn filters_leave_what_is_wanted() {
    let folder = tempfile::tempdir().unwrap();
    // Large enough that boxes differ, and few of them.
    write_run(folder.path(), 320);
    let options = PredictOptions {
        confidence: 3e-3,
        iou: 0.6,
        ..all(PairingMode::Detect)
    };
    let ranger = StereoRanger::load(folder.path(), &DeviceName::FLEX.open().unwrap())
        .unwrap()
        .with_options(options);
    let [left, right] = &pairs(&[[320, 180]])[0];
    let found = |filter: VehicleFilter| {
        let ranger = ranger.clone().with_filter(filter).unwrap();
        ranger.estimate(left, right)
    };
    let everything = found(VehicleFilter::default()).unwrap();
    assert!(everything.len() > 1);

    let best = found(VehicleFilter {
        max_vehicles: Some(1),
        ..VehicleFilter::default()
    });
    let highest = everything.iter().map(|v| v.score).fold(0.0, f32::max);
    assert_eq!(best.unwrap()[0].score, highest);

    for class in ["car", "truck"] {
        let of_class = found(VehicleFilter {
            classes: vec![class.to_owned()],
            ..VehicleFilter::default()
        });
        assert!(
            of_class
                .unwrap()
                .iter()
                .all(|vehicle| vehicle.class == class)
        );
    }

    let x = everything[0].left.center()[0];
    let beside = format!("0,0 {x},0 {x},180 0,180");
    let region = |text: &str| VehicleFilter {
        region: Some(text.parse().unwrap()),
        ..VehicleFilter::default()
    };
    let inside = found(region(&beside)).unwrap();
    assert!(inside.iter().all(|vehicle| vehicle.left.center()[0] < x));
    assert!(inside.len() < everything.len());
    let message = found(region("400,0 500,0 500,36")).unwrap_err().to_string();
    assert!(message.contains("320x180"), "{message}");
}

#[test]
fn a_vehicle_that_the_right_image_does_not_show_is_kept_only_if_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let ranger = ranger(&folder);
    let left = texture(64, 36, 1, 0);
    let right = RgbImage::new(64, 36);
    for single_sided in SingleSided::ALL {
        let options = PredictOptions {
            single_sided,
            ranger: RangerKind::Paper,
            ..all(PairingMode::Search)
        };
        let ranger = ranger.clone().with_options(options);
        let (found, _) = ranger.find(&[[&left, &right]]).unwrap();
        assert_eq!(found[0].vehicles, []);
        let is_kept = single_sided == SingleSided::Keep;
        assert_eq!(!found[0].unmatched.is_empty(), is_kept, "{single_sided}");
        assert!(
            found[0]
                .unmatched
                .iter()
                .all(|v| v.detected_in == DetectedIn::Left)
        );
    }
    // The posterior has an answer for it: what its size says.
    let ranger = ranger.with_options(all(PairingMode::Search));
    let (found, _) = ranger.find(&[[&left, &right]]).unwrap();
    assert!(!found[0].vehicles.is_empty());
    for vehicle in &found[0].vehicles {
        assert_eq!(vehicle.stereo_m, None);
        assert!(vehicle.distance_std_m.unwrap() > 0.05 * vehicle.distance_m);
    }
}

/// Keeps what it takes.
struct Kept(std::sync::Arc<std::sync::Mutex<Vec<FrameRecord>>>);

impl Sink for Kept {
    fn take(&mut self, record: &FrameRecord, images: Option<[&RgbImage; 2]>) -> Result<()> {
        let is_failed = matches!(record.outcome, Outcome::Failed { .. });
        assert_eq!(images.is_none(), is_failed);
        self.0.lock().unwrap().push(record.clone());
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        Ok(())
    }
}

/// Asks to stop after a number of questions.
struct Impatient {
    asked: AtomicU64,
    patience: u64,
}

impl Progress for Impatient {
    fn begin(&self, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn status(&self, _: &str) {}
    fn note(&self, _: &str) {}
    fn end(&self) {}
    fn interrupted(&self) -> bool {
        self.asked.fetch_add(1, Ordering::Relaxed) >= self.patience
    }
}

/// Every third frame is broken.
fn frames(count: u64) -> impl Iterator<Item = StereoFrame> {
    (0..count).map(|index| StereoFrame {
        index,
        name: format!("{index:03}"),
        origins: [String::new(), String::new()],
        time_s: None,
        images: if index % 3 == 2 {
            Err(Error::value("frame", "is broken", "mend it"))
        } else {
            Ok([RgbImage::new(64, 36), RgbImage::new(64, 36)])
        },
        read: Duration::from_millis(1),
    })
}

#[test]
fn broken_frames_are_told_in_their_place_and_the_others_are_measured() {
    let folder = tempfile::tempdir().unwrap();
    let ranger = ranger(&folder);
    for batch in [1, 4, 50] {
        let records = std::sync::Arc::default();
        let mut sinks: Vec<Box<dyn Sink>> = vec![Box::new(Kept(std::sync::Arc::clone(&records)))];
        let summary = predict(&ranger, frames(20), batch, &mut sinks, &Silent).unwrap();
        assert_eq!((summary.frames, summary.failed), (20, 6));
        assert!(!summary.interrupted);
        let records = records.lock().unwrap();
        for (i, record) in records.iter().enumerate() {
            assert_eq!(record.frame, format!("{i:03}"));
            let is_failed =
                matches!(&record.outcome, Outcome::Failed { error } if error.contains("mend it"));
            assert_eq!(is_failed, i % 3 == 2, "{record:?}");
        }
        assert_eq!(records.len(), 20);
    }
}

#[test]
fn a_user_who_asks_to_stop_gets_what_was_done() {
    let folder = tempfile::tempdir().unwrap();
    let ranger = ranger(&folder);
    let impatient = Impatient {
        asked: AtomicU64::new(0),
        patience: 3,
    };
    let summary = predict(&ranger, frames(20), 2, &mut [], &impatient).unwrap();
    assert!(summary.interrupted);
    assert_eq!(summary.frames, 6);
}
