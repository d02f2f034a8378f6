//! What there is of a run to judge: both networks, or the one that has been trained.

use std::path::Path;

use burn::tensor::Device;
use serde::{Deserialize, Serialize};

use crate::dataset::{BoxKind, StereoDataset};
use crate::detector::VehicleDetector;
use crate::error::{Error, Result};
use crate::geometry::StereoRig;
use crate::pipeline::{PredictOptions, StereoRanger, size_weights};
use crate::progress::Progress;
use crate::ranging::size::SizeEstimator;
use crate::ranging::{DistanceEstimator, FusedRanger, RigNote, TrustedRig};
use crate::train::StageFolder;

/// The networks that a run has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Networks {
    /// Detector and distance network: the whole pipeline.
    #[default]
    Both,
    /// The detector alone: what it finds is judged.
    Detector,
    /// The distance network alone: it is judged on labelled boxes.
    Distance,
    /// None: the posterior, which needs none, is judged on labelled boxes.
    None,
}

impl Networks {
    /// What cannot be judged for want of the other network, in words.
    pub const fn left_out(self) -> Option<&'static str> {
        match self {
            Self::Both => None,
            Self::None => Some(
                "without a run: the posterior, which needs no training, is judged on labelled boxes",
            ),
            Self::Detector => Some("the run has no distance network: its detector alone is judged"),
            Self::Distance => Some(
                "the run has no detector: its distance network is judged on labelled boxes alone",
            ),
        }
    }
}

/// The networks themselves.
#[derive(Debug, Clone)]
pub(super) enum Subject {
    Both(Box<StereoRanger>),
    Detector(Box<VehicleDetector>, PredictOptions),
    Distance(Box<DistanceEstimator>, Box<FusedRanger>, PredictOptions),
    /// Nothing that was trained: boxes of this kind.
    Labels(Box<FusedRanger>, PredictOptions),
}

impl Subject {
    /// Loads the best weights that a run folder has.
    ///
    /// # Errors
    /// A folder without any, or weights that cannot be used.
    pub fn load(run: &Path, options: PredictOptions, device: &Device) -> Result<Self> {
        let [detector, distance] =
            ["detector", "distance"].map(|stage| StageFolder::new(run, stage).best());
        match (detector.exists(), distance.exists()) {
            (true, false) => {
                let detector = VehicleDetector::load(&detector, device)?;
                Ok(Self::Detector(Box::new(detector), options))
            }
            (false, true) => {
                let distance = DistanceEstimator::load(&distance, device)?;
                let sizes = size_weights(run)
                    .map(|path| SizeEstimator::load(&path, device))
                    .transpose()?;
                let fused = FusedRanger::new(distance.header().box_kind).with_sizes(sizes);
                Ok(Self::Distance(Box::new(distance), Box::new(fused), options))
            }
            _ => {
                let ranger = StereoRanger::load(run, device)?.with_options(options);
                Ok(Self::Both(Box::new(ranger)))
            }
        }
    }

    /// Which networks these are.
    pub const fn networks(&self) -> Networks {
        match self {
            Self::Both(_) => Networks::Both,
            Self::Detector(..) => Networks::Detector,
            Self::Distance(..) => Networks::Distance,
            Self::Labels(..) => Networks::None,
        }
    }

    /// The whole pipeline.
    pub fn ranger(&self) -> Option<&StereoRanger> {
        match self {
            Self::Both(ranger) => Some(ranger),
            _ => None,
        }
    }

    pub fn detector(&self) -> Option<&VehicleDetector> {
        match self {
            Self::Both(ranger) => Some(ranger.detector()),
            Self::Detector(detector, _) => Some(detector),
            Self::Distance(..) | Self::Labels(..) => None,
        }
    }

    pub fn estimator(&self) -> Option<&DistanceEstimator> {
        match self {
            Self::Both(ranger) => Some(ranger.estimator()),
            Self::Detector(..) | Self::Labels(..) => None,
            Self::Distance(estimator, ..) => Some(estimator),
        }
    }

