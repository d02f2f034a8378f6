//! COCO's instance annotations: one JSON file a split.
//!
//! ```text
//! annotations/instances_train.json   images, annotations (bbox = x, y, width, height; pixels of
//!                                    this crate's convention) and categories
//! images/left_00042.png              the images, in this folder or where the file says
//! train/_annotations.coco.json       or beside the images, a folder a split (Roboflow)
//! ```
//!
//! Boxes count in the pixels of the picture as it is shown, or as it is stored where the file's width
//! and height are those. An annotation with `iscrowd` becomes an ignored label and the other way round. What this crate
//! knows beyond COCO stands under the key `twinsight` of the file, of each image and of each
//! annotation, which other programs ignore.

mod export;
mod files;
mod import;
mod lenient;

use serde::{Deserialize, Serialize};

use crate::dataset::{BoxKind, View};
use crate::geometry::RigSettings;
use lenient::{Id, Number};

pub use export::export;
pub(super) use import::Coco;

/// A file of annotations as it is read, as far as it matters here.
#[derive(Debug, Deserialize)]
struct CocoFile {
    images: Vec<CocoImage>,
    annotations: Vec<CocoAnnotation>,
    categories: Vec<CocoCategory>,
    #[serde(default)]
    twinsight: Option<FileExtra>,
}

#[derive(Debug, Deserialize)]
struct CocoImage {
    id: Id,
    file_name: String,
    #[serde(default)]
    width: Number,
    #[serde(default)]
    height: Number,
    #[serde(default)]
    twinsight: Option<ImageExtra>,
}

#[derive(Debug, Deserialize)]
struct CocoAnnotation {
    #[serde(default)]
    id: Number,
    image_id: Id,
    category_id: Id,
    /// x, y, width, height.
    #[serde(default)]
    bbox: Option<Vec<Number>>,
    #[serde(default)]
    iscrowd: Number,
    #[serde(default)]
    twinsight: Option<BoxExtra>,
}

#[derive(Debug, Serialize, Deserialize)]
struct CocoCategory {
    id: Id,
    name: String,
}

/// What only this crate writes and reads of a file.
#[derive(Debug, Serialize, Deserialize)]
struct FileExtra {
    kind: BoxKind,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rig: Option<RigSettings>,
}

/// Likewise of an image: its frame's row of `frames.csv`.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(default)]
struct ImageExtra {
    scene: Option<u32>,
    sun: Option<String>,
    view: Option<View>,
    azimuth_deg: Option<f64>,
    elevation_deg: Option<f64>,
    distance_m: Option<f64>,
}

/// Likewise of an annotation.
#[derive(Debug, Serialize, Deserialize)]
struct BoxExtra {
    /// The same in both images of a pair.
    vehicle: u32,
    #[serde(default)]
    distance_m: Option<f64>,
    #[serde(default)]
    visible: Option<f64>,
    center: [f64; 2],
    /// Edges of the box before it was cut off at the image's border.
    edges: [f64; 4],
}
