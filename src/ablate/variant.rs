//! The variants that are compared.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::ranging::{Crops, Readout};
use crate::train::{TrainConfig, TrainingBoxes};

/// What a distance network is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Variant {
    /// Both crops: the paper's network.
    RightLeft,
    /// The right crop twice.
    RightRight,
    /// The right crop alone.
    Mono,
    /// Both crops; the geometry vector is extended by the sub-pixel disparity, the meaning of the
    /// output stays.
    Disparity,
    /// The same, and the output counts from the surface that the disparity shows
    /// ([`Readout::Surface`]).
    Surface,
}

impl Variant {
    /// All of them, the one that the others are compared with first.
    pub const ALL: [Self; 5] = [
        Self::RightLeft,
        Self::RightRight,
        Self::Mono,
        Self::Disparity,
        Self::Surface,
    ];

    /// The word that people write for it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::RightLeft => "right-left",
            Self::RightRight => "right-right",
            Self::Mono => "mono",
            Self::Disparity => "disparity",
            Self::Surface => "surface",
        }
    }

    /// What it is, in a few words.
    pub const fn explanation(self) -> &'static str {
        match self {
            Self::RightLeft => "both crops, as in the paper",
            Self::RightRight => "the right crop twice",
            Self::Mono => "the right crop alone",
            Self::Disparity => "both crops and the sub-pixel disparity",
            Self::Surface => {
                "the same, the output counted from the surface that the disparity shows"
            }
        }
    }

    /// The settings of its training.
    ///
    /// # Errors
    /// Settings that do not fit together.
    pub fn configure(self, config: &TrainConfig, seed: u64) -> Result<TrainConfig> {
        let mut config = config.clone();
        config.seed = seed;
        if config.distance.readout == Readout::Surface {
            return Err(Error::value(
                "distance.readout = \"surface\"",
                "is what the variant `surface` sets; the others have no disparity to count from",
                "set another readout for them",
            ));
        }
        if config.distance.boxes == TrainingBoxes::Detector {
            return Err(Error::value(
                "distance.boxes = \"detector\"",
                "no detector is trained here",
                "take it out of the settings: boxes of the labels are moved as a detector's errors do",
            ));
        }
        let distance = &mut config.distance;
        distance.inputs = match self {
            Self::RightLeft | Self::Disparity | Self::Surface => Crops::RightLeft,
            Self::RightRight => Crops::RightRight,
            Self::Mono => Crops::Mono,
        };
        distance.disparity = matches!(self, Self::Disparity | Self::Surface);
        if self == Self::Surface {
            distance.readout = Readout::Surface;
        }
        config.validate()?;
        Ok(config)
    }
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}

impl FromStr for Variant {
    type Err = String;

    fn from_str(word: &str) -> std::result::Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|variant| variant.word() == word)
            .ok_or_else(|| {
                let words = Self::ALL.map(Self::word).join(", ");
                format!("'{word}' is none of {words}")
            })
    }
}
