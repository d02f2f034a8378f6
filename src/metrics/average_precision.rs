//! Precision, recall and average precision of a detector over a data set.
//!
//! Follows YOLO11's conventions: matching in descending order of scores, 101-point interpolated
//! average precision at ten overlaps, and precision, recall and F1 at the one confidence where the
//! mean F1 over the classes is best.

mod intervals;

use serde::{Deserialize, Serialize};

use super::coco::{self, CocoSummary};
use super::curves::{CONFIDENCE_STEPS, DetectionCurves, EPSILON, RunningCounts};
use super::matching::{AT_50, AT_75, IOU_THRESHOLDS, true_positives};
use crate::detector::detection::Detection;
use crate::error::{Error, Result};
use crate::geometry::PixelBox;

/// A vehicle that should be found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// Its box, in the same pixels as the detections.
    pub box_pixel: PixelBox,
    /// Class number.
    pub class: usize,
}

/// Collects detections and targets image by image.
///
/// ```
/// use twinsight::detector::detection::Detection;
/// use twinsight::geometry::PixelBox;
/// use twinsight::metrics::{DetectionMetrics, Target};
///
/// let box_pixel = PixelBox::new(10.0, 10.0, 50.0, 40.0);
/// let mut metrics = DetectionMetrics::new(1);
/// metrics.add_image(
///     &[Detection { box_pixel, score: 0.9, class: 0 }],
///     &[Target { box_pixel, class: 0 }],
/// )?;
/// assert_eq!(metrics.compute().recall, 1.0);
/// # Ok::<(), twinsight::error::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct DetectionMetrics {
    classes: usize,
    /// Detections by image in descending order of their scores, with the targets.
    images: Vec<(Vec<Detection>, Vec<Target>)>,
}

/// What a detector is worth; all values from 0 to 1.
///
/// Without targets, and likewise without detections, every value is 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DetectionSummary {
    /// Number of images.
    pub images: usize,
    /// Number of targets.
    pub targets: usize,
    /// Number of detections, all classes and confidences.
    pub detections: usize,
    /// Share of the detections that are right at [`DetectionSummary::best_confidence`], mean over
    /// the classes.
    pub precision: f64,
    /// Share of the targets that are found there, mean over the classes.
    pub recall: f64,
    /// Harmonic mean of both there, mean over the classes.
    pub f1: f64,
    /// The confidence where the smoothed mean F1 is largest; None where no target is ever found.
    pub best_confidence: Option<f64>,
    /// Its index in [`DetectionCurves::confidence`].
    pub best_index: usize,
    /// Mean average precision at an overlap of 0.50.
    pub map50: f64,
    /// Mean average precision at an overlap of 0.75.
    pub map75: f64,
    /// Mean average precision over the overlaps 0.50 to 0.95: the number that training maximises.
    pub map50_95: f64,
    /// The classes that have targets.
    pub per_class: Vec<ClassMetrics>,
    /// Curves over the confidence, rows as in [`DetectionSummary::per_class`].
    pub curves: DetectionCurves,
}

/// One class of a [`DetectionSummary`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClassMetrics {
    /// Class number.
    pub class: usize,
    /// Number of targets.
    pub targets: usize,
    /// Number of detections at any confidence.
    pub detections: usize,
    /// Precision at the common best confidence.
    pub precision: f64,
    /// Recall there.
    pub recall: f64,
    /// Harmonic mean of both there.
    pub f1: f64,
    /// Number of right detections there, from the interpolated recall.
    pub true_positives: f64,
    /// Number of wrong detections there, from the interpolated precision.
    pub false_positives: f64,
    /// Average precision at the overlaps 0.50, 0.55, .., 0.95.
    pub average_precision: [f64; 10],
}

impl ClassMetrics {
    /// Average precision at an overlap of 0.50.
    pub fn ap50(&self) -> f64 {
        self.average_precision[AT_50]
    }

    /// Average precision at an overlap of 0.75.
    pub fn ap75(&self) -> f64 {
        self.average_precision[AT_75]
    }

