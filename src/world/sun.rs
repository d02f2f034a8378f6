//! Where the sun stands.

use serde::{Deserialize, Serialize};

/// Sun positions by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sun {
    /// 7 degrees above the horizon, orange.
    Sunrise,
    /// 27 degrees, warm.
    Morning,
    /// 62 degrees, white.
    Noon,
    /// 40 degrees, slightly warm.
    Afternoon,
    /// 9 degrees, red.
    Sunset,
    /// Anywhere from 6 to 68 degrees above the horizon, another place in every frame.
    Random,
}

/// A place of the sun in the sky.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SunPlace {
    /// Above the horizon, degrees.
    pub elevation_deg: f32,
    /// Round the compass, degrees.
    pub azimuth_deg: f32,
}

impl Sun {
    /// The named positions in the day's order.
    pub const ALL: [Self; 5] = [
        Self::Sunrise,
        Self::Morning,
        Self::Noon,
        Self::Afternoon,
        Self::Sunset,
    ];

    /// Its name as `frames.csv` has it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sunrise => "sunrise",
            Self::Morning => "morning",
            Self::Noon => "noon",
            Self::Afternoon => "afternoon",
            Self::Sunset => "sunset",
            Self::Random => "random",
        }
    }

    /// Its place; for [`Sun::Random`] the middle of the range.
    pub const fn place(self) -> SunPlace {
        let [elevation_deg, azimuth_deg] = match self {
            Self::Sunrise => [7.0, 85.0],
            Self::Morning => [27.0, 120.0],
            Self::Noon => [62.0, 180.0],
            Self::Afternoon => [40.0, 235.0],
            Self::Sunset => [9.0, 275.0],
            Self::Random => [37.0, 180.0],
        };
        SunPlace {
            elevation_deg,
            azimuth_deg,
        }
    }

    /// Its place for two numbers in 0..1, which only [`Sun::Random`] looks at.
    pub fn place_at(self, [up, round]: [f32; 2]) -> SunPlace {
        match self {
            Self::Random => SunPlace {
                elevation_deg: 6.0 + 62.0 * up,
                azimuth_deg: 360.0 * round,
            },
            _ => self.place(),
        }
    }
}
