//! A video as frames of RGB pixels.

use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::process::{ChildStdout, Command, Stdio};

use image::RgbImage;
use serde::Deserialize;

use super::{PROTOCOLS, Program, command, file_argument, first_line, not_started, passthrough};
use crate::error::{Error, Result};
use crate::imaging::MAX_SIDE_PX;

/// The largest frame, bytes: as of images.
const MAX_FRAME_BYTES: u64 = 1 << 30;

/// What the programs are needed for.
const NEEDED_FOR: &str = "reading a video";

/// This share of the frames that a header promises may be missing: counts of some containers are
/// estimates, and edit lists hide a few frames.
const MISSING: f64 = 0.05;

/// What `ffprobe` says of a video.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::sources) struct VideoInfo {
    /// Width and height of a frame as it is shown, pixels.
    pub size: [u32; 2],
    /// Mean frames a second.
    pub rate_hz: Option<f64>,
    /// Frames, by its header.
    pub frames: Option<u64>,
}

/// The JSON of `ffprobe`.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Probed {
    streams: Vec<ProbedStream>,
    format: ProbedFormat,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct ProbedStream {
    width: u32,
    height: u32,
    avg_frame_rate: String,
    nb_frames: String,
    duration: String,
    side_data_list: Vec<ProbedSide>,
    tags: ProbedTags,
}

/// What a stream says beside its pictures; only rotations matter here.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct ProbedSide {
    /// Degrees, against the clock.
    rotation: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct ProbedTags {
    /// Degrees, of versions before 5.0.
    rotate: String,
}

