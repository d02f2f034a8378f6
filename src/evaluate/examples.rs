//! Pictures of what went best and worst.

use std::path::Path;

use image::{RgbImage, imageops};
use serde::{Deserialize, Serialize};

use super::vehicles::{Boxes, FalseVehicle, Method, VehicleRow};
use crate::annotate::{Annotation, annotate_pair};
use crate::dataset::{BoxKind, StereoDataset};
use crate::error::{Error, Result};
use crate::files;
use crate::geometry::PixelBox;
use crate::imaging::jpeg_bytes;

/// The folder of the pictures, inside the evaluation's.
pub(super) const FOLDER: &str = "examples";

/// Pictures of each kind.
const EACH: usize = 4;

/// Side of a picture, pixels.
const SIDE_PX: u32 = 320;

/// What a picture shows, in sides of the vehicle's box.
const SURROUNDINGS: f64 = 3.0;

/// And at least, pixels of the image: fewer are only blocks.
const LEAST_PX: f64 = 80.0;

/// What a picture is an example of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ExampleKind {
    /// Among the largest relative errors of found vehicles.
    Worst,
    /// Among the smallest.
    Best,
    /// Among the largest of the vehicles that were missed.
    Missed,
    /// Among the most certain of those that are not there.
    False,
}

impl ExampleKind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Worst, Self::Best, Self::Missed, Self::False];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Worst => "worst",
            Self::Best => "best",
            Self::Missed => "missed",
            Self::False => "false",
        }
    }
}

/// A picture of the left image around a vehicle; a row of `examples.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExampleRow {
    /// What it is an example of.
    pub kind: ExampleKind,
    /// The picture, from the evaluation's folder.
    pub picture: String,
    /// The frame's number.
    #[serde(with = "crate::dataset::stamp")]
    pub frame: u64,
    /// The vehicle's number in the frame; empty for one that is not there.
    pub id: Option<u32>,
    /// The true distance, metres.
    pub distance_m: Option<f64>,
    /// The pipeline's estimate, metres.
    pub estimated_m: Option<f64>,
    /// Its error, percent of the true distance.
    pub error_percent: Option<f64>,
    /// The detection's score.
    pub score: Option<f32>,
}

/// Chooses examples, and draws them into the evaluation's folder in place of earlier ones. Frames
/// that cannot be read any more are left out.
///
/// # Errors
/// A file that cannot be written.
pub(super) fn draw(
    folder: &Path,
    dataset: &StereoDataset,
    kind: BoxKind,
    method: Method,
    vehicles: &[VehicleRow],
    false_vehicles: &[FalseVehicle],
) -> Result<Vec<ExampleRow>> {
    let folder = folder.join(FOLDER);
    files::create_folder(&folder)?;
    let mut rows = Vec::new();
    for example in ExampleKind::ALL {
        for place in 1..=EACH {
            let path = folder.join(format!("{}_{place}.jpg", example.name()));
            if path.exists() {
                std::fs::remove_file(&path).map_err(Error::io("remove", &path))?;
            }
        }
        let chosen = match example {
            ExampleKind::False => of_false(false_vehicles),
            _ => of_labelled(example, method, vehicles),
        };
        for (row, area) in chosen {
            let Some((picture, path)) = picture(dataset, kind, &row, area)
                .map(|picture| (picture, folder.join(format!("{}.jpg", row.picture))))
            else {
                continue;
            };
            files::write_atomically(&path, &jpeg_bytes(&path, &picture)?)?;
            rows.push(ExampleRow {
                picture: format!("{FOLDER}/{}.jpg", row.picture),
                ..row
            });
        }
    }
    Ok(rows)
}

