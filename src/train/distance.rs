//! The distance network's recipe.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use burn::module::Module as _;
use burn::tensor::{Device, Tensor, TensorData};
use image::{Rgb, RgbImage};
use rand::RngExt as _;
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::augment::mirror_composite;
use super::config::{DistanceMerit, DistanceTraining, TrainConfig};
use super::frame_cache::FrameCache;
use super::log::EpochRow;
use super::normalize::normalize_layers;
use super::optimizer::{AverageRule, distance_optimizer, freeze, initialize};
use super::readout::fit_readout;
use super::stage::{PassLoss, PreparedStage, Recipe, Steering, device_of};
use crate::annotate::write_text;
use crate::dataset::{
    CompositeSize, CompositeStatistics, Frame, Split, StereoDataset, StereoLabel,
    composite_into_planes, geometry_vector, is_prepared, prepare,
};
use crate::error::{Error, Result};
use crate::geometry::{PixelBox, StereoRig};
use crate::imaging::ChannelStatistics;
use crate::metrics::DistanceErrors;
use crate::progress::Progress;
use crate::ranging::{
    DistanceEstimator, RangingConfig, RangingHeader, RangingNetwork, ranging_loss,
};

/// Validation composites in TensorBoard, at most.
const SHOWN: usize = 8;
const MAE: &str = "validation/mae_m";
const RMSE: &str = "validation/rmse_m";
const MRE: &str = "validation/mre_percent";
/// Composites on which the first weights are normalised, at most.
const NORMALIZED: usize = 32;

/// A labelled vehicle in its frame.
#[derive(Debug, Clone)]
struct Vehicle {
    frame: Arc<Frame>,
    label: StereoLabel,
}

/// Training vehicles, augmentation and loss of the distance network.
pub struct DistanceRecipe {
    settings: DistanceTraining,
    seed: u64,
    device: Device,
    rig: StereoRig,
    train: Vec<Vehicle>,
    val: Vec<Vehicle>,
    frames: FrameCache,
    header: RangingHeader,
}

impl DistanceRecipe {
    /// Opens the data of a dataset for the distance network; writes the composites and their
    /// statistics first where they are missing.
    ///
    /// # Errors
    /// A dataset without training vehicles, or composites that cannot be written.
    fn new(
        config: &TrainConfig,
        dataset: &StereoDataset,
        device: &Device,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let settings = config.distance.clone();
        if !is_prepared(dataset, config.box_kind, settings.composite) {
            let report = prepare(dataset, config.box_kind, settings.composite, progress)?;
            for problem in &report.problems {
                progress.note(&format!("left out: {problem}"));
            }
        }
        let vehicles = |split| -> Vec<Vehicle> {
            dataset
                .split(split)
                .into_iter()
                .flat_map(|frame| {
                    let shared = Arc::new(frame.clone());
                    frame
                        .vehicles(config.box_kind)
                        .into_iter()
                        .map(move |label| Vehicle {
                            frame: Arc::clone(&shared),
                            label,
                        })
                })
                .collect()
        };
        let train = vehicles(Split::Train);
        let device_plain = device.clone().without_autodiff();
        let given = settings
            .weights
            .as_ref()
            .map(|path| DistanceEstimator::read(path, &device_plain))
            .transpose()?;
        let statistics = CompositeStatistics::read(&dataset.folder)?.train;
        let Some(normalization) = statistics.filter(|_| !train.is_empty()) else {
            return Err(Error::dataset(
                &dataset.folder,
                "has no vehicle that is labelled in both images of a training frame",
                "give a dataset with training frames",
            ));
        };
        // Given weights go on with the numbers that they were trained with.
        let normalization = given.map_or(normalization, |(_, header)| header.normalization);
        Ok(Self {
            seed: config.seed,
            device: device.clone().autodiff(),
            rig: *dataset.rig(),
            train,
            val: vehicles(Split::Val),
            frames: FrameCache::new(config.cache_mib << 20),
            header: RangingHeader {
                network: RangingHeader::NETWORK.to_owned(),
                version: env!("CARGO_PKG_VERSION").to_owned(),
                composite: settings.composite,
                readout: settings.readout,
                normalization,
                box_kind: config.box_kind,
                classes: dataset.classes().to_vec(),
                rig: *dataset.rig(),
            },
            settings,
        })
    }

