//! KITTI out.

use std::collections::BTreeMap;
use std::path::Path;

use super::super::copy;
use super::super::report::ExportReport;
use super::super::target::{begin_export, write_frames};
use super::calib;
use super::objects::{DONT_CARE, Object};
use crate::dataset::{
    BoxKind, Frame, Label, ObjectRow, Problem, Split, StereoDataset, read_objects_csv,
};
use crate::error::{Error, Result};
use crate::files;
use crate::geometry::{Cuboid, StereoRig};
use crate::progress::Progress;

/// Vertical part of a vehicle's heading, in rig axes, up to which the rig counts as level.
const LEVEL: f64 = 0.02;

/// Writes a dataset as a KITTI object detection folder.
///
/// Everything is put under `training`, because all frames have labels; `ImageSets` lists the splits.
/// `label_3` holds the boxes in the right images. Sizes and headings come from `objects.csv`; where it
/// is missing, or the rig looks up or down so that KITTI's upright boxes would be wrong, sizes are
/// written as KITTI's unknown, and `location` is the centre of the box.
///
/// # Errors
/// A dataset of single images, an occupied folder, a file that cannot be read or written.
pub fn export(
    dataset: &StereoDataset,
    kind: BoxKind,
    out: &Path,
    progress: &dyn Progress,
) -> Result<ExportReport> {
    if !dataset.info.stereo {
        return Err(Error::dataset(
            &dataset.folder,
            "has single images, and KITTI needs pairs",
            "export it as yolo or coco",
        ));
    }
    begin_export(dataset, kind, out)?;
    let objects = objects(dataset)?;
    let training = out.join("training");
    for folder in ["image_2", "image_3", "calib", "label_2", "label_3"] {
        files::create_folder(training.join(folder))?;
    }
    let calibration = calib::text(dataset.rig());
    let outcomes = write_frames(dataset, progress, |frame| {
        write_frame(dataset, frame, kind, &objects, &training, &calibration)
    })?;
    let mut report = ExportReport::default();
    for (boxes, problems) in outcomes {
        report.images += 2;
        report.boxes += boxes;
        report.left_out.extend(problems);
    }
    files::create_folder(out.join("ImageSets"))?;
    for split in Split::ALL {
        let frames = dataset.split(*split);
        let list: String = frames.into_iter().map(|frame| name(frame) + "\n").collect();
        let path = out.join("ImageSets").join(format!("{split}.txt"));
        files::write_atomically(path, list.as_bytes())?;
    }
    Ok(report)
}

/// KITTI's names have six digits.
fn name(frame: &Frame) -> String {
    format!("{:06}", frame.row.stamp)
}

fn write_frame(
    dataset: &StereoDataset,
    frame: &Frame,
    kind: BoxKind,
    objects: &BTreeMap<(u64, u32), ObjectRow>,
    training: &Path,
    calibration: &str,
) -> Result<(usize, Vec<Problem>)> {
    let name = name(frame);
    for ((_, image), folder) in frame.images().zip(["image_2", "image_3"]) {
        copy::copy_as_png(
            &image.path,
            &training.join(folder).join(format!("{name}.png")),
        )?;
    }
    let path = |folder: &str| training.join(folder).join(format!("{name}.txt"));
    files::write_atomically(path("calib"), calibration.as_bytes())?;
    let mut texts = [String::new(), String::new()];
    let mut boxes = 0;
    let mut problems = Vec::new();
    let right_labels = frame.right.as_ref().map_or(&[][..], |right| &right.labels);
    for left in frame.left.labels_of(kind) {
        let alike = |label: &&Label| label.kind == kind && label.id == left.id;
        let right = right_labels.iter().find(alike);
        let row = objects.get(&(frame.row.stamp, left.id));
        let object = object(dataset, left, row);
        texts[0] += &(object.to_line() + "\n");
        boxes += 1;
        // Line by line the same object; one that the right camera does not see leaves a region.
        let line = match right {
            Some(right) => Object {
                box_pixel: clipped(dataset, right),
                ..object
            },
            None => Object {
                class: DONT_CARE.to_owned(),
                cuboid: None,
                truncated: None,
                ..object
            },
        };
        boxes += usize::from(right.is_some());
        texts[1] += &(line.to_line() + "\n");
    }
    for right in right_labels.iter().filter(|label| label.kind == kind) {
        if frame.left.labels_of(kind).all(|left| left.id != right.id) {
            let reason = format!("vehicle {} is in the right image alone", right.id);
            problems.push(Problem::of_frame(frame.row.stamp, reason));
        }
    }
    for (text, folder) in texts.iter().zip(["label_2", "label_3"]) {
        files::write_atomically(path(folder), text.as_bytes())?;
    }
    Ok((boxes, problems))
}

fn clipped(dataset: &StereoDataset, label: &Label) -> crate::geometry::PixelBox {
    let camera = dataset.rig().left;
    label
        .box_pixel
        .clipped(f64::from(camera.width), f64::from(camera.height))
}

/// Sizes and headings of vehicles by stamp and id, for rigs that look level.
fn objects(dataset: &StereoDataset) -> Result<BTreeMap<(u64, u32), ObjectRow>> {
    let path = dataset.folder.join("objects.csv");
    if !path.exists() {
        return Ok(BTreeMap::new());
    }
    let rows = read_objects_csv(&path)?.into_iter();
    let level = rows.filter(|row| row.forward_y.abs() < LEVEL);
    Ok(level.map(|row| ((row.stamp, row.id), row)).collect())
}

fn object(dataset: &StereoDataset, left: &Label, row: Option<&ObjectRow>) -> Object {
    let cuboid = center(dataset.rig(), left).map(|center_camera| Cuboid {
        center_camera,
        length_m: row.map_or(0.0, |row| row.length_m),
        width_m: row.map_or(0.0, |row| row.width_m),
        height_m: row.map_or(0.0, |row| row.height_m),
        yaw_rad: row.map_or(0.0, |row| libm::atan2(-row.forward_z, row.forward_x)),
    });
    let class = dataset.classes().get(left.class as usize);
    let class = class.filter(|_| cuboid.is_some());
    Object {
        class: class.map_or_else(|| DONT_CARE.to_owned(), |name| name.replace(' ', "_")),
        truncated: cuboid.map(|_| 0.0),
        occluded: match left.visible {
            _ if left.ignored => 3,
            Some(visible) if visible < 0.5 => 2,
            Some(visible) if visible < 0.9 => 1,
            _ => 0,
        },
        box_pixel: clipped(dataset, left),
        cuboid,
    }
}

/// Where a vehicle's centre is, axes and origin of the left camera: on the ray through its pixel,
/// at its distance from the middle between the cameras. None where the distance is unknown.
fn center(rig: &StereoRig, left: &Label) -> Option<[f64; 3]> {
    let distance_m = left.distance_m?;
    let ray = rig.left.camera_from_pixel(left.center_pixel);
    let square: f64 = ray.iter().map(|v| v * v).sum();
    let half_m = rig.baseline_m / 2.0;
    let along = half_m * ray[0];
    let root = along * along - square * (half_m * half_m - distance_m * distance_m);
    let z_m = (along + libm::sqrt(root.max(0.0))) / square;
    Some(ray.map(|v| v * z_m))
}
