//! The table of the formats that are imported.

use std::path::Path;

use super::draft::{Draft, ImportTarget};
use super::options::ImportOptions;
use super::report::ImportReport;
use super::{ClassMap, coco, kitti, vkitti2, yolo};
use crate::error::{Error, Result};
use crate::progress::Progress;

/// A foreign format. Its file has everything that is to be known of it.
pub(super) trait Importer: Sync {
    /// The word of `import` for it; several layouts of one family share theirs.
    fn word(&self) -> &'static str;

    /// What people call it.
    fn name(&self) -> &'static str;

    /// The files by which it is known.
    fn layout(&self) -> &'static str;

    /// Whether a file or folder is of this format, by what is in it.
    fn matches(&self, source: &Path) -> bool;

    /// Reads everything but the images' pixels; `classes` are those that are wanted.
    fn read(
        &self,
        source: &Path,
        classes: Option<&ClassMap>,
        options: &ImportOptions,
    ) -> Result<Draft>;
}

/// Every format. Of several that match, the first is taken: those that ask for more come first.
const IMPORTERS: [&dyn Importer; 5] = [
    &vkitti2::VirtualKitti,
    &kitti::Tracking,
    &kitti::Objects,
    &yolo::Yolo,
    &coco::Coco,
];

/// A format of the table, for people.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KnownFormat {
    /// The word of `import` for it.
    pub word: &'static str,
    /// What people call it.
    pub name: &'static str,
    /// The files by which it is known.
    pub layout: &'static str,
}

/// The formats that are imported.
pub fn known() -> impl Iterator<Item = KnownFormat> {
    IMPORTERS.iter().map(|importer| KnownFormat {
        word: importer.word(),
        name: importer.name(),
        layout: importer.layout(),
    })
}

/// The word that leaves it to the source what its format is.
const ANY: &str = "auto";

/// Imports a foreign dataset. `format` is a [`KnownFormat::word`], or `auto` for what the content
/// says; `source` is its folder or file.
///
/// # Errors
/// A source that is not of that format, with a list of those that are known; classes that it does not
/// have, a target that is occupied, or no usable frame.
pub fn import(
    format: &str,
    source: &Path,
    options: &ImportOptions,
    target: &ImportTarget,
    progress: &dyn Progress,
) -> Result<ImportReport> {
    std::fs::metadata(source).map_err(Error::io("read", source))?;
    let of_word = |importer: &&&dyn Importer| format == ANY || importer.word() == format;
    let matching = IMPORTERS
        .iter()
        .filter(of_word)
        .find(|importer| importer.matches(source));
    let named = IMPORTERS.iter().rev().find(of_word);
    let Some(importer) = matching.or(named.filter(|_| format != ANY)) else {
        return Err(Error::dataset(
            source,
            "is of no format that is known",
            known_list(),
        ));
    };
    let draft = importer.read(source, target.classes.as_ref(), options);
    let draft = draft.map_err(|error| {
        if matching.is_some() {
            error
        } else {
            with_list(error, source)
        }
    })?;
    draft.write(target, progress)
}

/// The formats in one line, for a remedy.
fn known_list() -> String {
    let formats: Vec<String> = known()
        .map(|format| format!("{} ({}: {})", format.word, format.name, format.layout))
        .collect();
    format!(
        "known are {}; docs/formats.md has an example of each",
        formats.join(", ")
    )
}

/// An error about a source that does not look like what it is said to be, with what it looks like
/// and the formats that are known.
fn with_list(error: Error, source: &Path) -> Error {
    let list = match IMPORTERS.iter().find(|importer| importer.matches(source)) {
        Some(other) => format!(
            "it looks like {}: import {}; {}",
            other.name(),
            other.word(),
            known_list()
        ),
        None => known_list(),
    };
    match error {
        Error::Dataset {
            path,
            problem,
            remedy,
        } => Error::dataset(path, problem, format!("{remedy}; {list}")),
        error => error,
    }
}
