//! Evaluation of a run on a split of a dataset.

use std::fmt;
use std::path::{Path, PathBuf};

use burn_dataset::Dataset as _;
use serde::Serialize;

use super::detection_metrics;
use crate::dataset::{DetectionSource, Frame, Side, Split, StereoDataset, StereoLabel};
use crate::device::DeviceName;
use crate::error::{Error, Result};
use crate::metrics::{DistanceErrors, DistanceSummary, is_covered};
use crate::pairing::PairingMode;
use crate::pipeline::{PredictOptions, StereoRanger, Vehicle};
use crate::progress::Progress;
use crate::ranging::Sighting;
use crate::train::saved_config;

/// Least intersection over union of a found and a labelled box of the same vehicle.
const MATCH_IOU: f64 = 0.5;

/// What to evaluate, and on what.
#[derive(Debug, Clone, Copy)]
pub struct EvaluateRequest<'a> {
    /// Run folder.
    pub run: &'a Path,
    /// Dataset folder.
    pub data: &'a Path,
    /// Split of the dataset.
    pub split: Split,
    /// Where to compute.
    pub device: DeviceName,
    /// What the pipeline counts as a detection, and how it pairs.
    pub options: PredictOptions,
}

/// How good a run is on a split.
#[derive(Debug, Clone, Serialize)]
pub struct Evaluation {
    /// Run folder.
    pub run: PathBuf,
    /// Dataset folder.
    pub data: PathBuf,
    /// Split.
    pub split: Split,
    /// Stereo frames evaluated.
    pub frames: usize,
    /// How the pipeline found boxes in the right image.
    pub pairing_mode: PairingMode,
    /// Detections of the pipeline scored above this.
    pub confidence: f32,
    /// The detector on all images of the split.
    pub detection: DetectionFigures,
    /// The distance network on labelled boxes.
    pub true_boxes: Option<DistanceSummary>,
    /// Detector, pairing and distance network together.
    pub pipeline: PipelineFigures,
}

/// The detector's figures.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct DetectionFigures {
    /// Images, left and right.
    pub images: usize,
    /// Labelled boxes.
    pub targets: usize,
    /// At the confidence of the best F1.
    pub precision: f64,
    /// At the confidence of the best F1.
    pub recall: f64,
    /// Mean average precision at IoU 0.50.
    pub map50: f64,
    /// Mean average precision over IoU 0.50 to 0.95.
    pub map50_95: f64,
}

/// The pipeline's figures.
#[derive(Debug, Clone, Serialize)]
pub struct PipelineFigures {
    /// Vehicles labelled in both images and ignored in neither.
    pub vehicles: usize,
    /// Of these, found.
    pub found: usize,
    /// Of these, missed.
    pub missed: usize,
    /// Found where none is labelled, not even an ignored one or one that a single camera sees.
    pub false_vehicles: usize,
    /// Distance errors of the found ones.
    pub distance: Option<DistanceSummary>,
}

/// Evaluates a run. Frames are divided as the run divided them for its training.
///
/// # Errors
/// A run or dataset that cannot be used, an empty split, or a device that fails.
pub fn evaluate(request: &EvaluateRequest, progress: &dyn Progress) -> Result<Evaluation> {
    let device = request.device.open()?;
    let ranger = StereoRanger::load(request.run, &device)?.with_options(request.options);
    let mut dataset = StereoDataset::open(request.data)?;
    if let Some(config) = saved_config(request.run)?
        && let Some(split) = config.split
    {
        dataset.resplit(split, config.seed)?;
    }
    dataset.check_images(progress)?;
    evaluate_dataset(&ranger, request.run, &dataset, request.split, progress)
}

/// Evaluates a loaded run on a dataset whose images are checked and whose frames are divided.
///
/// # Errors
/// A dataset with other classes, an empty split, or a device that fails.
pub fn evaluate_dataset(
    ranger: &StereoRanger,
    run: &Path,
    dataset: &StereoDataset,
    split: Split,
    progress: &dyn Progress,
) -> Result<Evaluation> {
    check_classes(ranger, dataset)?;
    if dataset.rig() != ranger.rig() {
        progress.note(
            "the run was trained for another rig (resolution, focal length or baseline) than this \
             dataset's: expect distances to be off",
        );
    }
    let kind = ranger.detector().header().box_kind;
    let frames = dataset.split(split);
    if frames.is_empty() {
        return Err(Error::dataset(
            &dataset.folder,
            format!("has no usable frames with split {split}"),
            "give another --split or --data",
        ));
    }
    progress.begin("evaluation", frames.len() as u64 + 1);
    progress.status("detector");
    let source = DetectionSource::new(dataset, split, kind, 0);
    let detection = detection_metrics(ranger.detector(), &source)?.compute();
    progress.advance(1);
    progress.status("pipeline");
    let mut true_boxes = DistanceErrors::new();
    let mut tally = Tally::default();
    if !dataset.info.stereo {
        progress.note("the dataset has single images: only the detector is judged");
    }
    for frame in frames.iter().filter(|_| dataset.info.stereo) {
        if progress.interrupted() {
            progress.end();
            return Err(Error::Interrupted {
                resume: "run the command again".to_owned(),
            });
        }
        evaluate_frame(ranger, dataset, frame, &mut true_boxes, &mut tally)?;
        progress.advance(1);
    }
    progress.end();
    Ok(Evaluation {
        run: run.to_path_buf(),
        data: dataset.folder.clone(),
        split,
        frames: frames.len(),
        pairing_mode: ranger.options().pairing_mode,
        confidence: ranger.options().confidence,
        detection: DetectionFigures {
            images: source.len(),
            targets: detection.targets,
            precision: detection.precision,
            recall: detection.recall,
            map50: detection.map50,
            map50_95: detection.map50_95,
        },
        true_boxes: true_boxes.summary(),
        pipeline: PipelineFigures {
            vehicles: tally.vehicles,
            found: tally.found,
            missed: tally.vehicles - tally.found,
            false_vehicles: tally.false_vehicles,
            distance: tally.errors.summary(),
        },
    })
}

