//! Evaluation of a run on a split of a dataset.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::baselines::{Baselines, fit_for_run};
use super::distances::{self, Drawing};
use super::judge::{Judge, Judged};
use super::tables::{self, Tables};
use super::vehicles::{Boxes, Method};
use super::{detections, examples, latency, protocol};
use crate::dataset::{BoxKind, Split, StereoDataset, StereoLabel};
use crate::device::DeviceName;
use crate::error::{Error, Result};
use crate::files;
use crate::metrics::{DetectionSummary, DistanceErrors, DistanceSummary, Interval};
use crate::pairing::PairingMode;
use crate::pipeline::{PredictOptions, StereoRanger, Vehicle};
use crate::progress::Progress;
use crate::ranging::RigNote;
use crate::train::{TrainConfig, saved_config};

/// Least intersection over union of a found and a labelled box of the same vehicle.
const MATCH_IOU: f64 = 0.5;

/// Draws of the bootstrap: bounds then move by a few percent of their width with another seed.
pub(crate) const DRAWS: usize = 1000;

/// Draws for average precision, each of which walks through every detection.
const DETECTION_DRAWS: usize = 200;

/// What to evaluate, and on what.
#[derive(Debug, Clone)]
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
    /// Folder for the tables; `evaluation/<dataset>-<split>` in the run's folder where it is not
    /// given.
    pub out: Option<&'a Path>,
}

/// How good a run is on a split.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Version of the program.
    pub version: String,
    /// Run folder.
    pub run: PathBuf,
    /// Dataset folder.
    pub data: PathBuf,
    /// Split.
    pub split: Split,
    /// Folder that the tables were written to.
    pub folder: PathBuf,
    /// Stereo frames evaluated.
    pub frames: usize,
    /// Frames that could not be read.
    pub left_out: usize,
    /// Kind of box that the run learnt and is judged by.
    pub box_kind: BoxKind,
    /// How the pipeline found boxes in the right image.
    pub pairing_mode: PairingMode,
    /// Detections of the pipeline scored above this.
    pub confidence: f32,
    /// How bounds were found.
    pub bootstrap: Bootstrap,
    /// The detector on all images of the split.
    pub detection: DetectionFigures,
    /// The distance network on labelled boxes.
    pub true_boxes: Option<DistanceSummary>,
    /// Detector, pairing and distance network together.
    pub pipeline: PipelineFigures,
    /// Constants of the baselines; none where there is nothing to fit them on.
    pub baselines: Option<Baselines>,
    /// How much of the paper's test the split holds; none where it holds nothing of its kind.
    pub protocol: Option<protocol::Protocol>,
    /// Every table; files of their own beside this one.
    #[serde(skip)]
    pub tables: Tables,
}

/// How the bounds of figures were found: 95 % of the draws, with replacement, lie between them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bootstrap {
    /// What is drawn: "scene" or "frame", with everything in it.
    pub unit: String,
    /// How many there are.
    pub units: usize,
    /// Draws for distances.
    pub draws: usize,
    /// Draws for average precision.
    pub detection_draws: usize,
}

/// The detector's figures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DetectionFigures {
    /// Images, left and right.
    pub images: usize,
    /// Labelled boxes.
    pub targets: usize,
    /// At the confidence of the best F1.
    pub precision: f64,
    /// At the confidence of the best F1.
    pub recall: f64,
    /// The best F1.
    pub f1: f64,
    /// Its confidence.
    pub best_confidence: Option<f64>,
    /// Mean average precision at IoU 0.50.
    pub map50: f64,
    /// Bounds of it.
    pub map50_interval: Option<Interval>,
    /// Mean average precision over IoU 0.50 to 0.95.
    pub map50_95: f64,
    /// Bounds of it.
    pub map50_95_interval: Option<Interval>,
}

