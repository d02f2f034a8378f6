//! Paints of vehicles.

use serde::{Deserialize, Serialize};

/// Paints by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Paint {
    /// Solid black.
    Black,
    /// Metallic dark grey.
    Anthracite,
    /// Metallic grey.
    Grey,
    /// Metallic silver.
    Silver,
    /// Solid white.
    White,
    /// Pearl white.
    Pearl,
    /// Metallic dark red.
    Burgundy,
    /// Solid red.
    Red,
    /// Metallic dark blue.
    Navy,
    /// Metallic blue.
    Blue,
    /// Solid light blue.
    Sky,
    /// Metallic dark green.
    Green,
    /// Solid pale green.
    Mint,
    /// Solid yellow.
    Yellow,
    /// Metallic orange.
    Orange,
    /// Metallic beige.
    Beige,
    /// Metallic brown.
    Brown,
    /// Metallic copper.
    Copper,
}

impl Paint {
    /// All of them.
    pub const ALL: [Self; 18] = [
        Self::Black,
        Self::Anthracite,
        Self::Grey,
        Self::Silver,
        Self::White,
        Self::Pearl,
        Self::Burgundy,
        Self::Red,
        Self::Navy,
        Self::Blue,
        Self::Sky,
        Self::Green,
        Self::Mint,
        Self::Yellow,
        Self::Orange,
        Self::Beige,
        Self::Brown,
        Self::Copper,
    ];

    /// Diffuse colour and colour of the metal flakes, linear.
    #[rustfmt::skip]
    pub(super) const fn colors(self) -> [[f32; 3]; 2] {
        match self {
            Self::Black => [[0.010, 0.010, 0.011], [0.0; 3]],
            Self::Anthracite => [[0.018, 0.019, 0.021], [0.060, 0.063, 0.068]],
            Self::Grey => [[0.070, 0.072, 0.075], [0.13, 0.135, 0.14]],
            Self::Silver => [[0.20, 0.205, 0.21], [0.30, 0.305, 0.31]],
            Self::White => [[0.74, 0.74, 0.73], [0.0; 3]],
            Self::Pearl => [[0.62, 0.61, 0.58], [0.10, 0.10, 0.11]],
            Self::Burgundy => [[0.085, 0.006, 0.010], [0.16, 0.012, 0.018]],
            Self::Red => [[0.48, 0.018, 0.014], [0.0; 3]],
            Self::Navy => [[0.006, 0.014, 0.060], [0.015, 0.035, 0.13]],
            Self::Blue => [[0.012, 0.060, 0.24], [0.03, 0.11, 0.34]],
            Self::Sky => [[0.18, 0.36, 0.52], [0.0; 3]],
            Self::Green => [[0.006, 0.040, 0.020], [0.014, 0.075, 0.040]],
            Self::Mint => [[0.36, 0.52, 0.42], [0.0; 3]],
            Self::Yellow => [[0.66, 0.42, 0.015], [0.0; 3]],
            Self::Orange => [[0.42, 0.10, 0.008], [0.30, 0.09, 0.015]],
            Self::Beige => [[0.25, 0.205, 0.14], [0.20, 0.175, 0.13]],
            Self::Brown => [[0.040, 0.022, 0.012], [0.085, 0.050, 0.030]],
            Self::Copper => [[0.15, 0.060, 0.025], [0.22, 0.095, 0.045]],
        }
    }
}