    /// Mean average precision over the ten overlaps.
    pub fn ap50_95(&self) -> f64 {
        self.average_precision.iter().sum::<f64>() / IOU_THRESHOLDS.len() as f64
    }
}

impl DetectionMetrics {
    /// Nothing collected yet, for a data set with this many classes.
    pub const fn new(classes: usize) -> Self {
        Self {
            classes,
            images: Vec::new(),
        }
    }

    /// Adds everything that another collection over the same classes holds.
    pub fn merge(&mut self, other: &Self) {
        self.images.extend_from_slice(&other.images);
    }

    /// Whether no image was added yet.
    pub fn is_empty(&self) -> bool {
        self.images.is_empty()
    }

    /// Adds an image without boxes to ignore; see [`DetectionMetrics::add_image_ignoring`].
    ///
    /// # Errors
    /// Those of [`DetectionMetrics::add_image_ignoring`].
    pub fn add_image(&mut self, detections: &[Detection], targets: &[Target]) -> Result<()> {
        self.add_image_ignoring(detections, targets, &[])
    }

    /// Adds an image; any list may be empty.
    ///
    /// A detection that is right for no target at an overlap of 0.50, and of which at least half
    /// lies in one of the `ignored` boxes, is left out: it is neither true nor false, whatever its
    /// class. Boxes of all lists are in the same pixels: the letterboxed input's for figures comparable
    /// with YOLO11's. Detections whose score or box is not finite are left out.
    ///
    /// # Errors
    /// A class number that the data set does not have.
    pub fn add_image_ignoring(
        &mut self,
        detections: &[Detection],
        targets: &[Target],
        ignored: &[PixelBox],
    ) -> Result<()> {
        let classes = detections
            .iter()
            .map(|d| d.class)
            .chain(targets.iter().map(|t| t.class));
        if let Some(class) = classes.max().filter(|&class| class >= self.classes) {
            return Err(Error::value(
                format!("class {class}"),
                format!("the data set has {} classes, numbered from 0", self.classes),
                "check the class names and the labels",
            ));
        }
        let mut detections: Vec<Detection> = detections
            .iter()
            .copied()
            .filter(|d| d.score.is_finite() && is_finite(&d.box_pixel))
            .collect();
        detections.sort_by(|a, b| b.score.total_cmp(&a.score));
        if !ignored.is_empty() {
            let flags = true_positives(&detections, targets);
            let mut right = flags.iter().map(|flags| flags[AT_50]);
            detections.retain(|detection| {
                right.next() == Some(true) || !is_covered(&detection.box_pixel, ignored)
            });
        }
        self.images.push((detections, targets.to_vec()));
        Ok(())
    }

    /// True-positive flags at [`IOU_THRESHOLDS`] of all finite detections:
    /// image by image as added, within an image in descending order of scores.
    pub fn true_positives(&self) -> Vec<[bool; 10]> {
        self.images
            .iter()
            .flat_map(|(detections, targets)| true_positives(detections, targets))
            .collect()
    }

