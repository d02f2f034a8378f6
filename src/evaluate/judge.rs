//! The one pass over the frames of a split: every image is decoded once and seen once by the
//! detector, whose boxes serve both its own figures and the pipeline.

use image::RgbImage;
use rayon::prelude::*;

use super::baselines::Baselines;
use super::detection::add_image;
use super::match_vehicles;
use super::subject::Subject;
use super::vehicles::{Boxes, Estimates, FalseVehicle, Places, Spread};
use crate::dataset::{BoxKind, Frame, Problem, Side, StereoDataset, StereoLabel};
use crate::detector::nms::NmsConfig;
use crate::detector::{Detection, LetterboxedCandidates, VehicleDetector};
use crate::error::{Error, Result};
use crate::geometry::PixelBox;
use crate::metrics::{Confusion, DetectionMetrics, Target, is_covered};
use crate::pipeline::Vehicle;
use crate::progress::Progress;
use crate::ranging::{FusedRanger, NamedBox, Ranged, Sighting, TrustedRig};

/// Frames that are decoded and detected together.
const BATCH: usize = 8;

/// Least intersection over union of a found and a labelled box in the confusion matrix.
const CONFUSION_IOU: f64 = 0.5;

/// Everything that the figures are made of.
pub(super) struct Judged {
    /// In the coordinates of the detector's input, as validation during training has them.
    pub detection: DetectionMetrics,
    /// In pixels of the images, for figures by size.
    pub detection_pixel: DetectionMetrics,
    /// At the pipeline's confidence.
    pub confusion: Confusion,
    /// Stamp of the frame of each image.
    pub image_stamps: Vec<u64>,
    /// Stamp and scene of each frame.
    pub frames: Vec<(u64, Option<u32>)>,
    /// Labelled vehicles.
    pub vehicles: Vec<super::VehicleRow>,
    /// Vehicles that the pipeline made up.
    pub false_vehicles: Vec<FalseVehicle>,
    /// Frames that could not be read.
    pub problems: Vec<Problem>,
}

/// What judges, and on what.
pub(super) struct Judge<'a> {
    subject: &'a Subject,
    dataset: &'a StereoDataset,
    baselines: Option<&'a Baselines>,
    rig: &'a TrustedRig,
    kind: BoxKind,
    places: Places<'a>,
}

/// What every method says of a box, and what the posterior says beside its median.
type Said = (Estimates, Option<Ranged>);

/// A decoded frame with what the detector found in its images, in the order of the images.
struct Seen<'a> {
    frame: &'a Frame,
    images: Vec<RgbImage>,
    found: Vec<Vec<Detection>>,
}

/// Labels and pipeline's pairs of a frame.
struct Paired {
    labels: Vec<StereoLabel>,
    pairs: Vec<crate::pipeline::Pair>,
}

impl<'a> Judge<'a> {
    /// Prepares to judge.
    pub fn new(
        subject: &'a Subject,
        dataset: &'a StereoDataset,
        baselines: Option<&'a Baselines>,
        rig: &'a TrustedRig,
    ) -> Self {
        let kind = subject.box_kind();
        Self {
            subject,
            dataset,
            baselines,
            rig,
            kind,
            places: Places::new(dataset, kind),
        }
    }

