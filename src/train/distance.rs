//! The distance network's recipe.

mod detected;
mod load;

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use burn::module::Module as _;
use burn::optim::ModuleOptimizer;
use burn::tensor::{Device, Tensor, TensorData};
use image::{Rgb, RgbImage};

use super::config::{DistanceMerit, DistanceTraining, TrainConfig, TrainingBoxes};
use super::log::EpochRow;
use super::normalize::normalize_layers;
use super::optimizer::{AverageRule, distance_optimizer, freeze, initialize};
use super::readout::fit_readout;
use super::stage::{PassLoss, PreparedStage, Recipe, Steering, device_of};
use crate::annotate::write_text;
use crate::dataset::{
    CompositeSize, CompositeStatistics, DecodedCache, Split, StereoDataset, is_prepared, prepare,
};
use crate::error::{Error, Result};
use crate::geometry::StereoRig;
use crate::imaging::ChannelStatistics;
use crate::metrics::DistanceErrors;
use crate::progress::Progress;
use crate::ranging::{
    DistanceEstimator, RangingHeader, RangingNetwork, Readout, VehicleSizes, ranging_loss,
};
use detected::DetectedBoxes;
use load::{LoadedComposites, Vehicle};

/// Validation composites in TensorBoard, at most.
const SHOWN: usize = 8;
const MAE: &str = "validation/mae_m";
const RMSE: &str = "validation/rmse_m";
const MRE: &str = "validation/mre_percent";
/// Composites on which the first weights are normalised, at most.
const NORMALIZED: usize = 32;

/// Training vehicles, augmentation and loss of the distance network.
pub struct DistanceRecipe {
    settings: DistanceTraining,
    seed: u64,
    device: Device,
    rig: StereoRig,
    train: Vec<Vehicle>,
    val: Vec<Vehicle>,
    frames: DecodedCache<u64, [RgbImage; 2]>,
    header: RangingHeader,
    /// Check sum of the detector whose boxes are trained on.
    detector: Option<String>,
}

