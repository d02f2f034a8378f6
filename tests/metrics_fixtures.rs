//! Average precision, curves, COCO figures and distance errors against the reference numbers.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "tests panic and report where the library must not"
)]

mod support;

use support::fixture::{Fixture, assert_abs, assert_close};
use twinsight::detector::detection::Detection;
use twinsight::geometry::PixelBox;
use twinsight::metrics::{DetectionMetrics, DetectionSummary, DistanceErrors, Target};

const FILES: [&str; 2] = ["ap_nc1", "ap_nc3"];

/// Everything is computed in double precision.
const TOLERANCE: f64 = 1e-5;

fn collected(fixture: &Fixture) -> DetectionMetrics {
    let number = |key| fixture.meta_number(key).unwrap() as usize;
    let mut metrics = DetectionMetrics::new(number("nc"));
    let (_, targets) = fixture.f32("in.gt");
    let (_, detections) = fixture.f32("in.pred");
    let (targets, detections) = (targets.as_chunks::<6>().0, detections.as_chunks::<7>().0);
    let pixel_box = |row: &[f32]| {
        let edge = |i: usize| f64::from(row[i]);
        PixelBox::new(edge(0), edge(1), edge(2), edge(3))
    };
    for image in 0..number("images") {
        let image = image as f32;
        let detections: Vec<Detection> = detections
            .iter()
            .filter(|row| row[0] == image)
            .map(|row| Detection {
                box_pixel: pixel_box(&row[3..]),
                score: row[2],
                class: row[1] as usize,
            })
            .collect();
        let targets: Vec<Target> = targets
            .iter()
            .filter(|row| row[0] == image)
            .map(|row| Target {
                box_pixel: pixel_box(&row[2..]),
                class: row[1] as usize,
            })
            .collect();
        metrics.add_image(&detections, &targets).unwrap();
    }
    metrics
}

fn for_each_file(check: impl Fn(&Fixture, &DetectionMetrics, &DetectionSummary)) {
    for name in FILES {
        let fixture = Fixture::load(name);
        let metrics = collected(&fixture);
        check(&fixture, &metrics, &metrics.compute());
    }
}

#[test]
fn true_positive_flags_are_exact() {
    for_each_file(|fixture, metrics, _| {
        let flags: Vec<u8> = metrics
            .true_positives()
            .into_iter()
            .flat_map(|flags| flags.map(u8::from))
            .collect();
        assert_eq!(flags, fixture.u8("out.tp_matrix").1);
    });
}

#[test]
fn average_precision_per_class_and_overlap_agrees() {
    for_each_file(|fixture, _, summary| {
        let classes: Vec<i64> = summary.per_class.iter().map(|c| c.class as i64).collect();
        assert_eq!(classes, fixture.i64("out.class_ids").1);
        let precision: Vec<f64> = summary
            .per_class
            .iter()
            .flat_map(|c| c.average_precision)
            .collect();
        assert_abs(
            &precision,
            &fixture.values("out.ap"),
            TOLERANCE,
            "average precision",
        );
    });
}

#[test]
fn precision_recall_and_counts_at_the_best_confidence_agree() {
    for_each_file(|fixture, _, summary| {
        assert_eq!(
            summary.best_index as i64,
            fixture.i64("out.best_index").1[0]
        );
        let confidence = summary.best_confidence.unwrap();
        assert_eq!(confidence, summary.best_index as f64 / 999.0);
        let classes = &summary.per_class;
        let of_classes = |value: fn(&twinsight::metrics::ClassMetrics) -> f64, name: &str| {
            let values: Vec<f64> = classes.iter().map(value).collect();
            assert_abs(&values, &fixture.values(name), TOLERANCE, name);
        };
        of_classes(|c| c.precision, "out.precision");
        of_classes(|c| c.recall, "out.recall");
        of_classes(|c| c.f1, "out.f1");
        of_classes(|c| c.true_positives, "out.tp_count");
        of_classes(|c| c.false_positives, "out.fp_count");
    });
}

#[test]
fn means_over_the_classes_agree() {
    for_each_file(|fixture, _, s| {
        // The last is the fitness, which is the mean average precision.
        let means = [
            s.precision,
            s.recall,
            s.map50,
            s.map75,
            s.map50_95,
            s.map50_95,
        ];
        let expected = fixture.values("out.mp_mr_map50_map75_map_fitness");
        assert_abs(&means, &expected, TOLERANCE, "means");
    });
}

#[test]
fn curves_over_the_confidence_agree() {
    for_each_file(|fixture, _, summary| {
        for (curves, name) in [
            (&summary.curves.precision, "out.p_curve_every_50"),
            (&summary.curves.recall, "out.r_curve_every_50"),
            (&summary.curves.f1, "out.f1_curve_every_50"),
        ] {
            let sampled: Vec<f64> = curves
                .iter()
                .flat_map(|curve| curve.iter().step_by(50).copied())
                .collect();
            assert_abs(&sampled, &fixture.values(name), TOLERANCE, name);
        }
    });
}

#[test]
fn coco_figures_agree() {
    for_each_file(|fixture, metrics, _| {
        for (limit, suffix) in [(100, ""), (300, "_maxdet300")] {
            let coco = metrics.coco_summary(limit);
            // The reference writes -1 where no target counts.
            let number = |value: Option<f64>| value.unwrap_or(-1.0);
            let flat = |rows: &Vec<Vec<Option<f64>>>| -> Vec<f64> {
                rows.iter().flatten().copied().map(number).collect()
            };
            let maps = [coco.map50_95, coco.map50, coco.map75].map(number);
            for (values, name) in [
                (maps.to_vec(), "map"),
                (flat(&coco.average_precision), "ap_per_threshold_class"),
                (flat(&coco.recall), "recall_per_threshold_class"),
            ] {
                let name = format!("out.coco.{name}{suffix}");
                assert_abs(&values, &fixture.values(&name), TOLERANCE, &name);
            }
            if limit == 100 {
                let stats: Vec<f64> = maps
                    .into_iter()
                    .chain(coco.map_by_size.map(number))
                    .chain(coco.recall_by_limit.map(number))
                    .chain(coco.recall_by_size.map(number))
                    .collect();
                assert_abs(
                    &stats,
                    &fixture.values("out.coco.stats"),
                    TOLERANCE,
                    "stats",
                );
            }
        }
    });
}

#[test]
fn distance_errors_agree() {
    let fixture = Fixture::load("distance_metrics");
    let mut errors = DistanceErrors::new();
    for (estimated, truth) in fixture
        .values("in.pred")
        .into_iter()
        .zip(fixture.values("in.target"))
    {
        errors.add(estimated, truth);
    }
    let summary = errors.summary().unwrap();
    assert_eq!(summary.count, 12);
    let (mse, msre) = (summary.mse_m2, summary.msre_percent2);
    for (values, name) in [
        (
            [summary.mae_m, summary.rmse_m, summary.mre_percent],
            "out.mae_rmse_mre_percent_f64",
        ),
        ([mse, msre, mse.max(msre)], "out.mse_msre_loss_f64"),
    ] {
        assert_close(&values, &fixture.values(name), TOLERANCE, name);
    }
}