/// The pipeline's figures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PipelineFigures {
    /// Vehicles labelled in both images and ignored in neither.
    pub vehicles: usize,
    /// Of these, found.
    pub found: usize,
    /// Of these, missed.
    pub missed: usize,
    /// Found where none is labelled, not even an ignored one or one that a single camera sees.
    pub false_vehicles: usize,
    /// Bounds of the share that is found.
    pub found_interval: Option<Interval>,
    /// Bounds of the share of what the pipeline sees that is there.
    pub precision_interval: Option<Interval>,
    /// Distance errors of the found ones.
    pub distance: Option<DistanceSummary>,
}

/// Evaluates a run, and writes the tables. Frames are divided as the run divided them for its
/// training.
///
/// # Errors
/// A run or dataset that cannot be used, an empty split, a folder that cannot be written, or a
/// device that fails.
pub fn evaluate(request: &EvaluateRequest, progress: &dyn Progress) -> Result<Evaluation> {
    let device = request.device.open()?;
    let ranger = StereoRanger::load(request.run, &device)?.with_options(request.options);
    let mut dataset = StereoDataset::open(request.data)?;
    if let Some(config) = saved_config(request.run)?
        && let Some(split) = config.split
    {
        dataset.resplit(split, config.seed)?;
    }
    for problem in &dataset.problems {
        progress.note(&format!("left out: {problem}"));
    }
    evaluate_into(
        &ranger,
        request.run,
        &dataset,
        request.split,
        request.out,
        progress,
    )
}

/// Evaluates a loaded run on a dataset whose frames are divided, and writes the tables into the
/// run's folder.
///
/// # Errors
/// As [`evaluate`], and a dataset with other classes.
pub fn evaluate_dataset(
    ranger: &StereoRanger,
    run: &Path,
    dataset: &StereoDataset,
    split: Split,
    progress: &dyn Progress,
) -> Result<Evaluation> {
    evaluate_into(ranger, run, dataset, split, None, progress)
}

