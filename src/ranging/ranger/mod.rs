//! The distance of vehicles as Bayes sees it: box size and stereo pixels as two witnesses, and a
//! learnt one where there is one. Nothing here needs training.
//!
//! For the depth `z` of a vehicle's centre, `p(z) ~ p(box | z) p(pixels | z)` with a prior that is
//! even in `log z`. How bodies look at a depth, [`Body`] says; how alike the right image is at the
//! disparity of a depth, the windows of `stereo`. The surface that stereo sees lies before the
//! centre, and the rig's own disparities may be off: both are part of the likelihood.

mod body;
mod doubt;
mod offsets;
mod ray;
mod spline;
mod stereo;
mod trusted_rig;
mod witnessed;

use image::RgbImage;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

pub use body::Body;
use body::{SeenBox, Stance};
pub use doubt::PairDoubt;
use offsets::{Offsets, log_fit, shared};
use ray::{Ray, log_spaced};
use stereo::{StereoEvidence, stereo_evidence};
pub use trusted_rig::TrustedRig;
use witnessed::{LEAST_DEPTH_M, Witnessed, pixels};

use super::{Posterior, SizeWitness};
use crate::dataset::BoxKind;
use crate::geometry::{PixelBox, StereoRig};

/// Relative spread of the boxes of a strange pair: its vehicles may be anything.
const STRANGE_BOX_STD: f64 = 0.3;

/// Points of the grid that are even in the logarithm of the depth.
const EVEN_POINTS: usize = 160;

/// Depths of disparities that are at least this likely are points of the grid, too.
const LIKELY: f64 = 0.02;

/// Steps of the likelihood between those points.
const STRIDE: f64 = 3.0;

/// How far cameras look down, degrees, and how often: along the road from a vehicle, or from poles
/// and drones.
const PITCHES_DEG: [(f64, f64); 15] = [
    (-6.0, 0.01),
    (-3.0, 0.03),
    (0.0, 0.65),
    (3.0, 0.03),
    (6.0, 0.02),
    (10.0, 0.02),
    (15.0, 0.02),
    (20.0, 0.02),
    (27.0, 0.03),
    (35.0, 0.03),
    (43.0, 0.03),
    (51.0, 0.03),
    (60.0, 0.03),
    (70.0, 0.01),
    (80.0, 0.01),
];

/// Pitches less probable than this part of the most probable one are left out.
const LEAST_PITCH: f64 = 0.1;

/// The evidence is raised to this power: windows that see different faces of a vehicle vote for
/// different disparities, and added up they are wider than what is unknown of its centre. Found on
/// the training split of rendered traffic and real pairs, by the coverage of the intervals.
const SHARPNESS: f64 = 1.5;

/// The same with a learnt witness of the size, which also says what the windows disagree about. On the
/// validation split of rendered traffic the 95 % intervals then hold 98.7 % with true boxes and 97.4 % with
/// detected ones.
const WITNESSED_SHARPNESS: f64 = 2.5;

/// Settings of a [`Ranger`].
#[derive(Debug, Clone, PartialEq)]
pub struct RangerSettings {
    /// No vehicle is nearer, metres of depth.
    pub nearest_m: f64,
    /// No vehicle is farther, metres of depth.
    pub farthest_m: f64,
    /// Standard deviation of a matched disparity where the rig is exact, pixels.
    pub match_std_px: f64,
    /// Standard deviation of the sides of a box, as a part of them.
    pub box_std: f64,
    /// And in addition, pixels.
    pub box_std_px: f64,
}

impl Default for RangerSettings {
    fn default() -> Self {
        Self {
            nearest_m: 2.0,
            farthest_m: 300.0,
            match_std_px: 0.1,
            box_std: 0.05,
            box_std_px: 0.7,
        }
    }
}

/// A vehicle that is to be ranged.
#[derive(Debug, Clone, PartialEq)]
pub struct Target {
    /// Its box in the left image, pixels.
    pub box_pixel: PixelBox,
    /// The kind of the box: tight around the vehicle, or the paper's square around its sphere.
    pub kind: BoxKind,
    /// Its class name, where one is known.
    pub class: Option<String>,
    /// What a trained network says of its size.
    pub witness: Option<SizeWitness>,
}

