//! `assets.toml`: what the user says about single files.

use std::collections::BTreeMap;
use std::path::Path;

use glam::Vec3A;
use serde::Deserialize;

use crate::error::{Error, Result};
use crate::files;

/// Name of the file in the folder of assets.
pub(super) const NAME: &str = "assets.toml";
/// A weight above this is a mistake.
const HEAVIEST: u32 = 20;

/// The whole file; what it leaves out is as exporters write it.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Manifest {
    /// By the names of the files in `vehicles/`, without their endings.
    pub vehicles: BTreeMap<String, Entry>,
    /// By the names of the files in `props/`.
    pub props: BTreeMap<String, Entry>,
}

/// What is said about one file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Entry {
    /// Name in labels and settings; the file's where it is left out.
    pub name: Option<String>,
    /// Factor from the file's units to metres.
    pub scale: Option<f64>,
    /// The length that it shall have from front to rear, metres.
    pub length_m: Option<f64>,
    /// The height that it shall have, metres.
    pub height_m: Option<f64>,
    /// Where its front is.
    pub forward: Axis,
    /// Where its top is.
    pub up: Axis,
    /// How often it is drawn, against 1 of every other.
    pub weight: u32,
}

impl Default for Entry {
    fn default() -> Self {
        Self {
            name: None,
            scale: None,
            length_m: None,
            height_m: None,
            forward: Axis::PlusZ,
            up: Axis::PlusY,
            weight: 1,
        }
    }
}

/// A direction of the file's own axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub(super) enum Axis {
    #[serde(rename = "+x")]
    PlusX,
    #[serde(rename = "-x")]
    MinusX,
    #[serde(rename = "+y")]
    PlusY,
    #[serde(rename = "-y")]
    MinusY,
    #[serde(rename = "+z")]
    PlusZ,
    #[serde(rename = "-z")]
    MinusZ,
}

impl Axis {
    /// The unit vector.
    pub const fn direction(self) -> Vec3A {
        match self {
            Self::PlusX => Vec3A::X,
            Self::MinusX => Vec3A::NEG_X,
            Self::PlusY => Vec3A::Y,
            Self::MinusY => Vec3A::NEG_Y,
            Self::PlusZ => Vec3A::Z,
            Self::MinusZ => Vec3A::NEG_Z,
        }
    }
}

impl Manifest {
    /// Reads the file of a folder; without one, nothing is said.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(NAME);
        if !path.exists() {
            return Ok(Self::default());
        }
        let text = files::read_text(&path)?;
        let manifest: Self = toml::from_str(&text).map_err(|error| {
            Error::asset(
                &path,
                error.to_string().trim().to_owned(),
                "correct the file; datasets/README.md describes it",
            )
        })?;
        let entries = manifest.vehicles.iter().chain(&manifest.props);
        for (name, entry) in entries {
            entry.validate().map_err(|(problem, remedy)| {
                Error::asset(&path, format!("{name}: {problem}"), remedy)
            })?;
        }
        Ok(manifest)
    }
}

impl Entry {
    fn validate(&self) -> Result<(), (String, String)> {
        let sizes = [
            ("scale", self.scale),
            ("length_m", self.length_m),
            ("height_m", self.height_m),
        ];
        let mut given = sizes
            .iter()
            .filter_map(|(name, size)| Some((name, (*size)?)));
        for (name, size) in given.clone() {
            if !(size.is_finite() && (1e-6..=1e6).contains(&size)) {
                let remedy = "give a number above 0";
                return Err((
                    format!("{name} = {size} is out of range"),
                    remedy.to_owned(),
                ));
            }
        }
        if given.nth(1).is_some() {
            let remedy = "give one of scale, length_m and height_m";
            return Err(("has its size twice".to_owned(), remedy.to_owned()));
        }
        if self.forward.direction().dot(self.up.direction()) != 0.0 {
            let remedy = "give two axes at right angles, such as forward = \"+x\" and up = \"+z\"";
            return Err((
                "its top is where its front is".to_owned(),
                remedy.to_owned(),
            ));
        }
        if !(1..=HEAVIEST).contains(&self.weight) {
            let problem = format!("weight = {} is out of range", self.weight);
            return Err((problem, format!("give a number from 1 to {HEAVIEST}")));
        }
        Ok(())
    }
}