    /// Judges frames. Those that cannot be read are named and left out.
    ///
    /// # Errors
    /// A device that fails, frames of which none can be read, or [`Error::Interrupted`].
    pub fn run(&self, frames: &[&Frame], progress: &dyn Progress) -> Result<Judged> {
        let classes = self.dataset.classes().len();
        let mut judged = Judged {
            detection: DetectionMetrics::new(classes),
            detection_pixel: DetectionMetrics::new(classes),
            confusion: Confusion::new(classes),
            image_stamps: Vec::new(),
            frames: Vec::new(),
            vehicles: Vec::new(),
            false_vehicles: Vec::new(),
            problems: Vec::new(),
        };
        progress.begin("evaluation", frames.len() as u64);
        let outcome = frames.chunks(BATCH).try_for_each(|frames| {
            if progress.interrupted() {
                return Err(Error::Interrupted {
                    resume: "run the command again".to_owned(),
                });
            }
            self.add(frames, &mut judged, progress)?;
            progress.advance(frames.len() as u64);
            Ok(())
        });
        progress.end();
        outcome?;
        if judged.frames.is_empty() {
            return Err(Error::dataset(
                &self.dataset.folder,
                format!(
                    "no frame can be read: {}",
                    Problem::summary(&judged.problems)
                ),
                "repair the files that are named, or generate the dataset again",
            ));
        }
        Ok(judged)
    }

