//! Image files that can be read: how their names end and how their contents begin.

use std::fs;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use image::ImageFormat;

use crate::error::{Error, Result};

/// The kinds of image that are read, for messages.
pub(crate) const READABLE: &str = "PNG, JPEG, BMP, WebP or TIFF";

/// Endings of images that can be read.
const ENDINGS: [&str; 9] = [
    "png", "jpg", "jpeg", "jpe", "jfif", "bmp", "webp", "tif", "tiff",
];

/// Endings of files that lie beside images and that nobody takes for images.
const TEXTS: [&str; 22] = [
    "txt", "csv", "tsv", "json", "jsonl", "xml", "yaml", "yml", "toml", "md", "rst", "html", "htm",
    "log", "ini", "conf", "cfg", "cache", "py", "sh", "db", "lnk",
];

/// The longest beginning that tells an image from others, bytes.
const HEAD_BYTES: u64 = 64;

/// The format of an image's bytes; none where it is not one that is read.
pub(super) fn readable(bytes: &[u8]) -> Option<ImageFormat> {
    use ImageFormat::{Bmp, Jpeg, Png, Tiff, WebP};
    let format = image::guess_format(bytes).ok()?;
    [Png, Jpeg, Bmp, WebP, Tiff]
        .contains(&format)
        .then_some(format)
}

/// Whether a file's name ends as those of images that can be read.
pub fn has_image_ending(path: &Path) -> bool {
    ends_with(path, &ENDINGS)
}

/// Whether a file is an image that can be read: by its name, or where the name says nothing of
/// images, by how the file begins.
pub fn is_image(path: &Path) -> bool {
    has_image_ending(path) || (!ends_with(path, &TEXTS) && begins_like_an_image(path))
}

fn ends_with(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().unwrap_or_default();
    endings
        .iter()
        .any(|known| ending.eq_ignore_ascii_case(known))
}

fn begins_like_an_image(path: &Path) -> bool {
    // Pipes would wait.
    if !fs::metadata(path).is_ok_and(|metadata| metadata.is_file()) {
        return false;
    }
    let mut head = Vec::new();
    let read = fs::File::open(path).and_then(|file| file.take(HEAD_BYTES).read_to_end(&mut head));
    read.is_ok() && readable(&head).is_some()
}

/// What lies in a folder.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FolderFiles {
    /// The images that can be read, by name.
    pub images: Vec<PathBuf>,
    /// The folders, by name.
    pub folders: Vec<PathBuf>,
    /// Other files that could be pictures of a kind that is not read: not texts, not hidden.
    pub skipped: Vec<PathBuf>,
}

/// Sorts what lies directly in a folder; hidden files and folders are left out.
///
/// # Errors
/// [`Error::Io`] naming a folder that cannot be read.
pub fn files_in(folder: &Path) -> Result<FolderFiles> {
    let mut found = FolderFiles::default();
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with('.') || name.eq_ignore_ascii_case("thumbs.db") {
            continue;
        }
        if path.is_dir() {
            found.folders.push(path);
        } else if is_image(&path) {
            found.images.push(path);
        } else if !ends_with(&path, &TEXTS) {
            found.skipped.push(path);
        }
    }
    found.images.sort();
    found.folders.sort();
    found.skipped.sort();
    Ok(found)
}
