//! YOLO's text files with a `data.yaml`.
//!
//! ```text
//! data.yaml                        train, val, test: folders or lists of images; names: classes
//! images/train/left_00042.png      a folder `images`, ...
//! labels/train/left_00042.txt      ... and beside it one `labels` with a line an object
//! ```
//!
//! A line is `class center_x center_y width height`, fractions of the image as it is shown. Further
//! numbers are what `data.yaml` says: key points (`kpt_shape`), or as this crate's extension the
//! distance in metres; otherwise one more is a detector's confidence, and a polygon (six numbers or
//! more in place of the four) becomes the box around it. `data.yaml` of this crate also has the rig
//! and the kind of the boxes, under `twinsight`, which other programs ignore.

mod data_yaml;
mod export;
mod images;
mod import;
mod label;

use serde::{Deserialize, Serialize};

use crate::dataset::BoxKind;
use crate::geometry::RigSettings;

pub use export::export;
pub(super) use import::Yolo;

/// What only this crate writes and reads of `data.yaml`.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Extra {
    /// Of stereo pairs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rig: Option<RigSettings>,
    /// Kind of the boxes; files of older versions do not say and mean tight ones.
    #[serde(default = "tight")]
    kind: BoxKind,
    /// Whether a sixth number is a distance; files of older versions do not say and mean it.
    #[serde(default = "yes")]
    distance: bool,
}

const fn tight() -> BoxKind {
    BoxKind::Tight
}

const fn yes() -> bool {
    true
}