fn evaluate_into(
    ranger: &StereoRanger,
    run: &Path,
    dataset: &StereoDataset,
    split: Split,
    out: Option<&Path>,
    progress: &dyn Progress,
) -> Result<Evaluation> {
    check_classes(ranger, dataset)?;
    let readout = ranger.estimator().header().readout;
    let of_this_rig;
    let mut ranger = ranger;
    if dataset.info.stereo && dataset.rig() != ranger.rig() {
        for note in RigNote::of_rig(ranger.rig(), dataset.rig(), readout) {
            progress.note(&note.to_string());
        }
        of_this_rig = ranger.clone().with_rig(*dataset.rig());
        ranger = &of_this_rig;
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
    let folder = out.map_or_else(
        || tables::default_folder(run, &dataset.folder, split),
        Path::to_path_buf,
    );
    // Before the work, which a folder that cannot be written would make useless.
    files::create_folder(&folder)?;
    if !dataset.info.stereo {
        progress.note("the dataset has single images: only the detector is judged");
    }
    let baselines = if dataset.info.stereo {
        fit_for_run(run, dataset, kind, progress)?
    } else {
        None
    };
    let judged = Judge::new(ranger, dataset, baselines.as_ref()).run(&frames, progress)?;
    let classes = dataset.classes();
    let drawing = Drawing::new(&judged.frames, DRAWS);
    let summary = judged.detection.compute();
    let coco = judged
        .detection_pixel
        .coco_summary(detections::COCO_DETECTIONS);
    let protocol = Some(protocol::protocol(
        &frames,
        &judged.vehicles,
        &judged.false_vehicles,
    ))
    .filter(|protocol| protocol.cells + protocol.other_frames > 0);
    let detection = detection_figures(&judged, &summary, &drawing);
    let pipeline = pipeline_figures(&judged, &drawing);
    let true_boxes = errors(&judged, Boxes::True);
    let latency = if dataset.info.stereo {
        latency::measure(ranger, dataset, &frames)?
    } else {
        Vec::new()
    };
    let evaluation = Evaluation {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        run: run.to_path_buf(),
        data: dataset.folder.clone(),
        split,
        frames: judged.frames.len(),
        left_out: judged.problems.len(),
        box_kind: kind,
        pairing_mode: ranger.options().pairing_mode,
        confidence: ranger.options().confidence,
        bootstrap: Bootstrap {
            unit: drawing.unit.to_owned(),
            units: drawing.resamples.groups(),
            draws: DRAWS,
            detection_draws: DETECTION_DRAWS,
        },
        detection,
        true_boxes,
        pipeline,
        baselines,
        protocol: protocol.clone(),
        tables: Tables {
            distance: distances::rows(&judged.vehicles, &judged.false_vehicles, &drawing),
            differences: distances::differences(&judged.vehicles, &drawing),
            detection: detections::class_rows(&summary, classes),
            detection_curves: detections::curve_rows(&summary, classes),
            coco: detections::coco_rows(&coco),
            confusion: detections::confusion_rows(&judged.confusion, classes),
            latency,
            protocol,
            examples: examples::draw(
                &folder,
                dataset,
                kind,
                &judged.vehicles,
                &judged.false_vehicles,
            )?,
            vehicles: judged.vehicles,
            false_vehicles: judged.false_vehicles,
        },
        folder,
    };
    tables::write(&evaluation.folder, &evaluation)?;
    Ok(evaluation)
}

/// The dataset that a run was trained on, and its settings; None where the run does not say.
pub(super) fn training_dataset(run: &Path) -> Option<(PathBuf, TrainConfig)> {
    #[derive(Deserialize)]
    struct Saved {
        data: PathBuf,
    }
    let text = files::read_text(run.join("config.json")).ok()?;
    let saved: Saved = serde_json::from_str(&text).ok()?;
    Some((saved.data, saved_config(run).ok()??))
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

fn detection_figures(
    judged: &Judged,
    summary: &DetectionSummary,
    drawing: &Drawing,
) -> DetectionFigures {
    let stamps = judged.image_stamps.iter();
    let groups: Vec<usize> = stamps.map(|&stamp| drawing.group(stamp)).collect();
    let draws = drawing.resamples.first(DETECTION_DRAWS);
    let intervals = judged.detection.map_intervals(&draws, &groups);
    DetectionFigures {
        images: summary.images,
        targets: summary.targets,
        precision: summary.precision,
        recall: summary.recall,
        f1: summary.f1,
        best_confidence: summary.best_confidence,
        map50: summary.map50,
        map50_interval: intervals.map(|[map50, _]| map50),
        map50_95: summary.map50_95,
        map50_95_interval: intervals.map(|[_, map50_95]| map50_95),
    }
}

fn pipeline_figures(judged: &Judged, drawing: &Drawing) -> PipelineFigures {
    let found = judged
        .vehicles
        .iter()
        .filter(|vehicle| vehicle.found)
        .count();
    let labelled = judged
        .vehicles
        .iter()
        .map(|v| (v.frame, [1.0, f64::from(u8::from(v.found)), 0.0]));
    let made_up = judged
        .false_vehicles
        .iter()
        .map(|v| (v.frame, [0.0, 0.0, 1.0]));
    let sums = drawing.sums(labelled.chain(made_up));
    let share = |part: f64, whole: f64| (whole > 0.0).then(|| [part / whole]);
    let found_interval = drawing.intervals(&sums, |[vehicles, found, _]| share(found, vehicles));
    let precision_interval =
        drawing.intervals(&sums, |[_, found, made_up]| share(found, found + made_up));
    PipelineFigures {
        vehicles: judged.vehicles.len(),
        found,
        missed: judged.vehicles.len() - found,
        false_vehicles: judged.false_vehicles.len(),
        found_interval: found_interval.map(|[interval]| interval),
        precision_interval: precision_interval.map(|[interval]| interval),
        distance: errors(judged, Boxes::Pipeline),
    }
}

/// The network's errors.
fn errors(judged: &Judged, boxes: Boxes) -> Option<DistanceSummary> {
    let mut errors = DistanceErrors::new();
    for vehicle in &judged.vehicles {
        if let Some(estimate) = vehicle.estimate(boxes, Method::Network) {
            errors.add(estimate, vehicle.distance_m);
        }
    }
    errors.summary()
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
