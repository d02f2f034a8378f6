//! Many stereo pairs, one after the other: from a source to files of results.
//!
//! A pair that cannot be read or measured is a result too, with its reason; the next one follows.

mod csv_file;
mod json_lines;
mod notes;
mod pictures;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use image::RgbImage;
use serde::{Deserialize, Serialize};

use crate::error::Result;
use crate::pipeline::{DetectedIn, Findings, StageTimes, StereoRanger, Unmatched, Vehicle};
use crate::progress::Progress;
use crate::ranging::PairDoubt;
use crate::sources::StereoFrame;

use notes::Notes;

pub use csv_file::CsvFile;
pub use json_lines::JsonLines;
pub use pictures::{AnnotatedVideo, PictureFolder, picture};

/// Failed frames whose reasons are kept in the summary; all of them are in the results.
const MOST_REASONS: usize = 1000;

/// What is said of one frame: a line of the JSON Lines.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// Its name.
    pub frame: String,
    /// Where its left image is from.
    pub left: String,
    /// Where its right image is from.
    pub right: String,
    /// Seconds since the beginning of a video.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_s: Option<f64>,
    /// What is in it; `{"error": reason}` where it could not be used.
    #[serde(flatten)]
    pub outcome: Outcome,
}

/// What became of a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "vehicles, or an error")]
pub enum Outcome {
    /// It was measured.
    Measured {
        /// Vehicles with a distance, nearest first.
        vehicles: Vec<Vehicle>,
        /// Vehicles without one, where they are asked for.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        without_distance: Vec<Unmatched>,
    },
    /// It could not be used.
    Failed {
        /// Why.
        error: String,
    },
}

impl Outcome {
    /// What was found, or why nothing could be.
    fn new(found: Result<Findings>) -> Self {
        match found {
            Ok(Findings {
                vehicles,
                unmatched,
                ..
            }) => Self::Measured {
                vehicles,
                without_distance: unmatched,
            },
            Err(error) => Self::Failed {
                error: error.to_string(),
            },
        }
    }

    /// The vehicles with a distance; none in a frame that failed.
    pub fn vehicles(&self) -> &[Vehicle] {
        match self {
            Self::Measured { vehicles, .. } => vehicles,
            Self::Failed { .. } => &[],
        }
    }

    /// The vehicles without a distance.
    pub fn without_distance(&self) -> &[Unmatched] {
        match self {
            Self::Measured {
                without_distance, ..
            } => without_distance,
            Self::Failed { .. } => &[],
        }
    }
}

/// Takes what is said of each frame, in order.
pub trait Sink {
    /// Takes a frame; its images are there unless it could not be read.
    ///
    /// # Errors
    /// What was to be written cannot be.
    fn take(&mut self, record: &FrameRecord, images: Option<[&RgbImage; 2]>) -> Result<()>;

    /// Everything has been taken, or no more will come: makes it last.
    ///
    /// # Errors
    /// What was written cannot be kept.
    fn finish(self: Box<Self>) -> Result<()>;
}

/// How a prediction went.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PredictSummary {
    /// Frames seen, with those that failed.
    pub frames: u64,
    /// Of these, could not be used.
    pub failed: u64,
    /// Of those that could, without any vehicle.
    pub empty: u64,
    /// Vehicles with a distance.
    pub vehicles: u64,
    /// Of these, detected in one image only.
    pub single_sided: u64,
    /// Vehicles without a distance.
    pub without_distance: u64,
    /// Names of the first failed frames, and why they did.
    pub reasons: Vec<(String, String)>,
    /// Reading and decoding, which goes on beside everything else.
    pub read: Duration,
    /// The pipeline's stages.
    pub stages: StageTimes,
    /// Writing of results.
    pub write: Duration,
    /// From beginning to end.
    pub elapsed: Duration,
    /// The user stopped it before the end.
    pub interrupted: bool,
}

impl PredictSummary {
    fn count(&mut self, record: &FrameRecord) {
        self.frames += 1;
        match &record.outcome {
            Outcome::Measured {
                vehicles,
                without_distance,
            } => {
                self.vehicles += vehicles.len() as u64;
                let is_single = |vehicle: &&Vehicle| vehicle.detected_in != DetectedIn::Both;
                self.single_sided += vehicles.iter().filter(is_single).count() as u64;
                self.without_distance += without_distance.len() as u64;
                self.empty += u64::from(vehicles.is_empty() && without_distance.is_empty());
            }
            Outcome::Failed { error } => {
                self.failed += 1;
                if self.reasons.len() < MOST_REASONS {
                    self.reasons.push((record.frame.clone(), error.clone()));
                }
            }
        }
    }
}

