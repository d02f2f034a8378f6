//! A dataset that has been read from foreign files and waits to be written.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use super::classes::ClassMap;
use super::copy;
use super::report::ImportReport;
use super::splits::{self, SplitSettings};
use crate::dataset::{
    BoxKind, DatasetInfo, FORMAT_VERSION, FrameRow, Label, ObjectRow, Problem, Side, Split,
    SplitCounts, label_file_text, stamp_name, write_frames_csv, write_objects_csv,
};
use crate::error::{Error, Result};
use crate::files;
use crate::geometry::StereoRig;
use crate::progress::{Progress, in_parallel};

/// Holds what is being imported while frames are missing.
const MARKER: &str = "importing.toml";

/// Where an import goes, and what all formats have in common.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportTarget {
    /// Folder of the dataset; created where it is missing.
    pub out: PathBuf,
    /// The classes that are wanted; none takes the format's own default.
    pub classes: Option<ClassMap>,
    /// How frames are divided.
    pub splits: SplitSettings,
}

/// One frame with its labels, its images still in the foreign folder.
#[derive(Debug, Clone)]
pub(super) struct DraftFrame {
    /// What the source calls it.
    pub name: String,
    /// The left image, and the right one where there is one.
    pub images: Vec<PathBuf>,
    /// Labels of each image.
    pub labels: Vec<Vec<Label>>,
    /// Sizes and places of its vehicles, where they are known; their stamp is the frame's.
    pub objects: Vec<ObjectRow>,
    /// The split that the source gives it.
    pub split: Option<Split>,
    /// Its row of `frames.csv`; the split in it is not decided yet.
    pub row: FrameRow,
    /// Whether labels count in the images' pixels as they are stored, not as they are shown.
    pub stored: bool,
}

impl DraftFrame {
    /// A frame of which nothing is known but its images and labels.
    pub fn new(name: String, stamp: u64, images: Vec<PathBuf>, labels: Vec<Vec<Label>>) -> Self {
        Self {
            name,
            images,
            labels,
            objects: Vec::new(),
            split: None,
            row: FrameRow {
                stamp,
                split: Split::Train,
                scene: None,
                sun: None,
                view: None,
                azimuth_deg: None,
                elevation_deg: None,
                distance_m: None,
            },
            stored: false,
        }
    }

    /// What a table may call the frame.
    pub fn names(&self) -> Vec<String> {
        let of_path = |path: &PathBuf| {
            let part = |part: Option<&std::ffi::OsStr>| {
                part.map(|name| name.to_string_lossy().into_owned())
            };
            [part(path.file_name()), part(path.file_stem())]
        };
        let files = self.images.first().map(of_path).into_iter().flatten();
        std::iter::once(self.name.clone())
            .chain(files.flatten())
            .collect()
    }
}

/// Stamps for frames of these names: the numbers that the names are, or else their places.
pub(super) fn stamps(names: &[String]) -> Vec<u64> {
    let numbers: Option<Vec<u64>> = names
        .iter()
        .map(|name| {
            let is_number = name.bytes().all(|byte| byte.is_ascii_digit());
            is_number.then(|| name.parse().ok()).flatten()
        })
        .collect();
    let distinct = |numbers: &Vec<u64>| {
        let set: BTreeSet<_> = numbers.iter().collect();
        set.len() == names.len()
    };
    numbers
        .filter(distinct)
        .unwrap_or_else(|| (1..=names.len() as u64).collect())
}

/// A whole dataset on its way in.
#[derive(Debug)]
pub(super) struct Draft {
    /// The command that reads it, for `dataset.toml`.
    pub program: &'static str,
    /// The foreign dataset.
    pub source: PathBuf,
    /// Class names.
    pub classes: Vec<String>,
    /// Kinds of box that the labels have.
    pub kinds: Vec<BoxKind>,
    /// The two cameras, or those of single images.
    pub rig: StereoRig,
    /// Whether there are right images.
    pub stereo: bool,
    /// What was read.
    pub frames: Vec<DraftFrame>,
    /// What could not be read.
    pub problems: Vec<Problem>,
    /// Images that nobody labelled and that are taken to show nothing.
    pub unlabelled: usize,
}

