//! Pictures as a video.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Stdio};

use image::{RgbImage, imageops};
use tempfile::TempPath;

use super::{Program, command, file_argument};
use crate::error::{Error, Result};
use crate::files;

/// Kinds of video files that are written, each with FFmpeg's usual encoder of it.
const ENDINGS: [&str; 5] = ["mp4", "mkv", "mov", "webm", "avi"];

/// What the program is needed for.
const NEEDED_FOR: &str = "writing a video";

/// What a video is to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VideoEncoding {
    /// Frames a second.
    pub rate_hz: f64,
}

/// A video that is being written: to a temporary name, renamed when it is finished.
#[derive(Debug)]
pub struct VideoWriter {
    path: PathBuf,
    encoding: VideoEncoding,
    running: Option<Running>,
}

/// The program and its file.
#[derive(Debug)]
struct Running {
    // Before the file, so that the program has ended when it is removed.
    program: Program,
    pixels: Option<ChildStdin>,
    size: (u32, u32),
    file: TempPath,
}

impl VideoWriter {
    /// Prepares to write a video; its first picture says how large it is.
    ///
    /// # Errors
    /// A name that is none of a video, a rate that is none, or no program `ffmpeg`.
    pub fn new(path: &Path, encoding: VideoEncoding) -> Result<Self> {
        let ending = path.extension().and_then(|ending| ending.to_str());
        let is_known = ending.is_some_and(|ending| {
            ENDINGS
                .iter()
                .any(|known| known.eq_ignore_ascii_case(ending))
        });
        if !is_known {
            return Err(Error::value(
                path.display().to_string(),
                "is not the name of a video",
                format!("let it end in one of .{}", ENDINGS.join(", .")),
            ));
        }
        if !(encoding.rate_hz.is_finite() && (1e-3..=1e4).contains(&encoding.rate_hz)) {
            return Err(Error::value(
                format!("{} frames a second", encoding.rate_hz),
                "is no rate of a video",
                "give one from 0.001 to 10000",
            ));
        }
        // Before the work rather than at its first frame.
        super::passthrough(NEEDED_FOR)?;
        Ok(Self {
            path: path.to_path_buf(),
            encoding,
            running: None,
        })
    }

    /// Adds a picture. One of another size than the first is scaled to that.
    ///
    /// # Errors
    /// A folder that cannot be written, or an encoder that fails.
    pub fn add(&mut self, picture: &RgbImage) -> Result<()> {
        if self.running.is_none() {
            self.running = Some(self.start(picture.dimensions())?);
        }
        let Some(running) = &mut self.running else {
            return Ok(());
        };
        let (width, height) = running.size;
        let scaled;
        let fitting = if picture.dimensions() == running.size {
            picture
        } else {
            let filter = imageops::FilterType::Triangle;
            scaled = imageops::resize(picture, width, height, filter);
            &scaled
        };
        let written = match &mut running.pixels {
            Some(pixels) => pixels.write_all(fitting.as_raw()),
            None => Ok(()),
        };
        if written.is_err() {
            // What the program says is better than "broken pipe".
            running.pixels = None;
            let words = running.program.end().unwrap_or_default();
            return Err(self.failed(&words));
        }
        Ok(())
    }

    fn start(&self, size: (u32, u32)) -> Result<Running> {
        let ending = self.path.extension().unwrap_or_default().to_string_lossy();
        let place = files::followed(&self.path)?;
        let file = files::temporary_beside(&place, &format!(".{ending}"))?.into_temp_path();
        let mut encode = command("ffmpeg", ["-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]);
        encode
            .args(["-s", &format!("{}x{}", size.0, size.1)])
            .args(["-r", &self.encoding.rate_hz.to_string()])
            .args(["-i", "pipe:0", "-an"])
            // The usual colour format, which every player shows, wants even sides.
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"])
            .args(["-pix_fmt", "yuv420p"]);
        if ending.eq_ignore_ascii_case("avi") {
            // The encoder's own choice is hardly watchable.
            encode.args(["-q:v", "3"]);
        }
        encode
            .arg(file_argument(&file))
            .stdin(Stdio::piped())
            .stdout(Stdio::null());
        let mut program = Program::start(encode, NEEDED_FOR)?;
        Ok(Running {
            pixels: program.child.stdin.take(),
            program,
            size,
            file,
        })
    }

    /// Ends the video and gives it its name; false where it has no pictures and so is not written.
    ///
    /// # Errors
    /// An encoder that fails, or a file that cannot be renamed.
    pub fn finish(mut self) -> Result<bool> {
        let Some(mut running) = self.running.take() else {
            return Ok(false);
        };
        running.pixels = None;
        let words = running.program.end();
        let is_written = std::fs::metadata(&running.file).is_ok_and(|file| file.len() > 0);
        if !is_written {
            return Err(self.failed(&words.unwrap_or_default()));
        }
        running
            .file
            .persist(files::followed(&self.path)?)
            .map_err(|failure| Error::io("write", &self.path)(failure.error))?;
        Ok(true)
    }

    fn failed(&self, words: &str) -> Error {
        Error::value(
            format!("video {}", self.path.display()),
            format!("cannot be written: ffmpeg says \"{words}\""),
            "free some space, or choose another kind of video or another folder",
        )
    }
}
