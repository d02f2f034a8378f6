//! COCO's instance annotations: one JSON file a split.
//!
//! ```text
//! annotations/instances_train.json   images, annotations (bbox = x, y, width, height; pixels of
//!                                    this crate's convention) and categories
//! images/left_00042.png              the images, in this folder or where the file says
//! ```
//!
//! An annotation with `iscrowd` becomes an ignored label and the other way round. What this crate
//! knows beyond COCO stands under the key `twinsight` of the file, of each image and of each
//! annotation, which other programs ignore.

mod export;
mod import;

use serde::{Deserialize, Serialize};

use crate::dataset::{BoxKind, View};
use crate::geometry::RigSettings;

pub use export::export;
pub use import::import;

/// A file of annotations, as far as it matters here.
#[derive(Debug, Serialize, Deserialize)]
struct CocoFile {
    images: Vec<CocoImage>,
    annotations: Vec<CocoAnnotation>,
    categories: Vec<CocoCategory>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    twinsight: Option<FileExtra>,
}

#[derive(Debug, Serialize, Deserialize)]
struct CocoImage {
    id: u64,
    file_name: String,
    width: u32,
    height: u32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    twinsight: Option<ImageExtra>,
}

#[derive(Debug, Serialize, Deserialize)]
struct CocoAnnotation {
    id: u64,
    image_id: u64,
    category_id: u64,
    /// x, y, width, height.
    bbox: Vec<f64>,
    #[serde(default)]
    area: f64,
    #[serde(default)]
    iscrowd: u8,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    twinsight: Option<BoxExtra>,
}

#[derive(Debug, Serialize, Deserialize)]
struct CocoCategory {
    id: u64,
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
