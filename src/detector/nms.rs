//! Non-maximum suppression: of many boxes around the same vehicle only the best one stays.
//!
//! Follows YOLO11's conventions: a confidence floor, the best class or every class of an anchor,
//! greedy suppression in descending score, classes kept apart unless told otherwise. Knows plain
//! slices only.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::geometry::PixelBox;

/// How many and which boxes stay.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NmsConfig {
    /// Scores must be above this.
    pub confidence: f32,
    /// A box goes when its intersection over union with a better one is above this.
    pub iou: f64,
    /// At most this many boxes, the best ones, enter the suppression.
    pub max_nms: usize,
    /// At most this many boxes stay.
    pub max_detections: usize,
    /// Whether one anchor may stand for several classes (only with more than one class).
    pub multi_label: bool,
    /// Whether boxes suppress those of other classes too.
    pub class_agnostic: bool,
}

impl NmsConfig {
    /// What users see: confidence above 0.25, one class per anchor.
    pub const fn prediction() -> Self {
        Self {
            confidence: 0.25,
            iou: 0.7,
            max_nms: 30_000,
            max_detections: 300,
            multi_label: false,
            class_agnostic: false,
        }
    }

    /// What metrics need: nearly everything, with every class of an anchor.
    pub const fn validation() -> Self {
        Self {
            confidence: 0.001,
            multi_label: true,
            ..Self::prediction()
        }
    }
}

impl Default for NmsConfig {
    fn default() -> Self {
        Self::prediction()
    }
}

/// A box that a detector proposes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// The box, pixels of the letterboxed input.
    pub box_letterbox: PixelBox,
    /// Probability of the class.
    pub score: f32,
    /// Class number.
    pub class: usize,
    /// The anchor it comes from.
    pub anchor: usize,
}

/// The boxes that stay, best first.
///
/// `decoded` is one image's decoded output, row-major with one column per anchor: centre x,
/// centre y, width, height in pixels, then one row of probabilities per class. Boxes and scores
/// that are not finite are dropped. Equal scores keep the order of their anchors.
///
/// # Errors
/// No classes, or a length that is no multiple of `4 + classes`.
pub fn non_maximum_suppression(
    decoded: &[f32],
    classes: usize,
    config: &NmsConfig,
) -> Result<Vec<Candidate>> {
    let rows = 4 + classes;
    if classes == 0 || !decoded.len().is_multiple_of(rows) {
        return Err(Error::value(
            format!("decoded detections of {} numbers", decoded.len()),
            format!("need four box rows and {classes} class rows of one length"),
            "give the decoded output of one image and its number of classes",
        ));
    }
    let mut candidates = candidates(decoded, classes, config);
    // A stable sort: equal scores keep the order of their anchors.
    candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
    candidates.truncate(config.max_nms);
    Ok(suppressed(&candidates, config))
}

/// Everything above the confidence floor, in the order of anchors.
fn candidates(decoded: &[f32], classes: usize, config: &NmsConfig) -> Vec<Candidate> {
    let anchors = decoded.len() / (4 + classes);
    let (boxes, scores) = decoded.split_at(4 * anchors);
    let is_score = |score: f32| score.is_finite() && score > config.confidence;
    let candidate = |anchor: usize, class: usize, score: f32| {
        let [x, y, w, h] = [0, 1, 2, 3].map(|row| f64::from(boxes[row * anchors + anchor]));
        let box_letterbox = PixelBox::from_center([x, y], w, h);
        [x, y, w, h]
            .iter()
            .all(|v| v.is_finite())
            .then_some(Candidate {
                box_letterbox,
                score,
                class,
                anchor,
            })
    };
    if config.multi_label && classes > 1 {
        return (0..anchors)
            .flat_map(|anchor| (0..classes).map(move |class| (anchor, class)))
            .filter_map(|(anchor, class)| {
                let score = scores[class * anchors + anchor];
                is_score(score).then(|| candidate(anchor, class, score))?
            })
            .collect();
    }
    // Row by row, as the scores lie in memory.
    let mut best: Vec<Option<(usize, f32)>> = vec![None; anchors];
    for (class, row) in scores.chunks_exact(anchors.max(1)).enumerate() {
        for (best, &score) in best.iter_mut().zip(row) {
            if is_score(score) && best.is_none_or(|(_, highest)| score > highest) {
                *best = Some((class, score));
            }
        }
    }
    best.iter()
        .enumerate()
        .filter_map(|(anchor, best)| {
            best.and_then(|(class, score)| candidate(anchor, class, score))
        })
        .collect()
}

