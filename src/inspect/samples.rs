//! Which frames are shown, and how.

use std::collections::BTreeMap;

use image::{RgbImage, imageops};
use rayon::prelude::*;

use crate::annotate::{Annotation, annotate_pair};
use crate::dataset::{BoxKind, Frame, Label, StereoDataset};
use crate::error::{Error, Result};
use crate::geometry::PixelBox;
use crate::progress::Progress;
use crate::world::Sun;

/// Width of a sample, pixels.
pub(super) const SAMPLE_WIDTH: u32 = 360;

/// Samples in a row, nearest first.
pub(super) const COLUMNS: usize = 6;

/// Rows at most: what has more suns, or none, is shown in part.
const MOST_ROWS: usize = 8;

/// A vehicle that is narrower in its sample is shown once more, enlarged.
const SMALL_PX: f64 = 56.0;

/// Samples that have something in common.
pub(super) struct Row {
    /// What they have in common: a sun, or a split.
    pub title: String,
    /// Nearest first.
    pub samples: Vec<Sample>,
}

/// A frame's left image with its boxes.
pub(super) struct Sample {
    /// Frame, split and distance, in words.
    pub caption: String,
    /// At most [`SAMPLE_WIDTH`] wide.
    pub picture: RgbImage,
}

/// Draws samples of every sun, or of every split where suns are unknown, over the distances that
/// occur.
pub(super) fn draw(
    dataset: &StereoDataset,
    kind: BoxKind,
    progress: &dyn Progress,
) -> Result<Vec<Row>> {
    let chosen = choose(dataset, kind);
    let total: usize = chosen.iter().map(|(_, frames)| frames.len()).sum();
    progress.begin("drawing samples", total as u64);
    let mut failure = None;
    let mut rows = Vec::new();
    for (title, frames) in chosen {
        let drawn: Vec<Result<Sample>> = frames
            .par_iter()
            .map(|frame| {
                if progress.interrupted() {
                    return Err(Error::Interrupted {
                        resume: "run the same command again".to_owned(),
                    });
                }
                let sample = sample(dataset, frame, kind);
                progress.advance(1);
                sample
            })
            .collect();
        let mut samples = Vec::new();
        for outcome in drawn {
            match outcome {
                Ok(sample) => samples.push(sample),
                Err(error @ Error::Interrupted { .. }) => return Err(error),
                // `validate` names broken images; here they are only not shown.
                Err(error) => failure = failure.or(Some(error)),
            }
        }
        if !samples.is_empty() {
            rows.push(Row { title, samples });
        }
    }
    progress.end();
    match failure {
        Some(error) if rows.is_empty() => Err(error),
        _ => Ok(rows),
    }
}

/// The distance that a frame stands for: its nearest vehicle's that counts.
fn nearest_m(frame: &Frame, kind: BoxKind) -> Option<f64> {
    let judged = frame.left.labels_of(kind).filter(|label| !label.ignored);
    judged
        .filter_map(|label| label.distance_m)
        .min_by(f64::total_cmp)
}

/// Titles and frames of the rows.
fn choose(dataset: &StereoDataset, kind: BoxKind) -> Vec<(String, Vec<&Frame>)> {
    let suns_known = dataset.frames.iter().any(|frame| frame.row.sun.is_some());
    let mut groups: BTreeMap<(usize, String), Vec<&Frame>> = BTreeMap::new();
    for frame in &dataset.frames {
        let title = match &frame.row.sun {
            Some(sun) => sun.clone(),
            None if suns_known => "unknown sun".to_owned(),
            None => frame.row.split.to_string(),
        };
        // In the order of the day.
        let place = Sun::ALL.iter().position(|sun| sun.name() == title);
        let key = (place.unwrap_or(usize::MAX), title);
        groups.entry(key).or_default().push(frame);
    }
    groups
        .into_iter()
        .take(MOST_ROWS)
        .map(|((_, title), mut frames)| {
            // Frames with vehicles first; then evenly over the order of their distances.
            if frames.iter().any(|frame| nearest_m(frame, kind).is_some()) {
                frames.retain(|frame| nearest_m(frame, kind).is_some());
            }
            frames.sort_by(|a, b| {
                let distance = |frame: &Frame| nearest_m(frame, kind).unwrap_or(f64::INFINITY);
                let order = distance(a).total_cmp(&distance(b));
                order.then(a.row.stamp.cmp(&b.row.stamp))
            });
            let count = frames.len().min(COLUMNS);
            let last = frames.len() - 1;
            let spread = |i: usize| if count > 1 { i * last / (count - 1) } else { 0 };
            (title, (0..count).map(|i| frames[spread(i)]).collect())
        })
        .collect()
}

