//! The whole way from a stereo pair to metres: the library's front door.

use std::path::Path;
use std::time::{Duration, Instant};

use burn::tensor::Device;
use image::RgbImage;
use serde::{Deserialize, Serialize};

use crate::detector::nms::NmsConfig;
use crate::detector::{Detection, VehicleDetector};
use crate::error::{Error, Result};
use crate::geometry::{PixelBox, StereoRig};
use crate::pairing::search::search;
use crate::pairing::{PairingConfig, PairingMode, pair};
use crate::ranging::{DistanceEstimator, RigNote, Sighting};
use crate::train::StageFolder;

/// What counts as a detection, and what as the same vehicle in both images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PredictOptions {
    /// Detections must score above this, 0 to 1.
    pub confidence: f32,
    /// Boxes that overlap a better one by more than this intersection over union are dropped.
    pub iou: f64,
    /// Whether right boxes are detected or searched for.
    pub pairing_mode: PairingMode,
    /// What the two boxes of a vehicle have in common.
    pub pairing: PairingConfig,
}

/// Usual least score of a detection: one image has to convince alone when the other one's box is
/// searched.
const CONFIDENCE: f32 = 0.35;

impl Default for PredictOptions {
    fn default() -> Self {
        let nms = NmsConfig::prediction();
        Self {
            confidence: CONFIDENCE,
            iou: nms.iou,
            pairing_mode: PairingMode::default(),
            pairing: PairingConfig::default(),
        }
    }
}

/// A vehicle seen in both images, and how far it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Vehicle {
    /// Its box in the left image, pixels.
    pub left: PixelBox,
    /// Its box in the right image, pixels.
    pub right: PixelBox,
    /// Mean confidence of the two detections, 0 to 1; that of the left one alone with
    /// [`PairingMode::Search`].
    pub score: f32,
    /// Class name.
    pub class: String,
    /// From the midpoint between the cameras to the centre of the vehicle, metres.
    pub distance_m: f64,
}

/// Time spent in each part of an estimate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StageTimes {
    /// Detector on both images, or with [`PairingMode::Search`] on the left one, with letterboxing
    /// and suppression.
    pub detect: Duration,
    /// Pairing of left and right detections, or the search in the right image.
    pub pair: Duration,
    /// Crops and distance network.
    pub range: Duration,
}

/// A vehicle before its distance is known.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pair {
    /// Its detection in the left image.
    pub left: Detection,
    /// Its box in the right image, pixels.
    pub right: PixelBox,
    /// As [`Vehicle::score`].
    pub score: f32,
}

impl Pair {
    /// The vehicle, now that its distance is known.
    pub fn at(&self, distance_m: f64, classes: &[String]) -> Vehicle {
        Vehicle {
            left: self.left.box_pixel,
            right: self.right,
            score: self.score,
            class: classes.get(self.left.class).cloned().unwrap_or_default(),
            distance_m,
        }
    }
}

/// Finds vehicles in a stereo pair and says how far they are.
///
/// ```no_run
/// use twinsight::device::DeviceName;
/// use twinsight::imaging::load_pair;
/// use twinsight::pipeline::StereoRanger;
///
/// # fn main() -> twinsight::Result<()> {
/// let device = DeviceName::FLEX.open()?;
/// let ranger = StereoRanger::load("checkpoints/quick", &device)?;
/// let [left, right] = load_pair("left.png", "right.png")?;
/// for vehicle in ranger.estimate(&left, &right)? {
///     println!("{} at {:.1} m", vehicle.class, vehicle.distance_m);
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct StereoRanger {
    detector: VehicleDetector,
    estimator: DistanceEstimator,
    options: PredictOptions,
    /// The rig of the images, where it is not the trained one.
    given_rig: Option<StereoRig>,
}

impl StereoRanger {
    /// Loads the best weights of a run folder.
    ///
    /// # Errors
    /// A folder without both networks, or weights that cannot be used.
    pub fn load(run: impl AsRef<Path>, device: &Device) -> Result<Self> {
        let run = run.as_ref();
        let [detector, distance] = ["detector", "distance"].map(|stage| {
            let path = StageFolder::new(run, stage).best();
            if path.exists() {
                return Ok(path);
            }
            Err(Error::weights(
                path,
                "does not exist",
                format!(
                    "train this run's {stage} first: twinsight train {stage} --run {}",
                    run.display()
                ),
            ))
        });
        Self::new(
            VehicleDetector::load(&detector?, device)?,
            DistanceEstimator::load(&distance?, device)?,
        )
    }

    /// Joins two networks that were trained for the same rig.
    ///
    /// # Errors
    /// Networks trained for different rigs or kinds of box.
    pub fn new(detector: VehicleDetector, estimator: DistanceEstimator) -> Result<Self> {
        let (a, b) = (detector.header(), estimator.header());
        if a.rig != b.rig || a.box_kind != b.box_kind {
            return Err(Error::value(
                "run",
                "its detector and its distance network were trained for different rigs or kinds of box",
                "train both on the same dataset with the same settings",
            ));
        }
        Ok(Self {
            detector,
            estimator,
            options: PredictOptions::default(),
            given_rig: None,
        })
    }

    /// The same for rectified images of this rig, see
    /// [`CalibratedRig`](crate::calibration::CalibratedRig). Images must then be of its size, or the
    /// same resized.
    #[must_use]
    pub fn with_rig(mut self, rig: StereoRig) -> Self {
        self.given_rig = Some(rig);
        self
    }