    /// What counts as a detection, and as a pair.
    pub fn options(&self) -> &PredictOptions {
        match self {
            Self::Both(ranger) => ranger.options(),
            Self::Detector(_, options)
            | Self::Distance(_, _, options)
            | Self::Labels(_, options) => options,
        }
    }

    /// The kind of box that was learnt.
    pub fn box_kind(&self) -> BoxKind {
        match self {
            Self::Both(ranger) => ranger.detector().header().box_kind,
            Self::Detector(detector, _) => detector.header().box_kind,
            Self::Distance(estimator, ..) => estimator.header().box_kind,
            Self::Labels(fused, _) => fused.box_kind(),
        }
    }

    /// The default way to a distance; none without a distance network of a run.
    pub fn fused(&self) -> Option<&FusedRanger> {
        match self {
            Self::Both(ranger) => Some(ranger.fused()),
            Self::Distance(_, fused, _) | Self::Labels(fused, _) => Some(fused),
            Self::Detector(..) => None,
        }
    }

    /// The rig that was trained for.
    fn trained_rig(&self) -> Option<&StereoRig> {
        match self {
            Self::Both(ranger) => Some(ranger.rig()),
            Self::Detector(detector, _) => Some(&detector.header().rig),
            Self::Distance(estimator, ..) => Some(&estimator.header().rig),
            Self::Labels(..) => None,
        }
    }

    /// The same for the cameras of a dataset, saying what that leaves uncovered.
    ///
    /// # Errors
    /// Those of [`Subject::refuse_unjudgeable`].
    pub fn behind_rig_of(
        self,
        dataset: &StereoDataset,
        rig: &TrustedRig,
        progress: &dyn Progress,
    ) -> Result<Self> {
        self.refuse_unjudgeable(dataset)?;
        let Some(estimator) = self.estimator().filter(|_| dataset.info.stereo) else {
            return Ok(self);
        };
        if let Some(trained) = self.trained_rig().filter(|trained| **trained != rig.rig) {
            for note in RigNote::of_rig(trained, &rig.rig, estimator.header().readout) {
                progress.note(&note.to_string());
            }
        }
        Ok(match self {
            Self::Both(ranger) => Self::Both(Box::new(ranger.with_trusted_rig(*rig))),
            // An estimator is told the rig with every vehicle.
            alone => alone,
        })
    }

    /// Refuses a dataset that says nothing about these networks: other boxes, other classes, or
    /// single images for a distance network alone.
    fn refuse_unjudgeable(&self, dataset: &StereoDataset) -> Result<()> {
        let kind = self.box_kind();
        let kinds = &dataset.info.label_kinds;
        if !kinds.contains(&kind) {
            let kinds: Vec<_> = kinds.iter().map(ToString::to_string).collect();
            return Err(Error::dataset(
                &dataset.folder,
                format!(
                    "has no {kind} boxes, only {}, and the run learnt {kind} ones",
                    kinds.join(" and ")
                ),
                format!(
                    "evaluate on a dataset with {kind} boxes, or a run that was trained with \
                     `--box-kind {}`",
                    kinds.join("` or `")
                ),
            ));
        }
        if let Some(detector) = self.detector()
            && detector.header().classes[..] != *dataset.classes()
        {
            return Err(Error::dataset(
                &dataset.folder,
                format!(
                    "has the classes {:?}, the run was trained on {:?}",
                    dataset.classes(),
                    detector.header().classes
                ),
                "evaluate on a dataset with the same classes in the same order",
            ));
        }
        if self.detector().is_none() && !dataset.info.stereo {
            return Err(Error::dataset(
                &dataset.folder,
                "has single images (stereo = false), and without a detector there is nothing to judge in them",
                "evaluate on a dataset of stereo pairs",
            ));
        }
        Ok(())
    }
}
