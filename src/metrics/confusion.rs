//! Which class was taken for which, and what was missed or made up.

use serde::{Deserialize, Serialize};

use super::{Target, is_covered};
use crate::detector::detection::Detection;
use crate::geometry::PixelBox;

/// Counts of detections by the class that was found and the class that is there. The last row and
/// column are the background: nothing found, nothing there.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Confusion {
    /// `counts[found][there]`.
    pub counts: Vec<Vec<usize>>,
}

impl Confusion {
    /// Nothing counted yet.
    pub fn new(classes: usize) -> Self {
        Self {
            counts: vec![vec![0; classes + 1]; classes + 1],
        }
    }

    /// Counts an image: detections are matched with targets of any class, the largest overlap
    /// first, from an intersection over union of `least_iou` on. A detection without a target, of
    /// which half lies in an ignored box, is left out, and so is a class number that does not exist.
    pub fn add_image(
        &mut self,
        detections: &[Detection],
        targets: &[Target],
        ignored: &[PixelBox],
        least_iou: f64,
    ) {
        let background = self.counts.len() - 1;
        let mut overlaps: Vec<(f64, usize, usize)> = Vec::new();
        for (d, detection) in detections.iter().enumerate() {
            for (t, target) in targets.iter().enumerate() {
                let iou = detection.box_pixel.iou(&target.box_pixel);
                if iou >= least_iou {
                    overlaps.push((iou, d, t));
                }
            }
        }
        overlaps.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut of_detection = vec![None; detections.len()];
        let mut is_found = vec![false; targets.len()];
        for (_, d, t) in overlaps {
            if of_detection[d].is_none() && !is_found[t] {
                of_detection[d] = Some(targets[t].class);
                is_found[t] = true;
            }
        }
        for (detection, there) in detections.iter().zip(of_detection) {
            if there.is_none() && is_covered(&detection.box_pixel, ignored) {
                continue;
            }
            self.count(detection.class, there.unwrap_or(background));
        }
        for (target, is_found) in targets.iter().zip(is_found) {
            if !is_found {
                self.count(background, target.class);
            }
        }
    }

    fn count(&mut self, found: usize, there: usize) {
        if let Some(count) = self
            .counts
            .get_mut(found)
            .and_then(|row| row.get_mut(there))
        {
            *count += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64) -> PixelBox {
        PixelBox::new(x, 0.0, x + 10.0, 10.0)
    }

    fn detection(x: f64, class: usize) -> Detection {
        Detection {
            box_pixel: at(x),
            score: 0.9,
            class,
        }
    }

    fn target(x: f64, class: usize) -> Target {
        Target {
            box_pixel: at(x),
            class,
        }
    }

    #[test]
    fn right_wrong_missed_and_made_up_each_have_their_cell() {
        let mut confusion = Confusion::new(2);
        confusion.add_image(
            &[detection(0.0, 0), detection(100.0, 1), detection(300.0, 1)],
            &[target(1.0, 0), target(101.0, 0), target(200.0, 1)],
            &[],
            0.5,
        );
        assert_eq!(confusion.counts, [[1, 0, 0], [1, 0, 1], [0, 1, 0]]);
    }

    #[test]
    fn the_larger_overlap_wins_and_the_other_detection_is_made_up() {
        let mut confusion = Confusion::new(1);
        let found = [detection(2.0, 0), detection(0.0, 0)];
        confusion.add_image(&found, &[target(0.0, 0)], &[], 0.5);
        assert_eq!(confusion.counts, [[1, 1], [0, 0]]);
    }

    #[test]
    fn what_lies_in_an_ignored_box_and_classes_that_do_not_exist_are_left_out() {
        let mut confusion = Confusion::new(1);
        let found = [detection(50.0, 0), detection(80.0, 7)];
        confusion.add_image(&found, &[], &[at(50.0)], 0.5);
        assert_eq!(confusion.counts, [[0, 0], [0, 0]]);
    }
}