fn check_classes(ranger: &StereoRanger, dataset: &StereoDataset) -> Result<()> {
    let trained = &ranger.detector().header().classes;
    if trained[..] == *dataset.classes() {
        return Ok(());
    }
    Err(Error::dataset(
        &dataset.folder,
        format!(
            "has the classes {:?}, the run was trained on {trained:?}",
            dataset.classes()
        ),
        "evaluate on a dataset with the same classes in the same order",
    ))
}

#[derive(Default)]
struct Tally {
    vehicles: usize,
    found: usize,
    false_vehicles: usize,
    errors: DistanceErrors,
}

fn evaluate_frame(
    ranger: &StereoRanger,
    dataset: &StereoDataset,
    frame: &Frame,
    true_boxes: &mut DistanceErrors,
    tally: &mut Tally,
) -> Result<()> {
    let [left, right] = frame.load(dataset.rig())?;
    let kind = ranger.detector().header().box_kind;
    let labels = frame.vehicles(kind);
    let sightings: Vec<Sighting> = labels
        .iter()
        .map(|label| Sighting {
            images: [&left, &right],
            boxes: [label.left.box_pixel, label.right.box_pixel],
        })
        .collect();
    for (estimated_m, label) in ranger
        .estimator()
        .estimate(&sightings, dataset.rig())?
        .into_iter()
        .zip(&labels)
    {
        true_boxes.add(estimated_m, label.distance_m);
    }
    let vehicles = ranger.estimate(&left, &right)?;
    let matches = match_vehicles(&vehicles, &labels);
    tally.vehicles += labels.len();
    tally.found += matches.len();
    let unjudged = Side::ALL.map(|side| frame.unjudged_boxes(kind, side));
    tally.false_vehicles += vehicles
        .iter()
        .enumerate()
        .filter(|(index, vehicle)| {
            let matched = matches.iter().any(|(found, _)| found == index);
            let [left, right] = &unjudged;
            !matched && !is_covered(&vehicle.left, left) && !is_covered(&vehicle.right, right)
        })
        .count();
    for (vehicle, label) in matches {
        tally
            .errors
            .add(vehicles[vehicle].distance_m, labels[label].distance_m);
    }
    Ok(())
}

/// Pairs of found and labelled vehicles, best score first: a vehicle is found when its boxes
/// overlap the labels in both images.
pub fn match_vehicles(vehicles: &[Vehicle], labels: &[StereoLabel]) -> Vec<(usize, usize)> {
    let mut order: Vec<usize> = (0..vehicles.len()).collect();
    order.sort_by(|&a, &b| vehicles[b].score.total_cmp(&vehicles[a].score));
    let mut free: Vec<usize> = (0..labels.len()).collect();
    let mut matches = Vec::new();
    for vehicle in order {
        let overlap = |label: usize| {
            let (found, label) = (&vehicles[vehicle], &labels[label]);
            let left = found.left.iou(&label.left.box_pixel);
            left.min(found.right.iou(&label.right.box_pixel))
        };
        let best = (0..free.len()).max_by(|&a, &b| overlap(free[a]).total_cmp(&overlap(free[b])));
        if let Some(best) = best.filter(|&best| overlap(free[best]) >= MATCH_IOU) {
            matches.push((vehicle, free.remove(best)));
        }
    }
    matches
}

impl fmt::Display for Evaluation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let DetectionFigures {
            images,
            targets,
            precision,
            recall,
            map50,
            map50_95,
        } = self.detection;
        writeln!(
            f,
            "split {}: {} frames, pairing {}, confidence {}",
            self.split, self.frames, self.pairing_mode, self.confidence
        )?;
        writeln!(f)?;
        writeln!(
            f,
            "detector        images  boxes  precision  recall  mAP50  mAP50-95"
        )?;
        writeln!(
            f,
            "                {images:>6}  {targets:>5}  {precision:>9.3}  {recall:>6.3}  {map50:>5.3}  {map50_95:>8.3}"
        )?;
        writeln!(f)?;
        writeln!(f, "distance        vehicles  MAE m  RMSE m  MRE %")?;
        distance_row(f, "true boxes", self.true_boxes.as_ref())?;
        distance_row(f, "pipeline", self.pipeline.distance.as_ref())?;
        writeln!(f)?;
        let PipelineFigures {
            vehicles,
            found,
            missed,
            false_vehicles,
            ..
        } = self.pipeline;
        write!(
            f,
            "pipeline found {found} of {vehicles} vehicles, missed {missed}, and saw {false_vehicles} where none is"
        )
    }
}

fn distance_row(
    f: &mut fmt::Formatter<'_>,
    name: &str,
    summary: Option<&DistanceSummary>,
) -> fmt::Result {
    match summary {
        Some(DistanceSummary {
            count,
            mae_m,
            rmse_m,
            mre_percent,
            ..
        }) => {
            writeln!(
                f,
                "{name:<14}  {count:>8}  {mae_m:>5.2}  {rmse_m:>6.2}  {mre_percent:>5.1}"
            )
        }
        None => writeln!(f, "{name:<14}  {:>8}      -       -      -", 0),
    }
}