/// Any vehicle in a square around its sphere, whose side says little.
const SPHERE: SizeWitness = SizeWitness {
    log_size_mean: 1.28,
    log_size_std: 0.3,
    extent_mean_m: 0.7,
    extent_std_m: 0.4,
    unknown: 0.0,
};

/// Parts of the width and the height of the square around a sphere that a vehicle in it fills.
const SPHERE_FILLED: [f64; 2] = [0.8, 0.6];

impl Target {
    /// What is known of its size by something else than its tight box.
    fn size_witness(&self) -> Option<SizeWitness> {
        self.witness.or(match self.kind {
            BoxKind::Sphere => Some(SPHERE),
            BoxKind::Tight => None,
        })
    }

    /// Where its pixels are.
    fn filled(&self) -> PixelBox {
        let area = &self.box_pixel;
        match self.kind {
            BoxKind::Tight => *area,
            BoxKind::Sphere => PixelBox::from_center(
                area.center(),
                SPHERE_FILLED[0] * area.width(),
                SPHERE_FILLED[1] * area.height(),
            ),
        }
    }
}

/// What is known of the distance of a vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Ranged {
    /// From the midpoint between the cameras to its centre.
    pub posterior: Posterior,
    /// What its size alone says: the median, metres.
    pub size_m: f64,
    /// What the most likely disparity alone says, metres; None without texture or a disparity above
    /// 0.
    pub stereo_m: Option<f64>,
    /// Disparity of its visible surface that fits the median distance, pixels.
    pub disparity_px: f64,
    /// Share of the windows that agree on the most likely disparity, 0 to 1.
    pub support: f64,
    /// Why the distance may be another.
    pub doubt: Option<VehicleDoubt>,
}

/// Why the distance of a vehicle may be another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VehicleDoubt {
    /// The posterior has two separate modes.
    TwoDistances,
    /// The matched disparity contradicts the size.
    WitnessesDisagree,
}

impl VehicleDoubt {
    /// The word that files have for it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::TwoDistances => "two_distances",
            Self::WitnessesDisagree => "witnesses_disagree",
        }
    }
}

/// Ranges vehicles without any training: box size and stereo pixels are two witnesses of a posterior
/// over distance, and a learnt size is one more where there is one.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Ranger {
    settings: RangerSettings,
}

impl Ranger {
    /// A ranger with other settings.
    pub const fn new(settings: RangerSettings) -> Self {
        Self { settings }
    }

    /// The posterior of every vehicle of a rectified pair, left image first, in their order, and what
    /// is strange about the pair. The rig must be the one of images of this size.
    ///
    /// Of a pair whose images are the same or exchanged the pixels are no evidence: what is left is a
    /// wide statement of the sizes.
    pub fn posteriors(
        &self,
        images: [&RgbImage; 2],
        targets: &[Target],
        rig: &TrustedRig,
    ) -> (Vec<Ranged>, Option<PairDoubt>) {
        let nearer: Vec<Vec<PixelBox>> = targets
            .iter()
            .map(|target| nearer(target, targets))
            .collect();
        let stereo: Vec<Option<StereoEvidence>> = targets
            .par_iter()
            .zip(&nearer)
            .map(|(target, nearer)| stereo_evidence(images, &target.filled(), nearer, &rig.rig))
            .collect();
        let boxes: Vec<PixelBox> = targets.iter().map(Target::filled).collect();
        let doubt = PairDoubt::of(images, &boxes, &nearer, &stereo, &rig.rig);
        let witnessed: Vec<Witnessed> = targets
            .par_iter()
            .zip(stereo)
            .map(|(target, stereo)| self.witnessed(target, stereo, rig, doubt.is_some()))
            .collect();
        let pitches = Self::pitches(&witnessed, &rig.rig);
        let offsets = Offsets::new(&witnessed, &pitches, rig);
        let ranged = witnessed
            .par_iter()
            .enumerate()
            .map(|(i, witnessed)| {
                let stereo = witnessed
                    .stereo
                    .as_ref()
                    .map(|stereo| offsets.seen_by_others(i, stereo));
                self.range(witnessed, stereo.as_ref(), &pitches, &rig.rig)
            })
            .collect();
        (ranged, doubt)
    }

