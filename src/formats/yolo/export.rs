//! YOLO out.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use super::super::copy;
use super::super::report::ExportReport;
use super::super::target::{begin_export, image_stem, write_frames};
use super::Extra;
use super::label::YoloLabel;
use crate::dataset::{BoxKind, Frame, Problem, Split, StereoDataset};
use crate::error::{Error, Result};
use crate::files;
use crate::progress::Progress;

/// `data.yaml`.
#[derive(Debug, Serialize)]
struct DataYaml {
    #[serde(skip_serializing_if = "Option::is_none")]
    train: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    val: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    test: Option<String>,
    names: BTreeMap<u32, String>,
    twinsight: Extra,
}

/// Writes a dataset as YOLO's text files with a `data.yaml`; with `distance`, every line has the
/// distance as a sixth number, which other programs may not accept.
///
/// Boxes are cut off at the image's border. YOLO cannot mark objects as ignored: those are left
/// out.
///
/// # Errors
/// An occupied folder, or a file that cannot be read or written.
pub fn export(
    dataset: &StereoDataset,
    kind: BoxKind,
    distance: bool,
    out: &Path,
    progress: &dyn Progress,
) -> Result<ExportReport> {
    begin_export(dataset, kind, out)?;
    let used: Vec<Split> = Split::ALL
        .iter()
        .copied()
        .filter(|split| !dataset.split(*split).is_empty())
        .collect();
    for split in &used {
        for folder in ["images", "labels"] {
            files::create_folder(out.join(folder).join(split.word()))?;
        }
    }
    let outcomes = write_frames(dataset, progress, |frame| {
        write_frame(dataset, frame, kind, distance, out)
    })?;
    let mut report = ExportReport::default();
    for frame in outcomes {
        report.images += frame.images;
        report.boxes += frame.boxes;
        report.left_out.extend(frame.left_out);
    }
    let place = |split: Split| {
        let is_used = used.contains(&split);
        is_used.then(|| format!("images/{split}"))
    };
    let yaml = DataYaml {
        train: place(Split::Train),
        val: place(Split::Val),
        test: place(Split::Test),
        names: (0..).zip(dataset.classes().iter().cloned()).collect(),
        twinsight: Extra {
            rig: dataset.info.stereo.then(|| (*dataset.rig()).into()),
            kind,
            distance,
        },
    };
    let path = out.join("data.yaml");
    let text = serde_saphyr::to_string(&yaml)
        .map_err(|error| Error::dataset(&path, error.to_string(), "report this as a bug"))?;
    files::write_atomically(&path, text.as_bytes())?;
    Ok(report)
}

fn write_frame(
    dataset: &StereoDataset,
    frame: &Frame,
    kind: BoxKind,
    distance: bool,
    out: &Path,
) -> Result<ExportReport> {
    let mut report = ExportReport::default();
    let split = frame.row.split.word();
    for (side, image) in frame.images() {
        let camera = dataset.rig().camera(side);
        let size = [camera.width, camera.height];
        let stem = image_stem(dataset, frame, side);
        copy::copy_as_is(&image.path, &out.join("images").join(split), &stem)?;
        let mut text = String::new();
        for label in image.labels_of(kind) {
            if label.ignored {
                let reason = format!("vehicle {} in the {side} image is ignored", label.id);
                report
                    .left_out
                    .push(Problem::of_frame(frame.row.stamp, reason));
                continue;
            }
            let line = YoloLabel {
                class: label.class,
                box_pixel: label
                    .box_pixel
                    .clipped(f64::from(size[0]), f64::from(size[1])),
                distance_m: label.distance_m.filter(|_| distance),
            };
            text += &(line.to_line(size) + "\n");
            report.boxes += 1;
        }
        let path = out.join("labels").join(split).join(format!("{stem}.txt"));
        files::write_atomically(path, text.as_bytes())?;
        report.images += 1;
    }
    Ok(report)
}
