//! A trained detector ready for use: weights, what they were trained for, images to boxes.

use std::path::Path;

use burn::module::Module as _;
use burn::tensor::{Device, Tensor, TensorData};
use image::RgbImage;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::nms::{Candidate, NmsConfig, non_maximum_suppression};
use super::weights::{load_detector, tensor_name};
use super::{Detection, Scale, Yolo11, decode};
use crate::dataset::BoxKind;
use crate::error::{Error, Result};
use crate::geometry::StereoRig;
use crate::geometry::letterbox::{Enlarging, Frame, Letterbox, STRIDE, Size};
use crate::weights::StateDict;

/// What the detector's weights file says of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DetectorHeader {
    /// Always "yolo11".
    pub network: String,
    /// Version of the program that wrote it.
    pub version: String,
    /// Size of the network.
    pub scale: Scale,
    /// Class names.
    pub classes: Vec<String>,
    /// Long side of the input, pixels; the short one follows from the image.
    pub image_size: u32,
    /// What is done to pixel values: "0..1", divided by 255.
    pub normalization: String,
    /// Kind of box it was trained on.
    pub box_kind: BoxKind,
    /// Rig it was trained for.
    pub rig: StereoRig,
}

impl DetectorHeader {
    /// The network's name in headers.
    pub const NETWORK: &'static str = "yolo11";
    /// The only normalisation there is.
    pub const NORMALIZATION: &'static str = "0..1";
}

/// A trained detector.
#[derive(Debug, Clone)]
pub struct VehicleDetector {
    network: Yolo11,
    header: DetectorHeader,
    device: Device,
}

/// What is found in one image, in the coordinates of the network's input.
#[derive(Debug, Clone)]
pub struct LetterboxedCandidates {
    /// Best first.
    pub candidates: Vec<Candidate>,
    /// The way between image and input.
    pub letterbox: Letterbox,
}

impl LetterboxedCandidates {
    /// The same in pixels of the image; what lies outside of it is left out.
    pub fn detections(&self) -> Vec<Detection> {
        self.candidates
            .iter()
            .map(|candidate| Detection {
                box_pixel: self
                    .letterbox
                    .pixel_from_letterbox(&candidate.box_letterbox),
                score: candidate.score,
                class: candidate.class,
            })
            .filter(|detection| detection.box_pixel.is_valid())
            .collect()
    }
}

impl VehicleDetector {
    /// Wraps a network, its normalisation merged, for inference on its device.
    pub fn new(network: &Yolo11, header: DetectorHeader, device: &Device) -> Self {
        Self::fold(network.valid(), header, device)
    }

    /// Folds layer after layer, giving each one's weights free where nobody else holds them.
    fn fold(network: Yolo11, header: DetectorHeader, device: &Device) -> Self {
        Self {
            network: network.folded(),
            header,
            device: device.clone().without_autodiff(),
        }
    }

    /// Loads weights that training wrote.
    ///
    /// # Errors
    /// A file that is missing, damaged or of another network.
    pub fn load(path: &Path, device: &Device) -> Result<Self> {
        let state = StateDict::load(path)?;
        let header: Option<DetectorHeader> = state.header()?;
        let Some(header) = header.filter(|header| header.network == DetectorHeader::NETWORK) else {
            return Err(Error::weights(
                path,
                "does not say what it was trained for",
                "give the detector weights that `train` wrote; to start from foreign weights use \
                 `train --weights`",
            ));
        };
        let (network, _) = load_detector(&state, header.scale, header.classes.len(), device)?;
        drop(state);
        let inference = network.valid();
        drop(network);
        Ok(Self::fold(inference, header, device))
    }

    /// Saves weights with their header.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn save(network: &Yolo11, header: &DetectorHeader, path: &Path) -> Result<()> {
        StateDict::of(network, tensor_name)
            .with_header(header)?
            .save(path)
    }

    /// What the weights were trained for.
    pub fn header(&self) -> &DetectorHeader {
        &self.header
    }

    /// Detects in images of any sizes.
    ///
    /// # Errors
    /// An image of impossible size, or a device that fails.
    pub fn detect(&self, images: &[&RgbImage], nms: &NmsConfig) -> Result<Vec<Vec<Detection>>> {
        let found = self.detect_letterboxed(images, nms)?;
        Ok(found
            .iter()
            .map(LetterboxedCandidates::detections)
            .collect())
    }

    /// [`VehicleDetector::detect`] in the coordinates of the network's input. Images of one size
    /// run as one batch.
    ///
    /// # Errors
    /// As [`VehicleDetector::detect`].
    pub fn detect_letterboxed(
        &self,
        images: &[&RgbImage],
        nms: &NmsConfig,
    ) -> Result<Vec<LetterboxedCandidates>> {
        let mut found = Vec::with_capacity(images.len());
        for group in images.chunk_by(|a, b| a.dimensions() == b.dimensions()) {
            let (width, height) = group[0].dimensions();
            let letterbox = letterbox(Size::new(width, height), self.header.image_size)?;
            let size = letterbox.size();
            let mut planes = vec![0.0; group.len() * 3 * size.area()];
            planes
                .par_chunks_exact_mut(3 * size.area())
                .zip(group)
                .try_for_each(|(planes, image)| letterbox.write_planes(image, planes))?;
            let shape = [group.len(), 3, size.height as usize, size.width as usize];
            let input = Tensor::<4>::from_data(TensorData::new(planes, shape), &self.device);
            let decoded = decode::decode(&self.network.forward(input));
            let values = decoded.try_into_vec_as::<f32>().map_err(|source| {
                Error::device(
                    format!("{:?}", self.device),
                    source.to_string(),
                    "try another device",
                )
            })?;
            for values in values.chunks_exact(values.len() / group.len()) {
                let candidates = non_maximum_suppression(values, self.header.classes.len(), nms)?;
                found.push(LetterboxedCandidates {
                    candidates,
                    letterbox,
                });
            }
        }
        Ok(found)
    }
}

/// The letterbox of an image: long side `image_size`, the short one as it comes, both padded to
/// multiples of 32.
///
/// # Errors
/// An image of impossible size.
pub fn letterbox(original: Size, image_size: u32) -> Result<Letterbox> {
    let long_side = image_size.next_multiple_of(STRIDE);
    Letterbox::new(
        original,
        Size::square(long_side),
        Frame::MinimumRectangle { stride: STRIDE },
        Enlarging::Allowed,
    )
}
