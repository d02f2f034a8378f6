//! How far average precision could be off by chance.

use super::{AT_50, DetectionMetrics, RunningCounts};
use crate::metrics::{Interval, Resamples};

impl DetectionMetrics {
    /// Bounds of mAP50 and of mAP50-95 by drawing the images anew in groups, see [`Resamples`];
    /// `group_of_image` has the group of each image in the order of adding. The detections' ranking
    /// is made once: a draw only changes how often each image counts.
    pub fn map_intervals(
        &self,
        resamples: &Resamples,
        group_of_image: &[usize],
    ) -> Option<[Interval; 2]> {
        let mut ranked: Vec<(f32, usize, usize, [bool; 10])> = self
            .images
            .iter()
            .zip(group_of_image)
            .flat_map(|((detections, _), &group)| detections.iter().map(move |d| (d, group)))
            .zip(self.true_positives())
            .map(|((detection, group), flags)| (detection.score, detection.class, group, flags))
            .collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        // Per class: group and flags of each detection, and the number of targets of each group.
        let mut of_class = vec![(Vec::new(), vec![0; resamples.groups()]); self.classes];
        for (_, class, group, flags) in ranked {
            of_class[class].0.push((group, flags));
        }
        for ((_, targets), &group) in self.images.iter().zip(group_of_image) {
            for target in targets {
                of_class[target.class].1[group] += 1;
            }
        }
        resamples.intervals(|counts| {
            let mut sums = [0.0; 2];
            let mut judged = 0.0;
            for (detections, targets) in &of_class {
                let drawn: usize = targets.iter().zip(counts).map(|(n, &k)| n * k).sum();
                if drawn == 0 {
                    continue;
                }
                judged += 1.0;
                let precision: [f64; 10] = std::array::from_fn(|t| {
                    let flags = detections
                        .iter()
                        .flat_map(|(group, flags)| std::iter::repeat_n(flags[t], counts[*group]));
                    RunningCounts::new(flags, drawn).average_precision()
                });
                sums[0] += precision[AT_50];
                sums[1] += precision.iter().sum::<f64>() / precision.len() as f64;
            }
            (judged > 0.0).then(|| sums.map(|sum| sum / judged))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detector::detection::Detection;
    use crate::geometry::PixelBox;
    use crate::metrics::Target;

    fn at(x: f64) -> PixelBox {
        PixelBox::new(x, 0.0, x + 10.0, 10.0)
    }

    fn found(x: f64) -> Detection {
        Detection {
            box_pixel: at(x),
            score: 0.9,
            class: 0,
        }
    }

    #[test]
    fn bounds_hold_the_average_precision_and_images_that_are_alike_leave_none_between_them() {
        let target = Target {
            box_pixel: at(0.0),
            class: 0,
        };
        let mut metrics = DetectionMetrics::new(1);
        for i in 0..40 {
            let detections = [found(if i % 4 == 0 { 50.0 } else { 0.0 })];
            metrics.add_image(&detections, &[target]).unwrap();
        }
        let groups: Vec<usize> = (0..40).collect();
        let draws = Resamples::new(40, 100);
        let [map50, map50_95] = metrics.map_intervals(&draws, &groups).unwrap();
        let summary = metrics.compute();
        assert!(map50.contains(summary.map50) && map50_95.contains(summary.map50_95));
        assert!(map50.high - map50.low > 0.1);
        // Groups of four images, one of which is wrong, are all the same.
        let groups: Vec<usize> = (0..40).map(|i| i / 4).collect();
        let [map50, _] = metrics
            .map_intervals(&Resamples::new(10, 50), &groups)
            .unwrap();
        assert!(map50.high - map50.low < 1e-12);
    }
}
