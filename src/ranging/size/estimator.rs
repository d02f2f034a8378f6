//! A trained size network ready for use: boxes to witnesses.

use std::path::Path;

use burn::module::Module as _;
use burn::tensor::{Device, Tensor, TensorData};
use image::RgbImage;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::guard::{FrameLimits, Guard, GuardEvidence, GuardLimits};
use super::view::write_crop;
use super::{SIDE_PX, SizeConfig, SizeNetwork, SizeView, VIEW_CHANNELS, VIEW_NUMBERS};
use crate::dataset::BoxKind;
use crate::error::{Error, Result};
use crate::geometry::{Camera, PixelBox, StereoRig};
use crate::ranging::SizeWitness;
use crate::weights::StateDict;

/// Crops that run as one batch.
const BATCH: usize = 16;

/// Bounds of the logarithm of a spread, in standard deviations of the training vehicles.
const LOG_SPREADS: [f64; 2] = [-4.0, 2.0];

/// Spread of the log-size where nothing is known: a factor of two either way.
const UNKNOWN_LOG_SIZE: f64 = 0.7;

/// Spread of the extent where nothing is known, metres: anything from a motorcycle to a lorry.
const UNKNOWN_EXTENT_M: f64 = 1.2;

/// Ratios of focal length in pixels, to either side, from which on cameras are strange and from which
/// on nothing is known of their pictures: how sharp a crop is follows from it.
const FOCAL_RATIOS: GuardLimits = GuardLimits {
    near: 1.3,
    far: 1.8,
};

/// Mean extent where training had none to learn from, metres.
const USUAL_EXTENT_M: f64 = 1.2;

/// Mean and standard deviation of a number over the training vehicles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Moments {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub std: f64,
}

impl Moments {
    /// Of some numbers; none of fewer than two.
    pub fn of(values: &[f64]) -> Option<Self> {
        if values.len() < 2 {
            return None;
        }
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let squares = values.iter().map(|value| (value - mean).powi(2));
        Some(Self {
            mean,
            std: (squares.sum::<f64>() / count).sqrt().max(1e-3),
        })
    }

    /// A number in these standard deviations from this mean.
    pub fn standard(&self, value: f64) -> f64 {
        (value - self.mean) / self.std
    }
}

/// What vehicles of scenes that were not trained on said of the network's spreads.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Factor of the log-size's spread.
    pub log_size: f64,
    /// Factor of the extent's spread.
    pub extent: f64,
    /// How far from the training vehicles the network is believed; absent where it is always.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub guard: Option<GuardLimits>,
    /// The same of all vehicles of an image together.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<FrameLimits>,
}

impl Calibration {
    /// Leaves the spreads as they are.
    pub const NONE: Self = Self {
        log_size: 1.0,
        extent: 1.0,
        guard: None,
        frame: None,
    };
}

/// What the size network's weights file says of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SizeHeader {
    /// Always "size".
    pub network: String,
    /// Version of the program that wrote it.
    pub version: String,
    /// Kind of box it was trained on.
    pub box_kind: BoxKind,
    /// Class names of the vehicles it was trained on.
    pub classes: Vec<String>,
    /// Rig that took the training images. Inputs are angles, so that others will do.
    pub rig: StereoRig,
    /// Log-size of the training vehicles.
    pub log_size: Moments,
    /// Extent of the training vehicles along the line of sight, metres; absent where the dataset does
    /// not tell it, which makes the extent unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub extent: Option<Moments>,
    /// Corrections of the spreads; absent until training is over.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<Calibration>,
}

impl SizeHeader {
    /// The network's name in headers.
    pub const NETWORK: &'static str = "size";
}

/// What the network said of a vehicle before spreads are corrected.
#[derive(Debug, Clone, PartialEq)]
pub struct RawWitness {
    /// Of the network itself.
    pub said: SizeWitness,
    /// What the guard judges.
    pub evidence: GuardEvidence,
}

/// A trained size network.
#[derive(Debug, Clone)]
pub struct SizeEstimator {
    network: SizeNetwork,
    header: SizeHeader,
    guard: Option<Guard>,
    device: Device,
}

