//! Reads a dataset folder: every usable frame, and the reason for every other one.
//!
//! Text files are read and checked here; images are only looked up. [`StereoDataset::check_images`]
//! decodes them all for those who want to know before a long training.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::frame::{Frame, FrameImage, Problem, Side};
use super::{DatasetInfo, FORMAT_VERSION, FrameRow, Label, Split, read_frames_csv};
use crate::error::{Error, Result};
use crate::files;
use crate::geometry::StereoRig;
use crate::imaging::has_image_ending;
use crate::progress::Progress;

/// Distances of one vehicle in different lines may differ by this much, metres, because they were
/// rounded to different decimals; more than that is a contradiction.
const DISTANCE_TOLERANCE_M: f64 = 0.01;

/// A dataset folder whose text files have been read.
#[derive(Debug, Clone, PartialEq)]
pub struct StereoDataset {
    /// The folder.
    pub folder: PathBuf,
    /// `dataset.toml`.
    pub info: DatasetInfo,
    /// The usable frames, by stamp.
    pub frames: Vec<Frame>,
    /// What had to be left out.
    pub problems: Vec<Problem>,
}

impl StereoDataset {
    /// Reads a dataset. Frames that cannot be used are skipped and stand in
    /// [`problems`](Self::problems).
    ///
    /// # Errors
    /// [`Error::Dataset`] or [`Error::Io`] when `dataset.toml`, `frames.csv` or the folder `frames`
    /// is missing or unreadable, or when no frame is usable.
    pub fn open(folder: impl AsRef<Path>) -> Result<Self> {
        let folder = folder.as_ref();
        let info = read_info(folder)?;
        let frames_csv = folder.join("frames.csv");
        if !frames_csv.exists() {
            return Err(Error::dataset(
                folder,
                "has no frames.csv",
                "write one row a frame, or generate the dataset again",
            ));
        }
        let (rows, mut problems) = read_frames_csv(&frames_csv)?;
        let listed = rows.len() + problems.len();
        if listed == 0 {
            return Err(Error::dataset(
                frames_csv,
                "lists no frames",
                "write one row a frame, or generate the dataset again",
            ));
        }
        let (rows, duplicates) = without_duplicates(rows);
        problems.extend(
            duplicates
                .iter()
                .map(|stamp| Problem::of_frame(*stamp, "has more than one row in frames.csv")),
        );
        let files = scan_frame_files(&folder.join("frames"))?;
        let known: BTreeSet<_> = rows.iter().map(|row| row.stamp).chain(duplicates).collect();
        let strangers: BTreeSet<_> = files
            .keys()
            .map(|(stamp, _)| *stamp)
            .filter(|stamp| !known.contains(stamp))
            .collect();
        // A row that cannot be read makes its own files look like strangers: one report is enough.
        if problems
            .iter()
            .all(|problem| !problem.subject.starts_with("frames.csv"))
        {
            problems.extend(
                strangers
                    .into_iter()
                    .map(|stamp| Problem::of_frame(stamp, "has files but no row in frames.csv")),
            );
        }
        let read: Vec<_> = rows
            .into_par_iter()
            .map(|row| read_frame(row, &files, &info))
            .collect();
        let mut frames = Vec::with_capacity(read.len());
        for outcome in read {
            match outcome {
                Ok(frame) => frames.push(frame),
                Err(problem) => problems.push(problem),
            }
        }
        let dataset = Self {
            folder: folder.to_path_buf(),
            info,
            frames,
            problems,
        };
        dataset.refuse_empty(listed)?;
        Ok(dataset)
    }

    /// The two cameras.
    pub fn rig(&self) -> &StereoRig {
        &self.info.rig
    }

    /// Class names; labels hold indices into them.
    pub fn classes(&self) -> &[String] {
        &self.info.classes
    }

    /// The frames of one split, by stamp.
    pub fn split(&self, split: Split) -> Vec<&Frame> {
        self.frames
            .iter()
            .filter(|frame| frame.row.split == split)
            .collect()
    }

    /// The frame with this stamp.
    pub fn frame(&self, stamp: u64) -> Option<&Frame> {
        let index = self
            .frames
            .binary_search_by_key(&stamp, |frame| frame.row.stamp)
            .ok()?;
        self.frames.get(index)
    }