    /// Vehicles as rulers of a rig: for each one with texture the logarithm of how well its size and its
    /// pixels fit together if all disparities are larger than the rig says by each of `offsets_px`,
    /// pixels. See [`constant_from_evidence`](crate::calibrate::constant_from_evidence).
    pub fn offset_evidence(
        &self,
        images: [&RgbImage; 2],
        targets: &[Target],
        rig: &TrustedRig,
        offsets_px: &[f64],
    ) -> Vec<Vec<f64>> {
        let witnessed: Vec<Witnessed> = targets
            .par_iter()
            .map(|target| {
                let nearer = nearer(target, targets);
                let stereo = stereo_evidence(images, &target.filled(), &nearer, &rig.rig);
                self.witnessed(target, stereo, rig, false)
            })
            .collect();
        let pitches = Self::pitches(&witnessed, &rig.rig);
        witnessed
            .par_iter()
            .filter_map(|witnessed| {
                let stances = witnessed.stances(&pitches);
                let evidence = witnessed.evidence(&stances, &rig.rig, offsets_px)?;
                Some(evidence.into_iter().map(log_fit).collect())
            })
            .collect()
    }

    /// The posterior of one vehicle that has the images for itself, see [`Ranger::posteriors`].
    pub fn posterior(
        &self,
        images: [&RgbImage; 2],
        target: &Target,
        rig: &TrustedRig,
    ) -> Posterior {
        let (ranged, _) = self.posteriors(images, std::slice::from_ref(target), rig);
        ranged.into_iter().next().map_or_else(
            || Posterior::unknown(self.settings.nearest_m, self.settings.farthest_m),
            |ranged| ranged.posterior,
        )
    }

