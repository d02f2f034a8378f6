//! The detector's recipe.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use burn::optim::ModuleOptimizer;
use burn::tensor::{Device, Tensor, TensorData};
use burn_dataset::Dataset as _;
use image::RgbImage;
use rand::RngExt as _;
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::augment::{DetectionAugment, Scene, augmented_letterbox, augmented_mosaic};
use super::config::{DetectorMerit, DetectorTraining, TrainConfig};
use super::log::EpochRow;
use super::optimizer::{AverageRule, MomentumWarmup, detector_optimizer, freeze};
use super::stage::{PassLoss, PreparedStage, Recipe, Steering, device_of};
use crate::annotate::{Annotation, annotate_pair};
use crate::dataset::{DetectionItem, DetectionSource, Split, StereoDataset};
use crate::detector::decode::Anchors;
use crate::detector::loss::{ImageTargets, LossGains, detection_loss};
use crate::detector::nms::NmsConfig;
use crate::detector::weights::load_detector;
use crate::detector::{DetectorHeader, VehicleDetector, Yolo11, Yolo11Config, letterbox};
use crate::error::{Error, Result};
use crate::evaluate::detection_metrics;
use crate::geometry::letterbox::Size;
use crate::metrics::DetectionMetrics;
use crate::progress::Progress;
use crate::weights::StateDict;

/// Validation images in TensorBoard, at most.
const SHOWN: usize = 4;
/// Validation images that are examined at once.
const CHECK_BATCH: usize = 16;
const MAP50: &str = "validation/map50";
const MAP50_95: &str = "validation/map50_95";
/// Sides of the input are multiples of it, pixels.
const LARGEST_STRIDE: u32 = 32;
/// Layers with weights, by part.
const BACKBONE: [u32; 11] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10];
const NECK: [u32; 6] = [13, 16, 17, 19, 20, 22];
const HEAD: [u32; 1] = [23];
/// Random numbers of the input's size, apart from those of the images.
const SIZE_STREAM: u64 = 1;

/// Training images, augmentation and loss of the detector.
pub struct DetectorRecipe {
    settings: DetectorTraining,
    seed: u64,
    device: Device,
    input: Size,
    anchors: Anchors,
    train: DetectionSource,
    val: DetectionSource,
    header: DetectorHeader,
}

impl DetectorRecipe {
    /// Opens the data of a dataset for the detector.
    ///
    /// # Errors
    /// A dataset without training images.
    fn new(config: &TrainConfig, dataset: &StereoDataset, device: &Device) -> Result<Self> {
        let settings = config.detector.clone();
        let rig = *dataset.rig();
        let original = Size::new(rig.left.width, rig.left.height);
        let input = letterbox(original, settings.image_size)?.size();
        let cache = config.cache_mib << 20;
        let source = |split, cache| DetectionSource::new(dataset, split, config.box_kind, cache);
        let train = source(Split::Train, cache / 5 * 4);
        if train.is_empty() {
            return Err(Error::dataset(
                &dataset.folder,
                "has no training frames",
                "give a dataset whose frames.csv has rows with split train",
            ));
        }
        Ok(Self {
            seed: config.seed,
            device: device.clone().autodiff(),
            input,
            anchors: Anchors::new(input.height as usize, input.width as usize),
            train,
            val: source(Split::Val, cache / 5),
            header: DetectorHeader {
                network: DetectorHeader::NETWORK.to_owned(),
                version: env!("CARGO_PKG_VERSION").to_owned(),
                scale: settings.scale,
                classes: dataset.classes().to_vec(),
                image_size: settings.image_size,
                normalization: DetectorHeader::NORMALIZATION.to_owned(),
                box_kind: config.box_kind,
                rig,
            },
            settings,
        })
    }

    /// The whole stage, ready to run. One that goes on gets its weights from what it saved.
    ///
    /// # Errors
    /// A dataset without training images, or weights that do not fit.
    pub fn prepared(
        config: &TrainConfig,
        dataset: &StereoDataset,
        goes_on: bool,
        device: &Device,
        progress: &dyn Progress,
    ) -> Result<PreparedStage<Self>> {
        let recipe = Self::new(config, dataset, device)?;
        Ok(PreparedStage {
            steering: recipe.steering(),
            network: recipe.model(goes_on, progress)?,
            recipe: Arc::new(recipe),
        })
    }