    /// The same with other options.
    #[must_use]
    pub fn with_options(mut self, options: PredictOptions) -> Self {
        self.options = options;
        self
    }

    /// What counts as a detection, and as a pair.
    pub fn options(&self) -> &PredictOptions {
        &self.options
    }

    /// The rig that the networks were trained for.
    pub fn rig(&self) -> &StereoRig {
        &self.detector.header().rig
    }

    /// The detector alone.
    pub fn detector(&self) -> &VehicleDetector {
        &self.detector
    }

    /// The distance network alone.
    pub fn estimator(&self) -> &DistanceEstimator {
        &self.estimator
    }

    /// Vehicles that are seen in both images, nearest first.
    ///
    /// # Errors
    /// Images of different or impossible sizes, or a device that fails.
    pub fn estimate(&self, left: &RgbImage, right: &RgbImage) -> Result<Vec<Vehicle>> {
        Ok(self.estimate_timed(left, right)?.0)
    }

    /// [`StereoRanger::estimate`], also saying where the time went.
    ///
    /// # Errors
    /// As [`StereoRanger::estimate`].
    pub fn estimate_timed(
        &self,
        left: &RgbImage,
        right: &RgbImage,
    ) -> Result<(Vec<Vehicle>, StageTimes)> {
        if left.dimensions() != right.dimensions() {
            return Err(Error::value(
                format!(
                    "pair of {:?} and {:?} pixels",
                    left.dimensions(),
                    right.dimensions()
                ),
                "the two images differ in size",
                "give the left and the right image of one capture",
            ));
        }
        let started = Instant::now();
        let nms = NmsConfig {
            confidence: self.options.confidence,
            iou: self.options.iou,
            ..NmsConfig::prediction()
        };
        let images = match self.options.pairing_mode {
            PairingMode::Detect => &[left, right][..],
            PairingMode::Search => &[left],
        };
        let found = self.detector.detect(images, &nms)?;
        let detect = started.elapsed();

        let started = Instant::now();
        let rig = self.rig_for(left.dimensions())?;
        let pairs = self.pairs([left, right], found, &rig);
        let paired = started.elapsed();

        let started = Instant::now();
        let sightings: Vec<Sighting> = pairs
            .iter()
            .map(|pair| Sighting {
                images: [left, right],
                boxes: [pair.left.box_pixel, pair.right],
            })
            .collect();
        let distances_m = self.estimator.estimate(&sightings, &rig)?;
        let classes = &self.detector.header().classes;
        let mut vehicles: Vec<Vehicle> = pairs
            .into_iter()
            .zip(distances_m)
            .map(|(pair, distance_m)| pair.at(distance_m, classes))
            .collect();
        vehicles.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
        Ok((
            vehicles,
            StageTimes {
                detect,
                pair: paired,
                range: started.elapsed(),
            },
        ))
    }

    /// The right box of each left detection that has one, given what the detector found in the
    /// images that it ran on.
    pub(crate) fn pairs(
        &self,
        images: [&RgbImage; 2],
        found: Vec<Vec<Detection>>,
        rig: &StereoRig,
    ) -> Vec<Pair> {
        let mut found = found.into_iter();
        let left = found.next().unwrap_or_default();
        let config = &self.options.pairing;
        match self.options.pairing_mode {
            PairingMode::Detect => {
                let right = found.next().unwrap_or_default();
                let pairs = pair(&left, &right, rig, config).pairs;
                let joined = |(l, r, _): (usize, usize, f64)| Pair {
                    left: left[l],
                    right: right[r].box_pixel,
                    score: f32::midpoint(left[l].score, right[r].score),
                };
                pairs.into_iter().map(joined).collect()
            }
            PairingMode::Search => search(images, &left, rig, config)
                .partners
                .into_iter()
                .map(|partner| Pair {
                    left: left[partner.left],
                    right: partner.box_pixel,
                    score: left[partner.left].score,
                })
                .collect(),
        }
    }

    /// In what images of this size differ from those that the networks were trained on, and what is
    /// done about it.
    pub fn rig_notes(&self, (width, height): (u32, u32)) -> Vec<RigNote> {
        let images = [width, height];
        match &self.given_rig {
            None => RigNote::of_size(self.rig(), images).into_iter().collect(),
            Some(rig) => {
                let calibrated = [rig.left.width, rig.left.height];
                let resized =
                    (calibrated != images).then_some(RigNote::Resized { calibrated, images });
                let readout = self.estimator.header().readout;
                let mut notes = RigNote::of_rig(self.rig(), rig, readout);
                notes.extend(resized);
                notes
            }
        }
    }

    /// The rig of images of this size: the given one, or the trained one at another resolution of
    /// the same field of view.
    pub(crate) fn rig_for(&self, (width, height): (u32, u32)) -> Result<StereoRig> {
        let size = [width, height];
        match self.given_rig {
            Some(rig) => rig.resized(size).ok_or_else(|| {
                Error::value(
                    format!("images of {width}x{height} pixels"),
                    format!("the given rig has {}x{}", rig.left.width, rig.left.height),
                    "give images of the calibrated cameras, or the same resized but not cut",
                )
            }),
            None => Ok(self
                .rig()
                .resized(size)
                .unwrap_or_else(|| self.rig().cropped(size))),
        }
    }
}