/// Examples among the labelled vehicles, with the detected boxes; the labelled ones are looked up when
/// they are drawn.
fn of_labelled(
    kind: ExampleKind,
    method: Method,
    vehicles: &[VehicleRow],
) -> Vec<(ExampleRow, Option<PixelBox>)> {
    let estimate = |v: &VehicleRow| v.estimate(Boxes::Pipeline, method);
    let error = |v: &VehicleRow| {
        let estimated_m = estimate(v).filter(|m| m.is_finite())?;
        Some(100.0 * (estimated_m - v.distance_m) / v.distance_m)
    };
    let mut ranked: Vec<(f64, &VehicleRow)> = vehicles
        .iter()
        .filter_map(|v| match kind {
            ExampleKind::Worst => Some((-error(v)?.abs(), v)),
            ExampleKind::Best => Some((error(v)?.abs(), v)),
            _ => (!v.found).then_some((-v.box_px, v)),
        })
        .collect();
    ranked.sort_by(|a, b| {
        a.0.total_cmp(&b.0)
            .then((a.1.frame, a.1.id).cmp(&(b.1.frame, b.1.id)))
    });
    let chosen = ranked.into_iter().take(EACH).zip(1..);
    chosen
        .map(|((_, v), place)| {
            let row = ExampleRow {
                kind,
                picture: format!("{}_{place}", kind.name()),
                frame: v.frame,
                id: Some(v.id),
                distance_m: Some(v.distance_m),
                estimated_m: estimate(v),
                error_percent: error(v),
                score: v.score,
            };
            (row, v.found_box())
        })
        .collect()
}

fn of_false(vehicles: &[FalseVehicle]) -> Vec<(ExampleRow, Option<PixelBox>)> {
    let mut ranked: Vec<&FalseVehicle> = vehicles.iter().collect();
    ranked.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.frame.cmp(&b.frame)));
    let chosen = ranked.into_iter().take(EACH).zip(1..);
    chosen
        .map(|(v, place)| {
            let row = ExampleRow {
                kind: ExampleKind::False,
                picture: format!("{}_{place}", ExampleKind::False.name()),
                frame: v.frame,
                id: None,
                distance_m: None,
                estimated_m: Some(v.estimated_m),
                error_percent: None,
                score: Some(v.score),
            };
            (row, Some(PixelBox::new(v.x_min, v.y_min, v.x_max, v.y_max)))
        })
        .collect()
}

/// The surroundings of the vehicle in the left image, with the labelled box in the first colour and
/// the detected one in the second.
fn picture(
    dataset: &StereoDataset,
    kind: BoxKind,
    row: &ExampleRow,
    found: Option<PixelBox>,
) -> Option<RgbImage> {
    let frame = dataset.frame(row.frame)?;
    let labels = || frame.left.labels_of(kind);
    let labelled = labels()
        .find(|label| Some(label.id) == row.id)
        .map(|label| label.box_pixel);
    let area = labelled.or(found)?;
    let image = frame.left.load(&dataset.rig().left).ok()?;
    let most = f64::from(image.width().min(image.height()));
    let side = (SURROUNDINGS * area.squared().width())
        .max(LEAST_PX)
        .min(most)
        .round();
    let start = |center: f64, length: u32| {
        (center - side / 2.0)
            .clamp(0.0, f64::from(length) - side)
            .round()
    };
    let [x, y] = area.center();
    let (left, top) = (start(x, image.width()), start(y, image.height()));
    let (left_px, top_px, side_px) = (left as u32, top as u32, side as u32);
    let crop = imageops::crop_imm(&image, left_px, top_px, side_px, side_px).to_image();
    let crop = imageops::resize(&crop, SIDE_PX, SIDE_PX, imageops::FilterType::CatmullRom);
    let scale = f64::from(SIDE_PX) / side;
    let moved = |area: PixelBox| {
        PixelBox::new(
            (area.x_min - left) * scale,
            (area.y_min - top) * scale,
            (area.x_max - left) * scale,
            (area.y_max - top) * scale,
        )
    };
    let text = match (row.estimated_m, row.distance_m) {
        (Some(estimated_m), Some(distance_m)) => format!("{estimated_m:.1} of {distance_m:.1} m"),
        (Some(estimated_m), None) => format!("{estimated_m:.1} m?"),
        (None, Some(distance_m)) => format!("missed, {distance_m:.1} m"),
        (None, None) => String::new(),
    };
    let annotation = |area: Option<PixelBox>, text: String| Annotation {
        left: area.map(moved),
        right: None,
        text,
    };
    let annotations = if labelled.is_some() {
        [annotation(labelled, text), annotation(found, String::new())]
    } else {
        [annotation(None, String::new()), annotation(found, text)]
    };
    Some(annotate_pair(&crop, &RgbImage::new(0, 0), &annotations))
}
