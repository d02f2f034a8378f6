//! Frames that are image files.

use std::path::{Path, PathBuf};
use std::time::Instant;

use super::StereoFrame;
use super::layout::Layout;
use crate::error::{Error, Result};
use crate::imaging::{load_pair, load_upright};

/// A frame that has not been read.
#[derive(Debug)]
pub(super) struct Entry {
    name: String,
    files: Files,
}

#[derive(Debug)]
enum Files {
    Pair([PathBuf; 2]),
    Stacked(PathBuf, Layout),
    /// What there is cannot be used.
    Unusable {
        origins: [PathBuf; 2],
        problem: String,
        remedy: &'static str,
    },
}

impl Entry {
    pub fn pair(name: String, files: [&Path; 2]) -> Self {
        Self {
            name,
            files: Files::Pair(files.map(Path::to_path_buf)),
        }
    }

    pub fn stacked(name: String, file: &Path, layout: Layout) -> Self {
        Self {
            name,
            files: Files::Stacked(file.to_path_buf(), layout),
        }
    }

    /// A frame of which one or both sides have no file, or more than one; `expected` is where a
    /// missing one was looked for.
    pub fn of_sides(name: String, sides: [&[PathBuf]; 2], expected: [&str; 2]) -> Self {
        if let [[left], [right]] = sides {
            return Self::pair(name, [left, right]);
        }
        let shown = |i: usize| sides[i].first().cloned().unwrap_or_default();
        let (problem, remedy) = match sides {
            [[], _] => (format!("has no left image ({})", expected[0]), "add it"),
            [_, []] => (format!("has no right image ({})", expected[1]), "add it"),
            [left, right] => {
                let several = if left.len() > 1 { left } else { right };
                let names: Vec<String> = several.iter().map(|p| p.display().to_string()).collect();
                (
                    format!("has several images of one side: {}", names.join(", ")),
                    "keep one of them",
                )
            }
        };
        Self {
            name,
            files: Files::Unusable {
                origins: [shown(0), shown(1)],
                problem,
                remedy,
            },
        }
    }

    fn read(&self) -> Result<[image::RgbImage; 2]> {
        match &self.files {
            Files::Pair([left, right]) => load_pair(left, right),
            Files::Stacked(file, layout) => {
                layout.split(&load_upright(file)?, &file.display().to_string())
            }
            Files::Unusable {
                problem, remedy, ..
            } => Err(Error::value(
                format!("frame {}", self.name),
                problem,
                *remedy,
            )),
        }
    }

    /// The files that there are; both sides of a picture that shows both are one.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        let files = match &self.files {
            Files::Pair(files) | Files::Unusable { origins: files, .. } => files.as_slice(),
            Files::Stacked(file, _) => std::slice::from_ref(file),
        };
        let is_there = |path: &&PathBuf| !path.as_os_str().is_empty();
        files.iter().filter(is_there).map(PathBuf::as_path)
    }

    fn origins(&self) -> [String; 2] {
        let files = match &self.files {
            Files::Pair(files) | Files::Unusable { origins: files, .. } => files.clone(),
            Files::Stacked(file, _) => [file.clone(), file.clone()],
        };
        files.map(|file| file.display().to_string())
    }
}

/// Reads one frame after the other.
pub(super) fn frames(entries: Vec<Entry>) -> impl Iterator<Item = StereoFrame> + Send {
    (0..).zip(entries).map(|(index, entry)| {
        let began = Instant::now();
        let images = entry.read();
        StereoFrame {
            index,
            origins: entry.origins(),
            name: entry.name,
            time_s: None,
            images,
            read: began.elapsed(),
        }
    })
}
