//! The detector's recipe.

use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use burn_dataset::Dataset as _;
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::augment::{DetectionAugment, augmented_letterbox};
use super::config::{DetectorTraining, TrainConfig};
use super::log::EpochRow;
use super::optimizer::scalar;
use super::stage::{PassLoss, Recipe, Steering};
use crate::dataset::{DetectionItem, DetectionSource, Split, StereoDataset};
use crate::detector::decode::Anchors;
use crate::detector::loss::{ImageTargets, LossGains, detection_loss};
use crate::detector::weights::load_detector;
use crate::detector::{DetectorHeader, VehicleDetector, Yolo11, Yolo11Config, letterbox};
use crate::error::{Error, Result};
use crate::evaluate::detection_metrics;
use crate::geometry::letterbox::Size;
use crate::progress::Progress;
use crate::weights::StateDict;

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
    pub fn new(config: &TrainConfig, dataset: &StereoDataset, device: &Device) -> Result<Self> {
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

    /// The network to start from: fresh, or the given weights.
    ///
    /// # Errors
    /// Weights that do not fit.
    pub fn model(&self, progress: &dyn Progress) -> Result<Yolo11> {
        let classes = self.header.classes.len();
        self.device.seed(self.seed);
        let Some(path) = &self.settings.weights else {
            return Ok(Yolo11Config::new(self.settings.scale, classes).init(&self.device));
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
        Ok(model)
    }

    /// The numbers that steer the stage.
    pub fn steering(&self) -> Steering {
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
            clip_norm: Some(settings.clip_norm),
            average: Some((settings.ema_decay, settings.ema_ramp)),
            validate_every: settings.validate_every,
            settings: serde_json::json!({ "seed": self.seed, "header": self.header, "training": settings }).to_string(),
        }
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
}

impl Recipe for DetectorRecipe {
    type Model = Yolo11;
    type Batch = LetterboxedBatch;
    const STAGE: &'static str = "detector";

    fn items(&self) -> usize {
        self.train.len()
    }

    fn item_name(&self, item: usize) -> String {
        self.train.get(item).map_or_else(
            |_| format!("item {item}"),
            |item| item.path.display().to_string(),
        )
    }

    fn load(&self, epoch: u32, items: &[usize]) -> Result<LetterboxedBatch> {
        let augment = DetectionAugment {
            hsv: self.settings.hsv,
            zoom: self.settings.zoom,
            shift: self.settings.shift,
            flip: self.settings.flip,
        };
        let area = self.input.area();
        let mut planes = vec![0.0; items.len() * 3 * area];
        let targets = planes
            .par_chunks_exact_mut(3 * area)
            .zip(items)
            .map(|(planes, &index)| {
                let item = self.item(index)?;
                let stream = (u128::from(epoch) << 64) | index as u128;
                let mut random = Pcg64::new(u128::from(self.seed), stream);
                augmented_letterbox(
                    &item.image,
                    &item.boxes,
                    &item.ignored,
                    self.input,
                    &augment,
                    &mut random,
                    planes,
                )
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(LetterboxedBatch { planes, targets })
    }

    fn loss(&self, model: &Yolo11, batch: LetterboxedBatch, _: f64) -> Result<PassLoss> {
        let LetterboxedBatch { planes, targets } = batch;
        let shape = [
            targets.len(),
            3,
            self.input.height as usize,
            self.input.width as usize,
        ];
        let input = Tensor::<4>::from_data(TensorData::new(planes, shape), &self.device);
        let output = model.forward(input).flatten();
        let loss = detection_loss(&output, &targets, &self.anchors, LossGains::default())?;
        let terms = loss.items.iter().map(scalar).collect::<Result<Vec<_>>>()?;
        // The batch size times the terms: summed over passes, as in one large batch.
        Ok(PassLoss {
            total: loss.total,
            reported: terms.iter().sum(),
            terms,
        })
    }

    fn report_terms(&self, terms: &[f64], row: &mut EpochRow) {
        if let [boxes, classes, distribution] = *terms {
            row.box_loss = Some(boxes);
            row.class_loss = Some(classes);
            row.distribution_loss = Some(distribution);
        }
    }

    fn validate(&self, model: &Yolo11, row: &mut EpochRow) -> Result<Option<f64>> {
        if self.val.is_empty() {
            return Ok(None);
        }
        let detector = VehicleDetector::new(model, self.header.clone(), &self.device);
        let summary = detection_metrics(&detector, &self.val)?.compute();
        row.precision = Some(summary.precision);
        row.recall = Some(summary.recall);
        row.map50 = Some(summary.map50);
        row.map50_95 = Some(summary.map50_95);
        Ok(Some(summary.map50_95))
    }

    fn describe(&self, row: &EpochRow) -> String {
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
