//! Datasets of other programs: into this crate's format and out of it.
//!
//! An import reads the foreign files into a draft, frame by frame, and writes what is usable as a
//! dataset; every frame that is not is named with its reason. An export writes a dataset so that an
//! import brings back what the foreign format can hold. `datasets/README.md` has the table of what
//! is kept and what is lost, `docs/formats.md` an example of every format.
//!
//! Formats that are imported stand in the table of [`known`]; a new one is a type with the trait
//! `Importer` in a file of its own, and a line there.

mod classes;
pub mod coco;
mod copy;
mod draft;
mod finder;
mod flat;
mod importer;
pub mod kitti;
mod number;
mod options;
mod report;
mod splits;
mod target;
mod vehicle;
mod vkitti2;
pub mod yolo;

pub use classes::ClassMap;
pub use draft::ImportTarget;
pub use importer::{KnownFormat, import, known};
pub use options::ImportOptions;
pub use report::{ExportReport, ImportReport};
pub use splits::SplitSettings;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::dataset::Problem;
use crate::error::Result;
use crate::imaging::{READABLE, files_in};

/// The images in a folder by their names without ending; other files that may have been meant are
/// named among the problems.
fn image_files(folder: &Path, problems: &mut Vec<Problem>) -> Result<BTreeMap<String, PathBuf>> {
    let files = files_in(folder)?;
    problems.extend(files.skipped.iter().map(|path| skipped(folder, path)));
    let mut named: BTreeMap<String, PathBuf> = BTreeMap::new();
    for path in files.images {
        let Some(stem) = path.file_stem() else {
            continue;
        };
        let stem = stem.to_string_lossy().into_owned();
        if let Some(first) = named.get(&stem) {
            let first = first.file_name().unwrap_or_default().display();
            problems.push(Problem {
                subject: path.display().to_string(),
                reason: format!("has the name of {first}, which is taken"),
            });
            continue;
        }
        named.insert(stem, path);
    }
    Ok(named)
}

/// A file that may be a picture but not of a kind that is read.
fn skipped(folder: &Path, path: &Path) -> Problem {
    let inside = path.strip_prefix(folder).unwrap_or(path);
    Problem {
        subject: inside.display().to_string(),
        reason: format!("is not a {READABLE} image"),
    }
}
