//! Pictures that show both images of a pair.

use std::fmt;
use std::str::FromStr;

use image::{RgbImage, imageops};

use crate::error::{Error, Result};

/// How one picture shows both images of a pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Layout {
    /// The left image in the left half.
    SideBySide,
    /// The left image in the upper half.
    TopBottom,
}

impl Layout {
    /// Both layouts.
    pub const ALL: [Self; 2] = [Self::SideBySide, Self::TopBottom];

    /// The word that people write for it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::SideBySide => "side-by-side",
            Self::TopBottom => "top-bottom",
        }
    }

    /// Divides a picture into left and right image; `origin` is what errors call it.
    ///
    /// # Errors
    /// A picture that has no two halves.
    pub(super) fn split(self, picture: &RgbImage, origin: &str) -> Result<[RgbImage; 2]> {
        let (width, height) = picture.dimensions();
        let (side, what) = match self {
            Self::SideBySide => (width, "wide"),
            Self::TopBottom => (height, "high"),
        };
        if side < 2 || side % 2 == 1 {
            return Err(Error::image(
                origin,
                format!("is {side} pixels {what} and cannot be divided into two equal halves"),
                "give a picture of both images at equal sizes, or another --layout",
            ));
        }
        let half =
            |x, y, width, height| imageops::crop_imm(picture, x, y, width, height).to_image();
        Ok(match self {
            Self::SideBySide => [0, width / 2].map(|x| half(x, 0, width / 2, height)),
            Self::TopBottom => [0, height / 2].map(|y| half(0, y, width, height / 2)),
        })
    }
}

impl fmt::Display for Layout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}

impl FromStr for Layout {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|layout| layout.word() == word)
            .ok_or_else(|| format!("'{word}' is neither side-by-side nor top-bottom"))
    }
}
