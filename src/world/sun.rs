//! The five sun positions and the light that comes with them.

use glam::Vec3A;
use serde::{Deserialize, Serialize};

use super::mesh;

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
}

impl Sun {
    /// All of them in the day's order.
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
        }
    }
}

/// Sun and sky, as linear radiance.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Light {
    /// Towards the sun, unit length.
    pub direction: Vec3A,
    /// What a white surface that faces the sun sends back.
    pub sun: Vec3A,
    /// Sky overhead.
    pub zenith: Vec3A,
    /// Sky at the horizon, and the haze's colour.
    pub horizon: Vec3A,
    /// Distance after which haze leaves 1/e of a surface's light, metres.
    pub haze_m: f32,
    /// Factor from radiance to the camera's range.
    pub exposure: f32,
}

impl Light {
    /// The light of a sun position; `turn_deg` turns the compass against the streets.
    #[rustfmt::skip]
    pub fn of(sun: Sun, turn_deg: f32) -> Self {
        let light = |angles: [f32; 2], sun: [f32; 3], zenith: [f32; 3], horizon: [f32; 3], haze_m, exposure| {
            let [up, azimuth] = [angles[0] / 360.0, (angles[1] + turn_deg) / 360.0].map(mesh::turn);
            Self {
                direction: Vec3A::new(up[1] * azimuth[1], up[1] * azimuth[0], up[0]),
                sun: Vec3A::from_array(sun),
                zenith: Vec3A::from_array(zenith),
                horizon: Vec3A::from_array(horizon),
                haze_m,
                exposure,
            }
        };
        match sun {
            Sun::Sunrise => light([7.0, 85.0], [1.75, 0.95, 0.50], [0.22, 0.30, 0.48], [0.78, 0.58, 0.46], 900.0, 1.15),
            Sun::Morning => light([27.0, 120.0], [2.55, 2.15, 1.65], [0.30, 0.43, 0.66], [0.74, 0.80, 0.86], 1500.0, 0.70),
            Sun::Noon => light([62.0, 180.0], [3.00, 2.85, 2.62], [0.28, 0.44, 0.72], [0.68, 0.80, 0.95], 2200.0, 0.60),
            Sun::Afternoon => light([40.0, 235.0], [2.80, 2.45, 1.95], [0.29, 0.43, 0.68], [0.74, 0.80, 0.88], 1800.0, 0.65),
            Sun::Sunset => light([9.0, 275.0], [1.85, 0.78, 0.34], [0.20, 0.24, 0.42], [0.86, 0.50, 0.34], 1000.0, 1.15),
        }
    }

    /// Light of the sky from a direction (unit length), with a bright region around the sun.
    pub fn sky(&self, direction: Vec3A) -> Vec3A {
        let up = direction.z.max(0.0);
        let blend = 1.0 - (1.0 - up) * (1.0 - up) * (1.0 - up);
        let base = self.horizon + (self.zenith - self.horizon) * blend;
        let toward_sun = direction.dot(self.direction).max(0.0);
        let wide = toward_sun * toward_sun * toward_sun * toward_sun;
        let narrow = wide * wide * wide * wide;
        let disc = if toward_sun > 0.9996 { 6.0 } else { 0.0 };
        base + self.sun * (0.05 * wide + 0.14 * narrow * narrow + disc)
    }

    /// Diffuse light of sky and sunlit ground on a surface with this normal.
    pub fn ambient(&self, normal: Vec3A) -> Vec3A {
        let sky = self.zenith * 0.55 + self.horizon * 0.45;
        let ground = (self.sun * self.direction.z + sky) * 0.20;
        let up = 0.5 + 0.5 * normal.z;
        sky * up + ground * (1.0 - up)
    }
}