    fn add(
        &self,
        frames: &[&'a Frame],
        judged: &mut Judged,
        progress: &dyn Progress,
    ) -> Result<()> {
        let rig = self.dataset.rig();
        let loaded: Vec<Result<Vec<RgbImage>>> = frames
            .par_iter()
            .map(|frame| {
                let images = frame.images();
                images
                    .map(|(side, image)| image.load(rig.camera(side)))
                    .collect()
            })
            .collect();
        let mut seen = Vec::new();
        for (&frame, images) in frames.iter().zip(loaded) {
            match images {
                Ok(images) => seen.push(Seen {
                    frame,
                    images,
                    found: Vec::new(),
                }),
                Err(error) => {
                    let problem = Problem::of_frame(frame.row.stamp, error.to_string());
                    progress.note(&format!("left out: {problem}"));
                    judged.problems.push(problem);
                }
            }
        }
        if let Some(detector) = self.subject.detector() {
            self.detect(detector, &mut seen, judged)?;
        }
        if let Some(fused) = self.subject.fused()
            && self.dataset.info.stereo
        {
            self.range(fused, &seen, judged)?;
        }
        for seen in &seen {
            judged
                .frames
                .push((seen.frame.row.stamp, seen.frame.row.scene));
        }
        Ok(())
    }

    /// Runs the detector, with nearly no confidence asked for, and counts.
    fn detect(
        &self,
        detector: &VehicleDetector,
        seen: &mut [Seen],
        judged: &mut Judged,
    ) -> Result<()> {
        let images: Vec<&RgbImage> = seen.iter().flat_map(|seen| &seen.images).collect();
        let candidates = detector.detect_letterboxed(&images, &NmsConfig::validation())?;
        let confident = self.confident(detector, &images, &candidates)?;
        let mut results = candidates.iter().zip(confident);
        for seen in seen {
            for (side, labelled) in seen.frame.images() {
                let Some((candidates, confident)) = results.next() else {
                    continue;
                };
                let camera = self.dataset.rig().camera(side);
                let boxes = labelled.boxes(self.kind, camera);
                let ignored = labelled.ignored_boxes(self.kind, camera);
                add_image(&mut judged.detection, candidates, &boxes, &ignored)?;
                let targets: Vec<Target> = boxes
                    .iter()
                    .map(|(class, box_pixel)| Target {
                        box_pixel: *box_pixel,
                        class: *class as usize,
                    })
                    .collect();
                let detections = candidates.detections();
                judged
                    .detection_pixel
                    .add_image_ignoring(&detections, &targets, &ignored)?;
                judged
                    .confusion
                    .add_image(&confident, &targets, &ignored, CONFUSION_IOU);
                judged.image_stamps.push(seen.frame.row.stamp);
                seen.found.push(confident);
            }
        }
        Ok(())
    }

    /// What the pipeline takes for a detection. With one class it is the same suppression with a
    /// higher floor, which only cuts off the end of the list.
    fn confident(
        &self,
        detector: &VehicleDetector,
        images: &[&RgbImage],
        candidates: &[LetterboxedCandidates],
    ) -> Result<Vec<Vec<Detection>>> {
        let options = self.subject.options();
        let is_same = self.dataset.classes().len() == 1
            && options.iou == NmsConfig::validation().iou
            && options.confidence >= NmsConfig::validation().confidence;
        if !is_same {
            let nms = NmsConfig {
                confidence: options.confidence,
                iou: options.iou,
                ..NmsConfig::prediction()
            };
            return detector.detect(images, &nms);
        }
        let cut = |candidates: &LetterboxedCandidates| {
            let mut detections = candidates.detections();
            detections.retain(|detection| detection.score > options.confidence);
            detections
        };
        Ok(candidates.iter().map(cut).collect())
    }

    /// Estimates the distances of labelled and of detected vehicles, all frames at once, and
    /// matches them. Detected ones go the pipeline's way; without a detector there are none.
    fn range(&self, fused: &FusedRanger, seen: &[Seen], judged: &mut Judged) -> Result<()> {
        let classes = self.dataset.classes();
        let mut paired: Vec<Paired> = Vec::with_capacity(seen.len());
        let mut of_labels = Vec::with_capacity(seen.len());
        for seen in seen {
            let labels = seen.frame.vehicles(self.kind);
            let images = pair_of(seen);
            // What is ignored hides others, too.
            let boxes: Vec<NamedBox> = labels
                .iter()
                .map(|label| (label.left.box_pixel, Some(label.class)))
                .chain(self.unjudged(seen.frame))
                .map(|(box_pixel, class)| NamedBox {
                    box_pixel,
                    class: class
                        .and_then(|class| classes.get(class as usize))
                        .map(String::as_str),
                })
                .collect();
            let (mut ranged, _) = fused.range(images, &boxes, self.rig)?;
            ranged.truncate(labels.len());
            of_labels.push(ranged);
            let pairs = match self.subject.ranger() {
                Some(ranger) => ranger.pairs(images, seen.found.clone(), self.rig)?,
                None => Vec::new(),
            };
            paired.push(Paired { labels, pairs });
        }
        let frames = || seen.iter().zip(&paired);
        let labelled = frames().flat_map(|(seen, paired)| {
            let boxes = paired
                .labels
                .iter()
                .map(|l| [l.left.box_pixel, l.right.box_pixel]);
            sightings(seen, boxes)
        });
        let detected = frames().flat_map(|(seen, paired)| {
            let boxes = paired.pairs.iter().map(|p| [p.left.box_pixel, p.right]);
            sightings(seen, boxes)
        });
        let mut by_labels = self.estimates(&labelled.collect::<Vec<_>>())?.into_iter();
        let mut by_pairs = self.estimates(&detected.collect::<Vec<_>>())?.into_iter();
        for ((seen, paired), of_labels) in frames().zip(of_labels) {
            let of_labels: Vec<Said> = by_labels
                .by_ref()
                .zip(of_labels)
                .map(|(estimates, ranged)| said(estimates, Some(ranged)))
                .collect();
            let of_pairs: Vec<Said> = paired
                .pairs
                .iter()
                .zip(by_pairs.by_ref())
                .map(|(pair, estimates)| said(estimates, pair.ranged.clone()))
                .collect();
            self.match_frame(seen.frame, paired, &of_labels, of_pairs, judged);
        }
        Ok(())
    }

    /// Boxes of a frame's left image that are not judged.
    fn unjudged(&self, frame: &Frame) -> impl Iterator<Item = (PixelBox, Option<u32>)> {
        let boxes = frame.unjudged_boxes(self.kind, Side::Left);
        boxes.into_iter().map(|box_pixel| (box_pixel, None))
    }

    /// What the network, where there is one, and the baselines say.
    fn estimates(&self, sightings: &[Sighting]) -> Result<Vec<Estimates>> {
        let rig = &self.rig.rig;
        let network_m: Vec<Option<f64>> = match self.subject.estimator() {
            Some(estimator) => {
                let distances_m = estimator.estimate(sightings, rig)?;
                distances_m.into_iter().map(Some).collect()
            }
            None => vec![None; sightings.len()],
        };
        let estimates = sightings.par_iter().zip(network_m);
        Ok(estimates
            .map(|(sighting, network_m)| {
                let mut estimates = self
                    .baselines
                    .map_or([None; 5], |baselines| baselines.estimates(sighting, rig));
                estimates[1] = network_m;
                estimates
            })
            .collect())
    }

    fn match_frame(
        &self,
        frame: &Frame,
        Paired { labels, pairs }: &Paired,
        of_labels: &[Said],
        of_pairs: Vec<Said>,
        judged: &mut Judged,
    ) {
        let classes = self.dataset.classes();
        let kind = self.subject.options().ranger;
        let mut found: Vec<(Vehicle, Said)> = pairs
            .iter()
            .zip(of_pairs)
            .map(|(pair, said)| (pair.vehicle(kind, said.0[1], classes), said))
            .collect();
        found.sort_by(|a, b| a.0.distance_m.total_cmp(&b.0.distance_m));
        let vehicles: Vec<Vehicle> = found.iter().map(|(vehicle, _)| vehicle.clone()).collect();
        let matches = match_vehicles(&vehicles, labels);
        for (i, (label, said)) in labels.iter().zip(of_labels).enumerate() {
            let mut row = self.places.unseen(frame, label);
            row.set_said(Boxes::True, said);
            if let Some((vehicle, _)) = matches.iter().find(|(_, of)| *of == i) {
                let (vehicle, said) = &found[*vehicle];
                let overlap = vehicle.left.iou(&label.left.box_pixel);
                row.found = true;
                row.set_found_box(&vehicle.left);
                row.score = Some(vehicle.score);
                row.overlap = Some(overlap.min(vehicle.right.iou(&label.right.box_pixel)));
                row.set_said(Boxes::Pipeline, said);
            }
            judged.vehicles.push(row);
        }
        let [left, right] = Side::ALL.map(|side| frame.unjudged_boxes(self.kind, side));
        for (i, vehicle) in vehicles.iter().enumerate() {
            let is_matched = matches.iter().any(|(found, _)| *found == i);
            if is_matched || is_covered(&vehicle.left, &left) || is_covered(&vehicle.right, &right)
            {
                continue;
            }
            judged.false_vehicles.push(FalseVehicle {
                frame: frame.row.stamp,
                class: vehicle.class.clone(),
                scene: frame.row.scene,
                sun: frame.row.sun.clone(),
                score: vehicle.score,
                estimated_m: vehicle.distance_m,
                x_min: vehicle.left.x_min,
                y_min: vehicle.left.y_min,
                x_max: vehicle.left.x_max,
                y_max: vehicle.left.y_max,
            });
        }
    }
}

/// Estimates with the posterior's median among them.
fn said(mut estimates: Estimates, ranged: Option<Ranged>) -> Said {
    estimates[0] = ranged.as_ref().map(|ranged| ranged.posterior.median_m());
    (estimates, ranged)
}

impl super::VehicleRow {
    /// Sets all that is said of the vehicle from these boxes.
    fn set_said(&mut self, boxes: Boxes, (estimates, ranged): &Said) {
        self.set_estimates(boxes, *estimates);
        if let Some(ranged) = ranged {
            self.set_spread(boxes, &Spread::new(&ranged.posterior, self.distance_m));
        }
    }
}

/// Boxes of a stereo frame with its images.
fn sightings<'a>(
    seen: &'a Seen,
    boxes: impl Iterator<Item = [PixelBox; 2]>,
) -> impl Iterator<Item = Sighting<'a>> {
    let images = pair_of(seen);
    boxes.map(move |boxes| Sighting { images, boxes })
}

/// The left and the right image of a stereo frame.
fn pair_of<'a>(seen: &'a Seen) -> [&'a RgbImage; 2] {
    [&seen.images[0], &seen.images[seen.images.len() - 1]]
}