impl ProbedStream {
    /// Whether players turn the pictures on their side.
    fn is_on_its_side(&self) -> bool {
        let side = self.side_data_list.iter().find_map(|side| side.rotation);
        let degrees = side.or_else(|| self.tags.rotate.parse().ok());
        // As exactly as the program itself asks before it turns by a quarter.
        degrees.is_some_and(|degrees: f64| (degrees.rem_euclid(180.0) - 90.0).abs() < 1.0)
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct ProbedFormat {
    duration: String,
}

/// Looks at a video.
pub(in crate::sources) fn probe(path: &Path) -> Result<VideoInfo> {
    std::fs::File::open(path).map_err(Error::io("read", path))?;
    let entries = "stream=width,height,avg_frame_rate,nb_frames,duration:\
                   stream_side_data=rotation:stream_tags=rotate:format=duration";
    let mut probe = command("ffprobe", ["-protocol_whitelist", PROTOCOLS]);
    probe
        .args(["-select_streams", "v:0", "-show_entries", entries])
        .args(["-of", "json", "-i"])
        .arg(file_argument(path))
        .stdin(Stdio::null());
    let output = probe
        .output()
        .map_err(|error| not_started(&probe, NEEDED_FOR, error))?;
    let unusable = |problem: String| {
        Error::value(
            format!("video {}", path.display()),
            problem,
            "copy or record it again, or convert it to a folder of PNG images",
        )
    };
    if !output.status.success() {
        let words = first_line(&String::from_utf8_lossy(&output.stderr));
        return Err(unusable(format!("cannot be read: {words}")));
    }
    let probed: Probed = serde_json::from_slice(&output.stdout)
        .map_err(|error| unusable(format!("cannot be read: ffprobe says {error}")))?;
    let Some(stream) = probed.streams.first() else {
        return Err(unusable("has no pictures".to_owned()));
    };
    let [width, height] = [stream.width, stream.height];
    let size = if stream.is_on_its_side() {
        [height, width]
    } else {
        [width, height]
    };
    let bytes = 3 * u64::from(width) * u64::from(height);
    if width == 0 || height == 0 || width.max(height) > MAX_SIDE_PX || bytes > MAX_FRAME_BYTES {
        return Err(unusable(format!("has frames of {width}x{height} pixels")));
    }
    let positive = |text: &str| {
        text.parse::<f64>()
            .ok()
            .filter(|v| v.is_finite() && *v > 0.0)
    };
    let rate_hz = stream.avg_frame_rate.split_once('/').and_then(|(a, b)| {
        let rate = positive(a)? / positive(b)?;
        rate.is_finite().then_some(rate)
    });
    let duration = positive(&stream.duration).or_else(|| positive(&probed.format.duration));
    let counted = stream.nb_frames.parse::<u64>().ok().filter(|&n| n > 0);
    let estimated = || Some((duration? * rate_hz?).round() as u64);
    Ok(VideoInfo {
        size,
        rate_hz,
        frames: counted.or_else(estimated),
    })
}

/// How a video ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::sources) enum Ending {
    /// After all of its frames.
    Complete,
    /// Earlier, or with errors, for this reason.
    Broken(String),
}

/// A video that is being decoded, frame by frame.
#[derive(Debug)]
pub(in crate::sources) struct Decoder {
    path: PathBuf,
    info: VideoInfo,
    program: Program,
    pixels: ChildStdout,
    taken: u64,
}

impl Decoder {
    pub fn start(path: &Path, info: VideoInfo) -> Result<Self> {
        let [width, height] = info.size;
        let mut decode: Command = command("ffmpeg", ["-nostdin", "-protocol_whitelist", PROTOCOLS]);
        decode
            // Frames come turned as players show them, like images with a note: the program's way
            // unless it is told otherwise.
            .arg("-i")
            .arg(file_argument(path))
            .args(["-map", "0:v:0"])
            .args(passthrough(NEEDED_FOR)?)
            // Frames stay as large as the first one, whatever comes.
            .args(["-s", &format!("{width}x{height}")])
            .args(["-f", "rawvideo", "-pix_fmt", "rgb24", "pipe:1"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped());
        let mut program = Program::start(decode, NEEDED_FOR)?;
        let Some(pixels) = program.child.stdout.take() else {
            return Err(Error::io("read", path)(io::ErrorKind::BrokenPipe.into()));
        };
        Ok(Self {
            path: path.to_path_buf(),
            info,
            program,
            pixels,
            taken: 0,
        })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The next frame, or how the video ended.
    pub fn next(&mut self) -> Result<RgbImage, Ending> {
        let [width, height] = self.info.size;
        let mut pixels = vec![0; 3 * width as usize * height as usize];
        let mut filled = 0;
        while filled < pixels.len() {
            match self.pixels.read(&mut pixels[filled..]) {
                Ok(0) => return Err(self.ending(filled)),
                Ok(count) => filled += count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(Ending::Broken(error.to_string())),
            }
        }
        self.taken += 1;
        RgbImage::from_raw(width, height, pixels)
            .ok_or_else(|| Ending::Broken("a frame of another size".to_owned()))
    }

    /// How it ended, with some bytes of another frame.
    fn ending(&mut self, bytes: usize) -> Ending {
        let words = self.program.end();
        let promised = self.info.frames.unwrap_or(0);
        let is_short = (self.taken as f64) < (promised as f64 * (1.0 - MISSING)).floor() - 2.0;
        let reason = match words {
            Some(words) => words,
            None if bytes > 0 => "the last frame is incomplete".to_owned(),
            None if is_short => format!("its header promises {promised} frames"),
            None if self.taken == 0 => "it has no frames".to_owned(),
            None => return Ending::Complete,
        };
        Ending::Broken(reason)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_turn_is_known_by_the_words_of_old_and_new_versions() {
        for (stream, is_on_its_side) in [
            (r#"{"side_data_list": [{"rotation": -90}]}"#, true),
            (r#"{"side_data_list": [{}, {"rotation": 270}]}"#, true),
            (r#"{"side_data_list": [{"rotation": -180}]}"#, false),
            (r#"{"side_data_list": [{"rotation": 0}]}"#, false),
            (r#"{"side_data_list": [{"rotation": 44.5}]}"#, false),
            (r#"{"tags": {"rotate": "90"}}"#, true),
            (r#"{"tags": {"rotate": "180"}}"#, false),
            (r#"{"tags": {"rotate": "no"}}"#, false),
            (
                r#"{"tags": {"rotate": "90"}, "side_data_list": [{"rotation": 0}]}"#,
                false,
            ),
            ("{}", false),
        ] {
            let stream: ProbedStream = serde_json::from_str(stream).unwrap();
            assert_eq!(stream.is_on_its_side(), is_on_its_side, "{stream:?}");
        }
    }
}