    /// The whole stage, ready to run; as [`DistanceRecipe::new`].
    ///
    /// # Errors
    /// Those of [`DistanceRecipe::new`], or weights that do not fit.
    pub fn prepared(
        config: &TrainConfig,
        dataset: &StereoDataset,
        device: &Device,
        progress: &dyn Progress,
    ) -> Result<PreparedStage<Self>> {
        let recipe = Self::new(config, dataset, device, progress)?;
        Ok(PreparedStage {
            steering: recipe.steering(),
            network: recipe.model(progress)?,
            optimizer: distance_optimizer(recipe.settings.optimizer),
            recipe: Arc::new(recipe),
        })
    }

    /// The network to start from.
    ///
    /// # Errors
    /// A frame that cannot be read, or a device that fails.
    fn model(&self, progress: &dyn Progress) -> Result<RangingNetwork> {
        self.device.seed(self.seed);
        let device = self.device.clone().without_autodiff();
        let freeze_named = |network| freeze(network, "distance.freeze", &self.settings.freeze);
        if let Some(path) = &self.settings.weights {
            let network = self.given_weights(path, &device)?;
            return freeze_named(network.train());
        }
        let network = RangingConfig::for_size(self.settings.composite).init(&device)?;
        initialize(&network);
        if !self.settings.fit_start {
            return freeze_named(network.train());
        }
        progress.begin("distance, first weights", self.train.len() as u64);
        // Evenly over the data: neighbours show the same scene.
        let step = self.train.len().div_ceil(NORMALIZED);
        let some: Vec<Vehicle> = self.train.iter().step_by(step).cloned().collect();
        let composites = self
            .batch(self.composites(&some, None)?, &device)
            .composites;
        let network = normalize_layers(network, composites);
        let mut rows = Vec::new();
        let mut outputs = Vec::with_capacity(self.train.len());
        for vehicles in self.train.chunks(self.settings.micro_batch) {
            let loaded = self.composites(vehicles, None)?;
            let wanted = loaded.distances_m.iter().zip(&loaded.distance_per_output);
            outputs.extend(wanted.map(|(distance, per)| f64::from(*distance) / f64::from(*per)));
            let batch = self.batch(loaded, &device);
            let features = network.features(batch.composites).fc2;
            let inputs = Tensor::cat(vec![features, batch.geometry], 1);
            let [_, width] = inputs.dims();
            let values = inputs
                .try_into_vec_as::<f64>()
                .map_err(|source| Error::training(source.to_string(), "try another device"))?;
            rows.extend(values.chunks_exact(width).map(<[f64]>::to_vec));
            progress.advance(vehicles.len() as u64);
        }
        progress.end();
        freeze_named(fit_readout(network, &rows, &outputs).train())
    }

    /// The network to go on from; it must see the same composites and mean the same by its output.
    fn given_weights(&self, path: &Path, device: &Device) -> Result<RangingNetwork> {
        let (network, header) = DistanceEstimator::read(path, device)?;
        let (given, wanted) = (&header, &self.header);
        let refuse = |what: &str, given: String, setting: String| {
            Err(Error::weights(
                path,
                format!("was trained with {what} {given}"),
                format!("train with {setting}, or start from other weights"),
            ))
        };
        if given.composite != wanted.composite {
            let size = given.composite.to_string();
            let setting = format!("--composite {size}");
            return refuse("composites of", size, setting);
        }
        if given.readout != wanted.readout {
            let readout = format!("{:?}", given.readout).to_lowercase();
            let setting = format!("distance.readout = \"{readout}\"");
            return refuse("the readout", readout, setting);
        }
        Ok(network)
    }

