//! The size network's recipe: trained after the distance network, which it leaves as it is.

mod extent;
mod findings;
mod finish;
mod samples;
mod view;

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use burn::optim::ModuleOptimizer;
use burn::tensor::{Device, Tensor, TensorData};
use image::imageops::replace;
use image::{Rgb, RgbImage};

use super::config::{SizeTraining, TrainConfig};
use super::log::EpochRow;
use super::optimizer::{AverageRule, detector_optimizer, initialize};
use super::stage::{PassLoss, PreparedStage, Recipe, Steering, device_of};
use crate::annotate::write_text;
use crate::dataset::{BoxKind, Split, StereoDataset};
use crate::error::{Error, Result};
use crate::geometry::StereoRig;
use crate::imaging::crop_resized;
use crate::progress::Progress;
use crate::ranging::size::{
    Moments, SizeConfig, SizeEstimator, SizeHeader, SizeInputs, SizeNetwork, crop_area,
};
use findings::SizeErrors;
use samples::SampleSet;
use view::{LoadedViews, Target};

/// Validation crops in TensorBoard, at most, and their side in pixels.
const SHOWN: usize = 8;
const SHOWN_SIDE: u32 = 128;

/// Weight of the pose's squared errors, in standard deviations, beside the likelihoods: it is learnt
/// for what it teaches the features, and must not push the witness aside.
const POSE_WEIGHT: f64 = 0.5;

/// Share of its variance by which a vehicle's likelihood is weighed, after Seitzer and others, "On the
/// pitfalls of heteroscedastic uncertainty estimation" (2022): with none of it the spread of what is
/// hard grows until nothing is learnt of it any more, and that of what is easy shrinks by heart.
const BETA: f64 = 0.5;

/// Bounds of the logarithm of a spread, in standard deviations of the training vehicles.
const LOG_SPREADS: [f64; 2] = [-4.0, 2.0];

const NLL: &str = "validation/size_nll";

/// Training vehicles, augmentation and loss of the size network.
pub struct SizeRecipe {
    settings: SizeTraining,
    seed: u64,
    kind: BoxKind,
    device: Device,
    rig: StereoRig,
    train: SampleSet,
    val: SampleSet,
    header: SizeHeader,
    /// Moments of the pose's numbers; none where the dataset does not tell poses.
    pose: Option<[Moments; SizeNetwork::POSE]>,
}

impl SizeRecipe {
    fn new(
        config: &TrainConfig,
        dataset: &StereoDataset,
        device: &Device,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let budget = config.cache_mib << 20;
        let kind = config.box_kind;
        let train = SampleSet::open(dataset, Split::Train, kind, budget / 5 * 4, progress)?;
        let val = SampleSet::open(dataset, Split::Val, kind, budget / 5, progress)?;
        let sizes: Vec<f64> = train
            .samples
            .iter()
            .map(|sample| sample.log_size(dataset.rig()))
            .collect();
        let Some(log_size) = Moments::of(&sizes) else {
            return Err(Error::dataset(
                &dataset.folder,
                "has no vehicles that are labelled in both images of training frames",
                "give a dataset with training frames, or leave the size network out: size.epochs = 0",
            ));
        };
        let extents: Vec<f64> = train.samples.iter().filter_map(|s| s.extent_m).collect();
        let poses: Vec<_> = train.samples.iter().filter_map(|s| s.pose).collect();
        let mut pose = None;
        if !poses.is_empty() {
            let column = |index: usize| poses.iter().map(|pose| pose[index]).collect::<Vec<_>>();
            let moments = (0..SizeNetwork::POSE).filter_map(|index| Moments::of(&column(index)));
            pose = moments.collect::<Vec<_>>().try_into().ok();
        }
        Ok(Self {
            settings: config.size.clone(),
            seed: config.seed,
            kind,
            device: device.clone().autodiff(),
            rig: *dataset.rig(),
            header: SizeHeader {
                network: SizeHeader::NETWORK.to_owned(),
                version: env!("CARGO_PKG_VERSION").to_owned(),
                box_kind: kind,
                classes: dataset.classes().to_vec(),
                rig: *dataset.rig(),
                log_size,
                extent: Moments::of(&extents),
                calibration: None,
            },
            pose,
            train,
            val,
        })
    }