/// Crops and the numbers beside them, before they go to a device.
#[derive(Debug, Clone, Default)]
pub struct SizeInputs {
    /// `[count, SIDE_PX, SIDE_PX, VIEW_CHANNELS]`.
    pub pixels: Vec<f32>,
    /// One of each crop.
    pub views: Vec<SizeView>,
}

impl SizeInputs {
    /// Values of one crop.
    pub const PIXELS: usize = SIDE_PX as usize * SIDE_PX as usize * VIEW_CHANNELS;

    /// Tensors of the crops and of the numbers.
    pub fn into_tensors(self, device: &Device) -> (Tensor<4>, Tensor<2>) {
        let count = self.views.len();
        let side = SIDE_PX as usize;
        let pixels = TensorData::new(self.pixels, [count, side, side, VIEW_CHANNELS]);
        let numbers: Vec<f32> = self.views.iter().flat_map(|view| view.numbers).collect();
        let numbers = TensorData::new(numbers, [count, VIEW_NUMBERS]);
        (
            Tensor::from_data(pixels, device),
            Tensor::from_data(numbers, device),
        )
    }
}

impl SizeEstimator {
    /// Wraps a network for inference on its device.
    pub fn new(
        network: &SizeNetwork,
        header: SizeHeader,
        guard: Option<Guard>,
        device: &Device,
    ) -> Self {
        Self {
            network: network.valid().folded(),
            header,
            guard,
            device: device.clone().without_autodiff(),
        }
    }

    /// Loads weights that training wrote.
    ///
    /// # Errors
    /// A file that is missing, damaged or of another network.
    pub fn load(path: &Path, device: &Device) -> Result<Self> {
        let mut state = StateDict::load(path)?;
        let header: Option<SizeHeader> = state.header()?;
        let Some(header) = header.filter(|header| header.network == SizeHeader::NETWORK) else {
            return Err(Error::weights(
                path,
                "does not say what it was trained for",
                "give the size weights that `train` wrote",
            ));
        };
        let guard = Guard::take_from(&mut state.tensors)?;
        let device = device.clone().without_autodiff();
        let network = state.apply(SizeConfig::new().init(&device), str::to_owned)?;
        Ok(Self::new(&network, header, guard, &device))
    }