    /// The numbers that steer the stage.
    fn steering(&self) -> Steering {
        let settings = &self.settings;
        Steering {
            seed: self.seed,
            epochs: settings.epochs,
            batch: settings.batch,
            micro_batch: settings.micro_batch,
            learning_rate: settings.learning_rate,
            final_learning_rate: settings.final_learning_rate,
            schedule: settings.schedule,
            warmup_epochs: settings.warmup_epochs,
            clip_norm: None,
            average: (settings.ema_decay > 0.0)
                .then_some(AverageRule {
                    longest: settings.ema_decay,
                    ramp: settings.ema_ramp,
                }),
            validate_every: settings.validate_every,
            patience: settings.patience,
            keep_last: settings.keep_last,
            settings: serde_json::json!({ "seed": self.seed, "header": self.header, "training": settings }).to_string(),
        }
    }

    /// Loads composites; with an epoch they are changed at random.
    fn composites(
        &self,
        vehicles: &[Vehicle],
        epoch: Option<(u32, &[usize])>,
    ) -> Result<LoadedComposites> {
        let size = self.settings.composite;
        let mut planes = vec![0.0; vehicles.len() * size.plane_values()];
        let geometry = planes
            .par_chunks_exact_mut(size.plane_values())
            .zip(vehicles)
            .enumerate()
            .map(|(position, (planes, vehicle))| {
                let images = self.frames.load(&vehicle.frame, &self.rig)?;
                let mut boxes = [vehicle.label.left.box_pixel, vehicle.label.right.box_pixel];
                let mut random = epoch.map(|(epoch, items)| {
                    let stream = (u128::from(epoch) << 64) | items[position] as u128;
                    Pcg64::new(u128::from(self.seed) + 1, stream)
                });
                if let Some(random) = &mut random {
                    boxes = boxes.map(|area| self.jitter(area, random));
                }
                let [left, right] = &boxes;
                let normalization = &self.header.normalization;
                composite_into_planes(
                    [&images[0], &images[1]],
                    [left, right],
                    size,
                    normalization,
                    planes,
                );
                if let Some(random) = &mut random {
                    self.change(planes, random);
                }
                let (width, height) = images[0].dimensions();
                let per_output = self
                    .settings
                    .readout
                    .distance_per_output([left, right], &self.rig);
                Ok((
                    geometry_vector(left, right, width, height),
                    per_output as f32,
                ))
            })
            .collect::<Result<Vec<([f32; 2], f32)>>>()?;
        let (geometry, distance_per_output) = geometry.into_iter().unzip();
        Ok(LoadedComposites {
            planes,
            geometry,
            distance_per_output,
            distances_m: vehicles
                .iter()
                .map(|vehicle| vehicle.label.distance_m as f32)
                .collect(),
        })
    }

    /// Takes composites to a device.
    fn batch(&self, loaded: LoadedComposites, device: &Device) -> Batch {
        let size = self.settings.composite;
        let count = loaded.distances_m.len();
        let shape = [count, 3, size.height as usize, size.width as usize];
        let geometry = TensorData::new(loaded.geometry.concat(), [count, 2]);
        let column =
            |values: Vec<f32>| Tensor::from_data(TensorData::new(values, [count, 1]), device);
        Batch {
            composites: Tensor::from_data(TensorData::new(loaded.planes, shape), device),
            geometry: Tensor::from_data(geometry, device),
            distance_per_output: column(loaded.distance_per_output),
            distances_m: column(loaded.distances_m),
        }
    }

