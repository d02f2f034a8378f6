//! Training vehicles of the size network: one image of one vehicle each, with its truth.

use std::collections::BTreeMap;
use std::sync::Arc;

use image::RgbImage;
use image::imageops::crop_imm;

use super::extent::{Maps, cuboid_surface_z_m};
use crate::dataset::{
    BoxKind, Decoded, DecodedCache, Frame, ObjectRow, Side, Split, StereoDataset, StereoLabel,
    read_objects_csv,
};
use crate::error::{Error, Result};
use crate::geometry::{PixelBox, StereoRig};
use crate::progress::{Progress, in_parallel};
use crate::ranging::size::{SizeNetwork, crop_area};

/// Side of the kept part of an image over that of the crop: what moved boxes and crops still need.
const KEPT: f64 = 1.5;

/// A vehicle in one image.
#[derive(Debug, Clone)]
pub struct Sample {
    /// Its frame.
    pub frame: Arc<Frame>,
    /// Which image.
    pub side: Side,
    /// Its box there.
    pub box_pixel: PixelBox,
    /// Depth of its centre, metres.
    pub z_m: f64,
    /// How far its centre lies behind its visible surface along the optical axis, metres.
    pub extent_m: Option<f64>,
    /// Cosine and sine of the azimuth, sine of the elevation, logarithms of length, width and height.
    pub pose: Option<[f64; SizeNetwork::POSE]>,
}

/// A part of an image.
#[derive(Debug)]
pub struct Patch {
    /// Its pixels.
    pub image: RgbImage,
    /// Where its corner is in the image, pixels.
    pub corner: [f64; 2],
}

impl Decoded for Patch {
    fn bytes(&self) -> usize {
        self.image.as_raw().len()
    }
}

/// The vehicles of one split, each in both images, and the pixels around them.
pub struct SampleSet {
    /// The samples.
    pub samples: Vec<Sample>,
    patches: DecodedCache<usize, Patch>,
    rig: StereoRig,
}

impl SampleSet {
    /// Opens the vehicles of a split and keeps the pixels around them, up to so many bytes.
    ///
    /// # Errors
    /// Images or an `objects.csv` that cannot be read, or the user's wish to stop.
    pub fn open(
        dataset: &StereoDataset,
        split: Split,
        kind: BoxKind,
        budget_bytes: usize,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let objects = objects(dataset)?;
        let rig = *dataset.rig();
        let frames = dataset.split(split);
        let found = in_parallel(
            progress,
            "size, vehicles",
            "run the same command with --resume",
            &frames,
            |frame| samples_of(dataset, frame, kind, &objects),
        )?;
        let mut samples = Vec::new();
        let mut patches = Vec::new();
        for (sample, patch) in found.into_iter().flatten() {
            samples.push(sample);
            patches.push(patch);
        }
        let cache = DecodedCache::new(budget_bytes);
        for (index, patch) in patches.into_iter().enumerate() {
            cache.get(index, || Ok(patch))?;
        }
        Ok(Self {
            samples,
            patches: cache,
            rig,
        })
    }

    /// The pixels around a sample.
    ///
    /// # Errors
    /// An image that cannot be read.
    pub fn patch(&self, index: usize) -> Result<Arc<Patch>> {
        let sample = &self.samples[index];
        self.patches.get(index, || {
            let image = sample
                .frame
                .images()
                .find(|(side, _)| *side == sample.side)
                .map(|(_, image)| image);
            let Some(image) = image else {
                return Err(Error::training(
                    format!("frame {} lost an image", sample.frame.name()),
                    "report this as a defect",
                ));
            };
            let pixels = image.load(self.rig.camera(sample.side))?;
            Ok(cut(&pixels, &sample.box_pixel))
        })
    }
}

/// `objects.csv` by frame and vehicle; nothing where there is none.
fn objects(dataset: &StereoDataset) -> Result<BTreeMap<(u64, u32), ObjectRow>> {
    let path = dataset.folder.join("objects.csv");
    if !path.exists() {
        return Ok(BTreeMap::new());
    }
    let rows = read_objects_csv(path)?;
    Ok(rows
        .into_iter()
        .map(|row| ((row.stamp, row.id), row))
        .collect())
}

/// The samples of a frame and the pixels around them.
fn samples_of(
    dataset: &StereoDataset,
    frame: &Frame,
    kind: BoxKind,
    objects: &BTreeMap<(u64, u32), ObjectRow>,
) -> Result<Vec<(Sample, Patch)>> {
    let labels = frame.vehicles(kind);
    if labels.is_empty() {
        return Ok(Vec::new());
    }
    let rig = dataset.rig();
    let shared = Arc::new(frame.clone());
    let images = frame.load(rig)?;
    let mut samples = Vec::with_capacity(2 * labels.len());
    for (side, image) in Side::ALL.into_iter().zip(&images) {
        let maps = Maps::read(&dataset.folder, frame.row.stamp, side);
        for label in &labels {
            let object = objects.get(&(frame.row.stamp, label.id));
            let box_pixel = match side {
                Side::Left => label.left.box_pixel,
                Side::Right => label.right.box_pixel,
            };
            if !box_pixel.is_valid() {
                continue;
            }
            let z_m = object.map_or_else(|| depth_m(label, rig), |object| object.z_m);
            let surface_z_m = match (&maps, object) {
                (Some(maps), _) => maps.surface_z_m(label.id, &box_pixel, rig),
                (None, Some(object)) => cuboid_surface_z_m(object, &box_pixel, side, rig),
                (None, None) => None,
            };
            let sample = Sample {
                frame: Arc::clone(&shared),
                side,
                box_pixel,
                z_m,
                extent_m: surface_z_m.map(|surface_z_m| z_m - surface_z_m),
                pose: object.map(pose),
            };
            samples.push((sample, cut(image, &box_pixel)));
        }
    }
    Ok(samples)
}

/// Depth of a labelled vehicle's centre, metres: its distance along the ray from the rig's midpoint,
/// which lies between those of both cameras.
fn depth_m(label: &StereoLabel, rig: &StereoRig) -> f64 {
    let [left_x, left_y, _] = rig.left.camera_from_pixel(label.left.center_pixel);
    let [right_x, right_y, _] = rig.right.camera_from_pixel(label.right.center_pixel);
    let (x, y) = (
        f64::midpoint(left_x, right_x),
        f64::midpoint(left_y, right_y),
    );
    label.distance_m / (x * x + y * y + 1.0).sqrt()
}

fn pose(object: &ObjectRow) -> [f64; SizeNetwork::POSE] {
    let azimuth = object.azimuth_deg.to_radians();
    [
        azimuth.cos(),
        azimuth.sin(),
        object.elevation_deg.to_radians().sin(),
        object.length_m.max(0.1).ln(),
        object.width_m.max(0.1).ln(),
        object.height_m.max(0.1).ln(),
    ]
}

/// The part of an image around a box.
fn cut(image: &RgbImage, area: &PixelBox) -> Patch {
    let window = crop_area(area);
    let side = KEPT * window.width();
    let (width, height) = (f64::from(image.width()), f64::from(image.height()));
    let part = PixelBox::from_center(window.center(), side, side).clipped(width, height);
    let (x, y) = (part.x_min.floor(), part.y_min.floor());
    let (columns, rows) = (
        (part.x_max.ceil() - x).max(1.0) as u32,
        (part.y_max.ceil() - y).max(1.0) as u32,
    );
    Patch {
        image: crop_imm(image, x as u32, y as u32, columns, rows).to_image(),
        corner: [x, y],
    }
}