    /// The whole stage, ready to run. One that goes on gets its weights from what it saved.
    ///
    /// # Errors
    /// A dataset without training vehicles, or images that cannot be read.
    pub fn prepared(
        config: &TrainConfig,
        dataset: &StereoDataset,
        device: &Device,
        progress: &dyn Progress,
    ) -> Result<PreparedStage<Self>> {
        let recipe = Self::new(config, dataset, device, progress)?;
        recipe.device.seed(recipe.seed);
        let network = SizeConfig::new().init(&recipe.device);
        initialize(&network);
        Ok(PreparedStage {
            steering: recipe.steering(),
            network,
            recipe: Arc::new(recipe),
        })
    }

    fn steering(&self) -> Steering {
        let settings = &self.settings;
        Steering {
            seed: self.seed,
            epochs: settings.epochs,
            batch: settings.batch,
            micro_batch: settings.batch,
            learning_rate: settings.learning_rate,
            final_learning_rate: settings.final_learning_rate,
            schedule: settings.schedule,
            warmup_epochs: settings.warmup_epochs,
            first_bias_rate: 0.0,
            clip_norm: Some(settings.clip_norm),
            average: (settings.ema_decay > 0.0).then_some(AverageRule {
                longest: settings.ema_decay,
                ramp: settings.ema_ramp,
            }),
            validate_every: settings.validate_every,
            patience: settings.patience,
            keep_last: 0,
            settings: serde_json::json!({ "seed": self.seed, "header": self.header, "training": settings }).to_string(),
            // Known to the run, which opened it.
            dataset: String::new(),
        }
    }
}