    /// The network to start from: fresh, or the given weights.
    ///
    /// # Errors
    /// Weights that do not fit.
    fn model(&self, goes_on: bool, progress: &dyn Progress) -> Result<Yolo11> {
        let classes = self.header.classes.len();
        self.device.seed(self.seed);
        let frozen = frozen_layers(&self.settings.freeze)?;
        let given = self.settings.weights.as_ref().filter(|_| !goes_on);
        let Some(path) = given else {
            let fresh = Yolo11Config::new(self.settings.scale, classes).init(&self.device);
            return freeze(fresh, "detector.freeze", &frozen);
        };
        let state = StateDict::load(path)?;
        let (model, report) = load_detector(&state, self.settings.scale, classes, &self.device)?;
        if report.folded {
            return Err(Error::weights(
                path,
                "has its batch normalisation merged into the convolutions",
                "train from weights that still have it",
            ));
        }
        if report.classes_reset {
            progress.note(&format!(
                "{}: trained for {} classes, not {classes}: the last class convolutions start afresh",
                path.display(),
                report.classes_in_file
            ));
        }
        freeze(model, "detector.freeze", &frozen)
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
            first_bias_rate: settings.warmup_bias_rate,
            clip_norm: Some(settings.clip_norm),
            average: Some(AverageRule {
                longest: settings.ema_decay,
                ramp: settings.ema_ramp,
            }),
            validate_every: settings.validate_every,
            patience: settings.patience,
            keep_last: settings.keep_last,
            settings: serde_json::json!({ "seed": self.seed, "header": self.header, "training": settings }).to_string(),
            // Known to the run, which opened it.
            dataset: String::new(),
        }
    }

    /// The size of a pass's input; with `multi_scale` it is another one from pass to pass.
    fn input_size(&self, epoch: u32, items: &[usize]) -> Size {
        if self.settings.multi_scale <= 0.0 {
            return self.input;
        }
        let first = items.first().copied().unwrap_or_default();
        let mut random = self.random(epoch, first, SIZE_STREAM);
        let factor = 1.0 + self.settings.multi_scale * random.random_range(-1.0..1.0);
        let side = |side: u32| {
            let stride = f64::from(LARGEST_STRIDE);
            ((f64::from(side) * factor / stride).round().max(1.0) * stride) as u32
        };
        Size::new(side(self.input.width), side(self.input.height))
    }

    /// Random numbers that depend on nothing but seed, epoch, item and purpose.
    fn random(&self, epoch: u32, item: usize, purpose: u64) -> Pcg64 {
        let stream = (u128::from(epoch) << 64) | item as u128;
        Pcg64::new(u128::from(self.seed) | (u128::from(purpose) << 64), stream)
    }

    /// The other items of an item's mosaic, if it is one, and the random numbers that follow.
    fn others(&self, epoch: u32, item: usize) -> (Option<[usize; 3]>, Pcg64) {
        let settings = &self.settings;
        let mut random = self.random(epoch, item, 0);
        let with_mosaics = epoch + settings.close_mosaic < settings.epochs;
        let is_mosaic =
            settings.mosaic > 0.0 && with_mosaics && random.random_bool(settings.mosaic);
        let count = self.train.len();
        let others = is_mosaic.then(|| [(); 3].map(|()| random.random_range(0..count)));
        (others, random)
    }

    /// Writes an augmented image into its planes.
    fn augmented(
        &self,
        epoch: u32,
        item: usize,
        input: Size,
        planes: &mut [f32],
    ) -> Result<ImageTargets> {
        let settings = &self.settings;
        let augment = DetectionAugment {
            hsv: settings.hsv,
            zoom: settings.zoom,
            shift: settings.shift,
            flip: settings.flip,
        };
        let (others, mut random) = self.others(epoch, item);
        if let Some(others) = others {
            let [a, b, c] = others.map(|other| self.item(other));
            let items = [self.item(item)?, a?, b?, c?];
            let scenes = items.each_ref().map(scene);
            return Ok(augmented_mosaic(
                scenes,
                input,
                &augment,
                &mut random,
                planes,
            ));
        }
        let item = self.item(item)?;
        augmented_letterbox(scene(&item), input, &augment, &mut random, planes)
    }

    fn item(&self, item: usize) -> Result<DetectionItem> {
        self.train.get(item).map_err(|source| {
            Error::training(
                source.to_string(),
                "run `twinsight prepare` to list broken frames",
            )
        })
    }
}

