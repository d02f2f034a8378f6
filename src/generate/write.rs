//! The dataset's folder: what is there, what is missing, and how files get into it.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ImageEncoder as _, RgbImage};

use super::config::GenerateConfig;
use crate::dataset::{
    BoxKind, DatasetInfo, FORMAT_VERSION, FrameRow, Label, ObjectRow, label_file_text, stamp_name,
    write_frames_csv, write_objects_csv,
};
use crate::error::{Error, Result};
use crate::files;
use crate::geometry::StereoRig;
use crate::render::Eye;

/// Holds the configuration while frames are missing.
const MARKER: &str = "generating.toml";

/// A dataset folder that is being filled.
#[derive(Debug)]
pub(super) struct Target {
    root: PathBuf,
}

impl Target {
    /// Begins or continues a dataset in a folder.
    pub fn open(config: &GenerateConfig, root: &Path) -> Result<Self> {
        let marker = root.join(MARKER);
        let content = marker_text(config)?;
        if marker.exists() {
            if files::read_text(&marker)? != content {
                return Err(Error::dataset(
                    root,
                    "was begun with other settings or another version of the program",
                    format!(
                        "use the settings in {MARKER}, or delete the folder or choose another one"
                    ),
                ));
            }
        } else if ["dataset.toml", "frames.csv", "objects.csv", "frames"]
            .iter()
            .any(|name| root.join(name).exists())
        {
            return Err(Error::dataset(
                root,
                "already holds a dataset, which is never overwritten",
                "choose another folder or delete this one",
            ));
        }
        files::create_folder(root.join("frames"))?;
        files::write_atomically(&marker, content.as_bytes())?;
        Ok(Self {
            root: root.to_owned(),
        })
    }

    fn file(&self, stamp: u64, eye: Eye, extension: &str) -> PathBuf {
        let side = match eye {
            Eye::Left => "left",
            Eye::Right => "right",
        };
        self.root
            .join("frames")
            .join(format!("{side}_{}.{extension}", stamp_name(stamp)))
    }

    /// Whether all four files of a frame are there; each is written whole or not at all.
    pub fn has_frame(&self, stamp: u64) -> bool {
        Eye::BOTH.iter().all(|&eye| {
            ["png", "txt"]
                .iter()
                .all(|name| self.file(stamp, eye, name).exists())
        })
    }

    /// Writes the image and the labels of one camera.
    pub fn write_view(
        &self,
        stamp: u64,
        eye: Eye,
        image: &RgbImage,
        labels: &[Label],
    ) -> Result<()> {
        let path = self.file(stamp, eye, "png");
        let mut bytes = Cursor::new(Vec::new());
        PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Sub)
            .write_image(
                image,
                image.width(),
                image.height(),
                image::ExtendedColorType::Rgb8,
            )
            .map_err(|error| Error::image(&path, error.to_string(), "report this as a bug"))?;
        files::write_atomically(&path, bytes.get_ref())?;
        files::write_atomically(
            self.file(stamp, eye, "txt"),
            label_file_text(labels).as_bytes(),
        )
    }

    /// Writes the files that make the folder a dataset.
    pub fn finish(
        &self,
        config: &GenerateConfig,
        rig: StereoRig,
        rows: &[FrameRow],
        objects: &[ObjectRow],
    ) -> Result<()> {
        write_objects_csv(self.root.join("objects.csv"), objects)?;
        write_frames_csv(self.root.join("frames.csv"), rows)?;
        let path = self.root.join("dataset.toml");
        let info = DatasetInfo {
            version: FORMAT_VERSION,
            classes: vec!["car".to_owned()],
            label_kinds: vec![BoxKind::Sphere, BoxKind::Tight],
            stereo: true,
            rig,
            made_by: made_by(config)?,
        };
        let text = toml::to_string(&info).map_err(|error| cannot_encode(&path, &error))?;
        files::write_atomically(&path, text.as_bytes())?;
        let marker = self.root.join(MARKER);
        std::fs::remove_file(&marker).map_err(Error::io("remove", &marker))
    }
}

fn cannot_encode(path: &Path, error: &dyn std::error::Error) -> Error {
    Error::dataset(path, error.to_string(), "report this as a bug")
}

/// How the dataset came about, for `dataset.toml`.
fn made_by(config: &GenerateConfig) -> Result<toml::Table> {
    let settings = toml::Table::try_from(config)
        .map_err(|error| cannot_encode(Path::new("dataset.toml"), &error))?;
    let mut table = toml::Table::new();
    table.insert("program".to_owned(), "twinsight generate".into());
    table.insert("version".to_owned(), env!("CARGO_PKG_VERSION").into());
    table.insert("settings".to_owned(), settings.into());
    Ok(table)
}

fn marker_text(config: &GenerateConfig) -> Result<String> {
    let table = toml::to_string(&made_by(config)?)
        .map_err(|error| cannot_encode(Path::new(MARKER), &error))?;
    Ok(format!(
        "# This dataset is unfinished: run the same command again to complete it.\n{table}"
    ))
}
