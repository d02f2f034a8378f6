//! What kind of dataset to make.

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{Assets, Outputs, VehicleCount};
use crate::dataset::View;
use crate::error::{Error, Result};
use crate::files;
use crate::geometry::StereoRig;
use crate::render::{Appearance, Range};
use crate::world::{Sun, Wardrobe};

/// How frames are divided between training and validation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SplitMode {
    /// Whole scenes with their vehicles: validation shows cities and cars never seen in training.
    Scene,
    /// Single frames at random, as the paper does: validation shows the scenes of training. Planned
    /// views of one scene are at least 15 degrees apart or have different distances, so none is a
    /// near-copy of another.
    Frame,
}

/// Settings of [`generate`](super::generate). A field that a file leaves out has the default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GenerateConfig {
    /// Everything random follows from it.
    pub seed: u64,
    /// Training and validation frames together; the frames of `test` come on top.
    pub frames: u32,
    /// Frames of one scene, which is one city with its vehicles.
    pub frames_per_scene: u32,
    /// Vehicles of a scene, as a number or as the least and the most: one is the target, which
    /// the drone orbits; the others stand and drive about it.
    pub vehicles: VehicleCount,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Horizontal field of view of both cameras, degrees.
    pub hfov_deg: f64,
    /// Distance between the cameras, metres.
    pub baseline_m: f64,
    /// Shortest distance from the rig to the target, metres.
    pub distance_min_m: f64,
    /// Longest distance from the rig to the target, metres.
    pub distance_max_m: f64,
    /// Sun positions, used in turn.
    pub suns: Vec<Sun>,
    /// Samples a pixel at edges, a square number; 1 switches anti-aliasing off.
    pub samples_per_pixel: u32,
    /// Standard deviation of the sensor's noise on white, 8-bit counts, as a number or as a range
    /// from which every frame draws; 0 switches it off.
    pub noise_counts: Range,
    /// Least part of the target that either camera must see; other views are drawn again.
    pub min_visible: f64,
    /// A vehicle of which an image shows less than this part is ignored in it.
    pub ignore_below_visible: f64,
    /// A vehicle is ignored in an image where both sides of its tight box are shorter than this,
    /// pixels.
    pub ignore_below_px: f64,
    /// Part of `frames` that validates.
    pub val_fraction: f64,
    /// How frames are divided between training and validation.
    pub split: SplitMode,
    /// What is written beside images and labels.
    pub outputs: Outputs,
    /// Weather, camera, sensor, bodies and paints.
    pub appearance: Appearance,
    /// The user's own vehicles and props.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub assets: Option<Assets>,
    /// A grid of test views in scenes of their own.
    pub test: Option<TestProtocol>,
}

/// Test frames: one for every combination of distance, sun and view.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TestProtocol {
    /// Distances from the rig to the vehicle, metres.
    pub distances_m: Vec<f64>,
    /// Sun positions.
    pub suns: Vec<Sun>,
    /// Sides from which the vehicle is seen; `other` is not one.
    pub views: Vec<View>,
    /// Scenes over which the frames are spread.
    pub scenes: u32,
}

impl Default for GenerateConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            frames: 360,
            frames_per_scene: 4,
            vehicles: VehicleCount { least: 4, most: 8 },
            width: 640,
            height: 360,
            hfov_deg: 90.0,
            baseline_m: 0.8,
            distance_min_m: 10.0,
            distance_max_m: 40.0,
            suns: Sun::ALL.to_vec(),
            samples_per_pixel: 4,
            noise_counts: Range::Fixed(1.5),
            min_visible: 0.55,
            ignore_below_visible: 0.5,
            ignore_below_px: 8.0,
            val_fraction: 0.2,
            split: SplitMode::Scene,
            outputs: Outputs::default(),
            appearance: Appearance::default(),
            assets: None,
            test: None,
        }
    }
}

impl TestProtocol {
    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.distances_m.len() * self.suns.len() * self.views.len()
    }
}

impl GenerateConfig {
    /// The names that [`GenerateConfig::preset`] knows.
    pub const PRESETS: [&str; 2] = ["quick", "paper"];