/// Letterboxed images `[batch, 3, height, width]` and their targets.
pub struct LetterboxedBatch {
    planes: Vec<f32>,
    targets: Vec<ImageTargets>,
    input: Size,
}

fn scene(item: &DetectionItem) -> Scene<'_> {
    Scene {
        image: &item.image,
        boxes: &item.boxes,
        ignored: &item.ignored,
    }
}

impl Recipe for DetectorRecipe {
    type Model = Yolo11;
    type Batch = LetterboxedBatch;
    type Judge = VehicleDetector;
    type Findings = DetectionMetrics;
    const STAGE: &'static str = "detector";
    const TERMS: &'static [&'static str] = &["loss/box", "loss/class", "loss/distribution"];
    const SCORES: &'static [&'static str] =
        &["validation/precision", "validation/recall", MAP50, MAP50_95];

    fn items(&self) -> usize {
        self.train.len()
    }

    fn item_files(&self, epoch: u32, item: usize) -> Vec<PathBuf> {
        let (others, _) = self.others(epoch, item);
        let items = std::iter::once(item).chain(others.into_iter().flatten());
        items
            .filter_map(|item| self.train.path(item))
            .map(Path::to_path_buf)
            .collect()
    }

    fn load(&self, epoch: u32, items: &[usize]) -> Result<LetterboxedBatch> {
        let input = self.input_size(epoch, items);
        let area = input.area();
        let mut planes = vec![0.0; items.len() * 3 * area];
        let targets = planes
            .par_chunks_exact_mut(3 * area)
            .zip(items)
            .map(|(planes, &item)| self.augmented(epoch, item, input, planes))
            .collect::<Result<Vec<_>>>()?;
        Ok(LetterboxedBatch {
            planes,
            targets,
            input,
        })
    }

    fn loss(&self, model: &Yolo11, batch: LetterboxedBatch, _: f64) -> Result<PassLoss> {
        let LetterboxedBatch {
            planes,
            targets,
            input,
        } = batch;
        let [height, width] = [input.height as usize, input.width as usize];
        let planes = TensorData::new(planes, [targets.len(), 3, height, width]);
        // The network's own device: several may share the training.
        let tensor = Tensor::<4>::from_data(planes, &device_of(model).autodiff());
        let output = model.forward(tensor).flatten();
        let resized = (input != self.input).then(|| Anchors::new(height, width));
        let anchors = resized.as_ref().unwrap_or(&self.anchors);
        let loss = detection_loss(&output, &targets, anchors, LossGains::default())?;
        // The batch size times the terms: summed over passes, as in one large batch.
        Ok(PassLoss {
            total: loss.total,
            terms: Tensor::cat(loss.items.to_vec(), 0),
        })
    }

    fn optimizer(&self, warmup_steps: f64) -> Result<ModuleOptimizer> {
        let settings = &self.settings;
        let warmup = MomentumWarmup {
            first: settings.warmup_momentum,
            steps: warmup_steps,
        };
        detector_optimizer(settings.optimizer, settings.weight_decay, Some(warmup))
    }

    fn checks(&self) -> usize {
        self.val.len()
    }

    fn check_batch(&self) -> usize {
        CHECK_BATCH
    }

    fn judge(&self, model: &Yolo11) -> Result<VehicleDetector> {
        let device = device_of(model).without_autodiff();
        Ok(VehicleDetector::new(model, self.header.clone(), &device))
    }

    fn examine(&self, judge: &VehicleDetector, items: Range<usize>) -> Result<DetectionMetrics> {
        detection_metrics(judge, &self.val, items)
    }

    fn no_findings(&self) -> DetectionMetrics {
        DetectionMetrics::new(self.header.classes.len())
    }

    fn merge(findings: &mut DetectionMetrics, more: &DetectionMetrics) {
        findings.merge(more);
    }

    fn scores(findings: &DetectionMetrics) -> Option<Vec<f64>> {
        if findings.is_empty() {
            return None;
        }
        let summary = findings.compute();
        Some(vec![
            summary.precision,
            summary.recall,
            summary.map50,
            summary.map50_95,
        ])
    }

    fn merit(&self) -> (&'static str, f64) {
        match self.settings.best_by {
            DetectorMerit::Map50To95 => (MAP50_95, 1.0),
            DetectorMerit::Map50 => (MAP50, 1.0),
        }
    }

    fn pictures(&self, detector: &VehicleDetector) -> Result<Vec<(String, RgbImage)>> {
        let mut pictures = Vec::new();
        // Evenly over the data: neighbours show the same scene.
        let stride = self.val.len().div_ceil(SHOWN).max(1);
        for (number, index) in (0..self.val.len()).step_by(stride).enumerate() {
            let item = self.val.get(index).map_err(|source| {
                Error::training(
                    source.to_string(),
                    "run `twinsight validate` on the dataset",
                )
            })?;
            let found = detector.detect(&[&item.image], &NmsConfig::prediction())?;
            let truth = item.boxes.iter().map(|(_, area)| Annotation {
                left: Some(*area),
                right: None,
                text: "true".to_owned(),
            });
            let found = found.iter().flatten().map(|detection| Annotation {
                left: None,
                right: Some(detection.box_pixel),
                text: format!("{:.2}", detection.score),
            });
            let annotations: Vec<Annotation> = truth.chain(found).collect();
            pictures.push((
                format!("validation/true_left_found_right_{number}"),
                annotate_pair(&item.image, &item.image, &annotations),
            ));
        }
        Ok(pictures)
    }

    fn describe(row: &EpochRow) -> String {
        match (row.precision, row.recall, row.map50, row.map50_95) {
            (Some(precision), Some(recall), Some(map50), Some(map)) => format!(
                ", precision {precision:.3}, recall {recall:.3}, mAP50 {map50:.3}, mAP50-95 {map:.3}"
            ),
            _ => String::new(),
        }
    }

    fn save(&self, model: &Yolo11, path: &Path) -> Result<()> {
        VehicleDetector::save(model, &self.header, path)
    }
}

