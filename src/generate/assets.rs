//! The user's own vehicles and props in a configuration.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::world::AssetLibrary;

/// Where the user's own vehicles and props are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Assets {
    /// Folder with `vehicles/` and `props/`, as [`AssetLibrary`] reads it.
    pub folder: PathBuf,
    /// Metres of pavement for each prop, where there is room.
    #[serde(default = "Assets::usual_spacing_m")]
    pub prop_spacing_m: f64,
    /// What [`AssetLibrary::digest`] has to be; filled in when a dataset is made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub digest: Option<String>,
}

impl Assets {
    /// The assets of a folder.
    pub fn of(folder: PathBuf) -> Self {
        Self {
            folder,
            prop_spacing_m: Self::usual_spacing_m(),
            digest: None,
        }
    }

    const fn usual_spacing_m() -> f64 {
        15.0
    }

    pub(super) fn library(&self) -> Result<AssetLibrary> {
        let library = AssetLibrary::read(&self.folder)?;
        match &self.digest {
            Some(digest) if digest != library.digest() => Err(Error::asset(
                &self.folder,
                "holds other assets than when the dataset was made",
                "bring its files back, or make another dataset without the digest in the settings",
            )),
            _ => Ok(library),
        }
    }
}