impl Draft {
    /// Drops labels of kinds that the dataset does not have.
    pub fn keep_kinds(&mut self) {
        for labels in self.frames.iter_mut().flat_map(|frame| &mut frame.labels) {
            labels.retain(|label| self.kinds.contains(&label.kind));
        }
    }

    /// Divides the frames and writes everything. `dataset.toml` comes last, so that nothing takes a
    /// half-written folder for a dataset.
    pub fn write(mut self, target: &ImportTarget, progress: &dyn Progress) -> Result<ImportReport> {
        self.frames.sort_by_key(|frame| frame.row.stamp);
        let unlisted = splits::divide(&mut self.frames, &target.splits)?;
        self.problems.extend(unlisted);
        self.refuse_empty()?;
        let out = &target.out;
        self.begin(target)?;
        let outcomes = in_parallel(
            progress,
            "importing frames",
            "run the same command again",
            &self.frames,
            |frame| self.write_frame(frame, out),
        )?;
        let mut kept = Vec::with_capacity(outcomes.len());
        for (frame, outcome) in std::mem::take(&mut self.frames).into_iter().zip(outcomes) {
            match outcome {
                Ok(()) => kept.push(frame),
                Err(reason) => self.problems.push(Problem {
                    subject: frame.name,
                    reason,
                }),
            }
        }
        self.frames = kept;
        self.refuse_empty()?;
        self.finish(out)?;
        Ok(self.report())
    }

    /// Begins or continues an import into a folder.
    fn begin(&self, target: &ImportTarget) -> Result<()> {
        let out = &target.out;
        let marker = format!(
            "# This import is unfinished: run the same command again to complete it.\n\
             program = {:?}\nsource = {:?}\nsettings = {:?}\n",
            self.program,
            self.source.display().to_string(),
            format!("{:?} {:?} {:?}", self.classes, self.rig, target.splits),
        );
        let path = out.join(MARKER);
        let begun = files::read_text(&path).is_ok_and(|old| old == marker);
        if !begun && let Some(content) = files::first_entry(out)? {
            let is_dataset = ["dataset.toml", MARKER]
                .iter()
                .any(|name| out.join(name).exists());
            let reason = if is_dataset {
                "already holds a dataset or another unfinished one, which is never overwritten"
                    .to_owned()
            } else {
                format!("holds other files, such as {content}")
            };
            let remedy = "choose another folder with --out, or delete this one";
            return Err(Error::dataset(out, reason, remedy));
        }
        files::create_folder(out.join("frames"))?;
        files::write_atomically(&path, marker.as_bytes())
    }

    /// Writes a frame; the inner error is a reason to leave it out.
    fn write_frame(&self, frame: &DraftFrame, out: &Path) -> Result<Result<(), String>> {
        let folder = out.join("frames");
        let mut written = Vec::new();
        for ((side, image), labels) in Side::ALL.iter().zip(&frame.images).zip(&frame.labels) {
            let camera = self.rig.camera(*side);
            let size = [camera.width, camera.height];
            let stem = format!("{side}_{}", stamp_name(frame.row.stamp));
            match copy::place(image, &folder, &stem, size, frame.stored) {
                Ok(path) => written.push(path),
                // What cannot be written stops the import, what cannot be read only this frame.
                Err(
                    error @ Error::Io {
                        action: "write", ..
                    },
                ) => return Err(error),
                Err(error) => {
                    for path in written {
                        fs::remove_file(&path).map_err(Error::io("remove", &path))?;
                    }
                    return Ok(Err(error.to_string()));
                }
            }
            let path = folder.join(format!("{stem}.txt"));
            files::write_atomically(&path, label_file_text(labels).as_bytes())?;
            written.push(path);
        }
        Ok(Ok(()))
    }

