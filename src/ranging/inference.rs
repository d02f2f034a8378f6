//! A trained distance network ready for use: pairs of boxes to metres.

use std::path::Path;

use burn::module::Module as _;
use burn::tensor::{Device, Tensor, TensorData};
use image::RgbImage;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{Crops, RangingConfig, RangingNetwork, Reading, Readout, VehicleSizes};
use crate::dataset::{BoxKind, CompositeSize};
use crate::error::{Error, Result};
use crate::geometry::{PixelBox, StereoRig};
use crate::imaging::ChannelStatistics;
use crate::weights::StateDict;

/// Composites that run as one batch.
const BATCH: usize = 16;

/// What the distance network's weights file says of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangingHeader {
    /// Always "twin".
    pub network: String,
    /// Version of the program that wrote it.
    pub version: String,
    /// Size of the composite, "height x width".
    pub composite: CompositeSize,
    /// What the network's output stands for; files of older versions do not say and mean the
    /// distance.
    #[serde(default)]
    pub readout: Readout,
    /// Which crops the composite holds; files of older versions do not say and hold both.
    #[serde(default)]
    pub crops: Crops,
    /// Sizes of the vehicles it was trained on, where it is given the measured disparity: they
    /// judge what was measured. Absent where it is not given the disparity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sizes: Option<VehicleSizes>,
    /// Per-channel mean and deviation that normalise the composite.
    pub normalization: ChannelStatistics,
    /// Kind of box it was trained on.
    pub box_kind: BoxKind,
    /// Class names of the vehicles it was trained on.
    pub classes: Vec<String>,
    /// Rig it was trained for.
    pub rig: StereoRig,
}

impl RangingHeader {
    /// The network's name in headers.
    pub const NETWORK: &'static str = "twin";

    /// Settings of the network that takes what this header describes.
    pub fn config(&self) -> RangingConfig {
        RangingConfig::for_size(self.composite).with_geometry(self.geometry_numbers())
    }
}

/// A vehicle seen in both images.
#[derive(Debug, Clone, Copy)]
pub struct Sighting<'a> {
    /// Left and right image.
    pub images: [&'a RgbImage; 2],
    /// Its box in the left and in the right image, pixels.
    pub boxes: [PixelBox; 2],
}

/// A trained distance network.
#[derive(Debug, Clone)]
pub struct DistanceEstimator {
    network: RangingNetwork,
    header: RangingHeader,
    device: Device,
}

impl DistanceEstimator {
    /// Wraps a network for inference on its device.
    pub fn new(network: &RangingNetwork, header: RangingHeader, device: &Device) -> Self {
        let device = device.clone().without_autodiff();
        Self {
            network: network.valid().packed(),
            header,
            device,
        }
    }

    /// Loads weights that training wrote.
    ///
    /// # Errors
    /// A file that is missing, damaged or of another network.
    pub fn load(path: &Path, device: &Device) -> Result<Self> {
        let (network, header) = Self::read(path, device)?;
        Ok(Self::new(&network, header, device))
    }

    /// Reads weights that training wrote, to train on.
    ///
    /// # Errors
    /// As [`DistanceEstimator::load`].
    pub fn read(path: &Path, device: &Device) -> Result<(RangingNetwork, RangingHeader)> {
        let state = StateDict::load(path)?;
        let header: Option<RangingHeader> = state.header()?;
        let Some(header) = header.filter(|header| header.network == RangingHeader::NETWORK) else {
            return Err(Error::weights(
                path,
                "does not say what it was trained for",
                "give the distance weights that `train` wrote",
            ));
        };
        let fresh = header.config().init(device)?;
        Ok((state.apply(fresh, str::to_owned)?, header))
    }

    /// Saves weights with their header.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn save(network: &RangingNetwork, header: &RangingHeader, path: &Path) -> Result<()> {
        StateDict::of(network, str::to_owned)
            .with_header(header)?
            .save(path)
    }

    /// What the weights were trained for.
    pub fn header(&self) -> &RangingHeader {
        &self.header
    }

    /// The distance of each vehicle, metres, given the rig that took the images. Where it is another
    /// than the trained one, box sizes become what they would have been with that one.
    ///
    /// # Errors
    /// A device that fails.
    pub fn estimate(&self, sightings: &[Sighting], rig: &StereoRig) -> Result<Vec<f64>> {
        let mut distances_m = Vec::with_capacity(sightings.len());
        for batch in sightings.chunks(BATCH) {
            let (composites, readings) = stack(&self.header, batch, rig, &self.device);
            let geometry: Vec<f32> = readings
                .iter()
                .flat_map(|reading| reading.geometry.iter().copied())
                .collect();
            let shape = [batch.len(), self.header.geometry_numbers()];
            let geometry = Tensor::from_data(TensorData::new(geometry, shape), &self.device);
            let estimated = self.network.forward(composites, geometry);
            let values = estimated.try_into_vec_as::<f32>().map_err(|source| {
                Error::device(
                    format!("{:?}", self.device),
                    source.to_string(),
                    "try another device",
                )
            })?;
            let metres = values
                .into_iter()
                .zip(&readings)
                .map(|(value, reading)| reading.distance_m(f64::from(value)));
            distances_m.extend(metres);
        }
        Ok(distances_m)
    }
}

/// Composites `[batch, 3, height, width]`, normalised, and the numbers beside them.
fn stack(
    header: &RangingHeader,
    sightings: &[Sighting],
    rig: &StereoRig,
    device: &Device,
) -> (Tensor<4>, Vec<Reading>) {
    let size = header.composite;
    let mut planes = vec![0.0; sightings.len() * size.plane_values()];
    let readings = planes
        .par_chunks_exact_mut(size.plane_values())
        .zip(sightings)
        .map(|(planes, sighting)| {
            header.compose(sighting, planes);
            header.reading(sighting, rig)
        })
        .collect();
    let shape = [
        sightings.len(),
        3,
        size.height as usize,
        size.width as usize,
    ];
    let composites = Tensor::from_data(TensorData::new(planes, shape), device);
    (composites, readings)
}
