//! The whole way from a stereo pair to metres: the library's front door.

mod filter;
mod run;
mod sides;
mod vehicle;

use std::path::Path;
use std::time::Instant;

use burn::tensor::Device;
use image::RgbImage;

use crate::detector::nms::NmsConfig;
use crate::detector::{Detection, VehicleDetector};
use crate::error::{Error, Result};
use crate::geometry::{DisparityCorrection, PixelBox, StereoRig};
use crate::pairing::{PairingConfig, PairingMode};
use crate::ranging::size::SizeEstimator;
use crate::ranging::{
    DistanceEstimator, FusedRanger, NamedBox, PairDoubt, RangerKind, RigNote, Sighting, TrustedRig,
};

use sides::Sides;
use vehicle::class_name;

pub use filter::VehicleFilter;
pub(crate) use run::size_weights;
pub(crate) use vehicle::Pair;
pub use vehicle::{DetectedIn, Findings, SingleSided, StageTimes, Unmatched, Vehicle};

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
    /// What becomes of a vehicle that the detector sees in one image only.
    pub single_sided: SingleSided,
    /// Which answer the distance is.
    pub ranger: RangerKind,
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
            single_sided: SingleSided::default(),
            ranger: RangerKind::default(),
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
    filter: VehicleFilter,
    /// Numbers of the filter's classes; None for all.
    classes: Option<Vec<usize>>,
    /// The rig of the images, where it is not the trained one.
    given_rig: Option<TrustedRig>,
    /// Where it is not the rig's own.
    disparity_std_px: Option<f64>,
    fused: FusedRanger,
}

/// A service may share one ranger among its threads.
const _: () = {
    const fn assert_send_and_sync<T: Send + Sync>() {}
    assert_send_and_sync::<StereoRanger>();
    assert_send_and_sync::<Findings>();
    assert_send_and_sync::<Error>();
};

