//! Domain randomisation: the ranges that weather, camera and sensor are drawn from, and one draw.
//!
//! Both images of a pair share one [`Conditions`]; only the sensor's noise differs.

use std::sync::Arc;

use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::world::noise::derive_seed;
use crate::world::{Air, AssetLibrary, BodyStyle, OwnAssets, Paint, Sun, SunPlace, Wardrobe};

const CONDITIONS_STREAM: u64 = 6;
/// Keeps single ranges apart from the conditions.
const RANGE_STREAM: u64 = 9;

/// One number, or the lowest and the highest of a range.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "a number or a range such as [0.2, 0.8]")]
pub enum Range {
    /// Always this.
    Fixed(f64),
    /// Any number between these two, all equally likely.
    Between([f64; 2]),
}

impl Range {
    const fn ends(self) -> [f64; 2] {
        match self {
            Self::Fixed(value) => [value, value],
            Self::Between(ends) => ends,
        }
    }

    /// The number of a frame.
    pub(crate) fn drawn(self, seed: u64) -> f32 {
        self.draw(&mut Pcg64::seed_from_u64(derive_seed(
            seed,
            RANGE_STREAM,
            0,
        )))
    }

    /// Checks that it is a range, and inside of another one.
    pub(crate) fn validate(self, name: &str, [low, high]: [f64; 2]) -> Result<()> {
        let [first, last] = self.ends();
        if low <= first && first <= last && last <= high {
            return Ok(());
        }
        Err(Error::value(
            format!("{name} = {first} to {last}"),
            "out of range",
            format!("give a number or [lowest, highest] between {low} and {high}"),
        ))
    }

    fn draw(self, rng: &mut impl Rng) -> f32 {
        let [low, high] = self.ends();
        // Drawn even where the range is one number, so that fixing one leaves the others alone.
        let part: f64 = rng.random();
        (low + (high - low) * part) as f32
    }
}

/// A vehicle's body by its name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "the name of a body")]
pub enum BodyName {
    /// One that the program comes with.
    BuiltIn(BodyStyle),
    /// One of the user's vehicles.
    Own(String),
}

/// How much frames differ in weather, camera and sensor, and which vehicles there are.
///
/// A range is `[lowest, highest]` or one number, which fixes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Appearance {
    /// Vehicle bodies; the other built-in ones are held out. The user's own vehicles are drawn from
    /// as well, unless the list names some of them: then it is those.
    pub bodies: Vec<BodyName>,
    /// Paints; the others are held out.
    pub paints: Vec<Paint>,
    /// Share of frames under a closed layer of cloud, without shadows: 0 to 1.
    pub overcast: f64,
    /// Share of frames with wet streets, most of them under cloud: 0 to 1.
    pub wet: f64,
    /// Share of a clear sky with single clouds: 0 to 1.
    pub clouds: Range,
    /// Haziness of the air that colours sun and sky: 1.8 (very clear) to 8 (murky).
    pub turbidity: Range,
    /// Distance after which haze leaves 37% of a thing's own light, metres.
    pub haze_m: Range,
    /// Error of the automatic exposure, stops.
    pub exposure_ev: Range,
    /// Error of the white balance: -0.2 (blue) to 0.2 (orange).
    pub white_balance: Range,
    /// Steepness of the tone curve; 1 is neutral.
    pub contrast: Range,
    /// Strength of colours; 1 is neutral, 0 grey.
    pub saturation: Range,
    /// Part of the light that the corners of the image lack: 0 to 0.8.
    pub vignetting: Range,
    /// Blur of the lens, standard deviation in pixels: 0 to 5.
    pub blur_pixel: Range,
    /// Share of frames that went through lossy compression: 0 to 1.
    pub jpeg: f64,
    /// Quality of that compression: 10 to 100.
    pub jpeg_quality: Range,
}

impl Default for Appearance {
    fn default() -> Self {
        Self {
            bodies: BodyStyle::ALL.map(BodyName::BuiltIn).to_vec(),
            paints: Paint::ALL.to_vec(),
            overcast: 0.2,
            wet: 0.12,
            clouds: Range::Between([0.0, 0.7]),
            turbidity: Range::Between([2.0, 5.0]),
            haze_m: Range::Between([900.0, 5000.0]),
            exposure_ev: Range::Between([-0.35, 0.35]),
            white_balance: Range::Between([-0.05, 0.05]),
            contrast: Range::Between([0.92, 1.12]),
            saturation: Range::Between([0.85, 1.12]),
            vignetting: Range::Between([0.0, 0.3]),
            blur_pixel: Range::Between([0.0, 0.6]),
            jpeg: 0.3,
            jpeg_quality: Range::Between([70.0, 95.0]),
        }
    }
}