/// Measures frame after frame, `batch` at a time, and hands what is found to the sinks, in order.
///
/// Stops after the batch at hand when the user asks for it, and says so in the summary. Memory does
/// not grow with the number of frames. What is strange about the frames is noted once: sizes that
/// the rig has to be assumed for, both images the same, left and right that look exchanged.
///
/// # Errors
/// A sink that fails. What it and the others have taken is theirs to finish.
pub fn predict(
    ranger: &StereoRanger,
    frames: impl Iterator<Item = StereoFrame>,
    batch: usize,
    sinks: &mut [Box<dyn Sink>],
    progress: &dyn Progress,
) -> Result<PredictSummary> {
    let began = Instant::now();
    let mut summary = PredictSummary::default();
    let mut notes = Notes::default();
    let mut frames = frames.peekable();
    while frames.peek().is_some() {
        if progress.interrupted() {
            summary.interrupted = true;
            break;
        }
        let taken: Vec<StereoFrame> = frames.by_ref().take(batch.max(1)).collect();
        let count = taken.len() as u64;
        for images in taken.iter().filter_map(|frame| frame.images.as_ref().ok()) {
            notes.size(images[0].dimensions(), ranger, progress);
        }
        for (record, images, note) in measured(ranger, taken, &mut summary) {
            notes.frame(&record, note, progress);
            let images = images.as_ref().map(|[left, right]| [left, right]);
            summary.count(&record);
            let writing = Instant::now();
            for sink in sinks.iter_mut() {
                sink.take(&record, images)?;
            }
            summary.write += writing.elapsed();
        }
        progress.advance(count);
        progress.status(&format!(
            "{} vehicles, {} failed frames",
            summary.vehicles, summary.failed
        ));
    }
    notes.finish(progress);
    summary.elapsed = began.elapsed();
    Ok(summary)
}

/// What is said of each frame, its images and what is strange about them. Where a batch fails, its frames are tried one by one,
/// so that each answers for itself.
fn measured(
    ranger: &StereoRanger,
    frames: Vec<StereoFrame>,
    summary: &mut PredictSummary,
) -> Vec<(FrameRecord, Option<[RgbImage; 2]>, Option<PairDoubt>)> {
    let pairs: Vec<[&RgbImage; 2]> = frames
        .iter()
        .filter_map(|frame| frame.images.as_ref().ok())
        .map(|[left, right]| [left, right])
        .collect();
    let mut add = |times: StageTimes| {
        summary.stages.detect += times.detect;
        summary.stages.pair += times.pair;
        summary.stages.range += times.range;
    };
    let found: Vec<Result<Findings>> = match ranger.find(&pairs) {
        Ok((found, times)) => {
            add(times);
            found.into_iter().map(Ok).collect()
        }
        Err(error) if pairs.len() == 1 => vec![Err(error)],
        Err(_) => pairs
            .iter()
            .map(|pair| {
                let (mut found, times) = ranger.find(&[*pair])?;
                add(times);
                Ok(found.pop().unwrap_or_default())
            })
            .collect(),
    };
    let mut found = found.into_iter();
    let told = frames.into_iter().map(|frame| {
        summary.read += frame.read;
        let (images, findings) = match frame.images {
            Ok(images) => (
                Some(images),
                found.next().unwrap_or_else(|| Ok(Findings::default())),
            ),
            Err(reason) => (None, Err(reason)),
        };
        let note = findings.as_ref().ok().and_then(|found| found.note);
        let [left, right] = frame.origins;
        let record = FrameRecord {
            frame: frame.name,
            left,
            right,
            time_s: frame.time_s,
            outcome: Outcome::new(findings),
        };
        (record, images, note)
    });
    told.collect()
}

/// Where a file of a frame goes in a folder.
fn file_of(folder: &std::path::Path, frame: &str, ending: &str) -> PathBuf {
    folder.join(format!("{frame}.{ending}"))
}

#[cfg(test)]
mod tests;
