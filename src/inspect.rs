//! Shows a dataset: a sheet of samples, and a page with samples, counts and histograms.
//!
//! Both are one file each and need nothing else: pictures, charts and styles are inside.

mod charts;
mod page;
mod samples;
mod sheet;
mod summary;

use std::path::{Path, PathBuf};

use crate::dataset::{BoxKind, StereoDataset};
use crate::error::Result;
use crate::files;
use crate::imaging::png_bytes;
use crate::progress::Progress;

pub use summary::{SplitSummary, Summary};

/// What [`inspect`] wrote.
#[derive(Debug, Clone, PartialEq)]
pub struct Inspection {
    /// The sheet, a PNG image.
    pub sheet: PathBuf,
    /// The page, HTML.
    pub page: PathBuf,
    /// Counts of each split.
    pub summary: Summary,
}

/// Writes `inspect.png` and `inspect.html` into a folder, which is created where it is missing.
///
/// The same dataset gives the same files.
///
/// # Errors
/// No image that can be decoded, or a file that cannot be written.
pub fn inspect(
    dataset: &StereoDataset,
    kind: BoxKind,
    out: &Path,
    progress: &dyn Progress,
) -> Result<Inspection> {
    let summary = Summary::new(dataset, kind);
    let samples = samples::draw(dataset, kind, progress)?;
    let sheet = out.join("inspect.png");
    let page = out.join("inspect.html");
    files::create_folder(out)?;
    files::write_atomically(&sheet, &png_bytes(&sheet, &sheet::compose(&samples.rows))?)?;
    let text = page::render(dataset, kind, &summary, &samples)?;
    files::write_atomically(&page, text.as_bytes())?;
    Ok(Inspection {
        sheet,
        page,
        summary,
    })
}

#[cfg(test)]
mod tests;