impl DistanceRecipe {
    /// Opens the data of a dataset for the distance network; writes the composites and their
    /// statistics first where they are missing. Boxes of the detector are those of the run in the
    /// given folder, and labelled boxes without one.
    ///
    /// # Errors
    /// A dataset without training vehicles, composites that cannot be written, or a run without the
    /// detector whose boxes are wanted.
    fn new(
        config: &TrainConfig,
        dataset: &StereoDataset,
        run: Option<&Path>,
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
                        .map(move |label| Vehicle::new(Arc::clone(&shared), label))
                })
                .collect()
        };
        let mut train = vehicles(Split::Train);
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
        let normalization = given
            .as_ref()
            .map_or(normalization, |(_, header)| header.normalization);
        let sizes = match given.and_then(|(_, header)| header.sizes) {
            _ if !settings.disparity => None,
            Some(sizes) => Some(sizes),
            None => VehicleSizes::of(train.iter().map(|vehicle| {
                let [left, right] = &vehicle.boxes();
                let size = Readout::Size.distance_per_output([left, right], dataset.rig());
                vehicle.label.distance_m / size
            })),
        };
        let detector = match run {
            Some(run) if settings.boxes == TrainingBoxes::Detector => {
                let found = DetectedBoxes::of_run(run, dataset, config.box_kind, device, progress)?;
                exchange_boxes(&mut train, &found, progress);
                Some(found.detector)
            }
            _ => None,
        };
        Ok(Self {
            seed: config.seed,
            device: device.clone().autodiff(),
            rig: *dataset.rig(),
            train,
            val: vehicles(Split::Val),
            frames: DecodedCache::new(config.cache_mib << 20),
            header: RangingHeader {
                network: RangingHeader::NETWORK.to_owned(),
                version: env!("CARGO_PKG_VERSION").to_owned(),
                composite: settings.composite,
                readout: settings.readout,
                crops: settings.inputs,
                sizes,
                normalization,
                box_kind: config.box_kind,
                classes: dataset.classes().to_vec(),
                rig: *dataset.rig(),
            },
            detector,
            settings,
        })
    }

    /// The whole stage, ready to run; as [`DistanceRecipe::new`]. One that goes on gets its weights
    /// from what it saved.
    ///
    /// # Errors
    /// Those of [`DistanceRecipe::new`], or weights that do not fit.
    pub fn prepared(
        config: &TrainConfig,
        dataset: &StereoDataset,
        run: Option<&Path>,
        goes_on: bool,
        device: &Device,
        progress: &dyn Progress,
    ) -> Result<PreparedStage<Self>> {
        let recipe = Self::new(config, dataset, run, device, progress)?;
        Ok(PreparedStage {
            steering: recipe.steering(),
            network: recipe.model(goes_on, progress)?,
            recipe: Arc::new(recipe),
        })
    }

    /// The network to start from.
    ///
    /// # Errors
    /// A frame that cannot be read, or a device that fails.
    fn model(&self, goes_on: bool, progress: &dyn Progress) -> Result<RangingNetwork> {
        self.device.seed(self.seed);
        let device = self.device.clone().without_autodiff();
        let freeze_named = |network| freeze(network, "distance.freeze", &self.settings.freeze);
        if let Some(path) = self.settings.weights.as_ref().filter(|_| !goes_on) {
            let network = self.given_weights(path, &device)?;
            return freeze_named(network.train());
        }
        let network = self.header.config().init(&device)?;
        initialize(&network);
        if !self.settings.fit_start || goes_on {
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
        let mut weights = Vec::with_capacity(self.train.len());
        let mut found = 0;
        for vehicles in self.train.chunks(self.settings.micro_batch) {
            let loaded = self.composites(vehicles, None)?;
            for (reading, &distance_m) in loaded.readings.iter().zip(&loaded.distances_m) {
                let distance_m = f64::from(distance_m);
                found += usize::from(reading.surface_found() == Some(true));
                // In the precision of the batches that the network will be trained on.
                let per_output = f64::from(reading.distance_per_output as f32);
                let at_zero_m = f64::from(reading.distance_at_zero_m as f32);
                outputs.push((distance_m - at_zero_m) / per_output);
                // As the loss's relative term does: by the error of distance that an error makes.
                weights.push((distance_m / per_output).powi(-2));
            }
            let batch = self.batch(loaded, &device);
            let features = network.features(batch.composites).fc2;
            let inputs = Tensor::cat(vec![features, batch.geometry], 1);
            let [_, width] = inputs.dims();
            let values = inputs
                .try_into_vec_as::<f64>()
                .map_err(|source| Error::training(source.to_string(), "try another device"))?;
            rows.extend(values.chunks_exact(width).map(<[f64]>::to_vec));
            progress.advance(vehicles.len() as u64);
            if progress.interrupted() {
                progress.end();
                return Err(Error::Interrupted {
                    resume:
                        "the distance network has not begun; run the same command with --resume"
                            .to_owned(),
                });
            }
        }
        progress.end();
        if self.settings.disparity {
            progress.note(&format!(
                "distance: the disparity says how far {found} of {} training vehicles are, the size of \
                 the others is taken for typical",
                self.train.len()
            ));
        }
        freeze_named(fit_readout(network, &rows, &outputs, &weights).train())
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
        if given.crops != wanted.crops {
            let word = given.crops.word();
            let setting = format!("distance.inputs = \"{word}\"");
            return refuse("the inputs", word.to_owned(), setting);
        }
        if given.sizes.is_some() != wanted.sizes.is_some() {
            let is_given = given.sizes.is_some();
            let setting = format!("distance.disparity = {is_given}");
            return refuse("disparity", is_given.to_string(), setting);
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
            first_bias_rate: 0.0,
            clip_norm: None,
            average: (settings.ema_decay > 0.0)
                .then_some(AverageRule {
                    longest: settings.ema_decay,
                    ramp: settings.ema_ramp,
                }),
            validate_every: settings.validate_every,
            patience: settings.patience,
            keep_last: settings.keep_last,
            settings: serde_json::json!({ "seed": self.seed, "header": self.header, "training": settings, "detector": self.detector }).to_string(),
            // Known to the run, which opened it.
            dataset: String::new(),
        }
    }

    /// Takes composites to a device.
    fn batch(&self, loaded: LoadedComposites, device: &Device) -> Batch {
        let size = self.settings.composite;
        let count = loaded.distances_m.len();
        let shape = [count, 3, size.height as usize, size.width as usize];
        let numbers = self.header.geometry_numbers();
        let readings = &loaded.readings;
        let geometry = readings.iter().flat_map(|reading| &reading.geometry);
        let geometry = TensorData::new(geometry.copied().collect(), [count, numbers]);
        let column =
            |values: Vec<f32>| Tensor::from_data(TensorData::new(values, [count, 1]), device);
        let per_output = readings.iter().map(|r| r.distance_per_output as f32);
        let at_zero_m = readings.iter().map(|r| r.distance_at_zero_m as f32);
        Batch {
            composites: Tensor::from_data(TensorData::new(loaded.planes, shape), device),
            geometry: Tensor::from_data(geometry, device),
            distance_per_output: column(per_output.collect()),
            distance_at_zero_m: column(at_zero_m.collect()),
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
}

/// Gives vehicles the boxes that the detector found around them, and says how many it missed.
fn exchange_boxes(vehicles: &mut [Vehicle], found: &DetectedBoxes, progress: &dyn Progress) {
    let found = found.by_vehicle();
    let mut count = 0;
    for vehicle in vehicles.iter_mut() {
        vehicle.detected = found
            .get(&(vehicle.frame.row.stamp, vehicle.label.id))
            .copied();
        count += usize::from(vehicle.detected.is_some());
    }
    progress.note(&format!(
        "distance: {count} of {} training vehicles ({:.0} %) have the detector's boxes, the others \
         their labels', moved at random",
        vehicles.len(),
        100.0 * count as f64 / vehicles.len().max(1) as f64
    ));
}

/// Composites `[batch, 3, height, width]`, geometry `[batch, numbers]`; metres of distance per unit of
/// the network's output and at an output of 0, and true distances, `[batch, 1]`.
struct Batch {
    composites: Tensor<4>,
    geometry: Tensor<2>,
    distance_per_output: Tensor<2>,
    distance_at_zero_m: Tensor<2>,
    distances_m: Tensor<2>,
}

impl Batch {
    /// The network's distances, metres, `[batch, 1]`.
    fn predict(&self, network: &RangingNetwork) -> Tensor<2> {
        let output = network.forward(self.composites.clone(), self.geometry.clone());
        output * self.distance_per_output.clone() + self.distance_at_zero_m.clone()
    }

    /// The network's distances, metres, read back.
    fn estimate(&self, network: &RangingNetwork) -> Result<Vec<f64>> {
        self.predict(network)
            .try_into_vec_as::<f64>()
            .map_err(|source| Error::training(source.to_string(), "try another device"))
    }
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

    fn item_files(&self, _: u32, item: usize) -> Vec<PathBuf> {
        let images = self.train[item].frame.images();
        images.map(|(_, image)| image.path.clone()).collect()
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

    fn optimizer(&self, _: f64) -> Result<ModuleOptimizer> {
        Ok(distance_optimizer(self.settings.optimizer))
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
