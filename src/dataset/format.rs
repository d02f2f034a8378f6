//! The version-1 dataset on disk: what `dataset.toml`, `frames.csv` and the label files say.

use serde::{Deserialize, Serialize};

use crate::geometry::{PixelBox, StereoRig};

/// The only format version that exists.
pub const FORMAT_VERSION: u32 = 1;

/// Which part of a dataset a frame belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Networks learn from it.
    Train,
    /// Chooses the best epoch.
    Val,
    /// Never seen in training.
    Test,
}

/// Which of the two kinds of label a box is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BoxKind {
    /// The paper's square around the bounding sphere.
    Sphere,
    /// The exact box of the visible silhouette.
    Tight,
}

/// From where the drone sees the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum View {
    /// From ahead.
    Front,
    /// From a side.
    Side,
    /// From behind.
    Rear,
    /// From a corner.
    Other,
}

/// One row of `frames.csv`; what is unknown is `None` and an empty field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameRow {
    /// The frame's number.
    pub stamp: u64,
    /// Its split.
    pub split: Split,
    /// Number of the scene it shows.
    pub scene: Option<u32>,
    /// Sun position by name: sunrise, morning, noon, afternoon, sunset.
    pub sun: Option<String>,
    /// View by name.
    pub view: Option<View>,
    /// Drone's angle around the vehicle, 0 in front, degrees.
    pub azimuth_deg: Option<f64>,
    /// Drone's angle above the horizon as seen from the vehicle, degrees.
    pub elevation_deg: Option<f64>,
    /// Rig midpoint to the vehicle's box centre, metres.
    pub distance_m: Option<f64>,
}

/// One line of a label file: one box of one vehicle in one image.
#[derive(Debug, Clone, PartialEq)]
pub struct Label {
    /// The vehicle's number in its frame, the same in both images.
    pub id: u32,
    /// Index into [`DatasetInfo::classes`].
    pub class: u32,
    /// The box, pixels of the full image.
    pub box_pixel: PixelBox,
    /// The vehicle's projected centre, pixels.
    pub center_pixel: [f64; 2],
    /// Rig midpoint to the vehicle's box centre, metres.
    pub distance_m: f64,
    /// The kind of box.
    pub kind: BoxKind,
    /// Fraction of the silhouette that is inside the image and not hidden, 0 to 1.
    pub visible: Option<f64>,
    /// Neither to be learnt nor to be judged: finding it is right, not finding it is no miss. Such
    /// a label's distance may be unknown, which is NaN.
    pub ignored: bool,
}

/// `dataset.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetInfo {
    /// Format version, 1.
    pub version: u32,
    /// Class names; labels hold indices into them.
    pub classes: Vec<String>,
    /// Kinds of label that every frame has.
    pub label_kinds: Vec<BoxKind>,
    /// The two cameras.
    pub rig: StereoRig,
    /// How it was made: seed, settings, program version.
    #[serde(default)]
    pub made_by: toml::Table,
}