impl Recipe for SizeRecipe {
    type Model = SizeNetwork;
    type Batch = LoadedViews;
    type Judge = SizeEstimator;
    type Findings = SizeErrors;
    const STAGE: &'static str = "size";
    const TERMS: &'static [&'static str] = &["loss/log_size", "loss/extent", "loss/pose"];
    const SCORES: &'static [&'static str] = &[
        "validation/log_size_rms",
        "validation/log_size_within_68",
        "validation/log_size_within_95",
        "validation/extent_rms_m",
        "validation/extent_within_68",
        "validation/extent_within_95",
        NLL,
    ];

    fn items(&self) -> usize {
        self.train.samples.len()
    }

    fn item_files(&self, _: u32, item: usize) -> Vec<PathBuf> {
        let sample = &self.train.samples[item];
        let images = sample.frame.images();
        images
            .filter(|(side, _)| *side == sample.side)
            .map(|(_, image)| image.path.clone())
            .collect()
    }

    fn load(&self, epoch: u32, items: &[usize]) -> Result<LoadedViews> {
        self.views(&self.train, items, Some(epoch))
    }

    fn loss(&self, model: &SizeNetwork, batch: LoadedViews, share: f64) -> Result<PassLoss> {
        let device = device_of(model).autodiff();
        let LoadedViews { inputs, targets } = batch;
        let count = targets.len();
        let column = |value: &dyn Fn(&Target) -> f64| -> Tensor<2> {
            let values: Vec<f32> = targets.iter().map(|target| value(target) as f32).collect();
            Tensor::from_data(TensorData::new(values, [count, 1]), &device)
        };
        let log_size = column(&|target| self.header.log_size.standard(target.log_size));
        let known = |target: &Target| Some((self.header.extent?, target.extent_m?));
        let extent = column(&|target| known(target).map_or(0.0, |(m, value)| m.standard(value)));
        let has_extent = column(&|target| f64::from(u8::from(known(target).is_some())));
        let has_pose = column(&|target| f64::from(u8::from(target.pose.is_some())));
        let poses: Vec<f32> = targets
            .iter()
            .flat_map(|target| match (&self.pose, &target.pose) {
                (Some(moments), Some(pose)) => {
                    std::array::from_fn(|i| moments[i].standard(pose[i]) as f32)
                }
                _ => [0.0; SizeNetwork::POSE],
            })
            .collect();
        let poses = TensorData::new(poses, [count, SizeNetwork::POSE]);
        let poses: Tensor<2> = Tensor::from_data(poses, &device);
        let (crops, numbers) = inputs.into_tensors(&device);
        let output = model.forward(crops, numbers);
        let likelihood = |first: usize, truth: Tensor<2>| {
            let mean = output.witness.clone().narrow(1, first, 1);
            let log_spread = output.witness.clone().narrow(1, first + 1, 1);
            let log_spread = log_spread.clamp(LOG_SPREADS[0], LOG_SPREADS[1]);
            let error = (mean - truth) * log_spread.clone().neg().exp();
            let weight = log_spread.clone().detach().mul_scalar(2.0 * BETA).exp();
            (error.square().mul_scalar(0.5) + log_spread) * weight
        };
        let size_loss = likelihood(0, log_size).mean();
        let extent_loss = (likelihood(2, extent) * has_extent).mean();
        let pose_loss = ((output.pose - poses).square().mean_dim(1) * has_pose)
            .mean()
            .mul_scalar(POSE_WEIGHT);
        let total = size_loss.clone() + extent_loss.clone() + pose_loss.clone();
        Ok(PassLoss {
            total: total.mul_scalar(share),
            terms: Tensor::cat(vec![size_loss, extent_loss, pose_loss], 0),
        })
    }

    fn optimizer(&self, _: f64) -> Result<ModuleOptimizer> {
        detector_optimizer(self.settings.optimizer, self.settings.weight_decay, None)
    }

    fn checks(&self) -> usize {
        self.val.samples.len()
    }

    fn check_batch(&self) -> usize {
        self.settings.batch
    }

    fn judge(&self, model: &SizeNetwork) -> Result<SizeEstimator> {
        let device = device_of(model).without_autodiff();
        Ok(SizeEstimator::new(
            model,
            self.header.clone(),
            None,
            &device,
        ))
    }

    fn examine(&self, judge: &SizeEstimator, items: Range<usize>) -> Result<SizeErrors> {
        let items: Vec<usize> = items.collect();
        let LoadedViews { inputs, targets } = self.views(&self.val, &items, None)?;
        let mut errors = SizeErrors::default();
        for (raw, target) in judge.examine(inputs)?.iter().zip(&targets) {
            errors.add(&raw.said, target.log_size, target.extent_m);
        }
        Ok(errors)
    }

    fn no_findings(&self) -> SizeErrors {
        SizeErrors::default()
    }

    fn merge(findings: &mut SizeErrors, more: &SizeErrors) {
        findings.merge(more);
    }

    fn scores(findings: &SizeErrors) -> Option<Vec<f64>> {
        let summary = findings.summary();
        let size = summary.log_size?;
        let extent = summary.extent;
        let of_extent =
            |value: fn(&findings::SpreadSummary) -> f64| extent.as_ref().map_or(f64::NAN, value);
        Some(vec![
            size.rms,
            size.within[0],
            size.within[1],
            of_extent(|extent| extent.rms),
            of_extent(|extent| extent.within[0]),
            of_extent(|extent| extent.within[1]),
            size.nll + extent.map_or(0.0, |extent| extent.nll),
        ])
    }

    fn merit(&self) -> (&'static str, f64) {
        (NLL, -1.0)
    }

    fn pictures(&self, judge: &SizeEstimator) -> Result<Vec<(String, RgbImage)>> {
        let count = self.val.samples.len();
        let some: Vec<usize> = (0..count).step_by(count.div_ceil(SHOWN).max(1)).collect();
        if some.is_empty() {
            return Ok(Vec::new());
        }
        let LoadedViews { inputs, targets } = self.views(&self.val, &some, None)?;
        let said = judge.examine(inputs)?;
        let mut picture = RgbImage::new(SHOWN_SIDE * some.len() as u32, SHOWN_SIDE);
        for ((column, &index), (raw, target)) in (0..).zip(&some).zip(said.iter().zip(&targets)) {
            let patch = self.val.patch(index)?;
            let window = patch.within(&crop_area(&self.val.samples[index].box_pixel));
            let crop = crop_resized(&patch.image, &window, SHOWN_SIDE, SHOWN_SIDE);
            let left = i64::from(column * SHOWN_SIDE);
            replace(&mut picture, &crop, left, 0);
            let said = &raw.said;
            let lines = [
                format!("is {:.2} m", target.log_size.exp()),
                format!(
                    "est {:.2} +-{:.0}%",
                    said.log_size_mean.exp(),
                    100.0 * said.log_size_std
                ),
            ];
            for (line, text) in (0..).zip(lines) {
                let corner = [left + 4, 4 + 12 * line];
                write_text(&mut picture, corner, &text, 1, Rgb([255, 255, 0]));
            }
        }
        Ok(vec![("validation/crops".to_owned(), picture)])
    }

    fn describe(row: &EpochRow) -> String {
        match (row.log_size_rms, row.log_size_within_68, row.extent_rms_m) {
            (Some(rms), Some(within), extent) => {
                let extent = extent.map_or(String::new(), |rms| format!(", extent {rms:.2} m"));
                format!(
                    ", size {:.1} % (68 % intervals hold {:.0} %){extent}",
                    100.0 * rms,
                    100.0 * within
                )
            }
            _ => String::new(),
        }
    }

    fn save(&self, model: &SizeNetwork, path: &Path) -> Result<()> {
        SizeEstimator::save(model, &self.header, None, path)
    }
}
