//! Results as JSON Lines: one object a frame.

use std::path::Path;

use image::RgbImage;

use super::{FrameRecord, Sink};
use crate::error::{Error, Result};
use crate::files::GrowingFile;

/// A file of JSON Lines that is being written.
#[derive(Debug)]
pub struct JsonLines {
    file: GrowingFile,
}

impl JsonLines {
    /// Begins a file.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        Ok(Self {
            file: GrowingFile::create(path)?,
        })
    }
}

impl FrameRecord {
    /// The record as a line, with its end.
    ///
    /// # Errors
    /// None in practice: every number has a form in JSON, `null` at worst.
    pub fn to_line(&self) -> Result<String> {
        let mut line = serde_json::to_string(self).map_err(|error| {
            Error::value(
                format!("frame {}", self.frame),
                format!("cannot be written as JSON: {error}"),
                "report this as a bug",
            )
        })?;
        line.push('\n');
        Ok(line)
    }
}

impl Sink for JsonLines {
    fn take(&mut self, record: &FrameRecord, _: Option<[&RgbImage; 2]>) -> Result<()> {
        self.file.write(record.to_line()?.as_bytes())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.file.finish()
    }
}
