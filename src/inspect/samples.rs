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
const SAMPLE_WIDTH: u32 = 400;

/// Samples in a row, nearest first.
const COLUMNS: usize = 6;

/// Images of driving scenes are wide and low; from this ratio of width to height on, fewer and
/// wider samples show them.
const WIDE: f64 = 2.4;

/// Width of a sample of a wide image, pixels.
const WIDE_SAMPLE_WIDTH: u32 = 620;

/// Samples of wide images in a row.
const WIDE_COLUMNS: usize = 4;

/// Stereo pairs that are shown whole.
const PAIRS: usize = 3;

/// Width of an image of a pair, pixels.
const PAIR_IMAGE_WIDTH: u32 = 620;

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
    /// The picture.
    pub picture: RgbImage,
}

/// Everything that is shown.
pub(super) struct Samples {
    /// Left images by sun and distance.
    pub rows: Vec<Row>,
    /// Left and right images side by side.
    pub pairs: Vec<Sample>,
}

/// Width of a sample and their number in a row.
fn grid(dataset: &StereoDataset) -> (u32, usize) {
    let camera = &dataset.rig().left;
    if f64::from(camera.width) > WIDE * f64::from(camera.height) {
        (WIDE_SAMPLE_WIDTH, WIDE_COLUMNS)
    } else {
        (SAMPLE_WIDTH, COLUMNS)
    }
}

/// Draws samples of every sun, or of every split where suns are unknown, over the distances that
/// occur.
pub(super) fn draw(
    dataset: &StereoDataset,
    kind: BoxKind,
    progress: &dyn Progress,
) -> Result<Samples> {
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
        _ => Ok(Samples {
            rows,
            pairs: pairs(dataset, kind),
        }),
    }
}

/// Pairs from the first, the middle and the last third of the distances.
fn pairs(dataset: &StereoDataset, kind: BoxKind) -> Vec<Sample> {
    let mut frames: Vec<&Frame> = dataset
        .frames
        .iter()
        .filter(|frame| !frame.vehicles(kind).is_empty())
        .collect();
    frames.sort_by(|a, b| {
        let distance = |frame: &Frame| nearest_m(frame, kind).unwrap_or(f64::INFINITY);
        let order = distance(a).total_cmp(&distance(b));
        order.then(a.row.stamp.cmp(&b.row.stamp))
    });
    let count = frames.len().min(PAIRS);
    (0..count)
        .filter_map(|i| {
            let frame = frames[(2 * i + 1) * frames.len() / (2 * count)];
            pair_sample(dataset, frame, kind).ok()
        })
        .collect()
}

fn pair_sample(dataset: &StereoDataset, frame: &Frame, kind: BoxKind) -> Result<Sample> {
    let rig = dataset.rig();
    let [left, right] = frame.load(rig)?;
    let scale = f64::from(PAIR_IMAGE_WIDTH) / f64::from(rig.left.width);
    let annotations: Vec<Annotation> = frame
        .vehicles(kind)
        .iter()
        .map(|vehicle| Annotation {
            left: Some(scaled(&vehicle.left.box_pixel, scale)),
            right: Some(scaled(&vehicle.right.box_pixel, scale)),
            text: text(&vehicle.left),
        })
        .collect();
    let [left, right] = [left, right].map(|image| shrunk(&image, PAIR_IMAGE_WIDTH));
    Ok(Sample {
        caption: format!(
            "left and right image, {}, frame {}",
            frame.row.split,
            frame.name()
        ),
        picture: annotate_pair(&left, &right, &annotations),
    })
}

/// An image at this width.
fn shrunk(image: &RgbImage, width: u32) -> RgbImage {
    let height = f64::from(image.height()) * f64::from(width) / f64::from(image.width());
    let height = (height.round() as u32).max(1);
    imageops::resize(image, width, height, imageops::FilterType::Triangle)
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
    let (_, columns) = grid(dataset);
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
            let count = frames.len().min(columns);
            let last = frames.len() - 1;
            let spread = |i: usize| if count > 1 { i * last / (count - 1) } else { 0 };
            (title, (0..count).map(|i| frames[spread(i)]).collect())
        })
        .collect()
}

fn sample(dataset: &StereoDataset, frame: &Frame, kind: BoxKind) -> Result<Sample> {
    let camera = &dataset.rig().left;
    let image = frame.left.load(camera)?;
    let (width, _) = grid(dataset);
    let scale = f64::from(width) / f64::from(camera.width);
    let small = shrunk(&image, width);
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
        // Its box alone: what is ignored stands in crowds.
        _ if label.ignored => String::new(),
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