    fn finish(&self, out: &Path) -> Result<()> {
        let rows: Vec<FrameRow> = self.frames.iter().map(|frame| frame.row.clone()).collect();
        write_frames_csv(out.join("frames.csv"), &rows)?;
        let objects: Vec<ObjectRow> = self
            .frames
            .iter()
            .flat_map(|frame| {
                let stamp = frame.row.stamp;
                let objects = frame.objects.iter().cloned();
                objects.map(move |object| ObjectRow { stamp, ..object })
            })
            .collect();
        if !objects.is_empty() {
            write_objects_csv(out.join("objects.csv"), &objects)?;
        }
        files::write_atomically(out.join("sources.csv"), self.sources()?.as_bytes())?;
        let mut made_by = toml::Table::new();
        made_by.insert("program".to_owned(), self.program.into());
        made_by.insert("version".to_owned(), env!("CARGO_PKG_VERSION").into());
        let source = self.source.display().to_string();
        made_by.insert("source".to_owned(), source.into());
        let info = DatasetInfo {
            version: FORMAT_VERSION,
            classes: self.classes.clone(),
            label_kinds: self.kinds.clone(),
            stereo: self.stereo,
            rig: self.rig,
            made_by,
        };
        let path = out.join("dataset.toml");
        let text = info
            .to_toml()
            .map_err(|error| Error::dataset(&path, error.to_string(), "report this as a bug"))?;
        files::write_atomically(&path, text.as_bytes())?;
        let marker = out.join(MARKER);
        fs::remove_file(&marker).map_err(Error::io("remove", &marker))
    }

    /// Which foreign file became which frame.
    fn sources(&self) -> Result<String> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        let failed = |error: csv::Error| {
            Error::dataset(&self.source, error.to_string(), "report this as a bug")
        };
        writer
            .write_record(["stamp", "name", "left", "right"])
            .map_err(failed)?;
        for frame in &self.frames {
            let image = |index: usize| {
                let path = frame.images.get(index)?;
                let inside = path.strip_prefix(&self.source).unwrap_or(path);
                Some(inside.display().to_string())
            };
            let [left, right] = [0, 1].map(|index| image(index).unwrap_or_default());
            let stamp = stamp_name(frame.row.stamp);
            writer
                .write_record([&stamp, &frame.name, &left, &right])
                .map_err(failed)?;
        }
        let bytes = writer.into_inner().map_err(|error| {
            Error::dataset(&self.source, error.to_string(), "report this as a bug")
        })?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }

    fn refuse_empty(&self) -> Result<()> {
        if !self.frames.is_empty() {
            return Ok(());
        }
        let reason = if self.problems.is_empty() {
            "there is none".to_owned()
        } else {
            Problem::summary(&self.problems)
        };
        Err(Error::dataset(
            &self.source,
            format!("gives no usable frame: {reason}"),
            "repair what is named, or check the folder and the format",
        ))
    }

    fn report(self) -> ImportReport {
        let mut counts = SplitCounts::default();
        for frame in &self.frames {
            *counts.of_mut(frame.row.split) += 1;
        }
        // Labels come once per kind of box, and not every vehicle has every kind.
        let mut vehicles: BTreeMap<(u64, u32), &Label> = BTreeMap::new();
        for frame in &self.frames {
            for label in frame.labels.first().into_iter().flatten() {
                vehicles.insert((frame.row.stamp, label.id), label);
            }
        }
        let count =
            |wanted: fn(&Label) -> bool| vehicles.values().filter(|label| wanted(label)).count();
        ImportReport {
            counts,
            vehicles: vehicles.len(),
            ignored: count(|label| label.ignored),
            with_distance: count(|label| label.distance_m.is_some()),
            unlabelled: self.unlabelled,
            left_out: self.problems,
        }
    }
}
