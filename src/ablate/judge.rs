//! Measures labelled vehicles with every trained network and every baseline.

use std::path::PathBuf;

use rayon::prelude::*;

use super::tables::{self, Estimate, Measured};
use super::{AblateRequest, Ablation, Variant};
use crate::dataset::{Problem, StereoDataset};
use crate::error::{Error, Result};
use crate::evaluate::{Baselines, Boxes, DRAWS, Drawing, Method, Places, VehicleRow};
use crate::progress::Progress;
use crate::ranging::{DistanceEstimator, Sighting};
use crate::train::DeviceSet;

/// Frames that are decoded together.
const BATCH: usize = 8;

/// A trained network: its variant, seed and weights.
pub(super) type Trained = (Variant, u64, PathBuf);

/// Measures the vehicles of the split, and computes every figure.
pub(super) fn judge(
    request: &AblateRequest,
    dataset: &StereoDataset,
    trained: &[Trained],
    progress: &dyn Progress,
) -> Result<(Ablation, Vec<Estimate>)> {
    let kind = request.config.box_kind;
    let devices = DeviceSet::open(request.devices)?;
    let device = devices.main();
    let estimators = trained
        .iter()
        .map(|(_, _, weights)| DistanceEstimator::load(weights, device))
        .collect::<Result<Vec<_>>>()?;
    let baselines = Baselines::fit(dataset, kind, progress)?;
    let places = Places::new(dataset, kind);
    let rig = dataset.rig();
    let frames = dataset.split(request.split);
    let mut seen = Vec::new();
    let mut problems = Vec::new();
    let mut vehicles: Vec<VehicleRow> = Vec::new();
    let mut networks_m: Vec<Vec<f64>> = vec![Vec::new(); trained.len()];
    progress.begin("measuring", frames.len() as u64);
    for frames in frames.chunks(BATCH) {
        if progress.interrupted() {
            progress.end();
            return Err(Error::Interrupted {
                resume: "run the same command again to go on".to_owned(),
            });
        }
        let loaded: Vec<_> = frames.par_iter().map(|frame| frame.load(rig)).collect();
        for (frame, images) in frames.iter().zip(loaded) {
            let images = match images {
                Ok(images) => images,
                Err(error) => {
                    let problem = Problem::of_frame(frame.row.stamp, error.to_string());
                    progress.note(&format!("left out: {problem}"));
                    problems.push(problem);
                    continue;
                }
            };
            seen.push((frame.row.stamp, frame.row.scene));
            let labels = frame.vehicles(kind);
            let sightings: Vec<Sighting> = labels
                .iter()
                .map(|label| Sighting {
                    images: [&images[0], &images[1]],
                    boxes: [label.left.box_pixel, label.right.box_pixel],
                })
                .collect();
            for (estimator, distances_m) in estimators.iter().zip(&mut networks_m) {
                distances_m.extend(estimator.estimate(&sightings, rig)?);
            }
            let rows: Vec<VehicleRow> = labels
                .par_iter()
                .zip(&sightings)
                .map(|(label, sighting)| {
                    let mut row = places.unseen(frame, label);
                    if let Some(baselines) = &baselines {
                        row.set_estimates(Boxes::True, baselines.estimates(sighting, rig));
                    }
                    row
                })
                .collect();
            vehicles.extend(rows);
        }
        progress.advance(frames.len() as u64);
    }
    progress.end();
    if vehicles.is_empty() {
        return Err(Error::dataset(
            &dataset.folder,
            format!("no frame can be read: {}", Problem::summary(&problems)),
            "repair the files that are named, or generate the dataset again",
        ));
    }
    let drawing = Drawing::new(&seen, DRAWS);
    let measured = Measured::new(request, trained, &vehicles, &networks_m);
    let ablation = Ablation {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        data: dataset.folder.clone(),
        split: request.split,
        out: request.out.to_path_buf(),
        frames: seen.len(),
        left_out: problems.len(),
        vehicles: vehicles.len(),
        seeds: request.seeds.to_vec(),
        unit: drawing.unit.to_owned(),
        units: drawing.resamples.groups(),
        draws: DRAWS,
        config: request.config.clone(),
        baselines,
        rows: tables::rows(&measured, &vehicles, &drawing),
        differences: tables::differences(&measured, &drawing),
    };
    Ok((ablation, tables::estimates(&measured)))
}

/// The baselines, in their order.
pub(super) fn baseline_methods() -> impl Iterator<Item = Method> {
    let all = Method::ALL.into_iter();
    all.filter(|method| ![Method::Fused, Method::Network].contains(method))
}