    /// A configuration that comes with the program.
    ///
    /// # Errors
    /// An unknown name.
    pub fn preset(name: &str) -> Result<Self> {
        let text = match name {
            "quick" => include_str!("../../datasets/quick.toml"),
            "paper" => include_str!("../../datasets/paper.toml"),
            _ => {
                return Err(Error::value(
                    format!("preset {name:?}"),
                    "no such preset",
                    format!("use one of {}", Self::PRESETS.join(", ")),
                ));
            }
        };
        Self::parse(text, name)
    }

    /// Reads a configuration file.
    ///
    /// # Errors
    /// A file that cannot be read, is not TOML, has an unknown field or an unusable value.
    pub fn from_toml_file(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        Self::parse(&files::read_text(path)?, &path.display().to_string())
    }

    /// Reads a configuration file whose values are changed, and checked, later.
    ///
    /// # Errors
    /// A file that cannot be read, is not TOML or has an unknown field.
    pub fn unchecked_from_toml_file(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        Self::read(&files::read_text(path)?, &path.display().to_string())
    }

    fn parse(text: &str, name: &str) -> Result<Self> {
        let config = Self::read(text, name)?;
        config.validate()?;
        Ok(config)
    }

    fn read(text: &str, name: &str) -> Result<Self> {
        toml::from_str(text).map_err(|error| {
            Error::value(
                format!("dataset configuration {name}"),
                error.to_string().trim().to_owned(),
                "correct the file; datasets/quick.toml shows every setting",
            )
        })
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The first value that cannot be used, with the range that can.
    pub fn validate(&self) -> Result<()> {
        self.rig()?;
        let in_range = |name: &str, value: f64, low: f64, high: f64| {
            if value.is_finite() && (low..=high).contains(&value) {
                return Ok(());
            }
            Err(Error::value(
                format!("{name} = {value}"),
                "out of range",
                format!("give a number from {low} to {high}"),
            ))
        };
        // TOML has no integers above this.
        in_range("seed", self.seed as f64, 0.0, i64::MAX as f64 / 2.0)?;
        in_range("frames", f64::from(self.frames), 1.0, 1e6)?;
        in_range(
            "frames_per_scene",
            f64::from(self.frames_per_scene),
            1.0,
            1e6,
        )?;
        in_range("width", f64::from(self.width), 64.0, 8192.0)?;
        in_range("height", f64::from(self.height), 64.0, 8192.0)?;
        in_range("hfov_deg", self.hfov_deg, 10.0, 140.0)?;
        in_range("baseline_m", self.baseline_m, 0.01, 5.0)?;
        // Nearer than this the drone is in the car; further away the car is a dot in a haze.
        in_range("distance_min_m", self.distance_min_m, 5.0, 500.0)?;
        in_range(
            "distance_max_m",
            self.distance_max_m,
            self.distance_min_m,
            500.0,
        )?;
        in_range(
            "samples_per_pixel",
            f64::from(self.samples_per_pixel),
            1.0,
            64.0,
        )?;
        self.noise_counts.validate("noise_counts", [0.0, 50.0])?;
        in_range("min_visible", self.min_visible, 0.0, 0.9)?;
        in_range("ignore_below_visible", self.ignore_below_visible, 0.0, 1.0)?;
        in_range("ignore_below_px", self.ignore_below_px, 0.0, 1000.0)?;
        self.vehicles.validate()?;
        in_range("val_fraction", self.val_fraction, 0.0, 0.9)?;
        self.appearance.validate()?;
        if let Some(assets) = &self.assets {
            in_range("assets.prop_spacing_m", assets.prop_spacing_m, 1.0, 1e4)?;
            if assets.folder.to_str().is_none() {
                return Err(Error::value(
                    format!("assets.folder = {}", assets.folder.display()),
                    "its name is not Unicode",
                    "rename the folder",
                ));
            }
        } else {
            self.appearance.wardrobe(None)?;
        }
        let root = self.samples_per_pixel.isqrt();
        if root * root != self.samples_per_pixel {
            return Err(Error::value(
                format!("samples_per_pixel = {}", self.samples_per_pixel),
                "samples lie on a square grid",
                "give a square number such as 1, 4, 9 or 16",
            ));
        }
        let filled = |name: &str, is_empty: bool| {
            if !is_empty {
                return Ok(());
            }
            Err(Error::value(name, "the list is empty", "name at least one"))
        };
        filled("suns", self.suns.is_empty())?;
        if let Some(test) = &self.test {
            filled("test.distances_m", test.distances_m.is_empty())?;
            filled("test.suns", test.suns.is_empty())?;
            filled("test.views", test.views.is_empty())?;
            for &distance_m in &test.distances_m {
                in_range("test.distances_m", distance_m, 5.0, 500.0)?;
            }
            in_range(
                "test.scenes",
                f64::from(test.scenes),
                1.0,
                test.frames() as f64,
            )?;
            if test.views.contains(&View::Other) {
                return Err(Error::value(
                    "test.views",
                    "\"other\" is no side of a vehicle",
                    "use front, side and rear",
                ));
            }
        }
        Ok(())
    }

    /// Reads the user's assets, and returns the settings with their digest beside the bodies and
    /// paints that scenes may draw from.
    ///
    /// # Errors
    /// Assets that cannot be used or that are not those of the digest, and a body that there is not.
    pub(super) fn dressed(&self) -> Result<(Self, Wardrobe)> {
        let mut config = self.clone();
        let own = match &mut config.assets {
            Some(assets) => {
                let library = assets.library()?;
                assets.digest = Some(library.digest().to_owned());
                Some((Arc::new(library), assets.prop_spacing_m))
            }
            None => None,
        };
        let wardrobe = self.appearance.wardrobe(own)?;
        Ok((config, wardrobe))
    }

    /// The rig that takes the frames.
    ///
    /// # Errors
    /// A size, field of view or baseline that no rig can have.
    pub fn rig(&self) -> Result<StereoRig> {
        StereoRig::from_hfov(self.width, self.height, self.hfov_deg, self.baseline_m)
    }

    /// Number of training and validation scenes. At least two where there are two frames, so that
    /// a split by scene has something to divide.
    pub fn scenes(&self) -> u32 {
        self.scenes_of(self.frames)
    }

    /// Number of scenes over which this many frames are spread.
    pub(super) fn scenes_of(&self, frames: u32) -> u32 {
        frames
            .div_ceil(self.frames_per_scene.max(1))
            .max(frames.min(2))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_presets_are_valid_and_have_the_sizes_they_promise() {
        let quick = GenerateConfig::preset("quick").unwrap();
        assert_eq!((quick.frames, quick.width, quick.scenes()), (360, 640, 90));
        assert_eq!(quick.test.unwrap().frames(), 36);
        let paper = GenerateConfig::preset("paper").unwrap();
        assert_eq!(
            (paper.frames, paper.width, paper.height),
            (7000, 2048, 1152)
        );
        assert_eq!(paper.test.unwrap().frames(), 108);
        assert!(
            GenerateConfig::preset("huge")
                .unwrap_err()
                .to_string()
                .contains("quick, paper")
        );
    }

    #[test]
    fn the_quick_preset_is_the_default_but_for_bodies_paints_and_test_frames() {
        let mut quick = GenerateConfig {
            test: None,
            ..GenerateConfig::preset("quick").unwrap()
        };
        let all = GenerateConfig::default();
        let (held, whole) = (&mut quick.appearance, &all.appearance);
        assert!(held.bodies.len() < whole.bodies.len() && held.paints.len() < whole.paints.len());
        held.bodies.clone_from(&whole.bodies);
        held.paints.clone_from(&whole.paints);
        assert_eq!(quick, all);
    }

    #[test]
    fn unusable_values_are_refused_by_name() {
        let base = GenerateConfig::default();
        let cases = [
            (
                GenerateConfig {
                    frames: 0,
                    ..base.clone()
                },
                "frames = 0",
            ),
            (
                GenerateConfig {
                    samples_per_pixel: 5,
                    ..base.clone()
                },
                "samples_per_pixel = 5",
            ),
            (
                GenerateConfig {
                    distance_max_m: 2.0,
                    ..base.clone()
                },
                "distance_max_m = 2",
            ),
            (
                GenerateConfig {
                    min_visible: f64::NAN,
                    ..base.clone()
                },
                "min_visible = NaN",
            ),
            (
                GenerateConfig {
                    suns: Vec::new(),
                    ..base.clone()
                },
                "suns",
            ),
            (
                GenerateConfig {
                    baseline_m: -1.0,
                    ..base.clone()
                },
                "baseline_m = -1",
            ),
            (
                GenerateConfig {
                    vehicles: VehicleCount { least: 5, most: 2 },
                    ..base.clone()
                },
                "vehicles = [5, 2]",
            ),
            (
                GenerateConfig {
                    vehicles: VehicleCount::exactly(0),
                    ..base
                },
                "vehicles = 0",
            ),
        ];
        for (config, words) in cases {
            let message = config.validate().unwrap_err().to_string();
            assert!(message.contains(words), "{message} should contain {words}");
        }
    }

    #[test]
    fn a_file_leaves_out_what_quick_has_but_for_its_bodies_and_paints_and_its_test() {
        let all = GenerateConfig::parse("", "a.toml").unwrap();
        let mut quick = GenerateConfig::preset("quick").unwrap();
        assert_eq!(
            (all.appearance.bodies.len(), all.appearance.paints.len()),
            (11, 18)
        );
        assert_eq!(
            (quick.appearance.bodies.len(), quick.appearance.paints.len()),
            (7, 14)
        );
        quick.appearance.bodies.clone_from(&all.appearance.bodies);
        quick.appearance.paints.clone_from(&all.appearance.paints);
        quick.test = None;
        assert_eq!(quick, all);
    }

    #[test]
    fn vehicles_are_a_number_or_a_range_and_come_back_from_toml() {
        for (text, least, most) in [("3", 3, 3), ("[2, 6]", 2, 6)] {
            let config = GenerateConfig::parse(&format!("vehicles = {text}"), "a").unwrap();
            assert_eq!(config.vehicles, VehicleCount { least, most });
            let written = toml::to_string(&config).unwrap();
            assert!(
                written.contains(&format!("vehicles = {text}\n")),
                "{written}"
            );
        }
        for text in ["0", "[1]", "[1, 2, 3]", "\"many\"", "[3, 2]", "[1, 1000]"] {
            let message = GenerateConfig::parse(&format!("vehicles = {text}"), "a.toml")
                .unwrap_err()
                .to_string();
            assert!(message.contains("vehicles"), "{message}");
        }
    }

    #[test]
    fn noise_is_a_number_or_a_range_and_every_frame_draws_from_it() {
        let parse = |text: &str| GenerateConfig::parse(&format!("noise_counts = {text}"), "a");
        for (text, ends) in [
            ("2", [2.0, 2.0]),
            ("1.5", [1.5, 1.5]),
            ("[0.5, 3.0]", [0.5, 3.0]),
        ] {
            let noise = parse(text).unwrap().noise_counts;
            let drawn: Vec<f32> = (0..50).map(|seed| noise.drawn(seed)).collect();
            assert!(
                drawn.iter().all(|v| (ends[0]..=ends[1]).contains(v)),
                "{drawn:?}"
            );
            let differ = drawn.iter().any(|v| *v != drawn[0]);
            assert_eq!(differ, ends[0] < ends[1]);
        }
        for text in ["-1", "[3, 1]", "nan", "51"] {
            let message = parse(text).unwrap_err().to_string();
            assert!(message.contains("noise_counts"), "{message}");
        }
    }

    #[test]
    fn an_unknown_field_is_an_error_that_names_it() {
        let message = GenerateConfig::parse("framez = 3", "a.toml")
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("framez") && message.contains("a.toml"),
            "{message}"
        );
    }
}
