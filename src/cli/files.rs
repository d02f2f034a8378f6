//! Files that a command writes where the user says.

use std::fs;
use std::path::Path;

use twinsight::{Error, Result, files};

/// Makes sure, before long work, that a file can be written there later.
///
/// # Errors
/// A folder in the file's place, or a parent folder that cannot be created.
pub fn check_target(path: &Path) -> Result<()> {
    if path.is_dir() {
        return Err(Error::value(
            path.display().to_string(),
            "is a folder",
            "give the name of a file",
        ));
    }
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => files::create_folder(parent),
        _ => Ok(()),
    }
}

/// Writes a file whole or not at all; a pipe or device is written to, not replaced.
///
/// # Errors
/// A file that cannot be written.
pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    let replaceable = fs::metadata(path).map_or(true, |metadata| metadata.is_file());
    if replaceable {
        return files::write_atomically(path, bytes);
    }
    fs::write(path, bytes).map_err(Error::io("write", path))
}
