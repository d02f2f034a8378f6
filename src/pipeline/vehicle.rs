//! What the pipeline says of a stereo pair.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::detector::Detection;
use crate::geometry::{PixelBox, StereoRig};
use crate::pairing::search::RightFromLeft;
use crate::ranging::{PairDoubt, Posterior, Ranged, RangerKind, VehicleDoubt};

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
    /// From the midpoint between the cameras to the centre of the vehicle, metres: what the ranger in
    /// use says, of a posterior its median.
    pub distance_m: f64,
    /// Standard deviation of the distance, metres; None with the paper's network, which has none.
    #[serde(default)]
    pub distance_std_m: Option<f64>,
    /// Lower bound of the interval that holds the distance with a probability of 95 %, metres.
    #[serde(default)]
    pub distance_low_m: Option<f64>,
    /// Its upper bound.
    #[serde(default)]
    pub distance_high_m: Option<f64>,
    /// What the size of the left box alone says, metres.
    #[serde(default)]
    pub size_m: Option<f64>,
    /// What the matched disparity alone says, metres; None where nothing in the right image is alike.
    #[serde(default)]
    pub stereo_m: Option<f64>,
    /// What the twin-branch network says, metres.
    #[serde(default)]
    pub network_m: Option<f64>,
    /// Why the distance may be another.
    #[serde(default)]
    pub doubt: Option<VehicleDoubt>,
    /// Where the detector saw it; a box in the other image was searched.
    #[serde(default)]
    pub detected_in: DetectedIn,
    /// Disparity of its visible surface, pixels of the left image counted from the principal points,
    /// where its box in the other image follows from it; None where the detector saw it in both.
    /// Above 0 but for vehicles near the horizon, see [`pairing`](crate::pairing).
    #[serde(default)]
    pub disparity_px: Option<f64>,
}

impl Vehicle {
    /// A vehicle detected in the left image of which no more is known than boxes and distance.
    pub(crate) fn bare(left: PixelBox, right: PixelBox, class: &str, distance_m: f64) -> Self {
        Self {
            left,
            right,
            score: 0.5,
            class: class.to_owned(),
            distance_m,
            distance_std_m: None,
            distance_low_m: None,
            distance_high_m: None,
            size_m: None,
            stereo_m: None,
            network_m: None,
            doubt: None,
            detected_in: DetectedIn::Left,
            disparity_px: None,
        }
    }
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
    pub note: Option<PairDoubt>,
}

/// Time spent in each part of an estimate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StageTimes {
    /// Detector on both images, or with [`PairingMode::Search`](crate::pairing::PairingMode::Search)
    /// on the left one, with letterboxing and suppression.
    pub detect: Duration,
    /// Pairing of left and right detections, or the search in the right image, and the posterior.
    pub pair: Duration,
    /// Crops and the twin-branch network.
    pub range: Duration,
}

/// A vehicle with a box in both images.
#[derive(Debug, Clone)]
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
    /// What is known of its distance.
    pub ranged: Option<Ranged>,
}

impl Pair {
    /// A vehicle whose box in the right image is its left one moved by a measured disparity, or the
    /// other way round.
    pub fn searched(
        [left, right]: [Detection; 2],
        detected_in: DetectedIn,
        disparity_px: f64,
    ) -> Self {
        Self {
            left,
            right: right.box_pixel,
            score: left.score,
            detected_in,
            disparity_px: Some(disparity_px),
            ranged: None,
        }
    }

    /// A vehicle that was detected in the left image, before its place in the right one is known.
    pub fn of_left(left: Detection) -> Self {
        Self {
            left,
            right: left.box_pixel,
            score: left.score,
            detected_in: DetectedIn::Left,
            disparity_px: None,
            ranged: None,
        }
    }

    /// The same with what is known of its distance. A box of the right image that no detector saw lies
    /// where the distance puts it.
    pub fn at_posterior(mut self, ranged: Ranged, rig: &StereoRig) -> Self {
        if self.detected_in == DetectedIn::Left {
            let size = [rig.right.width, rig.right.height].map(f64::from);
            let moved = RightFromLeft { rig }.moved(&self.left.box_pixel, ranged.disparity_px);
            self.right = moved.clipped(size[0], size[1]);
            self.disparity_px = Some(ranged.disparity_px);
        }
        self.ranged = Some(ranged);
        self
    }

    /// The vehicle, with what the network says and which of both rangers is asked.
    pub fn vehicle(&self, kind: RangerKind, network_m: Option<f64>, classes: &[String]) -> Vehicle {
        let posterior = self.ranged.as_ref().map(|ranged| &ranged.posterior);
        let asked = posterior.filter(|_| kind == RangerKind::Fused);
        let interval = asked.map(|posterior| posterior.interval_m(0.95));
        Vehicle {
            left: self.left.box_pixel,
            right: self.right,
            score: self.score,
            class: class_name(self.left.class, classes),
            distance_m: match asked {
                Some(posterior) => posterior.median_m(),
                None => network_m.unwrap_or(f64::NAN),
            },
            distance_std_m: asked.map(Posterior::std_m),
            distance_low_m: interval.map(|[low, _]| low),
            distance_high_m: interval.map(|[_, high]| high),
            size_m: self.ranged.as_ref().map(|ranged| ranged.size_m),
            stereo_m: self.ranged.as_ref().and_then(|ranged| ranged.stereo_m),
            network_m,
            doubt: self.ranged.as_ref().and_then(|ranged| ranged.doubt),
            detected_in: self.detected_in,
            disparity_px: self.disparity_px,
        }
    }
}

/// The name of a class.
pub(super) fn class_name(class: usize, classes: &[String]) -> String {
    classes.get(class).cloned().unwrap_or_default()
}
