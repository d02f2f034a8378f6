//! All settings of a training run, in one typed place: a preset, a TOML file, flags, in that
//! order.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

pub use super::choices::{DetectorMerit, DistanceMerit, OptimizerKind, Schedule, TrainingBoxes};
use crate::dataset::{BoxKind, CompositeSize, SplitBy};
use crate::detector::Scale;
use crate::error::{Error, Result};
use crate::files;
use crate::ranging::{Crops, Readout};

/// The presets that come with the program.
const PRESETS: [(&str, &str); 2] = [
    ("quick", include_str!("presets/quick.toml")),
    ("paper", include_str!("presets/paper.toml")),
];

/// Settings of a training run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Everything random follows from it.
    pub seed: u64,
    /// Which of a dataset's two kinds of box is learnt.
    pub box_kind: BoxKind,
    /// Divides frames anew between training and validation; absent keeps the dataset's own split.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub split: Option<SplitBy>,
    /// Decoded images kept in memory, MiB.
    pub cache_mib: usize,
    /// The detector's training.
    pub detector: DetectorTraining,
    /// The distance network's training.
    pub distance: DistanceTraining,
    /// The size network's training.
    #[serde(default)]
    pub size: SizeTraining,
}

/// Settings of the detector's training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DetectorTraining {
    /// Size of the network.
    pub scale: Scale,
    /// Long side of the network's input, pixels; the short side follows from the images, both are
    /// rounded up to multiples of 32.
    pub image_size: u32,
    /// Passes over the training images.
    pub epochs: u32,
    /// Images per optimiser step.
    pub batch: usize,
    /// Images per forward pass; gradients are accumulated to the batch. Less saves memory.
    pub micro_batch: usize,
    /// What turns gradients into steps.
    #[serde(default)]
    pub optimizer: OptimizerKind,
    /// Its learning rate.
    pub learning_rate: f64,
    /// Last learning rate as a share of the first.
    pub final_learning_rate: f64,
    /// How the learning rate falls.
    pub schedule: Schedule,
    /// Epochs over which the learning rate rises.
    pub warmup_epochs: f64,
    /// Learning rate from which that of the biases, normalisation's too, comes to the others' over
    /// the warm-up; 0 lets it rise as they do.
    #[serde(default)]
    pub warmup_bias_rate: f64,
    /// Momentum from which it rises over the warm-up; `sgd` alone.
    #[serde(default = "default_warmup_momentum")]
    pub warmup_momentum: f64,
    /// L2 penalty on convolution weights.
    pub weight_decay: f64,
    /// Gradients longer than this are scaled down, as one vector over all parameters.
    pub clip_norm: f64,
    /// Longest memory of the averaged weights that are validated and saved, as a decay.
    pub ema_decay: f64,
    /// Updates over which the average's memory grows.
    pub ema_ramp: f64,
    /// Validate every so many epochs; the last one always is.
    pub validate_every: u32,
    /// Stop after so many epochs without a better validation result; 0 never stops early.
    #[serde(default)]
    pub patience: u32,
    /// What the best epoch is best by.
    #[serde(default)]
    pub best_by: DetectorMerit,
    /// Weights of so many last epochs are kept, each in a file of its own; 0 keeps only the last
    /// and the best.
    #[serde(default)]
    pub keep_last: u32,
    /// Probability that an image is a mosaic of four.
    #[serde(default)]
    pub mosaic: f64,
    /// Last epochs without mosaics.
    #[serde(default)]
    pub close_mosaic: u32,
    /// Largest change of the input's size from batch to batch, as a share; 0 keeps it.
    #[serde(default)]
    pub multi_scale: f64,
    /// Largest change of hue, saturation and value, as shares.
    pub hsv: [f64; 3],
    /// Largest change of size, as a share.
    pub zoom: f64,
    /// Largest shift, as a share of the input's sides.
    pub shift: f64,
    /// Probability of a horizontal flip.
    pub flip: f64,
    /// Weights to start from: safetensors with the published names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weights: Option<PathBuf>,
    /// Parts that are not trained: `backbone`, `neck`, `head`, or single layers as `model.0`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub freeze: Vec<String>,
}

