//! Evaluation of a run on a split of a dataset.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::baselines::{Baselines, fit_for_run};
use super::distances::{self, Drawing};
use super::figures::{self, DetectionFigures, PipelineFigures, TrueBoxFigures};
use super::judge::{Judge, Judged};
use super::subject::{Networks, Subject};
use super::tables::{self, Tables};
use super::vehicles::{Method, VehicleRow};
use super::{detections, examples, latency, protocol, reliability};
use crate::dataset::{BoxKind, Frame, Split, StereoDataset, StereoLabel};
use crate::device::DeviceName;
use crate::error::{Error, Result};
use crate::files;
use crate::metrics::DetectionSummary;
use crate::pairing::PairingMode;
use crate::pipeline::{PredictOptions, StereoRanger, Vehicle};
use crate::progress::Progress;
use crate::ranging::{FusedRanger, RangerKind, TrustedRig};
use crate::train::saved_config;

/// Least intersection over union of a found and a labelled box of the same vehicle.
const MATCH_IOU: f64 = 0.5;

/// Draws of the bootstrap: bounds then move by a few percent of their width with another seed.
pub(crate) const DRAWS: usize = 1000;

/// What to evaluate, and on what.
#[derive(Debug, Clone)]
pub struct EvaluateRequest<'a> {
    /// Run folder; without one the posterior is judged on labelled boxes.
    pub run: Option<&'a Path>,
    /// Kind of the labelled boxes where no run says which it learnt; tight ones where there are.
    pub boxes: Option<BoxKind>,
    /// The cameras as a calibration has them, in place of the dataset's.
    pub rig: Option<TrustedRig>,
    /// Dataset folder.
    pub data: &'a Path,
    /// Split of the dataset.
    pub split: Split,
    /// Where to compute.
    pub device: DeviceName,
    /// What the pipeline counts as a detection, and how it pairs.
    pub options: PredictOptions,
    /// Folder for the tables; where it is not given, `evaluation/<dataset>-<split>` in the run's
    /// folder, or in the current one, with what is not as usual in its name.
    pub out: Option<&'a Path>,
}

/// How good a run is on a split.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Version of the program.
    pub version: String,
    /// Run folder; none where nothing trained is judged.
    pub run: Option<PathBuf>,
    /// Which answer the main figures are of.
    #[serde(default)]
    pub ranger: RangerKind,
    /// Dataset folder.
    pub data: PathBuf,
    /// Split.
    pub split: Split,
    /// Networks that the run has.
    #[serde(default)]
    pub networks: Networks,
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
    /// The detector on all images of the split; none where the run has no detector.
    pub detection: Option<DetectionFigures>,
    /// The ranger in use on labelled boxes; none where the run has a detector alone.
    pub true_boxes: Option<TrueBoxFigures>,
    /// Detector and ranger together; none where one is missing, and for single images.
    pub pipeline: Option<PipelineFigures>,
    /// Constants of the baselines; none where there is nothing to fit them on.
    pub baselines: Option<Baselines>,
    /// How much of the paper's test the split holds; none where it holds nothing of its kind.
    pub protocol: Option<protocol::Protocol>,
    /// Every table; files of their own beside this one.
    #[serde(skip)]
    pub tables: Tables,
}