/// The module paths of the parts that a setting names.
fn frozen_layers(parts: &[String]) -> Result<Vec<String>> {
    let layers = |numbers: &[u32]| numbers.iter().map(|n| format!("layer{n}")).collect();
    let mut paths = Vec::new();
    for part in parts {
        let named: Vec<String> = match part.as_str() {
            "backbone" => layers(&BACKBONE),
            "neck" => layers(&NECK),
            "head" => layers(&HEAD),
            _ => {
                let number = part.strip_prefix("model.").and_then(|n| n.parse().ok());
                let known = number.filter(|n| [&BACKBONE[..], &NECK, &HEAD].concat().contains(n));
                let Some(number) = known else {
                    return Err(Error::value(
                        format!("detector.freeze: {part}"),
                        "the detector has no such part",
                        "give some of backbone, neck, head, or layers with weights as model.0",
                    ));
                };
                layers(&[number])
            }
        };
        paths.extend(named);
    }
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_frozen_by_name_and_an_unknown_one_is_refused() {
        let names = |parts: &[&str]| {
            let parts: Vec<String> = parts.iter().map(|&part| part.to_owned()).collect();
            frozen_layers(&parts)
        };
        assert_eq!(names(&["head", "model.0"]).unwrap(), ["layer23", "layer0"]);
        for unknown in ["tail", "model.11", "model.99", "layer0"] {
            let message = names(&[unknown]).unwrap_err().to_string();
            assert!(message.contains(unknown), "{message}");
        }
    }

    #[test]
    fn frozen_layers_have_no_gradient_and_the_others_do() {
        let device = Device::flex().autodiff();
        let network = Yolo11Config::new(crate::detector::Scale::N, 1).init(&device);
        let frozen = frozen_layers(&["backbone".to_owned()]).unwrap();
        let network = freeze(network, "detector.freeze", &frozen).unwrap();
        assert!(!network.layer0.conv.weight.val().is_require_grad());
        assert!(network.layer16.cv1.conv.weight.val().is_require_grad());
        let moved = network.layer1.conv.weight.val().is_require_grad();
        assert!(
            !moved,
            "layer1 is not layer1x, and both are in the backbone"
        );
    }
}
