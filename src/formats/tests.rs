//! Laws of imports and exports on datasets that the tests write themselves.

mod coco_kinds;
mod hostile;
mod kinds;
mod kitti_kinds;
mod round_trip;
mod streets;

use std::fs;
use std::path::{Path, PathBuf};

use image::{Rgb, RgbImage};
use tempfile::TempDir;

use super::*;
use crate::dataset::{BoxKind, Split, StereoDataset};
use crate::imaging::save_png;
use crate::progress::Silent;
use crate::validate::validate;

/// A folder for foreign datasets and imports.
struct Place {
    folder: TempDir,
}

impl Place {
    fn new() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    fn image(&self, name: &str, [width, height]: [u32; 2], seed: u32) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let image = RgbImage::from_fn(width, height, |x, y| {
            let wave = (x * (seed % 7 + 1) + y * (seed % 5 + 2) + x * y / 9 * seed) % 251;
            Rgb([wave as u8, (wave / 2 + seed) as u8, (y * 3) as u8])
        });
        if name.ends_with("png") {
            save_png(path, &image).unwrap();
        } else {
            image.save(path).unwrap();
        }
    }

    /// Where an import goes when nothing else is wanted.
    fn target(&self, name: &str) -> ImportTarget {
        ImportTarget {
            out: self.path(name),
            classes: None,
            splits: SplitSettings::default(),
        }
    }

    fn open(&self, name: &str) -> StereoDataset {
        StereoDataset::open(self.path(name)).unwrap()
    }
}

/// Nothing may be wrong with what an import writes.
fn assert_sound(folder: &Path) {
    let validation = validate(folder, &Silent).unwrap();
    let text: Vec<String> = validation
        .findings
        .iter()
        .map(ToString::to_string)
        .collect();
    assert!(text.is_empty(), "{}", text.join("\n"));
}

/// The reasons against what was left out, in one text.
fn reasons(report: &ImportReport) -> String {
    let lines: Vec<String> = report.left_out.iter().map(ToString::to_string).collect();
    lines.join("\n")
}
