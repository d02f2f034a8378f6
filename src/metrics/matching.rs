//! Which detection is a true positive of which target, per overlap threshold.

use super::Target;
use crate::detector::detection::Detection;
use crate::geometry::PixelBox;

/// Overlaps from which on a detection counts as correct: 0.50, 0.55, .., 0.95.
pub const IOU_THRESHOLDS: [f64; 10] = [0.50, 0.55, 0.60, 0.65, 0.70, 0.75, 0.80, 0.85, 0.90, 0.95];

/// Position of 0.50 in [`IOU_THRESHOLDS`].
pub(super) const AT_50: usize = 0;

/// Position of 0.75 in [`IOU_THRESHOLDS`].
pub(super) const AT_75: usize = 5;

/// Keeps empty boxes from dividing by zero, as in the YOLO11 metrics.
const UNION_EPSILON: f64 = 1e-7;

/// True-positive flags of detections that stand in descending order of their scores.
///
/// Independently per threshold, each detection takes the unclaimed target of its class that it
/// overlaps most; from the threshold on it is a true positive and claims the target.
pub(super) fn true_positives(detections: &[Detection], targets: &[Target]) -> Vec<[bool; 10]> {
    let mut flags = vec![[false; 10]; detections.len()];
    let mut claimed = vec![[false; 10]; targets.len()];
    for (detection, flags) in detections.iter().zip(&mut flags) {
        let overlaps: Vec<f64> = targets
            .iter()
            .map(|target| {
                if target.class == detection.class {
                    overlap(&detection.box_pixel, &target.box_pixel)
                } else {
                    0.0
                }
            })
            .collect();
        for (t, threshold) in IOU_THRESHOLDS.iter().enumerate() {
            let mut best: Option<(usize, f64)> = None;
            for (target, &iou) in overlaps.iter().enumerate() {
                if !claimed[target][t] && best.is_none_or(|(_, highest)| iou > highest) {
                    best = Some((target, iou));
                }
            }
            if let Some((target, iou)) = best
                && iou >= *threshold
            {
                flags[t] = true;
                claimed[target][t] = true;
            }
        }
    }
    flags
}

/// Intersection over union with a small number added to the union; 0 for a box that is not finite.
fn overlap(a: &PixelBox, b: &PixelBox) -> f64 {
    let width = a.x_max.min(b.x_max) - a.x_min.max(b.x_min);
    let height = a.y_max.min(b.y_max) - a.y_min.max(b.y_min);
    let intersection = width.max(0.0) * height.max(0.0);
    let iou = intersection / (a.area() + b.area() - intersection + UNION_EPSILON);
    // NaN would keep every later target from being the best; `max` turns it into 0.
    iou.max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn detection(x: f64, class: usize) -> Detection {
        Detection {
            box_pixel: PixelBox::new(x, 0.0, x + 10.0, 10.0),
            score: 0.5,
            class,
        }
    }

    fn target(x: f64, class: usize) -> Target {
        Target {
            box_pixel: PixelBox::new(x, 0.0, x + 10.0, 10.0),
            class,
        }
    }

    #[test]
    fn a_target_is_claimed_once_and_by_the_first_detection() {
        let flags = true_positives(&[detection(0.0, 0), detection(0.0, 0)], &[target(0.0, 0)]);
        assert_eq!(flags, [[true; 10], [false; 10]]);
    }

    #[test]
    fn an_overlap_of_two_thirds_counts_up_to_0_65() {
        let flags = true_positives(&[detection(2.0, 0)], &[target(0.0, 0)]);
        let expected = IOU_THRESHOLDS.map(|threshold| threshold < 0.66);
        assert_eq!(flags, [expected]);
    }

    #[test]
    fn another_class_never_matches() {
        let flags = true_positives(&[detection(0.0, 1)], &[target(0.0, 0)]);
        assert_eq!(flags, [[false; 10]]);
    }

    #[test]
    fn a_target_without_a_usable_box_does_not_hide_the_others() {
        let lost = Target {
            box_pixel: PixelBox::new(f64::NAN, 0.0, f64::INFINITY, 1.0),
            class: 0,
        };
        let flags = true_positives(&[detection(0.0, 0)], &[lost, target(0.0, 0)]);
        assert_eq!(flags, [[true; 10]]);
    }

    #[test]
    fn a_detection_whose_best_target_is_taken_gets_the_next_best() {
        let detections = [detection(0.0, 0), detection(1.0, 0)];
        let targets = [target(0.0, 0), target(3.0, 0)];
        let flags = true_positives(&detections, &targets);
        assert!(flags[0][AT_50] && flags[1][AT_50]);
    }
}
