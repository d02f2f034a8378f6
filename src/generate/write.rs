//! The dataset's folder: what is there, what is missing, and how files get into it.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder as _, RgbImage};

use super::Outputs;
use super::part::Task;
use crate::dataset::{
    BoxKind, DatasetInfo, FORMAT_VERSION, FrameRow, Label, ObjectRow, frames_csv_text,
    label_file_text, objects_csv_text, read_frames_csv, stamp_name,
};
use crate::error::{Error, Result};
use crate::files::{self, TEMPORARY_PREFIX};
use crate::geometry::StereoRig;
use crate::render::{Eye, RigPose};

/// Holds the settings while frames are missing.
pub(super) const MARKER: &str = "generating.toml";

/// What a folder holds before a run.
pub(super) struct Folder {
    /// How its finished dataset was made.
    pub made_by: Option<toml::Table>,
    /// What was begun and not finished.
    pub marker: Option<toml::Table>,
    /// Something that it holds, by name.
    pub content: Option<String>,
}

impl Folder {
    /// Looks into a folder, which need not exist.
    pub fn read(root: &Path) -> Result<Self> {
        let table = |name: &str| -> Result<Option<toml::Table>> {
            let path = root.join(name);
            if !path.exists() {
                return Ok(None);
            }
            let text = files::read_text(&path)?;
            text.parse().map(Some).map_err(|error: toml::de::Error| {
                Error::dataset(
                    &path,
                    error.message().to_owned(),
                    "delete the folder or choose another one",
                )
            })
        };
        let made_by = table("dataset.toml")?.map(|mut info| match info.remove("made_by") {
            Some(toml::Value::Table(made_by)) => made_by,
            _ => toml::Table::new(),
        });
        Ok(Self {
            made_by,
            marker: table(MARKER)?,
            content: files::first_entry(root)?,
        })
    }
}

/// A dataset folder that is being filled.
#[derive(Debug)]
pub(super) struct Target {
    root: PathBuf,
    task: Task,
    rig: StereoRig,
}

/// A frame's part of the tables.
#[derive(Debug, Clone)]
pub(super) struct FrameRecord {
    pub row: FrameRow,
    pub objects: Vec<ObjectRow>,
    pub pose: RigPose,
}

impl Target {
    /// Begins or continues a task in a folder.
    pub fn open(task: Task, root: &Path) -> Result<Self> {
        let outputs = task.history.config.outputs;
        for name in ["frames"].into_iter().chain(outputs.map_folders()) {
            files::create_folder(root.join(name))?;
            remove_half_written(&root.join(name))?;
        }
        let target = Self {
            root: root.to_owned(),
            rig: task.history.config.rig()?,
            task,
        };
        target.refuse_foreign_stamps()?;
        let table = encode(&target.root, &target.task.history.to_table()?)?;
        let text = format!(
            "# This dataset is unfinished: run the same command again to complete it.\n{table}"
        );
        files::write_atomically(root.join(MARKER), text.as_bytes())?;
        Ok(target)
    }

    pub fn root(&self) -> &Path {
        &self.root
    }

    pub fn rig(&self) -> &StereoRig {
        &self.rig
    }

    pub fn task(&self) -> &Task {
        &self.task
    }

    fn outputs(&self) -> Outputs {
        self.task.history.config.outputs
    }

    /// Frames that are to be added must not take the stamps of frames that someone else added.
    fn refuse_foreign_stamps(&self) -> Result<()> {
        let path = self.root.join("frames.csv");
        if self.root.join(MARKER).exists() || !path.exists() {
            return Ok(());
        }
        let first = self.task.part.first_stamp;
        let (rows, _) = read_frames_csv(&path)?;
        match rows.iter().find(|row| row.stamp >= first) {
            Some(row) => Err(Error::dataset(
                &path,
                format!(
                    "lists frame {}, which the generator did not make",
                    stamp_name(row.stamp)
                ),
                format!("frames can be added from stamp {first} on: move it away first"),
            )),
            None => Ok(()),
        }
    }

    fn file(&self, folder: &str, stamp: u64, eye: Eye, extension: &str) -> PathBuf {
        let side = match eye {
            Eye::Left => "left",
            Eye::Right => "right",
        };
        self.root
            .join(folder)
            .join(format!("{side}_{}.{extension}", stamp_name(stamp)))
    }

    /// The files of a frame; each is written whole or not at all.
    fn files_of(&self, stamp: u64) -> Vec<PathBuf> {
        let mut files = Vec::new();
        for eye in Eye::BOTH {
            files.extend(["png", "txt"].map(|name| self.file("frames", stamp, eye, name)));
            let maps = self.outputs().map_folders();
            files.extend(maps.map(|folder| self.file(folder, stamp, eye, "png")));
        }
        files
    }

    /// Whether all files of a frame are there.
    pub fn has_frame(&self, stamp: u64) -> bool {
        self.files_of(stamp).iter().all(|file| file.exists())
    }

    /// Bytes on disk of a frame.
    pub fn frame_bytes(&self, stamp: u64) -> u64 {
        self.files_of(stamp)
            .iter()
            .map(|file| fs::metadata(file).map_or(0, |metadata| metadata.len()))
            .sum()
    }