/// Greedy suppression of candidates that stand in descending order of their scores.
///
/// Comparing class numbers is the same as moving every class's boxes far apart, without the
/// rounding that large coordinates bring.
fn suppressed(candidates: &[Candidate], config: &NmsConfig) -> Vec<Candidate> {
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in candidates {
        if kept.len() >= config.max_detections {
            break;
        }
        let is_covered = kept.iter().any(|better| {
            (config.class_agnostic || better.class == candidate.class)
                && better.box_letterbox.iou(&candidate.box_letterbox) > config.iou
        });
        if !is_covered {
            kept.push(*candidate);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of anchors (cx, cy, w, h, scores..) as the decoded output has them.
    fn decoded<const N: usize>(anchors: &[[f32; N]]) -> Vec<f32> {
        (0..N)
            .flat_map(|row| anchors.iter().map(move |anchor| anchor[row]))
            .collect()
    }

    fn anchors_kept<const N: usize>(anchors: &[[f32; N]], config: &NmsConfig) -> Vec<usize> {
        non_maximum_suppression(&decoded(anchors), N - 4, config)
            .unwrap()
            .iter()
            .map(|candidate| candidate.anchor)
            .collect()
    }

    #[test]
    fn the_best_of_overlapping_boxes_stays_and_distant_ones_too() {
        let anchors = [
            [50.0, 50.0, 20.0, 20.0, 0.8],
            [51.0, 50.0, 20.0, 20.0, 0.9],
            [150.0, 50.0, 20.0, 20.0, 0.3],
        ];
        assert_eq!(anchors_kept(&anchors, &NmsConfig::prediction()), [1, 2]);
    }

    #[test]
    fn classes_do_not_suppress_each_other_unless_agnostic() {
        let anchors = [
            [50.0, 50.0, 20.0, 20.0, 0.8, 0.1],
            [50.0, 50.0, 20.0, 20.0, 0.1, 0.7],
        ];
        let config = NmsConfig::prediction();
        assert_eq!(anchors_kept(&anchors, &config), [0, 1]);
        let agnostic = NmsConfig {
            class_agnostic: true,
            ..config
        };
        assert_eq!(anchors_kept(&anchors, &agnostic), [0]);
    }

    #[test]
    fn several_labels_of_one_anchor_come_only_when_asked_for() {
        let anchors = [[50.0, 50.0, 20.0, 20.0, 0.8, 0.6]];
        assert_eq!(anchors_kept(&anchors, &NmsConfig::prediction()), [0]);
        assert_eq!(anchors_kept(&anchors, &NmsConfig::validation()), [0, 0]);
    }

    #[test]
    fn numbers_that_are_not_finite_are_dropped() {
        let anchors = [
            [50.0, 50.0, 20.0, 20.0, f32::NAN],
            [f32::NAN, 50.0, 20.0, 20.0, 0.9],
            [50.0, 50.0, f32::INFINITY, 20.0, 0.9],
            [50.0, 50.0, 20.0, 20.0, f32::INFINITY],
            [50.0, 50.0, 20.0, 20.0, 0.5],
        ];
        assert_eq!(anchors_kept(&anchors, &NmsConfig::prediction()), [4]);
        let one_class = [[50.0, 50.0, 20.0, 20.0, f32::NAN, 0.4]];
        assert_eq!(anchors_kept(&one_class, &NmsConfig::prediction()), [0]);
    }

    #[test]
    fn a_score_equal_to_the_floor_is_too_low() {
        let anchors = [[50.0, 50.0, 20.0, 20.0, 0.25]];
        assert!(anchors_kept(&anchors, &NmsConfig::prediction()).is_empty());
    }

    #[test]
    fn no_anchors_give_no_boxes_and_a_wrong_length_is_refused() {
        let config = NmsConfig::prediction();
        assert!(non_maximum_suppression(&[], 1, &config).unwrap().is_empty());
        assert!(non_maximum_suppression(&[0.0; 7], 1, &config).is_err());
        assert!(non_maximum_suppression(&[0.0; 8], 0, &config).is_err());
    }

    #[test]
    fn limits_hold_the_best_boxes() {
        let anchors: Vec<[f32; 5]> = (0..20u8)
            .map(|i| {
                [
                    100.0 * f32::from(i),
                    50.0,
                    20.0,
                    20.0,
                    0.5 + 0.01 * f32::from(i),
                ]
            })
            .collect();
        let few = NmsConfig {
            max_detections: 2,
            ..NmsConfig::prediction()
        };
        assert_eq!(anchors_kept(&anchors, &few), [19, 18]);
        let few = NmsConfig {
            max_nms: 3,
            ..NmsConfig::prediction()
        };
        assert_eq!(anchors_kept(&anchors, &few), [19, 18, 17]);
    }
}
