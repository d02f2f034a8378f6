//! Frames from videos: one a side, or one that shows both.

use std::path::{Path, PathBuf};
use std::time::Instant;

use image::RgbImage;

use super::StereoFrame;
use super::ffmpeg::{Decoder, Ending, VideoInfo, probe};
use super::layout::Layout;
use crate::error::{Error, Result};

/// Endings of videos.
const ENDINGS: [&str; 16] = [
    "mp4", "mkv", "mov", "avi", "webm", "m4v", "mpg", "mpeg", "ts", "m2ts", "mts", "wmv", "flv",
    "ogv", "mjpeg", "y4m",
];

/// Two videos of one rig have the same rate, but for rounding and lost frames.
const RATE_SLACK: f64 = 0.05;

/// Digits of a frame's number.
const DIGITS: usize = 6;

/// Whether a file's name is that of a video.
pub(super) fn is_video(path: &Path) -> bool {
    let ending = path.extension().and_then(|ending| ending.to_str());
    ending.is_some_and(|ending| {
        ENDINGS
            .iter()
            .any(|known| known.eq_ignore_ascii_case(ending))
    })
}

/// Frames of one or two videos. How they end badly is the last item.
#[derive(Debug)]
pub(super) struct VideoFrames {
    paths: Vec<PathBuf>,
    infos: Vec<VideoInfo>,
    layout: Option<Layout>,
    decoders: Vec<Decoder>,
    next: u64,
    is_over: bool,
}

impl VideoFrames {
    /// A left and a right video.
    pub fn pair(paths: [&Path; 2]) -> Result<Self> {
        let infos = [probe(paths[0])?, probe(paths[1])?];
        let refuse = |what: &str, a: String, b: String| {
            Err(Error::value(
                format!("videos {} and {}", paths[0].display(), paths[1].display()),
                format!("have {what} of {a} and {b}"),
                "give the two recordings of one rig, converted alike",
            ))
        };
        let [left, right] = infos;
        if left.size != right.size {
            let shown = |[width, height]: [u32; 2]| format!("{width}x{height} pixels");
            return refuse("frames", shown(left.size), shown(right.size));
        }
        if let (Some(a), Some(b)) = (left.rate_hz, right.rate_hz)
            && (a - b).abs() > RATE_SLACK * a.max(b)
        {
            return refuse(
                "rates",
                format!("{a:.2}"),
                format!("{b:.2} frames a second"),
            );
        }
        Ok(Self::new(&paths, &infos, None))
    }

    /// A video of pictures that show both sides.
    pub fn stacked(path: &Path, layout: Layout) -> Result<Self> {
        let info = probe(path)?;
        // Refused before the work where it cannot be divided.
        let [width, height] = info.size;
        layout.split(&RgbImage::new(width, height), &path.display().to_string())?;
        Ok(Self::new(&[path], &[info], Some(layout)))
    }

    fn new(paths: &[&Path], infos: &[VideoInfo], layout: Option<Layout>) -> Self {
        Self {
            paths: paths.iter().map(|path| path.to_path_buf()).collect(),
            infos: infos.to_vec(),
            layout,
            decoders: Vec::new(),
            next: 0,
            is_over: false,
        }
    }

    /// How many frames there will be, as far as the headers say.
    pub fn expected(&self) -> Option<u64> {
        self.infos.iter().filter_map(|info| info.frames).min()
    }

    /// Frames a second.
    pub fn rate_hz(&self) -> Option<f64> {
        self.infos.first()?.rate_hz
    }

    /// The next pair; None at a good end.
    fn read(&mut self) -> Result<Option<[RgbImage; 2]>> {
        if self.decoders.is_empty() {
            for (path, info) in self.paths.iter().zip(&self.infos) {
                self.decoders.push(Decoder::start(path, *info)?);
            }
        }
        let taken: Vec<Result<RgbImage, Ending>> =
            self.decoders.iter_mut().map(Decoder::next).collect();
        let count = self.next;
        let shown = |i: usize| self.decoders[i].path().display().to_string();
        let broken = taken.iter().enumerate().find_map(|(i, taken)| match taken {
            Err(Ending::Broken(reason)) => Some((i, reason)),
            _ => None,
        });
        if let Some((i, reason)) = broken {
            return Err(Error::value(
                format!("video {}", shown(i)),
                format!("ends after {count} frames or is damaged: {reason}"),
                "what was read before is kept; copy or record it again for the rest",
            ));
        }
        let mut images = taken.into_iter().map(Result::ok);
        match (
            self.layout,
            images.next().flatten(),
            images.next().flatten(),
        ) {
            (Some(layout), Some(picture), _) => layout.split(&picture, &shown(0)).map(Some),
            (None, Some(left), Some(right)) => Ok(Some([left, right])),
            (Some(_), None, _) | (None, None, None) => Ok(None),
            (None, left, _) => {
                let (short, long) = if left.is_some() { (1, 0) } else { (0, 1) };
                Err(Error::value(
                    format!("video {}", shown(short)),
                    format!("ends after {count} frames, but {} goes on", shown(long)),
                    "pairs are kept as far as both go; cut both videos to the same beginning and \
                     end if they drift apart",
                ))
            }
        }
    }
}

impl Iterator for VideoFrames {
    type Item = StereoFrame;

    fn next(&mut self) -> Option<StereoFrame> {
        if self.is_over {
            return None;
        }
        let began = Instant::now();
        let images = self.read().transpose();
        if !matches!(images, Some(Ok(_))) {
            self.is_over = true;
            // Ends the programs too.
            self.decoders.clear();
        }
        let images = images?;
        let index = self.next;
        self.next += 1;
        let origin = |i: usize| {
            let path = self.paths.get(i).or_else(|| self.paths.first());
            path.map_or_else(String::new, |path| path.display().to_string())
        };
        Some(StereoFrame {
            index,
            name: format!("{index:0DIGITS$}"),
            origins: [origin(0), origin(1)],
            time_s: self.rate_hz().map(|rate_hz| index as f64 / rate_hz),
            images,
            read: began.elapsed(),
        })
    }
}
