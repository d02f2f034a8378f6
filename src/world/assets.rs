//! The user's own vehicles and props, from a folder of glTF files.
//!
//! ```text
//! <folder>/vehicles/*.glb *.gltf    one vehicle a file
//! <folder>/props/*.glb *.gltf       one thing of the roadside a file
//! <folder>/assets.toml              names, sizes, axes and weights where they need saying; optional
//! ```
//!
//! A file's own axes are glTF's: y up, z forward, metres. What moves in it (animations, skins, morph
//! targets) stands still in the pose of its nodes.

mod accessor;
mod corners;
#[cfg(test)]
pub(crate) mod fixture;
mod manifest;
mod material;
mod model;
mod source;
#[cfg(test)]
mod tests;
mod texture;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};

use super::vehicle::BodyStyle;
use crate::error::{Error, Result};
use manifest::{Entry, Manifest};
pub(crate) use model::Model;

const VEHICLES: &str = "vehicles";
const PROPS: &str = "props";
/// Memory that all models together may take.
const MOST_BYTES: usize = 512 << 20;
/// What a vehicle can measure, metres: from a small car to a lorry or a coach.
const LENGTH_M: [f32; 2] = [2.0, 14.0];
const WIDTH_M: [f32; 2] = [0.8, 3.0];
const HEIGHT_M: [f32; 2] = [0.7, 4.5];
/// What a prop can measure, metres: it has to fit on a pavement.
const PROP_DEPTH_M: [f32; 2] = [0.02, 2.5];
const PROP_LENGTH_M: [f32; 2] = [0.02, 8.0];
const PROP_HEIGHT_M: [f32; 2] = [0.05, 12.0];

/// One model with its name.
#[derive(Debug)]
pub(crate) struct Asset {
    /// As labels and settings call it.
    pub name: String,
    /// How often it is drawn, against 1 of every other.
    pub weight: u32,
    /// Its shape and look.
    pub model: Model,
}

/// All vehicles and props of a folder.
#[derive(Debug)]
pub struct AssetLibrary {
    /// Vehicles first, then props, each in the order of the file names.
    assets: Vec<Asset>,
    vehicles: usize,
    digest: String,
}

impl AssetLibrary {
    /// Reads a folder.
    ///
    /// # Errors
    /// A folder that is missing or holds no vehicle and no prop, and a file that is damaged, has no
    /// triangles or too many, or is of a size that its kind cannot have.
    pub fn read(folder: &Path) -> Result<Self> {
        if !folder.is_dir() {
            return Err(Error::asset(
                folder,
                "is no folder",
                "give a folder with vehicles/ or props/ in it",
            ));
        }
        let manifest = Manifest::read(folder)?;
        let mut reader = Reader {
            digest: Sha256::new(),
            assets: Vec::new(),
        };
        reader.read_all(&folder.join(VEHICLES), manifest.vehicles, plausible_vehicle)?;
        let vehicles = reader.assets.len();
        reader.read_all(&folder.join(PROPS), manifest.props, plausible_prop)?;
        if reader.assets.is_empty() {
            return Err(Error::asset(
                folder,
                "holds no vehicles and no props",
                "put .glb or .gltf files into its folders vehicles/ and props/",
            ));
        }
        let digest = reader.digest.finalize();
        Ok(Self {
            assets: reader.assets,
            vehicles,
            digest: format!("{digest:x}"),
        })
    }

    /// A number that changes with every byte that was read and every setting in `assets.toml`.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Names of the vehicles, in order.
    pub fn vehicle_names(&self) -> impl Iterator<Item = &str> {
        self.vehicles().iter().map(|asset| asset.name.as_str())
    }

    pub(crate) fn vehicles(&self) -> &[Asset] {
        &self.assets[..self.vehicles]
    }

    /// The props, each as often as its weight says, by their numbers.
    pub(crate) fn prop_numbers(&self) -> Vec<u16> {
        self.weighted(self.vehicles..self.assets.len())
    }

    /// Some assets' numbers, each as often as its weight says and no two alike beside each other
    /// where that can be.
    pub(crate) fn weighted(&self, numbers: impl IntoIterator<Item = usize>) -> Vec<u16> {
        let numbers: Vec<usize> = numbers.into_iter().collect();
        let weight = |&number: &usize| self.assets[number].weight;
        let heaviest = numbers.iter().map(weight).max().unwrap_or(0);
        (0..heaviest)
            .flat_map(|round| numbers.iter().filter(move |&n| weight(n) > round))
            // As many as `Reader` lets in.
            .map(|&number| number as u16)
            .collect()
    }

    /// An asset by its number.
    pub(crate) fn asset(&self, number: u16) -> &Asset {
        &self.assets[usize::from(number)]
    }

    /// A model by its number.
    pub(crate) fn model(&self, number: u16) -> &Model {
        &self.asset(number).model
    }
}

struct Reader {
    digest: Sha256,
    assets: Vec<Asset>,
}