/// Settings of the distance network's training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DistanceTraining {
    /// Size of the composites.
    pub composite: CompositeSize,
    /// What the network's output stands for.
    #[serde(default)]
    pub readout: Readout,
    /// Which crops the composites hold.
    #[serde(default)]
    pub inputs: Crops,
    /// Extend the geometry vector by the sub-pixel disparity of the box's pixels, measured as
    /// prediction does on the boxes and images that the network sees.
    #[serde(default)]
    pub disparity: bool,
    /// Passes over the training vehicles.
    pub epochs: u32,
    /// Composites per optimiser step.
    pub batch: usize,
    /// Composites per forward pass; gradients are accumulated to the batch. Less saves memory.
    pub micro_batch: usize,
    /// What turns gradients into steps.
    #[serde(default)]
    pub optimizer: OptimizerKind,
    /// Its learning rate.
    pub learning_rate: f64,
    /// Last learning rate as a share of the first.
    pub final_learning_rate: f64,
    /// How the learning rate falls.
    pub schedule: Schedule,
    /// Epochs over which the learning rate rises.
    pub warmup_epochs: f64,
    /// Fit the first weights to the data, rather than start from random numbers alone: every layer
    /// normalised on training composites, the last one by ridge regression.
    pub fit_start: bool,
    /// Whose boxes are trained on. Validation has the labels'.
    #[serde(default)]
    pub boxes: TrainingBoxes,
    /// Spread of the boxes' edges around the labels, as a share of the box: imitates the
    /// detector's errors. 0 trains on the labels' boxes alone.
    pub box_jitter: f64,
    /// Largest change of brightness and of contrast, as shares, the same for both crops.
    pub photometric: f64,
    /// Probability of the flip that keeps stereo true: both images mirrored, left and right
    /// exchanged.
    pub flip: f64,
    /// Share that the averaged weights, which are validated and saved, keep of themselves at every
    /// step; 0 averages nothing.
    pub ema_decay: f64,
    /// Steps over which that share rises.
    pub ema_ramp: f64,
    /// Validate every so many epochs; the last one always is.
    pub validate_every: u32,
    /// Stop after so many epochs without a better validation result; 0 never stops early.
    #[serde(default)]
    pub patience: u32,
    /// What the best epoch is best by.
    #[serde(default)]
    pub best_by: DistanceMerit,
    /// Weights of so many last epochs are kept, each in a file of its own; 0 keeps only the last
    /// and the best.
    #[serde(default)]
    pub keep_last: u32,
    /// Weights to start from, as training writes them; their composite's size must be the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weights: Option<PathBuf>,
    /// Parts that are not trained: `blocks`, single ones as `blocks.0`, `fc1`, `fc2`, `out`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub freeze: Vec<String>,
}

/// Settings of the size network's training, which is part of the distance network's stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SizeTraining {
    /// Passes over the training vehicles, each of them once in either image; 0 leaves the network out.
    pub epochs: u32,
    /// Crops per optimiser step.
    pub batch: usize,
    /// What turns gradients into steps.
    pub optimizer: OptimizerKind,
    /// Its learning rate.
    pub learning_rate: f64,
    /// Last learning rate as a share of the first.
    pub final_learning_rate: f64,
    /// How the learning rate falls.
    pub schedule: Schedule,
    /// Epochs over which the learning rate rises.
    pub warmup_epochs: f64,
    /// Decay of the weights.
    pub weight_decay: f64,
    /// Gradients longer than this are scaled down, as one vector over all parameters.
    pub clip_norm: f64,
    /// Spread of the boxes' edges around the labels, as a share of the box: a detector's errors.
    pub box_jitter: f64,
    /// Largest change of gamma and of the channels' gains, as shares.
    pub photometric: f64,
    /// Probability that something hides a part of the crop.
    pub occlusion: f64,
    /// Probability that the crop is mirrored.
    pub flip: f64,
    /// Share that the averaged weights, which are validated and saved, keep of themselves at every
    /// step; 0 averages nothing.
    pub ema_decay: f64,
    /// Steps over which that share rises.
    pub ema_ramp: f64,
    /// Validate every so many epochs; the last one always is.
    pub validate_every: u32,
    /// Stop after so many epochs without a better validation result; 0 never stops early.
    pub patience: u32,
}

