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
    /// Rig midpoint to the vehicle's box centre, metres; unknown in data for detectors alone.
    pub distance_m: Option<f64>,
    /// The kind of box.
    pub kind: BoxKind,
    /// Fraction of the silhouette that is inside the image and not hidden, 0 to 1.
    pub visible: Option<f64>,
    /// Neither to be learnt nor to be judged: to find it is no error, nor to miss it.
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
    /// Whether every frame has a right image. A dataset of single images trains and judges
    /// detectors; its rig says no more than the size of the images unless it says more.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub stereo: bool,
    /// The two cameras.
    pub rig: StereoRig,
    /// How it was made: seed, settings, program version.
    #[serde(default)]
    pub made_by: toml::Table,
}

/// What `stereo` is where `dataset.toml` does not say.
const fn yes() -> bool {
    true
}

#[allow(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde hands a reference to it"
)]
const fn is_yes(stereo: &bool) -> bool {
    *stereo
}

impl DatasetInfo {
    /// Reads the text of a `dataset.toml`.
    ///
    /// # Errors
    /// What the TOML reader says of it. The version is not looked at.
    pub fn from_toml(text: &str) -> Result<Self, toml::de::Error> {
        let mut table: toml::Table = text.parse()?;
        let single = table.get("stereo").and_then(toml::Value::as_bool) == Some(false);
        match table.get_mut("rig") {
            Some(toml::Value::Table(rig)) if single && !rig.contains_key("baseline_m") => {
                rig.insert("baseline_m".to_owned(), PLACEHOLDER_BASELINE_M.into());
                if !rig.contains_key("hfov_deg") && !rig.contains_key("left") {
                    rig.insert("hfov_deg".to_owned(), PLACEHOLDER_HFOV_DEG.into());
                }
                table.try_into()
            }
            // From the text and not from the table: errors then know their line.
            _ => toml::from_str(text),
        }
    }

    /// The text of a `dataset.toml`. The cameras of single images are left out: nobody knows them.
    ///
    /// # Errors
    /// What the TOML writer says, such as an unwritable value in [`made_by`](Self::made_by).
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        let mut table = toml::Table::try_from(self)?;
        if !self.stereo
            && let Some(toml::Value::Table(rig)) = table.get_mut("rig")
        {
            rig.retain(|key, _| key == "width" || key == "height");
        }
        toml::to_string(&table)
    }

    /// The rig of single images of this size: cameras that only their size is known of.
    ///
    /// # Errors
    /// A size that no camera can have.
    pub fn single_image_rig(width: u32, height: u32) -> crate::Result<StereoRig> {
        StereoRig::from_hfov(width, height, PLACEHOLDER_HFOV_DEG, PLACEHOLDER_BASELINE_M)
    }
}

/// Stands in for what is unknown of the rig of single images; nothing is computed from it.
const PLACEHOLDER_HFOV_DEG: f64 = 90.0;

/// See [`PLACEHOLDER_HFOV_DEG`].
const PLACEHOLDER_BASELINE_M: f64 = 1.0;