    /// Decodes every image in parallel; frames whose images are broken or of another size than the
    /// rig's move to [`problems`](Self::problems).
    ///
    /// # Errors
    /// [`Error::Dataset`] when no frame is left, [`Error::Interrupted`] when the user stopped it.
    pub fn check_images(&mut self, progress: &dyn Progress) -> Result<()> {
        progress.begin("checking images", self.frames.len() as u64);
        let rig = self.info.rig;
        let outcomes: Vec<_> = self
            .frames
            .par_iter()
            .map(|frame| {
                if progress.interrupted() {
                    return None;
                }
                let outcome = frame
                    .images()
                    .try_for_each(|(side, image)| image.load(rig.camera(side)).map(|_| ()))
                    .map_err(|error| error.to_string());
                progress.advance(1);
                Some(outcome)
            })
            .collect();
        progress.end();
        let total = self.frames.len();
        let mut usable = Vec::with_capacity(total);
        for (frame, outcome) in std::mem::take(&mut self.frames).into_iter().zip(outcomes) {
            match outcome {
                Some(Ok(())) => usable.push(frame),
                Some(Err(reason)) => self
                    .problems
                    .push(Problem::of_frame(frame.row.stamp, reason)),
                None => {
                    return Err(Error::Interrupted {
                        resume: "run the same command again".to_owned(),
                    });
                }
            }
        }
        self.frames = usable;
        self.refuse_empty(total)
    }

    /// Fails when no frame is left of those that were listed.
    fn refuse_empty(&self, listed: usize) -> Result<()> {
        if !self.frames.is_empty() {
            return Ok(());
        }
        Err(Error::dataset(
            &self.folder,
            format!(
                "none of its {listed} frames is usable: {}",
                Problem::summary(&self.problems)
            ),
            "repair the files that are named, or generate the dataset again",
        ))
    }
}

/// Reads and checks `dataset.toml`.
fn read_info(folder: &Path) -> Result<DatasetInfo> {
    if !folder.is_dir() {
        return Err(Error::dataset(folder, "is no folder", "check the path"));
    }
    let path = folder.join("dataset.toml");
    if !path.exists() {
        return Err(Error::dataset(
            folder,
            "has no dataset.toml",
            "give the folder that holds dataset.toml and frames.csv",
        ));
    }
    let text = files::read_text(&path)?;
    let unreadable = |error: &toml::de::Error| {
        let line = error
            .span()
            .and_then(|span| text.get(..span.start))
            .map_or(1, |before| 1 + before.matches('\n').count());
        Error::dataset(
            &path,
            format!("line {line}: {}", error.message()),
            "correct it; it needs version, classes, label_kinds and [rig]",
        )
    };
    // The version first: another version may have other keys.
    let table: toml::Table = text.parse().map_err(|error| unreadable(&error))?;
    match table.get("version") {
        Some(toml::Value::Integer(version)) if *version == i64::from(FORMAT_VERSION) => {}
        found => {
            let problem = match found {
                Some(version) => format!("has version = {version}, not {FORMAT_VERSION}"),
                None => "has no version".to_owned(),
            };
            return Err(Error::dataset(
                &path,
                problem,
                format!("convert the dataset to version {FORMAT_VERSION}"),
            ));
        }
    }
    let info = DatasetInfo::from_toml(&text).map_err(|error| unreadable(&error))?;
    for (empty, key) in [
        (info.classes.is_empty(), "classes"),
        (info.label_kinds.is_empty(), "label_kinds"),
    ] {
        if empty {
            return Err(Error::dataset(
                &path,
                format!("{key} is empty"),
                "name at least one",
            ));
        }
    }
    Ok(info)
}

/// The rows by stamp, and the stamps that occur more than once.
///
/// None of a stamp's rows is kept then: they may put the same images into two splits.
fn without_duplicates(mut rows: Vec<FrameRow>) -> (Vec<FrameRow>, BTreeSet<u64>) {
    rows.sort_by_key(|row| row.stamp);
    let duplicates: BTreeSet<_> = rows
        .windows(2)
        .filter(|pair| pair[0].stamp == pair[1].stamp)
        .map(|pair| pair[0].stamp)
        .collect();
    rows.retain(|row| !duplicates.contains(&row.stamp));
    (rows, duplicates)
}

/// The files of one side of one frame.
#[derive(Debug, Default)]
struct SideFiles {
    images: Vec<PathBuf>,
    labels: Vec<PathBuf>,
}

type FrameFiles = BTreeMap<(u64, Side), SideFiles>;

/// Looks up all images and label files by stamp and side; other files are no concern of ours.
fn scan_frame_files(folder: &Path) -> Result<FrameFiles> {
    let entries = fs::read_dir(folder).map_err(Error::io("read", folder))?;
    let mut files = FrameFiles::new();
    for entry in entries {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let Some((stamp, side)) = stamp_and_side(&path) else {
            continue;
        };
        let extension = path
            .extension()
            .and_then(|extension| extension.to_str())
            .unwrap_or_default();
        let is_text = extension.eq_ignore_ascii_case("txt");
        if has_image_ending(&path) {
            files.entry((stamp, side)).or_default().images.push(path);
        } else if is_text {
            files.entry((stamp, side)).or_default().labels.push(path);
        }
    }
    for found in files.values_mut() {
        found.images.sort();
        found.labels.sort();
    }
    Ok(files)
}