impl Appearance {
    /// The bodies and paints that scenes may draw from; `own` are the user's models and the metres
    /// of pavement for each of their props.
    ///
    /// # Errors
    /// A body that is neither built in nor among the user's vehicles.
    pub fn wardrobe(&self, own: Option<(Arc<AssetLibrary>, f64)>) -> Result<Wardrobe> {
        let mut bodies = Vec::new();
        let mut named = Vec::new();
        for body in &self.bodies {
            let name = match body {
                BodyName::BuiltIn(style) => {
                    bodies.push(*style);
                    continue;
                }
                BodyName::Own(name) => name,
            };
            let mut known = own.iter().flat_map(|(library, _)| library.vehicle_names());
            match known.position(|known| known == name) {
                Some(number) => named.push(number),
                None => return Err(Self::unknown_body(name, own.as_ref().map(|own| &*own.0))),
            }
        }
        let own = own.map(|(library, prop_spacing_m)| {
            let vehicles = if named.is_empty() {
                library.weighted(0..library.vehicles().len())
            } else {
                library.weighted(named)
            };
            OwnAssets {
                library,
                vehicles,
                prop_spacing_m,
            }
        });
        Ok(Wardrobe {
            bodies,
            paints: self.paints.clone(),
            own,
        })
    }

    fn unknown_body(name: &str, library: Option<&AssetLibrary>) -> Error {
        let built_in = BodyStyle::ALL.map(BodyStyle::name).join(", ");
        let remedy = match library {
            Some(library) => {
                let own: Vec<&str> = library.vehicle_names().collect();
                format!("use {built_in}, or of your own: {}", own.join(", "))
            }
            None => format!("use {built_in}, or give the folder of your own with --assets"),
        };
        Error::value(
            format!("appearance.bodies: {name:?}"),
            "there is no such vehicle",
            remedy,
        )
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The first value that cannot be used, with what can.
    pub fn validate(&self) -> Result<()> {
        for (name, empty, all) in [
            ("bodies", self.bodies.is_empty(), names(&BodyStyle::ALL)),
            ("paints", self.paints.is_empty(), names(&Paint::ALL)),
        ] {
            if empty {
                return Err(Error::value(
                    format!("appearance.{name}"),
                    "the list is empty",
                    format!("name at least one of {all}"),
                ));
            }
        }
        let share = |value| Range::Fixed(value);
        for (name, range, limits) in [
            ("overcast", share(self.overcast), [0.0, 1.0]),
            ("wet", share(self.wet), [0.0, 1.0]),
            ("clouds", self.clouds, [0.0, 1.0]),
            ("turbidity", self.turbidity, [1.8, 8.0]),
            ("haze_m", self.haze_m, [50.0, 1e6]),
            ("exposure_ev", self.exposure_ev, [-3.0, 3.0]),
            ("white_balance", self.white_balance, [-0.2, 0.2]),
            ("contrast", self.contrast, [0.5, 1.6]),
            ("saturation", self.saturation, [0.0, 2.0]),
            ("vignetting", self.vignetting, [0.0, 0.8]),
            ("blur_pixel", self.blur_pixel, [0.0, 5.0]),
            ("jpeg", share(self.jpeg), [0.0, 1.0]),
            ("jpeg_quality", self.jpeg_quality, [10.0, 100.0]),
        ] {
            range.validate(&format!("appearance.{name}"), limits)?;
        }
        Ok(())
    }
}

fn names<T: std::fmt::Debug>(all: &[T]) -> String {
    let names: Vec<String> = all
        .iter()
        .map(|one| format!("{one:?}").to_lowercase())
        .collect();
    names.join(", ")
}

/// Weather, camera and sensor of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conditions {
    /// Where the sun stands.
    pub sun: SunPlace,
    /// State of the air.
    pub air: Air,
    /// 0 for dry streets, 1 for puddles.
    pub wetness: f32,
    /// Error of the automatic exposure, stops.
    pub exposure_ev: f32,
    /// Error of the white balance.
    pub white_balance: f32,
    /// Steepness of the tone curve.
    pub contrast: f32,
    /// Strength of colours.
    pub saturation: f32,
    /// Part of the light that the corners lack.
    pub vignetting: f32,
    /// Blur of the lens, standard deviation in pixels.
    pub blur_pixel: f32,
    /// Quality of lossy compression; None is without.
    pub jpeg_quality: Option<u8>,
}

