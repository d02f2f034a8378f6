//! The one pass over the frames of a split: every image is decoded once and seen once by the
//! detector, whose boxes serve both its own figures and the pipeline.

use image::RgbImage;
use rayon::prelude::*;

use super::baselines::Baselines;
use super::detection::add_image;
use super::match_vehicles;
use super::subject::Subject;
use super::vehicles::{Boxes, Estimates, FalseVehicle, Places};
use crate::dataset::{BoxKind, Frame, Problem, Side, StereoDataset, StereoLabel};
use crate::detector::nms::NmsConfig;
use crate::detector::{Detection, LetterboxedCandidates, VehicleDetector};
use crate::error::{Error, Result};
use crate::geometry::{PixelBox, StereoRig};
use crate::metrics::{Confusion, DetectionMetrics, Target, is_covered};
use crate::pipeline::Vehicle;
use crate::progress::Progress;
use crate::ranging::{DistanceEstimator, Sighting};

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
    kind: BoxKind,
    places: Places<'a>,
}

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
    ) -> Self {
        let kind = subject.box_kind();
        Self {
            subject,
            dataset,
            baselines,
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
        if let Some(estimator) = self.subject.estimator()
            && self.dataset.info.stereo
        {
            self.range(estimator, &seen, judged)?;
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
    fn range(
        &self,
        estimator: &DistanceEstimator,
        seen: &[Seen],
        judged: &mut Judged,
    ) -> Result<()> {
        let rig = self.dataset.rig();
        let ranger = self.subject.ranger();
        let own_rig = match ranger {
            Some(ranger) => ranger.rig_for((rig.left.width, rig.left.height))?,
            None => *rig,
        };
        let paired: Vec<Paired> = seen
            .par_iter()
            .map(|seen| Paired {
                labels: seen.frame.vehicles(self.kind),
                pairs: ranger.map_or_else(Vec::new, |ranger| {
                    ranger.pairs(pair_of(seen), seen.found.clone(), &own_rig)
                }),
            })
            .collect();
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
        let mut of_labels = self
            .estimates(estimator, &labelled.collect::<Vec<_>>(), rig)?
            .into_iter();
        let mut of_pairs = self
            .estimates(estimator, &detected.collect::<Vec<_>>(), &own_rig)?
            .into_iter();
        for (seen, paired) in frames() {
            let of_labels: Vec<_> = of_labels.by_ref().take(paired.labels.len()).collect();
            let of_pairs: Vec<_> = of_pairs.by_ref().take(paired.pairs.len()).collect();
            self.match_frame(seen.frame, paired, &of_labels, of_pairs, judged);
        }
        Ok(())
    }

    /// What the network, which is given this rig, and the baselines say.
    fn estimates(
        &self,
        estimator: &DistanceEstimator,
        sightings: &[Sighting],
        rig: &StereoRig,
    ) -> Result<Vec<Estimates>> {
        let network_m = estimator.estimate(sightings, rig)?;
        let estimates = sightings.par_iter().zip(network_m);
        Ok(estimates
            .map(|(sighting, network_m)| {
                let mut estimates = self.baselines.map_or([None; 5], |baselines| {
                    baselines.estimates(sighting, self.dataset.rig())
                });
                estimates[0] = Some(network_m);
                estimates
            })
            .collect())
    }

    fn match_frame(
        &self,
        frame: &Frame,
        Paired { labels, pairs }: &Paired,
        of_labels: &[Estimates],
        of_pairs: Vec<Estimates>,
        judged: &mut Judged,
    ) {
        let classes = self.dataset.classes();
        let mut found: Vec<(Vehicle, Estimates)> = pairs
            .iter()
            .zip(of_pairs)
            .map(|(pair, estimates)| {
                let distance_m = estimates[0].unwrap_or(f64::NAN);
                (pair.at(distance_m, classes), estimates)
            })
            .collect();
        found.sort_by(|a, b| a.0.distance_m.total_cmp(&b.0.distance_m));
        let vehicles: Vec<Vehicle> = found.iter().map(|(vehicle, _)| vehicle.clone()).collect();
        let matches = match_vehicles(&vehicles, labels);
        for (i, (label, estimates)) in labels.iter().zip(of_labels).enumerate() {
            let mut row = self.places.unseen(frame, label);
            row.set_estimates(Boxes::True, *estimates);
            if let Some((vehicle, _)) = matches.iter().find(|(_, of)| *of == i) {
                let (vehicle, estimates) = &found[*vehicle];
                let overlap = vehicle.left.iou(&label.left.box_pixel);
                row.found = true;
                row.set_found_box(&vehicle.left);
                row.score = Some(vehicle.score);
                row.overlap = Some(overlap.min(vehicle.right.iou(&label.right.box_pixel)));
                row.set_estimates(Boxes::Pipeline, *estimates);
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
