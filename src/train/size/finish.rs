//! What follows the last epoch: spreads corrected by the validation vehicles, the guard fitted to the
//! training vehicles, and the coverage of both written down.

use std::path::Path;

use serde::Serialize;

use super::findings::{SizeErrors, SizeSummary};
use super::samples::{Sample, SampleSet};
use super::view::{LoadedViews, Target};
use super::{SizeRecipe, Split};
use crate::dataset::StereoDataset;
use crate::error::Result;
use crate::evaluate::write_json;
use crate::metrics::quantile_of;
use crate::progress::Progress;
use crate::ranging::size::{
    Calibration, FrameLimits, Guard, GuardEvidence, GuardLimits, RawWitness, SizeConfig,
    SizeEstimator, SizeHeader,
};
use crate::train::StageFolder;
use crate::train::stage::Recipe as _;
use crate::weights::StateDict;

/// Share of the vehicles of unseen scenes that the guard lets pass as they are.
const PASSED: f64 = 0.95;

/// Distance beyond which nothing is known, over the one within which everything passes.
const FAR: f64 = 1.4;

/// File with what the spreads hold.
const COVERAGE: &str = "coverage.json";

/// What the size network's spreads hold, by split.
#[derive(Debug, Clone, Serialize)]
struct Coverage {
    calibration: Calibration,
    /// Vehicles that the spreads were corrected by.
    val: SizeSummary,
    /// Vehicles that nothing was chosen by.
    test: SizeSummary,
}

impl SizeRecipe {
    /// Corrects the best weights' spreads, fits their guard and writes both for users, beside the
    /// coverage on the validation and test vehicles.
    ///
    /// # Errors
    /// Weights or images that cannot be read, a device that fails, or a file that cannot be written.
    pub fn finish(
        &self,
        run: &Path,
        dataset: &StereoDataset,
        progress: &dyn Progress,
    ) -> Result<()> {
        let folder = StageFolder::new(run, Self::STAGE);
        let device = self.device.clone().without_autodiff();
        let state = StateDict::load(&folder.best())?;
        let network = state.apply(SizeConfig::new().init(&device), str::to_owned)?;
        let raw = SizeEstimator::new(&network, self.header.clone(), None, &device);
        let seen: Vec<GuardEvidence> = self
            .said(&raw, &self.train)?
            .into_iter()
            .map(|(raw, _)| raw.evidence)
            .collect();
        let unseen = self.said(&raw, &self.val)?;
        let others: Vec<GuardEvidence> =
            unseen.iter().map(|(raw, _)| raw.evidence.clone()).collect();
        let guard = Guard::fit(&seen, &others);
        let limits = guard.as_ref().map(|guard| {
            // Without unseen scenes those that were seen must do.
            let usual = if others.is_empty() { &seen } else { &others };
            let distances: Vec<f64> = usual.iter().map(|v| guard.distance(v)).collect();
            let samples = if others.is_empty() {
                &self.train
            } else {
                &self.val
            };
            limits_of(&distances, &samples.samples)
        });
        let mut errors = SizeErrors::default();
        for (raw, target) in &unseen {
            errors.add(&raw.said, target.log_size, target.extent_m);
        }
        let calibration = Calibration {
            log_size: errors.log_size.factor(),
            extent: errors.extent.factor(),
            guard: limits.map(|(vehicle, _)| vehicle),
            frame: limits.map(|(_, frame)| frame),
        };
        let header = SizeHeader {
            calibration: Some(calibration),
            ..self.header.clone()
        };
        SizeEstimator::save(&network, &header, guard.as_ref(), &folder.calibrated())?;
        let ready = SizeEstimator::load(&folder.calibrated(), &device)?;
        let test = SampleSet::open(dataset, Split::Test, self.kind, 0, progress)?;
        let coverage = Coverage {
            calibration,
            val: self.summary(&ready, &self.val)?,
            test: self.summary(&ready, &test)?,
        };
        write_json(&run.join(Self::STAGE).join(COVERAGE), &coverage)?;
        if let Some(size) = coverage.val.log_size {
            progress.note(&format!(
                "size: {:.1} % error on the validation vehicles; 68 and 95 % intervals hold {:.0} and \
                 {:.0} %",
                100.0 * size.rms,
                100.0 * size.within[0],
                100.0 * size.within[1]
            ));
        }
        Ok(())
    }

    /// What a network says of all samples, uncorrected, and the truth.
    fn said(
        &self,
        estimator: &SizeEstimator,
        samples: &SampleSet,
    ) -> Result<Vec<(RawWitness, Target)>> {
        let items: Vec<usize> = (0..samples.samples.len()).collect();
        let mut said = Vec::with_capacity(items.len());
        for items in items.chunks(self.settings.batch) {
            let LoadedViews { inputs, targets } = self.views(samples, items, None)?;
            said.extend(estimator.examine(inputs)?.into_iter().zip(targets));
        }
        Ok(said)
    }

    fn summary(&self, estimator: &SizeEstimator, samples: &SampleSet) -> Result<SizeSummary> {
        let mut errors = SizeErrors::default();
        let said = self.said(estimator, samples)?;
        let mut said = said.into_iter();
        for image in images(&samples.samples) {
            let (raw, targets): (Vec<RawWitness>, Vec<Target>) =
                said.by_ref().take(image.len()).unzip();
            let camera = self.rig.camera(image[0].side);
            for (witness, target) in estimator.corrected(&raw, camera).iter().zip(targets) {
                errors.add(witness, target.log_size, target.extent_m);
            }
        }
        Ok(errors.summary())
    }
}

/// The samples of each image: they follow one another.
fn images(samples: &[Sample]) -> impl Iterator<Item = &[Sample]> {
    samples.chunk_by(|a, b| a.frame.row.stamp == b.frame.row.stamp && a.side == b.side)
}

/// Within which distances vehicles and images are known, by those of vehicles that are usual.
fn limits_of(distances: &[f64], samples: &[Sample]) -> (GuardLimits, FrameLimits) {
    let all = |share: f64| quantile_of(distances.iter().copied(), share);
    let (usual, near) = (all(0.5), all(PASSED));
    let mut rest = distances;
    let means = images(samples).map(|image| {
        let (own, others) = rest.split_at(image.len().min(rest.len()));
        rest = others;
        FrameLimits::mean(usual, own)
    });
    let near_frame = quantile_of(means, PASSED);
    let vehicle = GuardLimits {
        near,
        far: FAR * near,
    };
    // As far beyond the unusual ones as those are beyond the usual ones.
    let frame = FrameLimits {
        usual,
        limits: GuardLimits {
            near: near_frame,
            far: 2.0 * near_frame - usual,
        },
    };
    (vehicle, frame)
}
