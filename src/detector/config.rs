//! The five sizes of YOLO11.

use serde::{Deserialize, Serialize};

/// Size of the detector.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Serialize,
    Deserialize,
    clap::ValueEnum,
)]
#[serde(rename_all = "lowercase")]
pub enum Scale {
    /// Nano: 2.6 million parameters.
    N,
    /// Small: 9.4 million.
    S,
    /// Medium: 20 million.
    M,
    /// Large: 25 million.
    L,
    /// Extra large: 57 million.
    X,
}

impl Scale {
    /// All sizes, smallest first.
    pub const ALL: [Self; 5] = [Self::N, Self::S, Self::M, Self::L, Self::X];

    /// The letter that names the size.
    pub fn letter(self) -> &'static str {
        match self {
            Self::N => "n",
            Self::S => "s",
            Self::M => "m",
            Self::L => "l",
            Self::X => "x",
        }
    }

    /// Output channels of a module whose nominal number is `nominal`: capped, scaled, rounded up
    /// to a multiple of 8.
    pub fn channels(self, nominal: usize) -> usize {
        let (width, cap) = match self {
            Self::N => (0.25, 1024),
            Self::S => (0.5, 1024),
            Self::M | Self::L => (1.0, 512),
            Self::X => (1.5, 512),
        };
        (nominal.min(cap) as f64 * width / 8.0).ceil() as usize * 8
    }

    /// Repeats of the inner blocks, nominally 2.
    pub fn repeats(self) -> usize {
        match self {
            Self::N | Self::S | Self::M => 1,
            Self::L | Self::X => 2,
        }
    }

    /// Every C3k2 block uses C3k inside, not only the deep ones.
    pub fn c3k_everywhere(self) -> bool {
        self >= Self::M
    }
}

impl std::fmt::Display for Scale {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.letter())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_capped_before_they_are_scaled() {
        assert_eq!(Scale::N.channels(64), 16);
        assert_eq!(Scale::S.channels(1024), 512);
        assert_eq!(Scale::M.channels(1024), 512);
        assert_eq!(Scale::X.channels(1024), 768);
        assert_eq!(Scale::X.channels(64), 96);
    }
}