    /// Draws normalised planes as a picture, its left edge at a column.
    fn draw_composite(&self, planes: &[f32], left: u32, picture: &mut RgbImage) {
        let CompositeSize { height, width } = self.settings.composite;
        let ChannelStatistics { mean, std } = self.header.normalization;
        for y in 0..height {
            for x in 0..width {
                let pixel = (y * width + x) as usize;
                let color = std::array::from_fn(|channel| {
                    let value = planes[channel * (height * width) as usize + pixel];
                    let value = f64::from(value) * std[channel] + mean[channel];
                    (value * 255.0).round().clamp(0.0, 255.0) as u8
                });
                picture.put_pixel(left + x, y, Rgb(color));
            }
        }
    }

    /// Moves the edges of a box as a detector's errors do.
    fn jitter(&self, area: PixelBox, random: &mut Pcg64) -> PixelBox {
        let mut moved = |edge: f64, side: f64| {
            // The sum of three uniform numbers is close to normal, and bounded.
            let error: f64 = (0..3).map(|_| random.random_range(-1.0..1.0)).sum();
            edge + self.settings.box_jitter * side * error
        };
        let (width, height) = (area.width(), area.height());
        PixelBox::new(
            moved(area.x_min, width),
            moved(area.y_min, height),
            moved(area.x_max, width),
            moved(area.y_max, height),
        )
    }

    /// Changes brightness and contrast, and mirrors.
    fn change(&self, planes: &mut [f32], random: &mut Pcg64) {
        let size = self.settings.composite;
        let strength = self.settings.photometric;
        let contrast = 1.0 + strength * random.random_range(-1.0..1.0);
        let brightness = 0.5 * strength * random.random_range(-1.0..1.0);
        let ChannelStatistics { mean, std } = self.header.normalization;
        let area = size.height as usize * size.width as usize;
        for (channel, plane) in planes.chunks_exact_mut(area).enumerate() {
            // In pixel values: contrast * value + brightness; here the values are normalised.
            let shift = (mean[channel] * (contrast - 1.0) + brightness) / std[channel].max(1e-6);
            for value in plane {
                *value = *value * contrast as f32 + shift as f32;
            }
        }
        if random.random_bool(self.settings.flip) {
            mirror_composite(planes, size.height as usize, size.width as usize);
        }
    }
}

/// Composites `[batch, 3, height, width]`, geometry `[batch, 2]`; metres of distance per unit of the
/// network's output and true distances, `[batch, 1]`.
struct Batch {
    composites: Tensor<4>,
    geometry: Tensor<2>,
    distance_per_output: Tensor<2>,
    distances_m: Tensor<2>,
}

impl Batch {
    /// The network's distances, metres, `[batch, 1]`.
    fn predict(&self, network: &RangingNetwork) -> Tensor<2> {
        let output = network.forward(self.composites.clone(), self.geometry.clone());
        output * self.distance_per_output.clone()
    }

    /// The network's distances, metres, read back.
    fn estimate(&self, network: &RangingNetwork) -> Result<Vec<f64>> {
        self.predict(network)
            .try_into_vec_as::<f64>()
            .map_err(|source| Error::training(source.to_string(), "try another device"))
    }
}

/// What a [`Batch`] holds before it goes to a device.
pub struct LoadedComposites {
    planes: Vec<f32>,
    geometry: Vec<[f32; 2]>,
    distance_per_output: Vec<f32>,
    distances_m: Vec<f32>,
}