impl SizeTraining {
    /// Every value, and between which it can be used.
    fn ranges(&self) -> [(&'static str, f64, RangeInclusive<f64>); 14] {
        let share = 0.0..=1.0;
        [
            ("size.epochs", f64::from(self.epochs), 0.0..=1e6),
            ("size.batch", self.batch as f64, 2.0..=4096.0),
            ("size.learning_rate", self.learning_rate, 1e-9..=1.0),
            (
                "size.final_learning_rate",
                self.final_learning_rate,
                share.clone(),
            ),
            ("size.warmup_epochs", self.warmup_epochs, 0.0..=1e6),
            ("size.weight_decay", self.weight_decay, share.clone()),
            ("size.clip_norm", self.clip_norm, 1e-6..=1e9),
            ("size.box_jitter", self.box_jitter, 0.0..=0.2),
            ("size.photometric", self.photometric, 0.0..=0.9),
            ("size.occlusion", self.occlusion, share.clone()),
            ("size.flip", self.flip, share.clone()),
            ("size.ema_decay", self.ema_decay, share),
            ("size.ema_ramp", self.ema_ramp, 1.0..=1e9),
            (
                "size.validate_every",
                f64::from(self.validate_every),
                1.0..=1e6,
            ),
        ]
    }
}

impl Default for SizeTraining {
    fn default() -> Self {
        Self {
            epochs: 30,
            batch: 32,
            optimizer: OptimizerKind::AdamW,
            learning_rate: 0.002,
            final_learning_rate: 0.01,
            schedule: Schedule::Cosine,
            warmup_epochs: 1.0,
            weight_decay: 0.02,
            clip_norm: 10.0,
            box_jitter: 0.02,
            photometric: 0.2,
            occlusion: 0.25,
            flip: 0.5,
            ema_decay: 0.99,
            ema_ramp: 100.0,
            validate_every: 3,
            patience: 0,
        }
    }
}

fn default_warmup_momentum() -> f64 {
    0.8
}

impl TrainConfig {
    /// The settings of a preset: `quick` or `paper`.
    ///
    /// # Errors
    /// A name that is not a preset.
    pub fn preset(name: &str) -> Result<Self> {
        Self::resolve(Some(name), None, &toml::Table::new())
    }

    /// Resolves a preset (default `quick`), then a TOML file, then single settings, each over the
    /// ones before. A file or table gives only what it changes.
    ///
    /// # Errors
    /// An unknown preset or setting, a file that cannot be read, a value that cannot be used.
    pub fn resolve(preset: Option<&str>, file: Option<&Path>, flags: &toml::Table) -> Result<Self> {
        let name = preset.unwrap_or("quick");
        let Some((_, text)) = PRESETS.iter().find(|(preset, _)| *preset == name) else {
            let names: Vec<&str> = PRESETS.iter().map(|(name, _)| *name).collect();
            return Err(Error::value(
                format!("preset {name}"),
                "there is no such preset",
                format!("give one of {}", names.join(", ")),
            ));
        };
        let origin = format!("preset {name}");
        let table =
            toml::from_str(text).map_err(|source| invalid_settings(origin.clone(), &source))?;
        Self::laid_over(table, origin, file, flags)
    }

    /// These settings, over them a TOML file, over that single settings.
    ///
    /// # Errors
    /// An unknown setting, a file that cannot be read, a value that cannot be used.
    pub fn changed(&self, file: Option<&Path>, flags: &toml::Table) -> Result<Self> {
        let origin = "the run's settings".to_owned();
        let table = toml::Table::try_from(self)
            .map_err(|source| invalid_settings(origin.clone(), &source))?;
        Self::laid_over(table, origin, file, flags)
    }