impl StereoRanger {
    /// Loads the best weights of a run folder.
    ///
    /// # Errors
    /// No such folder, one without both networks, or weights that cannot be used.
    pub fn load(run: impl AsRef<Path>, device: &Device) -> Result<Self> {
        let [detector, distance] = run::weights(run.as_ref())?;
        let sizes = run::size_weights(run.as_ref())
            .map(|path| SizeEstimator::load(&path, device))
            .transpose()?;
        let ranger = Self::new(
            VehicleDetector::load(&detector, device)?,
            DistanceEstimator::load(&distance, device)?,
        )?;
        Ok(ranger.with_sizes(sizes))
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
            fused: FusedRanger::new(a.box_kind),
            detector,
            estimator,
            options: PredictOptions::default(),
            filter: VehicleFilter::default(),
            classes: None,
            given_rig: None,
            disparity_std_px: None,
        })
    }

    /// The same for rectified images of this rig, see
    /// [`CalibratedRig`](crate::calibration::CalibratedRig). Images must then be of its size, or the
    /// same resized.
    #[must_use]
    pub fn with_rig(self, rig: StereoRig) -> Self {
        self.with_trusted_rig(TrustedRig::unchecked(rig))
    }

    /// [`StereoRanger::with_rig`], also saying how far its disparities can be trusted.
    #[must_use]
    pub const fn with_trusted_rig(mut self, rig: TrustedRig) -> Self {
        self.given_rig = Some(rig);
        self
    }

    /// The same with another standard deviation of what all disparities of a frame are off by, pixels.
    #[must_use]
    pub const fn with_disparity_std(mut self, std_px: f64) -> Self {
        self.disparity_std_px = Some(std_px);
        self
    }

    /// The same with a trained size network as one more witness of the distance.
    #[must_use]
    pub fn with_sizes(mut self, sizes: Option<SizeEstimator>) -> Self {
        self.fused = self.fused.with_sizes(sizes);
        self
    }

    /// The same with other options.
    #[must_use]
    pub fn with_options(mut self, options: PredictOptions) -> Self {
        self.options = options;
        self
    }

    /// The same, reporting wanted vehicles only.
    ///
    /// # Errors
    /// A class that the networks do not know, or no vehicles at all.
    pub fn with_filter(mut self, filter: VehicleFilter) -> Result<Self> {
        self.classes = filter.class_numbers(&self.detector.header().classes)?;
        self.filter = filter;
        Ok(self)
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

    /// The default way to a distance alone.
    pub fn fused(&self) -> &FusedRanger {
        &self.fused
    }

    /// The distance network alone.
    pub fn estimator(&self) -> &DistanceEstimator {
        &self.estimator
    }

    /// Vehicles with a box in both images, nearest first; an empty list where there are none.
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
        let (mut findings, times) = self.find(&[[left, right]])?;
        Ok((findings.pop().unwrap_or_default().vehicles, times))
    }

    /// [`StereoRanger::estimate`] of several pairs, left images first in each, at once: pairs of one
    /// size that follow each other run as one batch, and so do the vehicles in all of them.
    ///
    /// Boxes and distances agree with those of single estimates but for rounding.
    ///
    /// # Errors
    /// As [`StereoRanger::estimate`], for any of the pairs.
    pub fn estimate_batch(&self, pairs: &[[&RgbImage; 2]]) -> Result<Vec<Vec<Vehicle>>> {
        let (findings, _) = self.find(pairs)?;
        Ok(findings.into_iter().map(|found| found.vehicles).collect())
    }

    /// [`StereoRanger::estimate_batch`] with all findings, also saying where the time went.
    ///
    /// # Errors
    /// As [`StereoRanger::estimate_batch`].
    pub fn find(&self, pairs: &[[&RgbImage; 2]]) -> Result<(Vec<Findings>, StageTimes)> {
        for [left, right] in pairs {
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
        }
        let mut findings = Vec::with_capacity(pairs.len());
        let mut times = StageTimes::default();
        for group in pairs.chunk_by(|a, b| a[0].dimensions() == b[0].dimensions()) {
            findings.append(&mut self.find_in_group(group, &mut times)?);
        }
        Ok((findings, times))
    }

    /// Pairs of one size.
    fn find_in_group(
        &self,
        pairs: &[[&RgbImage; 2]],
        times: &mut StageTimes,
    ) -> Result<Vec<Findings>> {
        let started = Instant::now();
        let nms = NmsConfig {
            confidence: self.options.confidence,
            iou: self.options.iou,
            ..NmsConfig::prediction()
        };
        let sides = match self.options.pairing_mode {
            PairingMode::Detect => 2,
            PairingMode::Search => 1,
        };
        let images: Vec<&RgbImage> = pairs
            .iter()
            .flat_map(|pair| pair.iter().copied().take(sides))
            .collect();
        let mut found = self.detector.detect(&images, &nms)?.into_iter();
        times.detect += started.elapsed();

        let started = Instant::now();
        let (width, height) = pairs[0][0].dimensions();
        if let Some(region) = &self.filter.region
            && !region.reaches_into(width, height)
        {
            return Err(Error::value(
                "region of interest",
                format!("lies outside of images of {width}x{height} pixels"),
                "give its corners in pixels of the left image",
            ));
        }
        let trusted = self.trusted_rig_for((width, height))?;
        let rig = &trusted.rig;
        let mut sorted: Vec<(Sides, Option<PairDoubt>)> = Vec::with_capacity(pairs.len());
        for images in pairs {
            let mut found: Vec<Vec<Detection>> = found.by_ref().take(sides).collect();
            if let Some(classes) = &self.classes {
                for side in &mut found {
                    side.retain(|detection| classes.contains(&detection.class));
                }
            }
            sorted.push(self.sides(*images, found, &trusted)?);
        }
        for (sides, _) in &mut sorted {
            sides.pairs = self.filter.pairs(std::mem::take(&mut sides.pairs));
        }
        times.pair += started.elapsed();

        let started = Instant::now();
        let sightings: Vec<Sighting> = pairs
            .iter()
            .zip(&sorted)
            .flat_map(|(images, (sides, _))| {
                sides.pairs.iter().map(|pair| Sighting {
                    images: *images,
                    boxes: [pair.left.box_pixel, pair.right],
                })
            })
            .collect();
        let mut distances_m = self.estimator.estimate(&sightings, rig)?.into_iter();
        let findings = sorted
            .into_iter()
            .map(|(sides, note)| Findings {
                note,
                ..self.findings(sides, &mut distances_m)
            })
            .collect();
        times.range += started.elapsed();
        Ok(findings)
    }

    /// The detections of a pair sorted out, and what is strange about its images. With the posterior
    /// as ranger, vehicles that the detector saw in the left image alone need no partner in the right
    /// one: where they are there follows from their distance.
    fn sides(
        &self,
        images: [&RgbImage; 2],
        found: Vec<Vec<Detection>>,
        rig: &TrustedRig,
    ) -> Result<(Sides, Option<PairDoubt>)> {
        let is_fused = self.options.ranger == RangerKind::Fused;
        if !is_fused {
            let sides = Sides::new(images, found, &rig.rig, &self.options);
            return Ok((sides, PairDoubt::of_images(images)));
        }
        let sides = match self.options.pairing_mode {
            PairingMode::Search => Sides::of_left(found.into_iter().next().unwrap_or_default()),
            PairingMode::Detect => Sides::new(images, found, &rig.rig, &self.options),
        };
        self.ranged(images, sides, rig)
    }

    /// The same pairs with what is known of their distances.
    fn ranged(
        &self,
        images: [&RgbImage; 2],
        sides: Sides,
        rig: &TrustedRig,
    ) -> Result<(Sides, Option<PairDoubt>)> {
        let classes = &self.detector.header().classes;
        let boxes: Vec<NamedBox> = sides
            .pairs
            .iter()
            .map(|pair| NamedBox {
                box_pixel: pair.left.box_pixel,
                class: classes.get(pair.left.class).map(String::as_str),
            })
            .collect();
        let (ranged, doubt) = self.fused.range(images, &boxes, rig)?;
        let pairs = sides.pairs.into_iter().zip(ranged);
        let pairs = pairs.map(|(pair, ranged)| pair.at_posterior(ranged, &rig.rig));
        let pairs = pairs.collect();
        Ok((
            Sides {
                pairs,
                alone: sides.alone,
            },
            doubt,
        ))
    }

    /// What is reported of one pair, given the distances of its vehicles.
    fn findings(&self, sides: Sides, distances_m: &mut impl Iterator<Item = f64>) -> Findings {
        let classes = &self.detector.header().classes;
        let mut vehicles: Vec<Vehicle> = sides
            .pairs
            .iter()
            .zip(distances_m)
            .map(|(pair, network_m)| pair.vehicle(self.options.ranger, Some(network_m), classes))
            .collect();
        vehicles.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
        let mut unmatched = Vec::new();
        if self.options.single_sided == SingleSided::Keep {
            let sides = [DetectedIn::Left, DetectedIn::Right]
                .into_iter()
                .zip(sides.alone);
            for (detected_in, alone) in sides {
                let alone = self.filter.detections(alone).into_iter();
                unmatched.extend(alone.map(|detection| Unmatched {
                    detected_in,
                    box_pixel: detection.box_pixel,
                    score: detection.score,
                    class: class_name(detection.class, classes),
                }));
            }
        }
        Findings {
            vehicles,
            unmatched,
            note: None,
        }
    }

    /// The boxes in both images with what is known of their distances, given what the detector found
    /// in the images that it ran on.
    pub(crate) fn pairs(
        &self,
        images: [&RgbImage; 2],
        found: Vec<Vec<Detection>>,
        rig: &TrustedRig,
    ) -> Result<Vec<Pair>> {
        let (sides, _) = self.sides(images, found, rig)?;
        if self.options.ranger == RangerKind::Fused {
            return Ok(sides.pairs);
        }
        // Its boxes stay those of the search.
        let boxes: Vec<PixelBox> = sides.pairs.iter().map(|pair| pair.right).collect();
        let (ranged, _) = self.ranged(images, sides, rig)?;
        let pairs = ranged.pairs.into_iter().zip(boxes);
        Ok(pairs.map(|(pair, right)| Pair { right, ..pair }).collect())
    }

    /// In what images of this size differ from those that the networks were trained on, and what is
    /// done about it.
    pub fn rig_notes(&self, (width, height): (u32, u32)) -> Vec<RigNote> {
        let images = [width, height];
        match &self.given_rig {
            None => RigNote::of_size(self.rig(), images).into_iter().collect(),
            Some(TrustedRig { rig, .. }) => {
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
    /// the same field of view. That the cameras are the trained ones nobody has checked.
    pub(crate) fn trusted_rig_for(&self, (width, height): (u32, u32)) -> Result<TrustedRig> {
        let size = [width, height];
        let mut trusted = match self.given_rig {
            Some(trusted) => {
                let own = trusted.rig.left;
                let rig = trusted.rig.resized(size).ok_or_else(|| {
                    Error::value(
                        format!("images of {width}x{height} pixels"),
                        format!("the given rig has {}x{}", own.width, own.height),
                        "give images of the calibrated cameras, or the same resized but not cut",
                    )
                })?;
                let correction = trusted
                    .correction
                    .map(|correction| DisparityCorrection::new(*correction.terms(), rig.left))
                    .transpose()?;
                TrustedRig {
                    rig,
                    correction,
                    ..trusted
                }
            }
            None => TrustedRig::unchecked(
                self.rig()
                    .resized(size)
                    .unwrap_or_else(|| self.rig().cropped(size)),
            ),
        };
        if let Some(std_px) = self.disparity_std_px {
            trusted.disparity_std_px = std_px;
        }
        Ok(trusted)
    }
}