    /// All figures of what was collected so far.
    pub fn compute(&self) -> DetectionSummary {
        let detections = self.images.iter().flat_map(|(detections, _)| detections);
        let mut ranked: Vec<(f64, usize, [bool; 10])> = detections
            .zip(self.true_positives())
            .map(|(detection, flags)| (f64::from(detection.score), detection.class, flags))
            .collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut targets_of_class = vec![0; self.classes];
        for target in self.images.iter().flat_map(|(_, targets)| targets) {
            targets_of_class[target.class] += 1;
        }

        let mut curves = DetectionCurves::new();
        let mut per_class = Vec::new();
        for (class, &targets) in targets_of_class.iter().enumerate().filter(|(_, n)| **n > 0) {
            let of_class: Vec<_> = ranked.iter().filter(|(_, c, _)| *c == class).collect();
            let counts = |t: usize| RunningCounts::new(of_class.iter().map(|d| d.2[t]), targets);
            let scores: Vec<f64> = of_class.iter().map(|d| d.0).collect();
            curves.push(&scores, &counts(AT_50));
            per_class.push(ClassMetrics {
                class,
                targets,
                detections: of_class.len(),
                precision: 0.0,
                recall: 0.0,
                f1: 0.0,
                true_positives: 0.0,
                false_positives: 0.0,
                average_precision: std::array::from_fn(|t| counts(t).average_precision()),
            });
        }
        let best_index = curves.best_index();
        for (row, class) in per_class.iter_mut().enumerate() {
            class.precision = curves.precision[row][best_index];
            class.recall = curves.recall[row][best_index];
            class.f1 = curves.f1[row][best_index];
            let right = (class.recall * class.targets as f64).round_ties_even();
            class.true_positives = right;
            class.false_positives = (right / (class.precision + EPSILON) - right).round_ties_even();
        }

        let mean = |value: &dyn Fn(&ClassMetrics) -> f64| {
            per_class
                .iter()
                .map(value)
                .fold(0.0, |sum, value| sum + value)
                / (per_class.len() as f64).max(1.0)
        };
        let f1 = mean(&|class| class.f1);
        let confidence = best_index as f64 / (CONFIDENCE_STEPS - 1) as f64;
        DetectionSummary {
            images: self.images.len(),
            targets: targets_of_class.iter().sum(),
            detections: ranked.len(),
            precision: mean(&|class| class.precision),
            recall: mean(&|class| class.recall),
            f1,
            best_confidence: (f1 > 0.0).then_some(confidence),
            best_index,
            map50: mean(&ClassMetrics::ap50),
            map75: mean(&ClassMetrics::ap75),
            map50_95: mean(&ClassMetrics::ap50_95),
            per_class,
            curves,
        }
    }

    /// The figures of the COCO evaluation, with at most `max_detections` per image and class
    /// where the standard limit is 100.
    pub fn coco_summary(&self, max_detections: usize) -> CocoSummary {
        coco::evaluate(&self.images, self.classes, max_detections)
    }
}

/// Whether at least half of a detection lies in one of the boxes to ignore, as for the crowds of
/// COCO and the don't-care regions of KITTI.
pub fn is_covered(detection: &PixelBox, ignored: &[PixelBox]) -> bool {
    ignored
        .iter()
        .any(|area| 2.0 * detection.intersection(area).area() >= detection.area())
}