    /// Writes the image and the labels of one camera.
    pub fn write_view(
        &self,
        stamp: u64,
        eye: Eye,
        image: &RgbImage,
        labels: &[Label],
    ) -> Result<()> {
        let path = self.file("frames", stamp, eye, "png");
        write_png(&path, image, image.dimensions(), ExtendedColorType::Rgb8)?;
        files::write_atomically(
            self.file("frames", stamp, eye, "txt"),
            label_file_text(labels).as_bytes(),
        )
    }

    /// Writes a map of 8-bit numbers, one a pixel, row by row.
    pub fn write_map_8(&self, folder: &str, stamp: u64, eye: Eye, values: &[u8]) -> Result<()> {
        let path = self.file(folder, stamp, eye, "png");
        write_png(&path, values, self.size(), ExtendedColorType::L8)
    }

    /// Writes a map of 16-bit numbers, one a pixel, row by row.
    pub fn write_map_16(&self, folder: &str, stamp: u64, eye: Eye, values: &[u16]) -> Result<()> {
        let path = self.file(folder, stamp, eye, "png");
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_ne_bytes()).collect();
        write_png(&path, &bytes, self.size(), ExtendedColorType::L16)
    }

    fn size(&self) -> (u32, u32) {
        (self.rig.left.width, self.rig.left.height)
    }

    /// Writes the files that make the folder a dataset: the tables with the rows of this part
    /// after those of the earlier ones, and `dataset.toml`.
    ///
    /// Stopped at any point, it can be repeated.
    pub fn finish(&self, records: &[FrameRecord]) -> Result<()> {
        let rows: Vec<FrameRow> = records.iter().map(|record| record.row.clone()).collect();
        let objects: Vec<ObjectRow> = records
            .iter()
            .flat_map(|record| record.objects.iter().cloned())
            .collect();
        let objects =
            objects_csv_text(&objects).map_err(|reason| cannot_encode(&self.root, &reason))?;
        self.append("objects.csv", &objects)?;
        if self.outputs().poses {
            let poses: Vec<(u64, RigPose)> = records
                .iter()
                .map(|record| (record.row.stamp, record.pose))
                .collect();
            self.append("poses.csv", &super::truth::poses_csv_text(&poses))?;
        }
        self.append("frames.csv", &frames_csv_text(&rows))?;
        let path = self.root.join("dataset.toml");
        let info = DatasetInfo {
            version: FORMAT_VERSION,
            classes: vec!["car".to_owned()],
            label_kinds: vec![BoxKind::Sphere, BoxKind::Tight],
            stereo: true,
            rig: self.rig,
            made_by: self.task.history.to_table()?,
        };
        let text = info
            .to_toml()
            .map_err(|error| cannot_encode(&path, &error))?;
        files::write_atomically(&path, text.as_bytes())?;
        let marker = self.root.join(MARKER);
        fs::remove_file(&marker).map_err(Error::io("remove", &marker))
    }

    /// Writes a table whose rows begin with a stamp: what the file has of earlier parts stays as it
    /// is, and rows of this part are replaced.
    fn append(&self, name: &str, text: &str) -> Result<()> {
        let path = self.root.join(name);
        let first = self.task.part.first_stamp;
        if first == 0 || !path.exists() {
            return files::write_atomically(&path, text.as_bytes());
        }
        let is_earlier = |line: &&str| {
            let stamp = line.split(',').next().unwrap_or_default().trim();
            stamp.parse::<u64>().map_or(true, |stamp| stamp < first)
        };
        let present = files::read_text(&path)?;
        let earlier = present.lines().filter(is_earlier);
        let mut whole: Vec<&str> = earlier.collect();
        whole.extend(text.lines().skip(1));
        files::write_atomically(&path, (whole.join("\n") + "\n").as_bytes())
    }
}

/// Removes what a killed run left half written in a folder.
fn remove_half_written(folder: &Path) -> Result<()> {
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let name = path.file_name().and_then(|name| name.to_str());
        if name.is_some_and(|name| name.starts_with(TEMPORARY_PREFIX)) {
            fs::remove_file(&path).map_err(Error::io("remove", &path))?;
        }
    }
    Ok(())
}

fn write_png(
    path: &Path,
    bytes: &[u8],
    (width, height): (u32, u32),
    color: ExtendedColorType,
) -> Result<()> {
    let mut encoded = Cursor::new(Vec::new());
    PngEncoder::new_with_quality(&mut encoded, CompressionType::Fast, FilterType::Sub)
        .write_image(bytes, width, height, color)
        .map_err(|error| Error::image(path, error.to_string(), "report this as a bug"))?;
    files::write_atomically(path, encoded.get_ref())
}

fn cannot_encode(path: &Path, error: &dyn std::fmt::Display) -> Error {
    Error::dataset(path, error.to_string(), "report this as a bug")
}

fn encode(path: &Path, table: &toml::Table) -> Result<String> {
    toml::to_string(table).map_err(|error| cannot_encode(path, &error))
}