    fn laid_over(
        mut table: toml::Table,
        mut origin: String,
        file: Option<&Path>,
        flags: &toml::Table,
    ) -> Result<Self> {
        if let Some(path) = file {
            origin = format!("config {}", path.display());
            let text = files::read_text(path)?;
            let changes = toml::from_str(&text)
                .map_err(|source| invalid_settings(origin.clone(), &source))?;
            overlay(&mut table, &changes);
        }
        overlay(&mut table, flags);
        let config: Self = table
            .try_into()
            .map_err(|source| invalid_settings(origin, &source))?;
        config.validate()?;
        Ok(config)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// Names the first value that cannot be used.
    pub fn validate(&self) -> Result<()> {
        let (detector, distance) = (&self.detector, &self.distance);
        let share = 0.0..=1.0;
        let checks = [
            ("cache_mib", self.cache_mib as f64, 0.0..=1e6),
            (
                "detector.image_size",
                f64::from(detector.image_size),
                32.0..=8192.0,
            ),
            ("detector.epochs", f64::from(detector.epochs), 1.0..=1e6),
            ("detector.batch", detector.batch as f64, 1.0..=4096.0),
            (
                "detector.micro_batch",
                detector.micro_batch as f64,
                1.0..=detector.batch.max(1) as f64,
            ),
            ("detector.learning_rate", detector.learning_rate, 1e-9..=1.0),
            (
                "detector.final_learning_rate",
                detector.final_learning_rate,
                share.clone(),
            ),
            ("detector.warmup_epochs", detector.warmup_epochs, 0.0..=1e6),
            (
                "detector.warmup_bias_rate",
                detector.warmup_bias_rate,
                share.clone(),
            ),
            (
                "detector.warmup_momentum",
                detector.warmup_momentum,
                share.clone(),
            ),
            (
                "detector.weight_decay",
                detector.weight_decay,
                share.clone(),
            ),
            ("detector.clip_norm", detector.clip_norm, 1e-6..=1e9),
            ("detector.ema_decay", detector.ema_decay, share.clone()),
            ("detector.ema_ramp", detector.ema_ramp, 1.0..=1e9),
            ("distance.ema_decay", distance.ema_decay, share.clone()),
            ("distance.ema_ramp", distance.ema_ramp, 1.0..=1e9),
            (
                "detector.validate_every",
                f64::from(detector.validate_every),
                1.0..=1e6,
            ),
            ("detector.mosaic", detector.mosaic, share.clone()),
            ("detector.multi_scale", detector.multi_scale, 0.0..=0.9),
            ("detector.hsv hue", detector.hsv[0], share.clone()),
            ("detector.hsv saturation", detector.hsv[1], share.clone()),
            ("detector.hsv value", detector.hsv[2], share.clone()),
            ("detector.zoom", detector.zoom, 0.0..=0.9),
            ("detector.shift", detector.shift, 0.0..=0.5),
            ("detector.flip", detector.flip, share.clone()),
            ("distance.epochs", f64::from(distance.epochs), 1.0..=1e6),
            ("distance.batch", distance.batch as f64, 1.0..=4096.0),
            (
                "distance.micro_batch",
                distance.micro_batch as f64,
                1.0..=distance.batch.max(1) as f64,
            ),
            ("distance.learning_rate", distance.learning_rate, 1e-9..=1.0),
            ("distance.warmup_epochs", distance.warmup_epochs, 0.0..=1e6),
            (
                "distance.final_learning_rate",
                distance.final_learning_rate,
                share.clone(),
            ),
            ("distance.box_jitter", distance.box_jitter, 0.0..=0.5),
            ("distance.photometric", distance.photometric, 0.0..=0.9),
            ("distance.flip", distance.flip, share),
            (
                "distance.validate_every",
                f64::from(distance.validate_every),
                1.0..=1e6,
            ),
        ];
        for (name, value, range) in checks.into_iter().chain(self.size.ranges()) {
            if !range.contains(&value) {
                return Err(Error::value(
                    format!("{name} = {value}"),
                    "out of range",
                    format!("give a value between {} and {}", range.start(), range.end()),
                ));
            }
        }
        CompositeSize::new(distance.composite.height, distance.composite.width)?;
        if distance.readout == Readout::Surface && !distance.disparity {
            return Err(Error::value(
                "distance.readout = \"surface\"",
                "counts from the surface that the disparity shows, which is not measured",
                "set distance.disparity = true as well, or another readout",
            ));
        }
        Ok(())
    }
}

fn invalid_settings(what: String, source: &dyn std::error::Error) -> Error {
    Error::value(
        what,
        source.to_string().trim().to_owned(),
        "correct the setting",
    )
}

/// Puts `changes` over `base`, table by table.
fn overlay(base: &mut toml::Table, changes: &toml::Table) {
    for (key, value) in changes {
        match (base.get_mut(key), value) {
            (Some(toml::Value::Table(base)), toml::Value::Table(changes)) => overlay(base, changes),
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_is_valid_and_uses_the_paper_optimiser_settings() {
        for (name, _) in PRESETS {
            let config = TrainConfig::preset(name).unwrap();
            assert_eq!((config.detector.batch, config.distance.batch), (16, 16));
            assert_eq!(config.detector.learning_rate, 0.001);
            assert_eq!(config.distance.learning_rate, 0.001);
        }
    }

    #[test]
    fn settings_that_quick_leaves_out_are_shown_with_the_value_that_then_holds() {
        let (_, text) = PRESETS[0];
        let mut shown: Vec<String> = Vec::new();
        let is_optional = |line: &&str| line.starts_with("# ") && line.contains(" = ");
        for line in text.lines() {
            // What has no such value is shown with an example.
            let example = ["# split", "# weights"].iter().any(|e| line.starts_with(e));
            match Some(line).filter(is_optional) {
                Some(line) if !example => shown.push(line[2..].to_owned()),
                Some(_) => {}
                None => shown.push(line.to_owned()),
            }
        }
        let spelled: toml::Table = toml::from_str(&shown.join("\n")).unwrap();
        let config: TrainConfig = spelled.clone().try_into().unwrap();
        assert_eq!(config, TrainConfig::preset("quick").unwrap());
        // An empty list is not written at all.
        let all = toml::Table::try_from(&config).unwrap();
        for section in ["detector", "distance", "size"] {
            let names = |table: &toml::Table| -> Vec<String> {
                let section = table[section].as_table().unwrap();
                let mut names: Vec<String> = section.keys().cloned().collect();
                names.retain(|name| name != "freeze");
                names.sort();
                names
            };
            assert_eq!(names(&spelled), names(&all));
        }
    }

    #[test]
    fn flags_go_over_the_file_and_the_file_over_the_preset() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("my.toml");
        std::fs::write(&path, "seed = 7\n[detector]\nepochs = 3\nscale = \"s\"\n").unwrap();
        let flags = toml::from_str("[detector]\nepochs = 5\n").unwrap();
        let config = TrainConfig::resolve(Some("quick"), Some(&path), &flags).unwrap();
        assert_eq!(config.seed, 7);
        assert_eq!(config.detector.epochs, 5);
        assert_eq!(config.detector.scale, Scale::S);
        assert_eq!(
            config.distance,
            TrainConfig::preset("quick").unwrap().distance
        );
    }

    #[test]
    fn settings_survive_being_changed_by_nothing_and_take_single_changes() {
        for (name, _) in PRESETS {
            let config = TrainConfig::preset(name).unwrap();
            assert_eq!(config.changed(None, &toml::Table::new()).unwrap(), config);
            let flags = toml::from_str("[distance]\nepochs = 5\n").unwrap();
            let changed = config.changed(None, &flags).unwrap();
            assert_eq!(changed.detector, config.detector);
            assert_eq!(changed.distance.epochs, 5);
        }
    }

    #[test]
    fn an_unknown_setting_and_a_value_out_of_range_are_named() {
        let resolve = |text: &str| {
            let flags = toml::from_str(text).unwrap();
            TrainConfig::resolve(None, None, &flags)
                .unwrap_err()
                .to_string()
        };
        assert!(resolve("[detector]\nepoch = 5\n").contains("epoch"));
        assert!(
            resolve("[detector]\nlearning_rate = 0.0\n").contains("detector.learning_rate = 0")
        );
        assert!(
            TrainConfig::preset("fast")
                .unwrap_err()
                .to_string()
                .contains("quick, paper")
        );
    }
}