    /// Saves weights with their header, and the guard once there is one.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn save(
        network: &SizeNetwork,
        header: &SizeHeader,
        guard: Option<&Guard>,
        path: &Path,
    ) -> Result<()> {
        let mut state = StateDict::of(network, str::to_owned).with_header(header)?;
        if let Some(guard) = guard {
            guard.save_into(&mut state.tensors);
        }
        state.save(path)
    }

    /// What the weights were trained for.
    pub fn header(&self) -> &SizeHeader {
        &self.header
    }

    /// A witness of each box in the left image of a rig; all vehicles of it together, since they say
    /// of each other whether such pictures are known.
    ///
    /// # Errors
    /// A device that fails.
    pub fn witnesses(
        &self,
        left_image: &RgbImage,
        boxes: &[PixelBox],
        rig: &StereoRig,
    ) -> Result<Vec<SizeWitness>> {
        self.witnesses_of(left_image, boxes, &rig.left)
    }

    /// A witness of each box in an image of a camera.
    ///
    /// # Errors
    /// A device that fails.
    pub fn witnesses_of(
        &self,
        image: &RgbImage,
        boxes: &[PixelBox],
        camera: &Camera,
    ) -> Result<Vec<SizeWitness>> {
        let mut raw = Vec::with_capacity(boxes.len());
        for batch in boxes.chunks(BATCH) {
            let mut pixels = vec![0.0; batch.len() * SizeInputs::PIXELS];
            let views = pixels
                .par_chunks_exact_mut(SizeInputs::PIXELS)
                .zip(batch)
                .map(|(pixels, area)| {
                    let tone = write_crop(image, area, pixels);
                    SizeView::of_box(area, camera).with_picture(pixels, tone)
                })
                .collect();
            raw.extend(self.examine(SizeInputs { pixels, views })?);
        }
        Ok(self.corrected(&raw, camera))
    }

    /// What the network says of crops, before its spreads are corrected.
    ///
    /// # Errors
    /// A device that fails.
    pub(crate) fn examine(&self, inputs: SizeInputs) -> Result<Vec<RawWitness>> {
        let views = inputs.views.clone();
        let (pixels, numbers_tensor) = inputs.into_tensors(&self.device);
        let output = self.network.forward(pixels, numbers_tensor);
        let read = |tensor: Tensor<2>| {
            tensor.try_into_vec_as::<f64>().map_err(|source| {
                Error::device(
                    format!("{:?}", self.device),
                    source.to_string(),
                    "try another device",
                )
            })
        };
        let [_, width] = output.features.dims();
        let said = read(output.witness)?;
        let features = read(output.features)?;
        let each = said
            .chunks_exact(SizeNetwork::WITNESS)
            .zip(features.chunks_exact(width))
            .zip(&views);
        Ok(each
            .map(|((said, features), view)| RawWitness {
                said: self.header.witness(said),
                evidence: GuardEvidence {
                    angles: view.angles.map(f64::ln).to_vec(),
                    picture: view.picture.to_vec(),
                    features: features.to_vec(),
                },
            })
            .collect())
    }

    /// The witnesses of one image of a camera with their spreads corrected: wider by what unseen scenes
    /// said, and as wide as ignorance where the guard does not know vehicle, image or camera.
    pub(crate) fn corrected(&self, raw: &[RawWitness], camera: &Camera) -> Vec<SizeWitness> {
        let calibration = self.header.calibration.unwrap_or(Calibration::NONE);
        let focal_ratio = camera.focal_x_px / self.header.rig.left.focal_x_px;
        let unknown_camera = FOCAL_RATIOS.unknown(focal_ratio.max(1.0 / focal_ratio));
        let distances: Option<Vec<f64>> = self.guard.as_ref().map(|guard| {
            let each = raw.iter().map(|raw| guard.distance(&raw.evidence));
            each.collect()
        });
        let unknown_image = match (calibration.frame, &distances) {
            (Some(limits), Some(distances)) => limits.unknown(distances),
            _ => 0.0,
        };
        raw.iter()
            .enumerate()
            .map(|(index, raw)| {
                let unknown_vehicle = match (calibration.guard, &distances) {
                    (Some(limits), Some(distances)) => limits.unknown(distances[index]),
                    _ => 0.0,
                };
                let unknown = unknown_camera.max(unknown_image).max(unknown_vehicle);
                widened(&raw.said, &calibration, unknown)
            })
            .collect()
    }
}

/// A witness with its spreads corrected, and widened by how unknown its vehicle is.
fn widened(said: &SizeWitness, calibration: &Calibration, unknown: f64) -> SizeWitness {
    let wide = |std: f64, factor: f64, unknown_std: f64| {
        (std * factor).hypot(unknown.sqrt() * unknown_std)
    };
    SizeWitness {
        log_size_mean: said.log_size_mean,
        log_size_std: wide(said.log_size_std, calibration.log_size, UNKNOWN_LOG_SIZE),
        extent_mean_m: said.extent_mean_m,
        extent_std_m: wide(said.extent_std_m, calibration.extent, UNKNOWN_EXTENT_M),
        unknown,
    }
}

impl SizeHeader {
    /// The network's outputs in logarithms and metres.
    fn witness(&self, said: &[f64]) -> SizeWitness {
        let spread = |log: f64| log.clamp(LOG_SPREADS[0], LOG_SPREADS[1]).exp();
        let (extent_mean_m, extent_std_m) = match &self.extent {
            Some(extent) => (
                extent.mean + extent.std * said[2],
                extent.std * spread(said[3]),
            ),
            None => (USUAL_EXTENT_M, UNKNOWN_EXTENT_M),
        };
        SizeWitness {
            log_size_mean: self.log_size.mean + self.log_size.std * said[0],
            log_size_std: self.log_size.std * spread(said[1]),
            extent_mean_m,
            extent_std_m,
            unknown: 0.0,
        }
    }
}
