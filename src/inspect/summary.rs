//! Numbers of a dataset, split by split.

use std::collections::BTreeSet;

use serde::Serialize;

use crate::dataset::{BoxKind, Frame, Split, StereoDataset};

/// What there is in each split; splits without frames are absent.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Train, val, test.
    pub splits: Vec<SplitSummary>,
    /// What the reader had to leave out.
    pub left_out: usize,
}

/// What there is in one split.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SplitSummary {
    /// Its name.
    pub split: Split,
    /// Frames.
    pub frames: usize,
    /// Images.
    pub images: usize,
    /// Different scenes; 0 where they are unknown.
    pub scenes: usize,
    /// Vehicles in the left images that are not ignored.
    pub vehicles: usize,
    /// Vehicles in the left images that are ignored.
    pub ignored: usize,
    /// Vehicles that both cameras see, with a distance: what distances are learnt from.
    pub pairs: usize,
    /// Distances of the vehicles, metres.
    pub distances_m: Vec<f64>,
    /// Angles of the rig around the vehicle of each frame, degrees.
    pub azimuths_deg: Vec<f64>,
    /// Angles of the rig above the vehicle of each frame, degrees.
    pub elevations_deg: Vec<f64>,
    /// Longer sides of the boxes in the left images, pixels.
    pub box_sides_px: Vec<f64>,
    /// Visible fractions of the vehicles in the left images.
    pub visible: Vec<f64>,
}

impl Summary {
    /// Counts a dataset by its boxes of one kind.
    pub fn new(dataset: &StereoDataset, kind: BoxKind) -> Self {
        let splits = Split::ALL
            .iter()
            .map(|&split| SplitSummary::new(split, &dataset.split(split), kind))
            .filter(|summary| summary.frames > 0)
            .collect();
        Self {
            splits,
            left_out: dataset.problems.len(),
        }
    }
}

impl SplitSummary {
    fn new(split: Split, frames: &[&Frame], kind: BoxKind) -> Self {
        let labels = || frames.iter().flat_map(|frame| frame.left.labels_of(kind));
        let judged = || labels().filter(|label| !label.ignored);
        let scenes: BTreeSet<u32> = frames.iter().filter_map(|frame| frame.row.scene).collect();
        Self {
            split,
            frames: frames.len(),
            images: frames.iter().map(|frame| frame.images().count()).sum(),
            scenes: scenes.len(),
            vehicles: judged().count(),
            ignored: labels().filter(|label| label.ignored).count(),
            pairs: frames.iter().map(|frame| frame.vehicles(kind).len()).sum(),
            distances_m: judged().filter_map(|label| label.distance_m).collect(),
            azimuths_deg: frames
                .iter()
                .filter_map(|frame| frame.row.azimuth_deg)
                .collect(),
            elevations_deg: frames
                .iter()
                .filter_map(|frame| frame.row.elevation_deg)
                .collect(),
            box_sides_px: judged()
                .map(|label| label.box_pixel.width().max(label.box_pixel.height()))
                .collect(),
            visible: judged().filter_map(|label| label.visible).collect(),
        }
    }
}