impl Recipe for DistanceRecipe {
    type Model = RangingNetwork;
    type Batch = LoadedComposites;
    type Judge = RangingNetwork;
    type Findings = DistanceErrors;
    const STAGE: &'static str = "distance";
    const TERMS: &'static [&'static str] = &["loss/total"];
    const SCORES: &'static [&'static str] = &[MAE, RMSE, MRE];

    fn items(&self) -> usize {
        self.train.len()
    }

    fn item_name(&self, item: usize) -> String {
        self.train[item].frame.left.path.display().to_string()
    }

    fn load(&self, epoch: u32, items: &[usize]) -> Result<LoadedComposites> {
        let vehicles: Vec<Vehicle> = items.iter().map(|&item| self.train[item].clone()).collect();
        self.composites(&vehicles, Some((epoch, items)))
    }

    fn loss(
        &self,
        model: &RangingNetwork,
        batch: LoadedComposites,
        share: f64,
    ) -> Result<PassLoss> {
        let batch = self.batch(batch, &device_of(model).autodiff());
        let loss = ranging_loss(batch.predict(model), batch.distances_m).total;
        Ok(PassLoss {
            total: loss.clone().mul_scalar(share),
            terms: loss,
        })
    }

    fn checks(&self) -> usize {
        self.val.len()
    }

    fn check_batch(&self) -> usize {
        self.settings.micro_batch
    }

    fn judge(&self, model: &RangingNetwork) -> Result<RangingNetwork> {
        Ok(model.clone())
    }

    fn examine(&self, judge: &RangingNetwork, items: Range<usize>) -> Result<DistanceErrors> {
        let vehicles = &self.val[items];
        let device = device_of(judge).without_autodiff();
        let batch = self.batch(self.composites(vehicles, None)?, &device);
        let mut errors = DistanceErrors::new();
        for (estimated_m, vehicle) in batch.estimate(judge)?.into_iter().zip(vehicles) {
            errors.add(estimated_m, vehicle.label.distance_m);
        }
        Ok(errors)
    }

    fn no_findings(&self) -> DistanceErrors {
        DistanceErrors::new()
    }

    fn merge(findings: &mut DistanceErrors, more: &DistanceErrors) {
        findings.merge(more);
    }

    fn scores(findings: &DistanceErrors) -> Option<Vec<f64>> {
        let summary = findings.summary()?;
        Some(vec![summary.mae_m, summary.rmse_m, summary.mre_percent])
    }

    fn merit(&self) -> (&'static str, f64) {
        let name = match self.settings.best_by {
            DistanceMerit::Mre => MRE,
            DistanceMerit::Mae => MAE,
            DistanceMerit::Rmse => RMSE,
        };
        (name, -1.0)
    }

    fn pictures(&self, judge: &RangingNetwork) -> Result<Vec<(String, RgbImage)>> {
        let stride = self.val.len().div_ceil(SHOWN).max(1);
        let some: Vec<Vehicle> = self.val.iter().step_by(stride).cloned().collect();
        if some.is_empty() {
            return Ok(Vec::new());
        }
        let loaded = self.composites(&some, None)?;
        let CompositeSize { height, width } = self.settings.composite;
        let mut picture = RgbImage::new(width * some.len() as u32, height);
        for (column, planes) in (0..).zip(loaded.planes.chunks(3 * (height * width) as usize)) {
            self.draw_composite(planes, column * width, &mut picture);
        }
        let device = device_of(judge).without_autodiff();
        let estimated = self.batch(loaded, &device).estimate(judge)?;
        for ((column, vehicle), estimated_m) in (0..).zip(&some).zip(estimated) {
            let lines = [
                format!("is {:.1} m", vehicle.label.distance_m),
                format!("est {estimated_m:.1} m"),
            ];
            for (line, text) in (0..).zip(lines) {
                let corner = [i64::from(column * width) + 4, 4 + 12 * line];
                write_text(&mut picture, corner, &text, 1, Rgb([255, 255, 0]));
            }
        }
        Ok(vec![("validation/composites".to_owned(), picture)])
    }

    fn describe(row: &EpochRow) -> String {
        match (row.mae_m, row.rmse_m, row.mre_percent) {
            (Some(mae), Some(rmse), Some(mre)) => {
                format!(", MAE {mae:.2} m, RMSE {rmse:.2} m, MRE {mre:.1} %")
            }
            _ => String::new(),
        }
    }

    fn save(&self, model: &RangingNetwork, path: &Path) -> Result<()> {
        DistanceEstimator::save(model, &self.header, path)
    }
}
