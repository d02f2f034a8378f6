//! TensorBoard's event files, whose writers panic where they cannot write.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::files;

/// A writer of tensorboard-rs, whose panics become errors.
pub struct Events<W> {
    folder: PathBuf,
    /// None once it has failed.
    writer: Option<W>,
}

impl<W> Events<W> {
    /// Begins an event file in a folder.
    ///
    /// # Errors
    /// A folder in which no file can be written.
    pub fn begin(folder: &Path, begin: impl FnOnce(&Path) -> W) -> Result<Self> {
        files::create_folder(folder)?;
        let probe = folder.join("probe");
        files::write_atomically(&probe, b"")?;
        std::fs::remove_file(&probe).map_err(Error::io("remove", &probe))?;
        Ok(Self {
            folder: folder.to_path_buf(),
            writer: Some(begin(folder)),
        })
    }

    /// Writes something.
    ///
    /// # Errors
    /// A disk that is full, now or at an earlier call.
    pub fn write(&mut self, write: impl FnOnce(&mut W)) -> Result<()> {
        let written = self.writer.as_mut().is_some_and(|writer| {
            // The writer is never used again after a panic.
            catch_unwind(AssertUnwindSafe(|| write(writer))).is_ok()
        });
        if written {
            return Ok(());
        }
        // It would panic again while it is dropped.
        std::mem::forget(self.writer.take());
        Err(Error::training(
            format!("cannot write events into {}", self.folder.display()),
            "make room on the disk and --resume",
        ))
    }
}

impl<W> Drop for Events<W> {
    fn drop(&mut self) {
        if let Some(writer) = self.writer.take() {
            // Its last flush may fail, when the run has told so or is complete.
            let _ = catch_unwind(AssertUnwindSafe(|| drop(writer)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Full;

    impl Drop for Full {
        fn drop(&mut self) {
            panic!("the disk is full");
        }
    }

    #[test]
    fn a_writer_that_panics_is_an_error_that_names_the_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("events");
        let mut events = Events::begin(&path, |_| Full).unwrap();
        events.write(|_| {}).unwrap();
        for _ in 0..2 {
            let error = events.write(|_| panic!("the disk is full")).unwrap_err();
            let message = error.to_string();
            assert!(message.contains(&path.display().to_string()), "{message}");
        }
        drop(events);
        drop(Events::begin(&path, |_| Full).unwrap());
    }

    #[test]
    fn a_file_where_the_folder_should_be_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("events");
        std::fs::write(&path, "a file").unwrap();
        let error = Events::begin(&path, |_| ()).err().unwrap();
        assert!(error.to_string().contains("events"), "{error}");
    }
}
