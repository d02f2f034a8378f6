//! Detection metrics over a set of images.

use std::ops::Range;

use burn_dataset::Dataset as _;
use rayon::prelude::*;

use crate::dataset::{DetectionItem, DetectionSource};
use crate::detector::nms::NmsConfig;
use crate::detector::{Detection, LetterboxedCandidates, VehicleDetector};
use crate::error::{Error, Result};
use crate::geometry::PixelBox;
use crate::metrics::{DetectionMetrics, Target};

/// Images that run as one batch.
const BATCH: usize = 16;

/// Matches the detector's boxes with the labels of some items of a set of images, in the coordinates
/// of the network's input.
///
/// # Errors
/// An image that cannot be read, or a device that fails.
pub fn detection_metrics(
    detector: &VehicleDetector,
    source: &DetectionSource,
    items: Range<usize>,
) -> Result<DetectionMetrics> {
    let mut metrics = DetectionMetrics::new(detector.header().classes.len());
    let indices: Vec<usize> = items.collect();
    for indices in indices.chunks(BATCH) {
        let items = indices
            .par_iter()
            .map(|&index| {
                source.get(index).map_err(|source| {
                    Error::training(
                        source.to_string(),
                        "run `twinsight prepare` to list broken frames",
                    )
                })
            })
            .collect::<Result<Vec<DetectionItem>>>()?;
        let images: Vec<_> = items.iter().map(|item| &*item.image).collect();
        let found = detector.detect_letterboxed(&images, &NmsConfig::validation())?;
        for (item, candidates) in items.iter().zip(&found) {
            add_image(&mut metrics, candidates, &item.boxes, &item.ignored)?;
        }
    }
    Ok(metrics)
}

/// Adds an image's candidates and labels, in the coordinates of the network's input.
pub(super) fn add_image(
    metrics: &mut DetectionMetrics,
    LetterboxedCandidates {
        candidates,
        letterbox,
    }: &LetterboxedCandidates,
    boxes: &[(u32, PixelBox)],
    ignored: &[PixelBox],
) -> Result<()> {
    let detections: Vec<Detection> = candidates
        .iter()
        .map(|candidate| Detection {
            box_pixel: candidate.box_letterbox,
            score: candidate.score,
            class: candidate.class,
        })
        .collect();
    let targets: Vec<Target> = boxes
        .iter()
        .map(|(class, box_pixel)| Target {
            box_pixel: letterbox.letterbox_from_pixel(box_pixel),
            class: *class as usize,
        })
        .collect();
    let ignored: Vec<PixelBox> = ignored
        .iter()
        .map(|box_pixel| letterbox.letterbox_from_pixel(box_pixel))
        .collect();
    metrics.add_image_ignoring(&detections, &targets, &ignored)
}
