//! COCO out.

use std::path::Path;

use serde::Serialize;

use super::super::copy;
use super::super::report::ExportReport;
use super::super::target::{begin_export, image_stem, write_frames};
use super::lenient::Id;
use super::{BoxExtra, CocoCategory, FileExtra, ImageExtra};
use crate::dataset::{BoxKind, Frame, Label, Split, StereoDataset};
use crate::error::{Error, Result};
use crate::files;
use crate::geometry::{Camera, PixelBox};
use crate::progress::Progress;

/// A file of annotations as it is written.
#[derive(Debug, Serialize)]
struct CocoFile {
    images: Vec<CocoImage>,
    annotations: Vec<CocoAnnotation>,
    categories: Vec<CocoCategory>,
    twinsight: FileExtra,
}

#[derive(Debug, Serialize)]
struct CocoImage {
    id: u64,
    file_name: String,
    width: u32,
    height: u32,
    twinsight: ImageExtra,
}

#[derive(Debug, Serialize)]
struct CocoAnnotation {
    id: u64,
    image_id: u64,
    category_id: u64,
    bbox: [f64; 4],
    area: f64,
    iscrowd: u8,
    twinsight: BoxExtra,
}

/// Writes a dataset as COCO annotations, one file a split, and a folder `images`.
///
/// Boxes are cut off at the image's border; the whole ones stand under `twinsight`.
///
/// # Errors
/// An occupied folder, or a file that cannot be read or written.
pub fn export(
    dataset: &StereoDataset,
    kind: BoxKind,
    out: &Path,
    progress: &dyn Progress,
) -> Result<ExportReport> {
    begin_export(dataset, kind, out)?;
    for folder in ["images", "annotations"] {
        files::create_folder(out.join(folder))?;
    }
    let mut report = ExportReport::default();
    let images = write_frames(dataset, progress, |frame| copy_images(dataset, frame, out))?;
    for split in Split::ALL {
        let mut frames = dataset
            .frames
            .iter()
            .zip(&images)
            .filter(|(frame, _)| frame.row.split == *split)
            .peekable();
        if frames.peek().is_none() {
            continue;
        }
        let mut file = CocoFile {
            images: Vec::new(),
            annotations: Vec::new(),
            categories: (1..)
                .zip(dataset.classes())
                .map(|(id, name)| CocoCategory {
                    id: Id::number(id),
                    name: name.clone(),
                })
                .collect(),
            twinsight: FileExtra {
                kind,
                rig: dataset.info.stereo.then(|| (*dataset.rig()).into()),
            },
        };
        for (frame, names) in frames {
            add_frame(dataset, frame, names, kind, &mut file);
        }
        report.images += file.images.len();
        report.boxes += file.annotations.len();
        let path = out
            .join("annotations")
            .join(format!("instances_{split}.json"));
        let text = serde_json::to_string(&file)
            .map_err(|error| Error::dataset(&path, error.to_string(), "report this as a bug"))?;
        files::write_atomically(&path, text.as_bytes())?;
    }
    Ok(report)
}

fn copy_images(dataset: &StereoDataset, frame: &Frame, out: &Path) -> Result<Vec<String>> {
    let folder = out.join("images");
    frame
        .images()
        .map(|(side, image)| {
            copy::copy_as_is(&image.path, &folder, &image_stem(dataset, frame, side))
        })
        .collect()
}

fn add_frame(
    dataset: &StereoDataset,
    frame: &Frame,
    names: &[String],
    kind: BoxKind,
    file: &mut CocoFile,
) {
    for ((side, image), file_name) in frame.images().zip(names) {
        let camera = dataset.rig().camera(side);
        let image_id = file.images.len() as u64 + 1;
        let row = frame.row.clone();
        file.images.push(CocoImage {
            id: image_id,
            file_name: file_name.clone(),
            width: camera.width,
            height: camera.height,
            twinsight: ImageExtra {
                scene: row.scene,
                sun: row.sun,
                view: row.view,
                azimuth_deg: row.azimuth_deg,
                elevation_deg: row.elevation_deg,
                distance_m: row.distance_m,
            },
        });
        for label in image.labels_of(kind) {
            let id = file.annotations.len() as u64 + 1;
            file.annotations
                .push(annotation(label, id, image_id, camera));
        }
    }
}

fn annotation(label: &Label, id: u64, image_id: u64, camera: &Camera) -> CocoAnnotation {
    let short = |value: f64| (value * 1e4).round() / 1e4;
    let PixelBox {
        x_min,
        y_min,
        x_max,
        y_max,
    } = label.box_pixel;
    let inside = label
        .box_pixel
        .clipped(f64::from(camera.width), f64::from(camera.height));
    let bbox = [inside.x_min, inside.y_min, inside.width(), inside.height()];
    CocoAnnotation {
        id,
        image_id,
        category_id: u64::from(label.class) + 1,
        bbox: bbox.map(short),
        area: short(inside.area()),
        iscrowd: u8::from(label.ignored),
        twinsight: BoxExtra {
            vehicle: label.id,
            distance_m: label.distance_m,
            visible: label.visible,
            center: label.center_pixel,
            edges: [x_min, y_min, x_max, y_max],
        },
    }
}
