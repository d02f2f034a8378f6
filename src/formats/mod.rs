//! Datasets of other programs: into this crate's format and out of it.
//!
//! An import reads the foreign files into a draft, frame by frame, and writes what is usable as a
//! dataset; every frame that is not is named with its reason. An export writes a dataset so that an
//! import brings back what the foreign format can hold. `datasets/README.md` has the table of what
//! is kept and what is lost.

mod classes;
pub mod coco;
mod copy;
mod draft;
mod flat;
pub mod kitti;
mod number;
mod report;
mod splits;
mod target;
mod vehicle;
pub mod vkitti2;
pub mod yolo;

pub use classes::ClassMap;
pub use draft::ImportTarget;
pub use flat::HeapOptions;
pub use report::{ExportReport, ImportReport};
pub use splits::SplitSettings;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// The images in a folder by their names without ending.
fn image_files(folder: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        if is_image(&path)
            && let Some(stem) = path.file_stem()
        {
            found.insert(stem.to_string_lossy().into_owned(), path);
        }
    }
    Ok(found)
}

/// Whether a file's name says that it is an image that can be read.
fn is_image(path: &Path) -> bool {
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    ["png", "jpg", "jpeg"].contains(&ending.to_ascii_lowercase().as_str())
}
