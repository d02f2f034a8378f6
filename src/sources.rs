//! Where stereo pairs come from: files, folders, sequences, videos.
//!
//! [`FrameSource::open`] finds out what was given; [`FrameSource::read_ahead`] reads it on a thread
//! of its own, in order, a few frames before they are needed and never more. A frame that cannot be
//! read is an item like any other and says why; the next one follows.
//!
//! ```
//! use twinsight::imaging::save_png;
//! use twinsight::sources::FrameSource;
//!
//! # fn main() -> twinsight::Result<()> {
//! # let folder = tempfile::tempdir().map_err(twinsight::Error::io("create folder", "example"))?;
//! # let folder = folder.path();
//! for name in ["left_00007.png", "right_00007.png", "left_00008.png"] {
//!     save_png(folder.join(name), &image::RgbImage::new(64, 36))?;
//! }
//! let source = FrameSource::open(&[folder], None)?;
//! assert_eq!(source.len(), Some(2));
//! let frames: Vec<_> = source.read_ahead(2)?.collect();
//! assert_eq!(frames[0].name, "00007");
//! assert!(frames[0].images.is_ok());
//! // The right image is missing.
//! assert!(frames[1].images.is_err());
//! # Ok(())
//! # }
//! ```

mod ffmpeg;
mod files;
mod folder;
mod layout;
mod names;
mod sequence;
mod video;

use std::collections::BTreeSet;
use std::panic;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use image::RgbImage;

use crate::error::{Error, Result};

pub use ffmpeg::{VideoEncoding, VideoWriter};
pub use layout::Layout;

/// A stereo pair, or why there is none.
#[derive(Debug)]
pub struct StereoFrame {
    /// Its place in the source, from 0.
    pub index: u64,
    /// What it is called: the part of its files' names that both have in common, or its number in a
    /// video.
    pub name: String,
    /// Where the left and the right image are from; the same twice for a picture of both.
    pub origins: [String; 2],
    /// Seconds since the beginning of a video, at its mean rate.
    pub time_s: Option<f64>,
    /// Left and right image, of equal size.
    pub images: Result<[RgbImage; 2]>,
    /// How long reading and decoding took.
    pub read: Duration,
}

/// Something that stereo pairs can be read from.
pub struct FrameSource {
    frames: Box<dyn Iterator<Item = StereoFrame> + Send>,
    len: Option<u64>,
    is_single: bool,
    rate_hz: Option<f64>,
    folders: Vec<PathBuf>,
    skipped: Vec<PathBuf>,
}

impl std::fmt::Debug for FrameSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FrameSource")
            .field("len", &self.len)
            .field("is_single", &self.is_single)
            .field("rate_hz", &self.rate_hz)
            .finish_non_exhaustive()
    }
}

impl FrameSource {
    /// Finds out what was given: two images, two folders, two patterns of numbered files such as
    /// `left_%05d.png`, or two videos; or one folder of both sides; or, with a layout, one image,
    /// folder, pattern or video of pictures that show both sides.
    ///
    /// Images are not read yet; videos are looked at.
    ///
    /// # Errors
    /// Nothing there, nothing that belongs together, or a video without the program `ffmpeg`. Files
    /// that lack their partner are no error here, but one of the frame.
    pub fn open(inputs: &[impl AsRef<Path>], layout: Option<Layout>) -> Result<Self> {
        let inputs: Vec<&Path> = inputs.iter().map(AsRef::as_ref).collect();
        match (&inputs[..], layout) {
            ([left, right], None) => Self::of_two(left, right),
            ([both], Some(layout)) => Self::of_one(both, layout),
            ([folder], None) if folder.is_dir() => {
                Ok(Self::of_folders(folder::both_sides(folder)?))
            }
            ([alone], None) => {
                check_exists(alone)?;
                Err(Error::value(
                    alone.display().to_string(),
                    "is one file, and a pair has two",
                    "give the right one too, or --layout side-by-side or top-bottom if it shows \
                     both",
                ))
            }
            ([_, _], Some(layout)) => Err(Error::value(
                format!("layout {layout}"),
                "is for one input that shows both sides, but two were given",
                "leave the layout out, or give one input",
            )),
            (inputs, _) => Err(Error::value(
                format!("{} inputs", inputs.len()),
                "are not one or two",
                "give a left and a right one, or one that holds both sides",
            )),
        }
    }