/// Reads `left_00042` as stamp 42, left; any number of digits is fine.
fn stamp_and_side(path: &Path) -> Option<(u64, Side)> {
    let (word, digits) = path.file_stem()?.to_str()?.split_once('_')?;
    let side = Side::ALL.into_iter().find(|side| side.word() == word)?;
    let is_number = digits.bytes().all(|byte| byte.is_ascii_digit());
    Some((is_number.then_some(digits)?.parse().ok()?, side))
}

/// Reads one frame's labels and checks that they agree; all reasons against it at once.
fn read_frame(row: FrameRow, files: &FrameFiles, info: &DatasetInfo) -> Result<Frame, Problem> {
    let mut reasons = Vec::new();
    let mut side = |side: Side| {
        read_side(side, files.get(&(row.stamp, side)), info)
            .map_err(|mut found| reasons.append(&mut found))
    };
    let left = side(Side::Left);
    let right = if info.stereo {
        side(Side::Right).map(Some)
    } else {
        Ok(None)
    };
    if let (Ok(left), Ok(right)) = (left, right) {
        let right_labels = right.as_ref().map_or(&[][..], |right| &right.labels);
        reasons.extend(contradictions(&left.labels, right_labels));
        if reasons.is_empty() {
            return Ok(Frame { row, left, right });
        }
    }
    Err(Problem::of_frame(row.stamp, reasons.join("; ")))
}

/// The one image and the labels of one side, or all reasons against it.
fn read_side(
    side: Side,
    found: Option<&SideFiles>,
    info: &DatasetInfo,
) -> Result<FrameImage, Vec<String>> {
    let none = SideFiles::default();
    let found = found.unwrap_or(&none);
    let mut reasons = Vec::new();
    let mut single = |paths: &[PathBuf], what: &str| match paths {
        [path] => Some(path.clone()),
        [] => {
            reasons.push(format!("the {side} {what} is missing"));
            None
        }
        several => {
            let names = several
                .iter()
                .map(|path| file_name(path))
                .collect::<Vec<_>>();
            reasons.push(format!("has several {side} {what}s: {}", names.join(", ")));
            None
        }
    };
    let image = single(&found.images, "image");
    let label = single(&found.labels, "label file");
    let (Some(path), Some(label_path)) = (image, label) else {
        return Err(reasons);
    };
    let labels = read_labels(&label_path, info)?;
    Ok(FrameImage { path, labels })
}

/// Reads a label file, or gives every reason against it.
fn read_labels(path: &Path, info: &DatasetInfo) -> Result<Vec<Label>, Vec<String>> {
    let name = file_name(path);
    let text = fs::read_to_string(path)
        .map_err(|error| vec![format!("{name} cannot be read: {error}")])?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    let mut labels: Vec<Label> = Vec::new();
    let mut reasons = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let parsed = Label::parse_line(line).and_then(|label| match label {
            Some(label) => check_label(&label, &labels, info).map(|()| Some(label)),
            None => Ok(None),
        });
        match parsed {
            Ok(Some(label)) => labels.push(label),
            Ok(None) => {}
            Err(reason) => reasons.push(format!("{name} line {}: {reason}", index + 1)),
        }
    }
    if reasons.is_empty() {
        Ok(labels)
    } else {
        Err(reasons)
    }
}

/// Checks a label against the dataset and the labels before it.
fn check_label(label: &Label, before: &[Label], info: &DatasetInfo) -> Result<(), String> {
    let id = label.id;
    let classes = info.classes.len();
    if label.class as usize >= classes {
        return Err(format!(
            "vehicle {id}: class {} but dataset.toml has {classes}",
            label.class
        ));
    }
    let (width, height) = (info.rig.left.width, info.rig.left.height);
    if !label
        .box_pixel
        .clipped(f64::from(width), f64::from(height))
        .is_valid()
    {
        return Err(format!(
            "vehicle {id}: the box lies wholly outside the {width}x{height} image"
        ));
    }
    if before
        .iter()
        .any(|other| other.id == id && other.kind == label.kind)
    {
        return Err(format!("vehicle {id} has two {} labels", label.kind));
    }
    Ok(())
}

/// What the labels of a frame say against each other: one vehicle has one class and one distance.
fn contradictions(left: &[Label], right: &[Label]) -> Vec<String> {
    let mut first: BTreeMap<u32, &Label> = BTreeMap::new();
    let mut reasons = Vec::new();
    for label in left.iter().chain(right) {
        let id = label.id;
        let known = *first.entry(id).or_insert(label);
        if known.class != label.class {
            reasons.push(format!(
                "vehicle {id} has classes {} and {}",
                known.class, label.class
            ));
        }
        if let (Some(one_m), Some(other_m)) = (known.distance_m, label.distance_m)
            && (one_m - other_m).abs() > DISTANCE_TOLERANCE_M
        {
            reasons.push(format!(
                "vehicle {id} has distances {one_m} m and {other_m} m"
            ));
        }
    }
    reasons.sort();
    reasons.dedup();
    reasons
}

/// A path's last part, for messages.
fn file_name(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

#[cfg(test)]
mod tests;