impl Reader {
    fn read_all(
        &mut self,
        folder: &Path,
        mut entries: BTreeMap<String, Entry>,
        check: impl Fn([f32; 3]) -> Result<(), [String; 2]>,
    ) -> Result<()> {
        for path in models_in(folder)? {
            let stem = path.file_stem().and_then(|stem| stem.to_str());
            let stem = stem.unwrap_or_default().to_owned();
            let entry = entries.remove(&stem).unwrap_or_default();
            let name = entry.name.clone().unwrap_or(stem);
            self.check_name(&path, &name)?;
            self.digest.update(format!("{name:?} {entry:?}"));
            let number = u16::try_from(self.assets.len()).map_err(|_too_many| {
                Error::asset(folder, "holds more than 65536 files", "leave some out")
            })?;
            let model = Model::read(&path, &entry, number, &mut self.digest)?;
            check(model.size_m)
                .map_err(|[problem, remedy]| Error::asset(&path, problem, remedy))?;
            self.assets.push(Asset {
                name,
                weight: entry.weight,
                model,
            });
            let bytes: usize = self.assets.iter().map(|asset| asset.model.bytes()).sum();
            if bytes > MOST_BYTES {
                return Err(Error::asset(
                    folder,
                    format!(
                        "takes more than {} MB of memory up to {}",
                        MOST_BYTES >> 20,
                        path.display()
                    ),
                    "use fewer files, smaller pictures or simpler models",
                ));
            }
        }
        match entries.keys().next() {
            Some(name) => Err(Error::asset(
                folder.with_file_name(manifest::NAME),
                format!(
                    "speaks of {name:?}, but {} has no such file",
                    folder.display()
                ),
                "name files without their ending .glb or .gltf",
            )),
            None => Ok(()),
        }
    }

    fn check_name(&self, path: &Path, name: &str) -> Result<()> {
        let rename = format!("rename the file, or give it a name in {}", manifest::NAME);
        let is_plain = |c: char| c.is_alphanumeric() || " -_.()".contains(c);
        let problem = if name.is_empty() || name.len() > 64 || !name.chars().all(is_plain) {
            format!("its name {name:?} is not of letters, digits, blanks and -_.()")
        } else if BodyStyle::ALL.iter().any(|style| style.name() == name) {
            format!("{name:?} is the name of a built-in body")
        } else if self.assets.iter().any(|asset| asset.name == name) {
            format!("another file has the name {name:?}")
        } else {
            return Ok(());
        };
        Err(Error::asset(path, problem, rename))
    }
}

/// The glTF files of a folder in the order of their names; none where it is missing.
fn models_in(folder: &Path) -> Result<Vec<PathBuf>> {
    if !folder.exists() {
        return Ok(Vec::new());
    }
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let ending = path.extension().and_then(|ending| ending.to_str());
        let is_hidden = |name: &str| name.starts_with('.');
        let name = path.file_name().and_then(|name| name.to_str());
        if !name.is_some_and(is_hidden)
            && ending.is_some_and(|e| ["glb", "gltf"].contains(&e.to_ascii_lowercase().as_str()))
        {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

fn plausible_vehicle(size_m: [f32; 3]) -> Result<(), [String; 2]> {
    let [length, width, height] = size_m;
    let fits = [(length, LENGTH_M), (width, WIDTH_M), (height, HEIGHT_M)]
        .into_iter()
        .all(|(size, [least, most])| (least..=most).contains(&size));
    if fits && length >= width {
        return Ok(());
    }
    let measures = measures(size_m);
    // Would it be one if its length were the width?
    if width > length && (LENGTH_M[0]..=LENGTH_M[1]).contains(&width) {
        return Err([
            format!("is wider than long: {measures}"),
            format!(
                "say where its front is in {}, such as forward = \"+x\"",
                manifest::NAME
            ),
        ]);
    }
    Err([
        format!("is no vehicle's size: {measures}"),
        format!(
            "vehicles are 2 to 14 m long, 0.8 to 3 m wide and 0.7 to 4.5 m high: give length_m or \
             scale, or the axes forward and up, in {}",
            manifest::NAME
        ),
    ])
}

fn plausible_prop(size_m: [f32; 3]) -> Result<(), [String; 2]> {
    let [depth, length, height] = size_m;
    let fits = [
        (depth, PROP_DEPTH_M),
        (length, PROP_LENGTH_M),
        (height, PROP_HEIGHT_M),
    ]
    .into_iter()
    .all(|(size, [least, most])| (least..=most).contains(&size));
    if fits {
        return Ok(());
    }
    Err([
        format!(
            "is too large or too small for a pavement: {}",
            measures(size_m)
        ),
        format!(
            "props are up to 2.5 m deep from front to rear, 8 m long and 12 m high: give height_m or \
             scale, or the axes forward and up, in {}",
            manifest::NAME
        ),
    ])
}

fn measures([length, width, height]: [f32; 3]) -> String {
    format!("{length:.2} m from front to rear, {width:.2} m wide and {height:.2} m high")
}