    /// What is known of a target before vehicles are compared.
    fn witnessed<'a>(
        &self,
        target: &'a Target,
        stereo: Option<StereoEvidence>,
        rig: &TrustedRig,
        is_strange: bool,
    ) -> Witnessed<'a> {
        let widened = if is_strange { STRANGE_BOX_STD } else { 0.0 };
        let noise = [
            libm::hypot(self.settings.box_std, widened),
            self.settings.box_std_px,
        ];
        let support = stereo.as_ref().map_or(0.0, |stereo| stereo.support);
        let delta_px = rig.delta_px(target.box_pixel.center());
        let usable = stereo.filter(|_| !is_strange);
        Witnessed {
            target,
            seen: SeenBox::new(&target.box_pixel, &rig.rig.left, noise),
            bodies: target
                .class
                .as_deref()
                .map_or_else(|| Body::TRAFFIC.to_vec(), Body::of_class),
            witness: target.size_witness().map(|witness| SizeWitness {
                log_size_std: libm::hypot(witness.log_size_std, widened),
                ..witness
            }),
            stereo: usable
                .map(|stereo| stereo.moved(-delta_px).blurred(self.settings.match_std_px)),
            delta_px,
            support,
        }
    }

    /// Pitches of the camera, radians, with their probabilities, given all vehicles.
    fn pitches(witnessed: &[Witnessed], rig: &StereoRig) -> Vec<(f64, f64)> {
        let rulers: Vec<&Witnessed> = witnessed
            .iter()
            .filter(|w| w.witness.is_none() && w.seen.is_some())
            .collect();
        let tempering = shared(rulers.len());
        let log: Vec<f64> = PITCHES_DEG
            .par_iter()
            .map(|&(pitch_deg, prior)| {
                let fits = rulers
                    .iter()
                    .map(|w| Self::fit(w, pitch_deg.to_radians(), rig));
                libm::log(prior) + fits.sum::<f64>() * tempering
            })
            .collect();
        let most = log.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let weights = log.iter().map(|log| libm::exp(log - most));
        let pitches = PITCHES_DEG
            .iter()
            .map(|(pitch_deg, _)| pitch_deg.to_radians());
        pitches
            .zip(weights)
            .filter(|(_, weight)| *weight >= LEAST_PITCH)
            .collect()
    }

    /// Logarithm of how well a vehicle fits a pitch.
    fn fit(witnessed: &Witnessed, pitch: f64, rig: &StereoRig) -> f64 {
        let evidence = witnessed.seen.as_ref().and_then(|seen| {
            let stances = Stance::all(&witnessed.bodies, pitch, seen);
            witnessed.evidence(&stances, rig, &[0.0])
        });
        evidence.map_or(0.0, |sums| log_fit(sums[0]))
    }

    /// The posterior of a vehicle, given its stereo evidence and the camera's pitches.
    fn range(
        &self,
        witnessed: &Witnessed,
        stereo: Option<&StereoEvidence>,
        pitches: &[(f64, f64)],
        rig: &StereoRig,
    ) -> Ranged {
        let area = &witnessed.target.box_pixel;
        let stances = witnessed.stances(pitches);
        let depths = self.depths(stereo, rig);
        // The spread of a size alone is right as it is.
        let sharpness = match (stereo, witnessed.target.witness) {
            (None, _) => 1.0,
            (Some(_), Some(_)) => WITNESSED_SHARPNESS,
            (Some(_), None) => SHARPNESS,
        };
        let mut joint = Vec::with_capacity(depths.len());
        let mut of_size = Vec::with_capacity(depths.len());
        let mut extent = Vec::with_capacity(depths.len());
        for &z_m in &depths {
            let (mut both, mut size, mut way) = (0.0, 0.0, 0.0);
            let mut add = |likelihood: f64, extent_m: f64| {
                let value = likelihood * pixels(stereo, rig, z_m, extent_m);
                size += likelihood;
                both += value;
                way += value * extent_m;
            };
            witnessed.sizes(&stances, z_m, &mut add);
            // Per metre: the prior is even in the logarithm of the depth.
            joint.push(sharpness * libm::log(both) - libm::log(z_m));
            of_size.push(libm::log(size / z_m));
            extent.push(way / both);
        }
        let ray = Ray::new(area, rig);
        let distances: Vec<f64> = depths.iter().map(|&z_m| ray.distance_m(z_m)).collect();
        let of = |log: &[f64]| {
            Posterior::new(distances.clone(), log).unwrap_or_else(|| {
                Posterior::unknown(self.settings.nearest_m, self.settings.farthest_m)
            })
        };
        let (posterior, size) = (of(&joint), of(&of_size));
        let median = posterior.median_m();
        let i = distances.partition_point(|&distance| distance < median);
        let i = i.min(depths.len() - 1);
        let surface_m = (ray.depth_m(median) - extent[i]).max(LEAST_DEPTH_M);
        let disparity_px = rig.disparity_px(surface_m) + witnessed.delta_px;
        let stereo_m = stereo.and_then(|stereo| {
            let best_px = stereo.best_px();
            let z_m = rig.depth_m(best_px);
            (best_px > 0.0 && z_m.is_finite()).then(|| ray.distance_m(z_m + extent[i]))
        });
        let [least_m, most_m] = size.interval_m(0.99);
        let is_other = |stereo_m: f64| !(least_m..=most_m).contains(&stereo_m);
        let doubt = if posterior.modes().len() > 1 {
            Some(VehicleDoubt::TwoDistances)
        } else if stereo_m.is_some_and(is_other) {
            Some(VehicleDoubt::WitnessesDisagree)
        } else {
            None
        };
        Ranged {
            doubt,
            size_m: size.median_m(),
            posterior,
            stereo_m,
            disparity_px,
            support: witnessed.support,
        }
    }

    /// Depths of the grid: evenly, and closely where stereo is likely.
    fn depths(&self, stereo: Option<&StereoEvidence>, rig: &StereoRig) -> Vec<f64> {
        let (nearest, farthest) = (self.settings.nearest_m, self.settings.farthest_m);
        let mut depths: Vec<f64> = log_spaced(nearest, farthest, EVEN_POINTS).collect();
        if let Some(stereo) = stereo {
            // The centre lies up to a few metres behind the surface; the grid need not be exact.
            let close = stereo
                .likely(LIKELY, STRIDE)
                .map(|disparity_px| rig.depth_m(disparity_px) + 0.8)
                .filter(|z_m| (nearest..farthest).contains(z_m));
            depths.extend(close);
        }
        depths.sort_by(f64::total_cmp);
        depths.dedup_by(|a, b| *a - *b < 1e-5 * *b);
        depths
    }
}

/// Boxes of vehicles that are before a target and overlap it: those that reach lower.
fn nearer(target: &Target, targets: &[Target]) -> Vec<PixelBox> {
    let own = target.filled();
    let least = own.y_max + 0.02 * own.height() + 1.0;
    targets
        .iter()
        .map(Target::filled)
        .filter(|other| other.y_max > least && own.intersection(other).is_valid())
        .collect()
}

#[cfg(test)]
mod tests;
