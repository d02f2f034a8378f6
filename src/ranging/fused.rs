//! The default way to metres: the posterior of the [`Ranger`], with a trained size network as one
//! more witness where it was trained for such boxes.

use std::fmt;
use std::str::FromStr;

use image::RgbImage;
use serde::{Deserialize, Serialize};

use super::size::SizeEstimator;
use super::{PairDoubt, Ranged, Ranger, SizeWitness, Target, TrustedRig};
use crate::dataset::BoxKind;
use crate::error::Result;
use crate::geometry::PixelBox;

/// Which answer `distance_m` is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RangerKind {
    /// The posterior over distance from size, disparity and, where it was trained for such views, the
    /// size network.
    #[default]
    Fused,
    /// The paper's twin-branch network alone.
    Paper,
}

impl RangerKind {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Fused, Self::Paper];

    /// The word that people write for it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Fused => "fused",
            Self::Paper => "paper",
        }
    }
}

impl fmt::Display for RangerKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}

impl FromStr for RangerKind {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|kind| kind.word() == word)
            .ok_or_else(|| format!("'{word}' is neither fused nor paper"))
    }
}

/// A [`Ranger`] with what was trained for it.
#[derive(Debug, Clone)]
pub struct FusedRanger {
    ranger: Ranger,
    kind: BoxKind,
    sizes: Option<SizeEstimator>,
}

/// A box that is to be ranged, and the name of its class where one is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NamedBox<'a> {
    /// Its box in the left image, pixels.
    pub box_pixel: PixelBox,
    /// The class's name.
    pub class: Option<&'a str>,
}

impl FusedRanger {
    /// For boxes of this kind, without anything trained.
    pub fn new(kind: BoxKind) -> Self {
        Self {
            ranger: Ranger::default(),
            kind,
            sizes: None,
        }
    }

    /// The same with a trained size network; it has no say where it was trained on boxes of the other
    /// kind.
    #[must_use]
    pub fn with_sizes(self, sizes: Option<SizeEstimator>) -> Self {
        let sizes = sizes.filter(|sizes| sizes.header().box_kind == self.kind);
        Self { sizes, ..self }
    }

    /// Whether a trained network is one of the witnesses.
    pub const fn is_trained(&self) -> bool {
        self.sizes.is_some()
    }

    /// The kind of the boxes.
    pub const fn box_kind(&self) -> BoxKind {
        self.kind
    }

    /// What is known of the distance of each box of a rectified pair, left image first, and what is
    /// strange about the pair.
    ///
    /// # Errors
    /// A device that fails.
    pub fn range(
        &self,
        images: [&RgbImage; 2],
        boxes: &[NamedBox],
        rig: &TrustedRig,
    ) -> Result<(Vec<Ranged>, Option<PairDoubt>)> {
        if boxes.is_empty() {
            return Ok((Vec::new(), PairDoubt::of_images(images)));
        }
        let mut witnesses = match &self.sizes {
            Some(sizes) => {
                let boxes: Vec<PixelBox> = boxes.iter().map(|b| b.box_pixel).collect();
                sizes.witnesses(images[0], &boxes, &rig.rig)?
            }
            None => Vec::new(),
        }
        .into_iter();
        let targets: Vec<Target> = boxes
            .iter()
            .map(|named| Target {
                box_pixel: named.box_pixel,
                kind: self.kind,
                class: named.class.map(str::to_owned),
                // One that was not trained for what it sees knows less than what vehicles are like.
                witness: witnesses.next().filter(SizeWitness::is_known),
            })
            .collect();
        Ok(self.ranger.posteriors(images, &targets, rig))
    }
}
