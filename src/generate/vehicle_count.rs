//! How many vehicles a scene has.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// How many vehicles a scene has: a number, or a range from which every scene draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Numbers", into = "Numbers")]
pub struct VehicleCount {
    /// Fewest vehicles of a scene.
    pub least: u32,
    /// Most vehicles of a scene.
    pub most: u32,
}

impl VehicleCount {
    /// More than this no stretch of road has room for.
    const LARGEST: u32 = 40;

    /// The same number in every scene.
    pub const fn exactly(number: u32) -> Self {
        Self {
            least: number,
            most: number,
        }
    }

    pub(super) fn validate(self) -> Result<()> {
        if (1..=self.most).contains(&self.least) && self.most <= Self::LARGEST {
            return Ok(());
        }
        Err(Error::value(
            format!("vehicles = {self}"),
            "out of range",
            format!(
                "give a number from 1 to {largest}, or two such as [4, 8]",
                largest = Self::LARGEST
            ),
        ))
    }
}

impl fmt::Display for VehicleCount {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.least == self.most {
            write!(f, "{}", self.least)
        } else {
            write!(f, "[{}, {}]", self.least, self.most)
        }
    }
}

/// A [`VehicleCount`] as people write it.
#[derive(Serialize, Deserialize)]
#[serde(untagged, expecting = "a number or a range such as [4, 8]")]
enum Numbers {
    One(u32),
    Range([u32; 2]),
}

impl From<Numbers> for VehicleCount {
    fn from(numbers: Numbers) -> Self {
        match numbers {
            Numbers::One(number) => Self::exactly(number),
            Numbers::Range([least, most]) => Self { least, most },
        }
    }
}

impl From<VehicleCount> for Numbers {
    fn from(VehicleCount { least, most }: VehicleCount) -> Self {
        if least == most {
            Self::One(least)
        } else {
            Self::Range([least, most])
        }
    }
}
