//! What the pipeline says of a stereo pair.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::note::PairNote;
use crate::detector::Detection;
use crate::geometry::{PixelBox, StereoRig};

/// In which images the detector saw a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DetectedIn {
    /// In both.
    Both,
    /// In the left one; its box in the right one was searched.
    #[default]
    Left,
    /// In the right one; its box in the left one was searched.
    Right,
}

impl DetectedIn {
    /// The word that people read.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Both => "both",
            Self::Left => "left",
            Self::Right => "right",
        }
    }
}

/// What becomes of a vehicle that the detector sees in one image only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SingleSided {
    /// It is left out.
    Drop,
    /// Its box in the other image is searched along the epipolar line; without one it is left out.
    #[default]
    Search,
    /// As `Search`, but without a box in the other image it is reported, without a distance.
    Keep,
}

impl SingleSided {
    /// All choices.
    pub const ALL: [Self; 3] = [Self::Drop, Self::Search, Self::Keep];

    /// The word that people write for it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Drop => "drop",
            Self::Search => "search",
            Self::Keep => "keep",
        }
    }
}

impl fmt::Display for SingleSided {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}

impl FromStr for SingleSided {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|choice| choice.word() == word)
            .ok_or_else(|| format!("'{word}' is none of drop, search, keep"))
    }
}

/// A vehicle with a box in both images, and how far it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Vehicle {
    /// Its box in the left image, pixels.
    pub left: PixelBox,
    /// Its box in the right image, pixels.
    pub right: PixelBox,
    /// Confidence of the detection, 0 to 1; mean of the two where both images have one.
    pub score: f32,
    /// Class name.
    pub class: String,
    /// From the midpoint between the cameras to the centre of the vehicle, metres.
    pub distance_m: f64,
    /// Where the detector saw it; a box in the other image was searched.
    #[serde(default)]
    pub detected_in: DetectedIn,
    /// Disparity of its visible surface, pixels of the left image counted from the principal points,
    /// where its box in the other image was searched; None where the detector saw it in both. Above
    /// 0 but for vehicles near the horizon, see [`pairing`](crate::pairing).
    #[serde(default)]
    pub disparity_px: Option<f64>,
    /// What this disparity alone says: from the midpoint between the cameras to the visible surface,
    /// metres. The centre of a vehicle lies further away, by half of its length for one seen from
    /// behind. None without a disparity above 0.
    #[serde(default)]
    pub surface_distance_m: Option<f64>,
}

/// A vehicle that one image shows and that was not found in the other one: no distance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Unmatched {
    /// The image that shows it: `left` or `right`.
    pub detected_in: DetectedIn,
    /// Its box there, pixels.
    #[serde(rename = "box")]
    pub box_pixel: PixelBox,
    /// Confidence of the detection, 0 to 1.
    pub score: f32,
    /// Class name.
    pub class: String,
}

/// Everything that is found in one stereo pair.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Findings {
    /// Vehicles with a distance, nearest first.
    pub vehicles: Vec<Vehicle>,
    /// Vehicles without one; always empty unless [`SingleSided::Keep`] is asked for.
    pub unmatched: Vec<Unmatched>,
    /// What is strange about the two images.
    pub note: Option<PairNote>,
}

/// Time spent in each part of an estimate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StageTimes {
    /// Detector on both images, or with [`PairingMode::Search`](crate::pairing::PairingMode::Search)
    /// on the left one, with letterboxing and suppression.
    pub detect: Duration,
    /// Pairing of left and right detections, or the search in the right image.
    pub pair: Duration,
    /// Crops and distance network.
    pub range: Duration,
}

/// A vehicle before its distance is known.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pair {
    /// Its detection in the left image; box and class of it where that was searched.
    pub left: Detection,
    /// Its box in the right image, pixels.
    pub right: PixelBox,
    /// As [`Vehicle::score`].
    pub score: f32,
    /// As [`Vehicle::detected_in`].
    pub detected_in: DetectedIn,
    /// As [`Vehicle::disparity_px`].
    pub disparity_px: Option<f64>,
    /// As [`Vehicle::surface_distance_m`].
    pub surface_distance_m: Option<f64>,
}

impl Pair {
    /// A vehicle whose box in the right image is its left one moved by a measured disparity, or the
    /// other way round.
    pub fn searched(
        [left, right]: [Detection; 2],
        detected_in: DetectedIn,
        disparity_px: f64,
        rig: &StereoRig,
    ) -> Self {
        Self {
            left,
            right: right.box_pixel,
            score: left.score,
            detected_in,
            disparity_px: Some(disparity_px),
            surface_distance_m: rig.triangulated_m(left.box_pixel.center(), disparity_px),
        }
    }

    /// The vehicle, now that its distance is known.
    pub fn at(&self, distance_m: f64, classes: &[String]) -> Vehicle {
        Vehicle {
            left: self.left.box_pixel,
            right: self.right,
            score: self.score,
            class: class_name(self.left.class, classes),
            distance_m,
            detected_in: self.detected_in,
            disparity_px: self.disparity_px,
            surface_distance_m: self.surface_distance_m,
        }
    }
}

/// The name of a class.
pub(super) fn class_name(class: usize, classes: &[String]) -> String {
    classes.get(class).cloned().unwrap_or_default()
}
