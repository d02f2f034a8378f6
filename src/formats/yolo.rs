//! YOLO's text files with a `data.yaml`.
//!
//! ```text
//! data.yaml                        train, val, test: folders or lists of images; names: classes
//! images/train/left_00042.png      a folder `images`, ...
//! labels/train/left_00042.txt      ... and beside it one `labels` with a line an object
//! ```
//!
//! A line is `class center_x center_y width height`, fractions of the image, and as this crate's
//! extension a sixth number, the distance in metres. A polygon (seven numbers or more) becomes the
//! box around it. `data.yaml` of this crate also has the rig and the kind of the boxes, under
//! `twinsight`, which other programs ignore.

mod export;
mod import;
mod label;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::dataset::BoxKind;
use crate::geometry::RigSettings;

pub use export::export;
pub use import::import;

/// `data.yaml`, as far as it matters here.
#[derive(Debug, Serialize, Deserialize)]
struct DataYaml {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    path: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    train: Option<Places>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    val: Option<Places>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    test: Option<Places>,
    names: Names,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    twinsight: Option<Extra>,
}

/// Where the images of a split are.
#[derive(Debug, Serialize, Deserialize)]
#[serde(untagged)]
enum Places {
    One(String),
    Several(Vec<String>),
}

/// Class names by index.
#[derive(Debug, Serialize, Deserialize)]
#[serde(untagged)]
enum Names {
    List(Vec<String>),
    Map(BTreeMap<u32, String>),
}

impl Names {
    fn get(&self, index: u32) -> Option<&String> {
        match self {
            Self::List(names) => names.get(index as usize),
            Self::Map(names) => names.get(&index),
        }
    }

    fn all(&self) -> Vec<String> {
        match self {
            Self::List(names) => names.clone(),
            Self::Map(names) => names.values().cloned().collect(),
        }
    }
}

/// What only this crate writes and reads.
#[derive(Debug, Serialize, Deserialize)]
struct Extra {
    /// Of stereo pairs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rig: Option<RigSettings>,
    /// Kind of the boxes; files of older versions do not say and mean tight ones.
    #[serde(default = "tight")]
    kind: BoxKind,
}

const fn tight() -> BoxKind {
    BoxKind::Tight
}