    fn of_two(left: &Path, right: &Path) -> Result<Self> {
        let inputs = [left, right];
        if sequence::is_pattern(left) && sequence::is_pattern(right) {
            return Ok(Self::of_files(sequence::pairs(inputs)?));
        }
        if inputs.iter().all(|input| input.is_dir()) {
            return Ok(Self::of_folders(folder::two(inputs)?));
        }
        for (input, other) in [(left, right), (right, left)] {
            if input.is_dir() || (sequence::is_pattern(input) && !sequence::is_pattern(other)) {
                check_exists(other)?;
                return Err(Error::value(
                    format!("{} and {}", left.display(), right.display()),
                    "are of different kinds",
                    "give two images, two folders, two patterns or two videos",
                ));
            }
        }
        match inputs.map(video::is_video) {
            [false, false] => {
                let name = names::pair_name(inputs);
                Ok(Self {
                    is_single: true,
                    ..Self::of_files(vec![files::Entry::pair(name, inputs)])
                })
            }
            [true, true] => Ok(Self::of_videos(video::VideoFrames::pair(inputs)?)),
            _ => Err(Error::value(
                format!("{} and {}", left.display(), right.display()),
                "are a video and an image",
                "give two images or two videos",
            )),
        }
    }

    fn of_one(both: &Path, layout: Layout) -> Result<Self> {
        if sequence::is_pattern(both) {
            return Ok(Self::of_files(sequence::stacked(both, layout)?));
        }
        if both.is_dir() {
            return Ok(Self::of_folders(folder::stacked(both, layout)?));
        }
        if video::is_video(both) {
            let frames = video::VideoFrames::stacked(both, layout)?;
            return Ok(Self::of_videos(frames));
        }
        let name = names::stem(both);
        Ok(Self {
            is_single: true,
            ..Self::of_files(vec![files::Entry::stacked(name, both, layout)])
        })
    }

    fn of_folders(found: folder::Found) -> Self {
        Self {
            skipped: found.skipped,
            ..Self::of_files(found.entries)
        }
    }

    fn of_files(entries: Vec<files::Entry>) -> Self {
        let files = entries.iter().flat_map(files::Entry::files);
        let folders: BTreeSet<&Path> = files.filter_map(Path::parent).collect();
        Self {
            folders: folders.into_iter().map(Path::to_path_buf).collect(),
            len: Some(entries.len() as u64),
            frames: Box::new(files::frames(entries)),
            is_single: false,
            rate_hz: None,
            skipped: Vec::new(),
        }
    }

    fn of_videos(frames: video::VideoFrames) -> Self {
        Self {
            len: frames.expected(),
            rate_hz: frames.rate_hz(),
            is_single: false,
            folders: Vec::new(),
            skipped: Vec::new(),
            frames: Box::new(frames),
        }
    }

    /// How many frames there are; an estimate for videos, None where they do not say.
    pub fn len(&self) -> Option<u64> {
        self.len
    }

    /// Whether it is known to have no frames.
    pub fn is_empty(&self) -> bool {
        self.len == Some(0)
    }

    /// Whether it is one pair that was named by its files, rather than a series of them.
    pub fn is_single(&self) -> bool {
        self.is_single
    }

    /// The folders that images are read from; the empty path is the current one.
    pub fn folders(&self) -> &[PathBuf] {
        &self.folders
    }

    /// Files in those folders that may have been meant as images but are none that can be read:
    /// pictures of other kinds, not texts.
    pub fn skipped(&self) -> &[PathBuf] {
        &self.skipped
    }

    /// Frames a second, of videos.
    pub fn rate_hz(&self) -> Option<f64> {
        self.rate_hz
    }

    /// Starts to read: at most `ahead` frames, at least one, wait to be taken.
    ///
    /// # Errors
    /// A system that starts no thread.
    pub fn read_ahead(self, ahead: usize) -> Result<Frames> {
        let (sender, receiver) = sync_channel(ahead.max(1) - 1);
        let frames = self.frames;
        let reader = thread::Builder::new()
            .name("twinsight-reader".to_owned())
            .spawn(move || {
                for frame in frames {
                    // Nobody wants more.
                    if sender.send(frame).is_err() {
                        break;
                    }
                }
            })
            .map_err(Error::io("start", "a reading thread"))?;
        Ok(Frames {
            receiver: Some(receiver),
            reader: Some(reader),
        })
    }
}

/// Frames that a thread reads before they are needed; it ends when this is dropped.
#[derive(Debug)]
pub struct Frames {
    receiver: Option<Receiver<StereoFrame>>,
    reader: Option<JoinHandle<()>>,
}

impl Iterator for Frames {
    type Item = StereoFrame;

    fn next(&mut self) -> Option<StereoFrame> {
        let frame = self.receiver.as_ref()?.recv().ok();
        if frame.is_none() {
            self.receiver = None;
            // A reader that panicked must not look like the end.
            if let Some(Err(defect)) = self.reader.take().map(JoinHandle::join) {
                panic::resume_unwind(defect);
            }
        }
        frame
    }
}

impl Drop for Frames {
    fn drop(&mut self) {
        self.receiver = None;
        if let Some(reader) = self.reader.take() {
            // What it has to say is no longer asked for; programs that it started are ended.
            reader.join().ok();
        }
    }
}

/// Refuses a path where nothing is.
fn check_exists(path: &Path) -> Result<()> {
    std::fs::metadata(path)
        .map(|_| ())
        .map_err(Error::io("read", path))
}

#[cfg(test)]
mod tests;