impl Evaluation {
    /// The ranger in use as one of the methods.
    pub const fn method(&self) -> Method {
        Method::of_ranger(self.ranger)
    }
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

/// Evaluates a run, and writes the tables. Frames are divided as the run divided them for its
/// training. A run with one network has that one judged: the detector on all images, the distance
/// network on labelled boxes.
///
/// # Errors
/// A run or dataset that cannot be used, a dataset without the run's kind of boxes, an empty split, a
/// folder that cannot be written, or a
/// device that fails.
pub fn evaluate(request: &EvaluateRequest, progress: &dyn Progress) -> Result<Evaluation> {
    let mut dataset = StereoDataset::open(request.data)?;
    let subject = match request.run {
        Some(run) => Subject::load(run, request.options, &request.device.open()?)?,
        None => of_labels(request, &dataset)?,
    };
    let config = request.run.map(saved_config).transpose()?.flatten();
    if let Some(config) = config
        && let Some(split) = config.split
    {
        dataset.resplit(split, config.seed)?;
    }
    for problem in &dataset.problems {
        progress.note(&format!("left out: {problem}"));
    }
    let rig = request
        .rig
        .unwrap_or_else(|| TrustedRig::of_dataset(&dataset.info));
    evaluate_into(
        subject,
        request.run,
        &dataset,
        &rig,
        request.split,
        request.out,
        progress,
    )
}

/// What is judged without a run.
fn of_labels(request: &EvaluateRequest, dataset: &StereoDataset) -> Result<Subject> {
    if request.options.ranger == RangerKind::Paper {
        return Err(Error::value(
            "--ranger paper",
            "the paper's network is trained, and no run is given",
            "give --run DIR, or leave --ranger out",
        ));
    }
    let kinds = &dataset.info.label_kinds;
    let kind = request.boxes.unwrap_or_else(|| {
        let tight = kinds.contains(&BoxKind::Tight);
        if tight {
            BoxKind::Tight
        } else {
            BoxKind::Sphere
        }
    });
    let fused = FusedRanger::new(kind);
    Ok(Subject::Labels(Box::new(fused), request.options))
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
    let subject = Subject::Both(Box::new(ranger.clone()));
    let rig = TrustedRig::of_dataset(&dataset.info);
    evaluate_into(subject, Some(run), dataset, &rig, split, None, progress)
}

fn evaluate_into(
    subject: Subject,
    run: Option<&Path>,
    dataset: &StereoDataset,
    rig: &TrustedRig,
    split: Split,
    out: Option<&Path>,
    progress: &dyn Progress,
) -> Result<Evaluation> {
    let subject = subject.behind_rig_of(dataset, rig, progress)?;
    let ranger = subject.options().ranger;
    let method = Method::of_ranger(ranger);
    let networks = subject.networks();
    let kind = subject.box_kind();
    let frames = usable(dataset, split)?;
    let folder = out.map_or_else(
        || tables::default_folder(run, &dataset.folder, split, subject.options()),
        Path::to_path_buf,
    );
    // Before the work, which a folder that cannot be written would make useless.
    files::create_folder(&folder)?;
    if !dataset.info.stereo && networks == Networks::Both {
        progress.note("the dataset has single images: only the detector is judged");
    }
    let baselines = if dataset.info.stereo && networks != Networks::Detector {
        fit_for_run(run, dataset, kind, progress)?
    } else {
        None
    };
    let judged = Judge::new(&subject, dataset, baselines.as_ref(), rig).run(&frames, progress)?;
    let drawing = Drawing::new(&judged.frames, DRAWS);
    let summary = judged.detection.compute();
    let protocol = Some(protocol::protocol(
        &frames,
        &judged.vehicles,
        &judged.false_vehicles,
        method,
    ))
    .filter(|protocol| protocol.cells + protocol.other_frames > 0);
    let detection = subject
        .detector()
        .map(|_| figures::detection_figures(&judged, &summary, &drawing));
    let whole = subject.ranger().filter(|_| dataset.info.stereo);
    let pipeline = whole.map(|_| figures::pipeline_figures(&judged, &drawing, method));
    let true_boxes = figures::true_box_figures(&judged, method);
    // Without a detector nothing was missed, and there is nothing to show.
    let shown: &[VehicleRow] = match whole {
        Some(_) => &judged.vehicles,
        None => &[],
    };
    let of_detector = match detection {
        Some(_) => detection_tables(&judged, &summary, dataset.classes()),
        None => Tables::default(),
    };
    let mut tables = Tables {
        distance: distances::rows(&judged.vehicles, &judged.false_vehicles, &drawing, method),
        differences: distances::differences(&judged.vehicles, &drawing, method),
        reliability: reliability::reliability(&judged.vehicles),
        spread: reliability::by_spread(&judged.vehicles),
        latency: match whole {
            Some(ranger) => latency::measure(ranger, dataset, &frames)?,
            None => Vec::new(),
        },
        protocol: protocol.clone(),
        examples: examples::draw(
            &folder,
            dataset,
            kind,
            method,
            shown,
            &judged.false_vehicles,
        )?,
        vehicles: judged.vehicles,
        false_vehicles: judged.false_vehicles,
        ..of_detector
    };
    if networks != Networks::Both {
        tables.leave_out_pipeline();
    }
    let evaluation = Evaluation {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        run: run.map(Path::to_path_buf),
        ranger,
        data: dataset.folder.clone(),
        split,
        networks,
        frames: judged.frames.len(),
        left_out: judged.problems.len(),
        box_kind: kind,
        pairing_mode: subject.options().pairing_mode,
        confidence: subject.options().confidence,
        bootstrap: Bootstrap {
            unit: drawing.unit.to_owned(),
            units: drawing.resamples.groups(),
            draws: DRAWS,
            detection_draws: figures::DETECTION_DRAWS,
        },
        detection,
        true_boxes,
        pipeline,
        baselines,
        protocol,
        tables,
        folder,
    };
    tables::write(&evaluation.folder, &evaluation)?;
    Ok(evaluation)
}

/// The frames of a split, of which there must be some.
fn usable(dataset: &StereoDataset, split: Split) -> Result<Vec<&Frame>> {
    let frames = dataset.split(split);
    if frames.is_empty() {
        return Err(Error::dataset(
            &dataset.folder,
            format!("has no usable frames with split {split}"),
            "give another --split or --data",
        ));
    }
    Ok(frames)
}

/// The detector's tables.
fn detection_tables(judged: &Judged, summary: &DetectionSummary, classes: &[String]) -> Tables {
    let coco = judged
        .detection_pixel
        .coco_summary(detections::COCO_DETECTIONS);
    Tables {
        detection: detections::class_rows(summary, classes),
        detection_curves: detections::curve_rows(summary, classes),
        coco: detections::coco_rows(&coco),
        confusion: detections::confusion_rows(&judged.confusion, classes),
        ..Tables::default()
    }
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