fn sample(dataset: &StereoDataset, frame: &Frame, kind: BoxKind) -> Result<Sample> {
    let camera = &dataset.rig().left;
    let image = frame.left.load(camera)?;
    let scale = f64::from(SAMPLE_WIDTH) / f64::from(camera.width);
    let height = ((f64::from(camera.height) * scale).round() as u32).max(1);
    let small = imageops::resize(&image, SAMPLE_WIDTH, height, imageops::FilterType::Triangle);
    let labels: Vec<&Label> = frame.left.labels_of(kind).collect();
    let annotations: Vec<Annotation> = labels
        .iter()
        .map(|label| Annotation {
            left: Some(scaled(&label.box_pixel, scale)),
            right: None,
            text: text(label),
        })
        .collect();
    let mut picture = annotate_pair(&small, &RgbImage::new(0, 0), &annotations);
    let judged = labels.iter().filter(|label| !label.ignored);
    let nearest = judged.min_by(|a, b| {
        let distance = |label: &Label| label.distance_m.unwrap_or(f64::INFINITY);
        distance(a).total_cmp(&distance(b))
    });
    if let Some(label) = nearest
        && label.box_pixel.width() * scale < SMALL_PX
    {
        enlarge(&image, &label.box_pixel, scale, &mut picture);
    }
    let distance = nearest_m(frame, kind).map(|distance_m| format!("{distance_m:.1} m, "));
    let caption = format!(
        "{}{}, frame {}",
        distance.unwrap_or_default(),
        frame.row.split,
        frame.name()
    );
    Ok(Sample { caption, picture })
}

fn text(label: &Label) -> String {
    match label.distance_m {
        _ if label.ignored => "ignored".to_owned(),
        Some(distance_m) => format!("{distance_m:.0} m"),
        None => String::new(),
    }
}

fn scaled(area: &PixelBox, scale: f64) -> PixelBox {
    PixelBox::new(
        area.x_min * scale,
        area.y_min * scale,
        area.x_max * scale,
        area.y_max * scale,
    )
}

/// Puts the vehicle's surroundings, enlarged, into the corner that is farthest from it.
fn enlarge(image: &RgbImage, area: &PixelBox, scale: f64, picture: &mut RgbImage) {
    let side = picture.height() * 2 / 5;
    let [x, y] = area.center();
    let wanted = (area.squared().width() * 1.5).max(f64::from(side) / 6.0);
    let most = f64::from(image.width().min(image.height()));
    let cut = wanted.min(most).round().max(1.0);
    let start = |center: f64, length: u32| {
        (center - cut / 2.0)
            .clamp(0.0, f64::from(length) - cut)
            .round() as u32
    };
    let (left, top) = (start(x, image.width()), start(y, image.height()));
    let crop = imageops::crop_imm(image, left, top, cut as u32, cut as u32).to_image();
    let crop = imageops::resize(&crop, side, side, imageops::FilterType::CatmullRom);
    let frame = 2;
    let border = RgbImage::from_pixel(side + 2 * frame, side + 2 * frame, image::Rgb([255; 3]));
    let at_left = x * scale > f64::from(picture.width()) / 2.0;
    let at_top = y * scale > f64::from(picture.height()) / 2.0;
    let place = |near: bool, length: u32| {
        if near {
            0
        } else {
            i64::from(length - (side + 2 * frame).min(length))
        }
    };
    let (px, py) = (
        place(at_left, picture.width()),
        place(at_top, picture.height()),
    );
    imageops::replace(picture, &border, px, py);
    imageops::replace(picture, &crop, px + i64::from(frame), py + i64::from(frame));
}