fn is_finite(b: &PixelBox) -> bool {
    [b.x_min, b.y_min, b.x_max, b.y_max]
        .iter()
        .all(|v| v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOX: PixelBox = PixelBox::new(0.0, 0.0, 10.0, 10.0);
    const ELSEWHERE: PixelBox = PixelBox::new(50.0, 0.0, 60.0, 10.0);

    fn detection(box_pixel: PixelBox, score: f32) -> Detection {
        Detection {
            box_pixel,
            score,
            class: 0,
        }
    }

    const TARGET: Target = Target {
        box_pixel: BOX,
        class: 0,
    };

    fn assert_all_zero(summary: &DetectionSummary) {
        let values = [
            summary.precision,
            summary.recall,
            summary.f1,
            summary.map50,
            summary.map75,
            summary.map50_95,
        ];
        assert_eq!(values, [0.0; 6]);
        assert_eq!(summary.best_confidence, None);
    }

    #[test]
    fn without_anything_every_value_is_zero() {
        let summary = DetectionMetrics::new(2).compute();
        assert_all_zero(&summary);
        assert!(summary.per_class.is_empty());
    }

    #[test]
    fn detections_without_targets_give_zero() {
        let mut metrics = DetectionMetrics::new(1);
        metrics.add_image(&[detection(BOX, 0.9)], &[]).unwrap();
        let summary = metrics.compute();
        assert_all_zero(&summary);
        assert_eq!(
            (summary.images, summary.targets, summary.detections),
            (1, 0, 1)
        );
    }

    #[test]
    fn targets_without_detections_give_zero_and_name_the_class() {
        let mut metrics = DetectionMetrics::new(1);
        metrics.add_image(&[], &[TARGET]).unwrap();
        let summary = metrics.compute();
        assert_all_zero(&summary);
        assert_eq!(summary.per_class[0].targets, 1);
        assert_eq!(summary.per_class[0].false_positives, 0.0);
    }

    #[test]
    fn only_wrong_detections_give_zero() {
        let mut metrics = DetectionMetrics::new(1);
        metrics
            .add_image(&[detection(ELSEWHERE, 0.9)], &[TARGET])
            .unwrap();
        let summary = metrics.compute();
        assert_eq!((summary.recall, summary.map50, summary.f1), (0.0, 0.0, 0.0));
        assert_eq!(summary.best_confidence, None);
    }

    #[test]
    fn a_false_alarm_of_low_score_is_cut_off_by_the_best_confidence() {
        let mut metrics = DetectionMetrics::new(1);
        for _ in 0..10 {
            let found = [detection(ELSEWHERE, 0.1), detection(BOX, 0.9)];
            metrics.add_image(&found, &[TARGET]).unwrap();
        }
        let summary = metrics.compute();
        // Precision is interpolated between the two scores, so it stays a little below 1.
        assert!(summary.precision > 0.99, "{}", summary.precision);
        assert_eq!(summary.recall, 1.0);
        let confidence = summary.best_confidence.unwrap();
        assert!(confidence > 0.1 && confidence < 0.9, "{confidence}");
        assert!((summary.map50_95 - 0.995).abs() < 1e-9);
        let class = &summary.per_class[0];
        assert_eq!((class.true_positives, class.false_positives), (10.0, 0.0));
    }

    #[test]
    fn detections_that_are_not_finite_are_left_out() {
        let mut metrics = DetectionMetrics::new(1);
        let nowhere = PixelBox::new(f64::NAN, 0.0, 1.0, 1.0);
        let found = [
            detection(BOX, f32::NAN),
            detection(nowhere, 0.9),
            detection(BOX, 0.8),
        ];
        metrics.add_image(&found, &[TARGET]).unwrap();
        let summary = metrics.compute();
        assert_eq!(
            (summary.detections, summary.recall, summary.precision),
            (1, 1.0, 1.0)
        );
    }

    #[test]
    fn a_detection_of_an_ignored_vehicle_is_neither_true_nor_false() {
        let with = |ignored: &[PixelBox]| {
            let mut metrics = DetectionMetrics::new(1);
            let found = [detection(ELSEWHERE, 0.9), detection(BOX, 0.8)];
            metrics
                .add_image_ignoring(&found, &[TARGET], ignored)
                .unwrap();
            metrics.compute()
        };
        let (judged, ignoring) = (with(&[]), with(&[ELSEWHERE]));
        assert_eq!((judged.detections, judged.precision), (2, 0.5));
        assert_eq!((ignoring.detections, ignoring.precision), (1, 1.0));
        assert_eq!((ignoring.targets, ignoring.recall), (1, 1.0));
        assert!(ignoring.map50 > 0.99 && judged.map50 < 0.6);
    }

    #[test]
    fn a_target_in_front_of_an_ignored_vehicle_is_judged_and_its_second_detection_is_not() {
        let mut metrics = DetectionMetrics::new(1);
        let found = [detection(BOX, 0.9), detection(BOX, 0.8)];
        let behind = PixelBox::new(-5.0, -5.0, 15.0, 15.0);
        metrics
            .add_image_ignoring(&found, &[TARGET], &[behind])
            .unwrap();
        let summary = metrics.compute();
        assert_eq!((summary.detections, summary.recall), (1, 1.0));
    }

    #[test]
    fn a_detection_that_reaches_into_an_ignored_box_by_less_than_half_is_judged() {
        let mut metrics = DetectionMetrics::new(1);
        let beside = PixelBox::new(55.1, 0.0, 80.0, 10.0);
        metrics
            .add_image_ignoring(&[detection(ELSEWHERE, 0.9)], &[TARGET], &[beside])
            .unwrap();
        assert_eq!(metrics.compute().detections, 1);
    }

    #[test]
    fn an_unknown_class_is_refused_by_number() {
        let target = Target { class: 3, ..TARGET };
        let error = DetectionMetrics::new(3)
            .add_image(&[], &[target])
            .unwrap_err();
        assert!(error.to_string().contains("class 3"), "{error}");
    }
}
