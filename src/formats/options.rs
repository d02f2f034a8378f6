//! What the files of foreign datasets do not say.

use std::path::PathBuf;

/// What an import is told beside its source. Each format takes what concerns it.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportOptions {
    /// YOLO, COCO: every image is on its own, even where names speak of left and right ones.
    pub single: bool,
    /// YOLO, COCO: distance between the cameras of pairs, metres.
    pub baseline_m: Option<f64>,
    /// YOLO, COCO: horizontal field of view of the cameras of pairs, degrees.
    pub hfov_deg: Option<f64>,
    /// The canvas for single images, pixels: larger ones are shrunk to fit. Without it, the canvas
    /// holds every image as it is.
    pub canvas: Option<[u32; 2]>,
    /// COCO: the folder of the images, where it is not beside the annotations.
    pub images: Option<PathBuf>,
    /// YOLO: a number behind the box is its distance in metres, and not a detector's confidence.
    pub distance_column: bool,
    /// YOLO: folders without any label file are meant: nothing is to be found in their images.
    pub background: bool,
    /// KITTI was recorded with several calibrations and a dataset has one rig: 1 takes the frames
    /// of the most common calibration, 2 of the next, and so on.
    pub rig: usize,
    /// KITTI: vehicles that are hidden more than this are ignored: 0 not at all, 1 partly, 2 largely.
    pub most_occluded: u8,
    /// KITTI: vehicles of which a larger part lies outside the image are ignored.
    pub most_truncated: f64,
    /// Virtual KITTI 2: which variants of the scenes, such as `clone` and `sunset`; empty takes all.
    pub variants: Vec<String>,
    /// Virtual KITTI 2: vehicles of which a smaller part is in the image and not hidden are ignored.
    pub least_visible: f64,
}

impl Default for ImportOptions {
    /// What KITTI's own hardest level says: ignored are vehicles hidden to an unknown degree or more
    /// than half outside the image.
    fn default() -> Self {
        Self {
            single: false,
            baseline_m: None,
            hfov_deg: None,
            canvas: None,
            images: None,
            distance_column: false,
            background: false,
            rig: 1,
            most_occluded: 2,
            most_truncated: 0.5,
            variants: Vec::new(),
            least_visible: 0.25,
        }
    }
}
