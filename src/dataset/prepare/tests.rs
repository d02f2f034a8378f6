use super::*;
use crate::dataset::CompositeSet;
use crate::dataset::fixture::Fixture;
use crate::imaging::load_rgb;
use crate::progress::Silent;

const SIZE: CompositeSize = CompositeSize::SMALLEST;

fn names(fixture: &Fixture, split: &str) -> Vec<String> {
    let mut names: Vec<_> = fs::read_dir(fixture.path("composites").join(split))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn every_pair_becomes_a_composite_with_its_truth() {
    let fixture = Fixture::new(5);
    let dataset = fixture.open();
    let report = prepare(&dataset, BoxKind::Tight, SIZE, &Silent).unwrap();
    assert_eq!(
        report.statistics.counts,
        SplitCounts {
            train: 3,
            val: 1,
            test: 1
        }
    );
    assert_eq!(names(&fixture, "val"), ["00004_3.png", "00004_3.txt"]);
    let vehicle = &dataset.frame(4).unwrap().vehicles(BoxKind::Tight)[0];
    let [left, right] = dataset.frame(4).unwrap().load(dataset.rig()).unwrap();
    let expected = composite(
        &left,
        &right,
        &vehicle.left.box_pixel,
        &vehicle.right.box_pixel,
        SIZE,
    );
    assert_eq!(
        load_rgb(fixture.path("composites/val/00004_3.png")).unwrap(),
        expected
    );
    let set = CompositeSet::open(fixture.root(), Split::Val).unwrap();
    let item = &set.items[0];
    assert_eq!((item.stamp, item.id, item.distance_m), (4, 3, 14.0));
    assert_eq!(item.geometry, [26.0 / 96.0, 16.0 / 54.0]);
    assert_eq!(item.load(SIZE).unwrap(), expected);
}

#[test]
fn the_statistics_are_those_of_a_direct_computation() {
    let fixture = Fixture::new(8);
    let report = prepare(&fixture.open(), BoxKind::Sphere, SIZE, &Silent).unwrap();
    let set = CompositeSet::open(fixture.root(), Split::Train).unwrap();
    assert_eq!(set.statistics, report.statistics);
    let statistics = set.statistics.train.unwrap();
    let images: Vec<_> = set
        .items
        .iter()
        .map(|item| item.load(SIZE).unwrap())
        .collect();
    for channel in 0..3 {
        let values: Vec<f64> = images
            .iter()
            .flat_map(|image| {
                image
                    .pixels()
                    .map(|pixel| f64::from(pixel.0[channel]) / 255.0)
            })
            .collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance =
            values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / values.len() as f64;
        assert!((statistics.mean[channel] - mean).abs() < 1e-10);
        assert!((statistics.std[channel] - variance.sqrt()).abs() < 1e-10);
    }
}

#[test]
fn preparing_again_changes_nothing_and_any_change_is_noticed() {
    let fixture = Fixture::new(5);
    let dataset = fixture.open();
    assert!(!is_prepared(&dataset, BoxKind::Sphere, SIZE));
    let first = prepare(&dataset, BoxKind::Sphere, SIZE, &Silent).unwrap();
    let bytes = fs::read(fixture.path("composites/train/00001_3.png")).unwrap();
    assert!(is_prepared(&dataset, BoxKind::Sphere, SIZE));
    assert_eq!(
        prepare(&dataset, BoxKind::Sphere, SIZE, &Silent).unwrap(),
        first
    );
    assert_eq!(
        fs::read(fixture.path("composites/train/00001_3.png")).unwrap(),
        bytes
    );

    assert!(!is_prepared(&dataset, BoxKind::Tight, SIZE));
    assert!(!is_prepared(
        &dataset,
        BoxKind::Sphere,
        CompositeSize::QUICK
    ));
    let mut resplit = dataset.clone();
    resplit.frames[0].row.split = Split::Val;
    assert!(!is_prepared(&resplit, BoxKind::Sphere, SIZE));
    fixture.remove("composites/train/00001_3.png");
    assert!(!is_prepared(&dataset, BoxKind::Sphere, SIZE));
}

#[test]
fn what_does_not_belong_is_removed_and_what_is_not_ours_stays() {
    let fixture = Fixture::new(5);
    let mut dataset = fixture.open();
    prepare(&dataset, BoxKind::Sphere, SIZE, &Silent).unwrap();
    fixture.write("composites/train/notes.txt", "mine");
    fixture.write("composites/train/.twinsight-abc", "half a file");
    dataset.frames[0].row.split = Split::Val;
    let report = prepare(&dataset, BoxKind::Sphere, SIZE, &Silent).unwrap();
    assert_eq!(report.removed, 3);
    assert_eq!(
        names(&fixture, "train"),
        [
            "00002_3.png",
            "00002_3.txt",
            "00003_3.png",
            "00003_3.txt",
            "notes.txt"
        ]
    );
    assert_eq!(
        report.statistics.counts,
        SplitCounts {
            train: 2,
            val: 2,
            test: 1
        }
    );
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let with = |threads| {
        let fixture = Fixture::new(7);
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let dataset = fixture.open();
        pool.install(|| prepare(&dataset, BoxKind::Sphere, SIZE, &Silent))
            .unwrap();
        names(&fixture, "train")
            .into_iter()
            .map(|name| fs::read(fixture.path(&format!("composites/train/{name}"))).unwrap())
            .chain([fs::read(fixture.path("composites/statistics.toml")).unwrap()])
            .collect::<Vec<_>>()
    };
    assert!(with(1) == with(3), "files differ between 1 and 3 threads");
}

#[test]
fn a_broken_image_is_reported_and_its_frame_left_out() {
    let fixture = Fixture::new(5);
    fixture.write("frames/right_00002.png", "no image");
    let report = prepare(&fixture.open(), BoxKind::Sphere, SIZE, &Silent).unwrap();
    assert_eq!(report.statistics.counts.train, 2);
    assert!(
        report.problems[0].to_string().contains("right_00002.png"),
        "{:?}",
        report.problems
    );
    assert!(is_prepared(&fixture.open(), BoxKind::Sphere, SIZE));
}

#[test]
fn a_dataset_that_gives_no_composite_is_refused() {
    let fixture = Fixture::new(1);
    fixture.write("frames/left_00001.txt", "");
    let message = prepare(&fixture.open(), BoxKind::Tight, SIZE, &Silent)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("no vehicle has a tight label in both images"),
        "{message}"
    );
    assert!(!is_prepared(&fixture.open(), BoxKind::Tight, SIZE));
}

#[test]
fn a_test_set_alone_has_no_training_statistics() {
    let fixture = Fixture::new(5);
    let mut dataset = fixture.open();
    dataset
        .frames
        .retain(|frame| frame.row.split == Split::Test);
    let report = prepare(&dataset, BoxKind::Sphere, SIZE, &Silent).unwrap();
    assert_eq!(report.statistics.train, None);
    assert!(is_prepared(&dataset, BoxKind::Sphere, SIZE));
}

/// Asks to stop from the beginning.
struct Impatient;

impl Progress for Impatient {
    fn begin(&self, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn status(&self, _: &str) {}
    fn note(&self, _: &str) {}
    fn end(&self) {}
    fn interrupted(&self) -> bool {
        true
    }
}

#[test]
fn an_interrupted_preparation_is_not_taken_for_a_finished_one() {
    let fixture = Fixture::new(5);
    let dataset = fixture.open();
    prepare(&dataset, BoxKind::Sphere, SIZE, &Silent).unwrap();
    let error = prepare(&dataset, BoxKind::Sphere, SIZE, &Impatient).unwrap_err();
    assert!(matches!(error, Error::Interrupted { .. }), "{error}");
    assert!(!is_prepared(&dataset, BoxKind::Sphere, SIZE));
}