impl Conditions {
    /// The conditions of a frame.
    pub fn draw(appearance: &Appearance, sun: Sun, seed: u64) -> Self {
        let mut rng = Pcg64::seed_from_u64(derive_seed(seed, CONDITIONS_STREAM, 0));
        let rng = &mut rng;
        let [wet, cover, close]: [f64; 3] = [(); 3].map(|()| rng.random());
        let is_wet = wet < appearance.wet;
        // Streets are wet under cloud more often than after it has gone.
        let is_overcast = if is_wet {
            appearance.overcast > 0.0 && cover < 0.75
        } else {
            cover < appearance.overcast
        };
        let [up, round, depth]: [f32; 3] = [(); 3].map(|()| rng.random());
        let jpeg: f64 = rng.random();
        let quality = appearance.jpeg_quality.draw(rng);
        Self {
            sun: sun.place_at([up, round]),
            air: Air {
                turbidity: appearance.turbidity.draw(rng),
                overcast: if is_overcast {
                    0.8 + 0.2 * close as f32
                } else {
                    0.0
                },
                clouds: appearance.clouds.draw(rng),
                haze_m: appearance.haze_m.draw(rng),
            },
            wetness: if is_wet { 0.4 + 0.6 * depth } else { 0.0 },
            exposure_ev: appearance.exposure_ev.draw(rng),
            white_balance: appearance.white_balance.draw(rng),
            contrast: appearance.contrast.draw(rng),
            saturation: appearance.saturation.draw(rng),
            vignetting: appearance.vignetting.draw(rng),
            blur_pixel: appearance.blur_pixel.draw(rng),
            jpeg_quality: (jpeg < appearance.jpeg).then_some((quality + 0.5) as u8),
        }
    }

    /// Fair weather and a perfect camera.
    pub const fn fair(sun: Sun) -> Self {
        Self {
            sun: sun.place(),
            air: Air {
                turbidity: 2.8,
                overcast: 0.0,
                clouds: 0.3,
                haze_m: 2500.0,
            },
            wetness: 0.0,
            exposure_ev: 0.0,
            white_balance: 0.0,
            contrast: 1.0,
            saturation: 1.0,
            vignetting: 0.0,
            blur_pixel: 0.0,
            jpeg_quality: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn draws(appearance: &Appearance) -> Vec<Conditions> {
        (0..400)
            .map(|seed| Conditions::draw(appearance, Sun::Random, seed))
            .collect()
    }

    #[test]
    fn draws_stay_in_their_ranges_and_shares_are_kept() {
        let appearance = Appearance::default();
        let all = draws(&appearance);
        let share = |test: fn(&Conditions) -> bool| {
            all.iter().filter(|c| test(c)).count() as f64 / all.len() as f64
        };
        for c in &all {
            assert!((2.0..=5.0).contains(&c.air.turbidity));
            assert!((-0.35..=0.35).contains(&c.exposure_ev));
            assert!((6.0..=68.0).contains(&c.sun.elevation_deg));
            assert!(c.jpeg_quality.is_none_or(|q| (70..=95).contains(&q)));
        }
        // Four standard errors of 400 draws.
        assert!((share(|c| c.wetness > 0.0) - 0.12).abs() < 0.07);
        assert!((share(|c| c.jpeg_quality.is_some()) - 0.3).abs() < 0.1);
    }

    #[test]
    fn a_single_number_fixes_a_value_and_leaves_the_others_as_they_were() {
        let loose = Appearance::default();
        let fixed = Appearance {
            contrast: Range::Fixed(1.0),
            ..loose.clone()
        };
        for (a, b) in draws(&loose).into_iter().zip(draws(&fixed)) {
            assert_eq!(b, Conditions { contrast: 1.0, ..a });
        }
    }

    #[test]
    fn what_cannot_be_is_refused_by_name() {
        for (text, wanted) in [
            ("overcast = 1.5", "overcast"),
            ("contrast = [1.2, 0.8]", "contrast"),
            ("blur_pixel = nan", "blur_pixel"),
            ("bodies = []", "bodies"),
            ("paints = []", "paints"),
        ] {
            let appearance: Appearance = toml::from_str(text).unwrap();
            let message = appearance.validate().unwrap_err().to_string();
            assert!(message.contains(wanted), "{message}");
        }
        let unknown: Appearance = toml::from_str("bodies = [\"hovercraft\"]").unwrap();
        let message = unknown.wardrobe(None).unwrap_err().to_string();
        assert!(message.contains("hovercraft"), "{message}");
        assert!(message.contains("hatchback"), "{message}");
    }
}
