//! The distance of vehicles as Bayes sees it: box size and stereo pixels as two witnesses, and a
//! learnt one where there is one. Nothing here needs training.
//!
//! For the depth `z` of a vehicle's centre, `p(z) ~ p(box | z) p(pixels | z)` with a prior that is
//! even in `log z`. How bodies look at a depth, [`Body`] says; how alike the right image is at the
//! disparity of a depth, the windows of `stereo`. The surface that stereo sees lies before the
//! centre, and the rig's own disparities may be off: both are part of the likelihood.

mod body;
mod doubt;
mod spline;
mod stereo;

use image::RgbImage;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

pub use body::Body;
use body::{SeenBox, Stance, with_unexplained};
pub use doubt::PairDoubt;
use stereo::{StereoEvidence, stereo_evidence};

use super::{Posterior, SizeWitness};
use crate::dataset::{BoxKind, DatasetInfo};
use crate::geometry::{DisparityCorrection, PixelBox, StereoRig};

/// Relative spread of the boxes of a strange pair: its vehicles may be anything.
const STRANGE_BOX_STD: f64 = 0.3;

/// Points of the grid that are even in the logarithm of the depth.
const EVEN_POINTS: usize = 220;

/// Depths of disparities that are at least this likely are points of the grid, too.
const LIKELY: f64 = 0.02;

/// Steps of the likelihood between those points.
const STRIDE: f64 = 2.0;

/// Nodes and weights of a normal distribution: Gauss-Hermite quadrature with five points.
const NORMAL_NODES: [(f64, f64); 5] = [
    (-2.856_970_013_872_806, 0.011_257_411_327_720_69),
    (-1.355_626_179_974_266, 0.222_075_922_005_612_6),
    (0.0, 0.533_333_333_333_333_3),
    (1.355_626_179_974_266, 0.222_075_922_005_612_6),
    (2.856_970_013_872_806, 0.011_257_411_327_720_69),
];

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
const LEAST_PITCH: f64 = 0.03;

/// A frame's vehicles say which pitch it has only up to this likelihood ratio each: one that is
/// boxed wrongly must not decide.
const LEAST_FIT: f64 = 1e-3;

/// The evidence is raised to this power: windows that see different faces of a vehicle vote for
/// different disparities, and added up they are wider than what is unknown of its centre. Found on
/// the training split of rendered traffic and real pairs, by the coverage of the intervals.
const SHARPNESS: f64 = 1.5;

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

/// Ranges vehicles without any training, see the [module](self).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Ranger {
    settings: RangerSettings,
}

/// A rig, and how far its disparities can be trusted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrustedRig {
    /// The cameras.
    pub rig: StereoRig,
    /// What disparities are too large by, where that was measured.
    pub correction: Option<DisparityCorrection>,
    /// Standard deviation of what all disparities of a frame are off by beside that, pixels.
    pub disparity_std_px: f64,
}

impl TrustedRig {
    /// Standard deviation of the disparities of calibrated cameras that nobody checked, pixels: what
    /// public driving data has.
    pub const UNCHECKED_STD_PX: f64 = 0.5;

    /// Cameras that are calibrated, without a check of how well.
    pub const fn unchecked(rig: StereoRig) -> Self {
        Self {
            rig,
            correction: None,
            disparity_std_px: Self::UNCHECKED_STD_PX,
        }
    }

    /// Rendered images, whose rig is exact.
    pub const fn exact(rig: StereoRig) -> Self {
        Self {
            rig,
            correction: None,
            disparity_std_px: 0.0,
        }
    }

    /// The rig of a dataset: exact where it was rendered, unchecked otherwise.
    pub fn of_dataset(info: &DatasetInfo) -> Self {
        let program = info.made_by.get("program").and_then(toml::Value::as_str);
        if program == Some("twinsight generate") {
            Self::exact(info.rig)
        } else {
            Self::unchecked(info.rig)
        }
    }

    /// Cameras of which it was measured what their disparities are off by: `twinsight calibrate`.
    pub fn corrected(rig: StereoRig, correction: DisparityCorrection) -> Self {
        Self {
            rig,
            disparity_std_px: correction.std_px(),
            correction: Some(correction),
        }
    }

    /// What the disparity of a pixel of the left image is too large by, pixels.
    fn delta_px(&self, pixel: [f64; 2]) -> f64 {
        self.correction
            .as_ref()
            .map_or(0.0, |correction| correction.delta_px(pixel))
    }
}

/// A target with all evidence for it.
struct Witnessed<'a> {
    target: &'a Target,
    seen: Option<SeenBox>,
    bodies: Vec<Body>,
    witness: Option<SizeWitness>,
    stereo: Option<StereoEvidence>,
    /// What its disparities are too large by, pixels.
    delta_px: f64,
    support: f64,
}

impl Witnessed<'_> {
    /// Ways to stand, given the camera's pitches with their weights.
    fn stances(&self, pitches: &[(f64, f64)]) -> Vec<Stance> {
        let (Some(seen), None) = (&self.seen, &self.witness) else {
            return Vec::new();
        };
        let total: f64 = pitches.iter().map(|(_, weight)| weight).sum();
        let mut stances = Vec::new();
        for (pitch, weight) in pitches {
            for mut stance in Stance::all(&self.bodies, *pitch, seen) {
                stance.share *= weight / total;
                stances.push(stance);
            }
        }
        stances
    }

    /// How likely the box is with the centre at a depth, in parts: each a likelihood and how far the
    /// centre then lies behind the surface, metres.
    fn sizes(&self, stances: &[Stance], z_m: f64, add: &mut impl FnMut(f64, f64)) {
        let Some(seen) = &self.seen else {
            add(1.0, 0.0);
            return;
        };
        let Some(witness) = &self.witness else {
            sized(stances, seen, z_m, add);
            return;
        };
        let side = (seen.size[0] * seen.size[1]).sqrt();
        let off = (libm::log(z_m * side) - witness.log_size_mean) / witness.log_size_std;
        let likelihood = with_unexplained(libm::exp(-0.5 * off * off) / witness.log_size_std);
        for (node, weight) in NORMAL_NODES {
            let extent_m = witness.extent_mean_m + node * witness.extent_std_m;
            add(weight * likelihood, extent_m.max(0.0));
        }
    }
}

/// What all disparities of a frame may be off by, as each of its vehicles sees it: vehicles are
/// rulers for each other.
struct Offsets {
    /// Log-evidence of each vehicle for each offset.
    evidence: Vec<Vec<f64>>,
    std_px: f64,
}

/// Offsets that are tried, to both sides of none.
const OFFSETS: usize = 15;

/// They go this many standard deviations far.
const OFFSET_REACH: f64 = 3.0;

/// Depths at which vehicles are rulers.
const RULER_DEPTHS: usize = 160;

impl Offsets {
    fn new(witnessed: &[Witnessed], pitches: &[(f64, f64)], rig: &TrustedRig) -> Self {
        let std_px = rig.disparity_std_px;
        if std_px <= 0.0 {
            return Self {
                evidence: Vec::new(),
                std_px,
            };
        }
        let evidence = witnessed
            .par_iter()
            .map(|witnessed| {
                let (Some(seen), Some(stereo)) = (&witnessed.seen, &witnessed.stereo) else {
                    return vec![0.0; 2 * OFFSETS + 1];
                };
                let stances = witnessed.stances(pitches);
                let depth = |height_m: f64| height_m / seen.size[1];
                let mut sums = [0.0; 2 * OFFSETS + 1];
                for z_m in log_spaced(depth(0.8), depth(6.5), RULER_DEPTHS) {
                    witnessed.sizes(&stances, z_m, &mut |likelihood, extent_m| {
                        let disparity_px = rig.rig.disparity_px((z_m - extent_m).max(0.3));
                        for (i, sum) in sums.iter_mut().enumerate() {
                            *sum += likelihood * stereo.at(disparity_px + offset_px(i, std_px));
                        }
                    });
                }
                sums.map(|sum| libm::log(sum / RULER_DEPTHS as f64 + LEAST_FIT))
                    .to_vec()
            })
            .collect();
        Self { evidence, std_px }
    }

    /// What a vehicle's stereo evidence is when disparities are off by what the other vehicles think.
    fn seen_by_others(&self, which: usize, stereo: &StereoEvidence) -> StereoEvidence {
        if self.std_px <= 0.0 {
            return stereo.clone();
        }
        let others = self.evidence.len().saturating_sub(1);
        let log: Vec<f64> = (0..=2 * OFFSETS)
            .map(|i| {
                let prior = -0.5 * (offset_px(i, self.std_px) / self.std_px).powi(2);
                let evidence: f64 = (0..self.evidence.len())
                    .filter(|other| *other != which)
                    .map(|other| self.evidence[other][i])
                    .sum();
                prior + shared(others) * evidence
            })
            .collect();
        let most = log.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> = log.iter().map(|log| libm::exp(log - most)).collect();
        // On the steps of the evidence. What is measured is too large by the offset.
        let step = stereo.step_px();
        let radius = libm::ceil(OFFSET_REACH * self.std_px / step) as usize;
        let kernel: Vec<f64> = (0..=2 * radius)
            .map(|k| {
                let offset = (k as f64 - radius as f64) * step;
                let place = offset / (OFFSET_REACH * self.std_px) * OFFSETS as f64 + OFFSETS as f64;
                let i = (place.max(0.0) as usize).min(2 * OFFSETS - 1);
                let part = (place - i as f64).clamp(0.0, 1.0);
                weights[i] + part * (weights[i + 1] - weights[i])
            })
            .collect();
        stereo.averaged(&kernel)
    }
}

fn offset_px(i: usize, std_px: f64) -> f64 {
    (i as f64 - OFFSETS as f64) / OFFSETS as f64 * OFFSET_REACH * std_px
}

/// How much each of several rulers counts: they share their prior, and so a part of their error.
fn shared(rulers: usize) -> f64 {
    1.0 / (1.0 + SHARED_ERROR * rulers.saturating_sub(1) as f64)
}

/// Part of the variance of a ruler that all of them share.
const SHARED_ERROR: f64 = 0.25;

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
        let pitches = self.pitches(&witnessed, &rig.rig);
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

    /// The posterior of one vehicle that has the images for itself, see [`Ranger::posteriors`].
    ///
    /// # Panics
    /// Never: there is one posterior for each target.
    pub fn posterior(
        &self,
        images: [&RgbImage; 2],
        target: &Target,
        rig: &TrustedRig,
    ) -> Posterior {
        let (ranged, _) = self.posteriors(images, std::slice::from_ref(target), rig);
        let [ranged] = <[Ranged; 1]>::try_from(ranged).unwrap_or_else(|_| unreachable!());
        ranged.posterior
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
    fn pitches(&self, witnessed: &[Witnessed], rig: &StereoRig) -> Vec<(f64, f64)> {
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
                    .map(|w| self.fit(w, pitch_deg.to_radians(), rig));
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
    fn fit(&self, witnessed: &Witnessed, pitch: f64, rig: &StereoRig) -> f64 {
        let Some(seen) = &witnessed.seen else {
            return 0.0;
        };
        // What is seen is between 0.8 and 6.5 m high.
        let depth = |height_m: f64| height_m / seen.size[1];
        let depths = log_spaced(depth(0.8), depth(6.5), 96);
        let stances = Stance::all(&witnessed.bodies, pitch, seen);
        let mut sum = 0.0;
        for z_m in depths {
            sized(&stances, seen, z_m, &mut |likelihood, extent_m| {
                sum += likelihood * pixels(witnessed.stereo.as_ref(), rig, z_m, extent_m);
            });
        }
        libm::log(sum / 96.0 + LEAST_FIT)
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
            joint.push(SHARPNESS * libm::log(both) - libm::log(z_m));
            of_size.push(libm::log(size / z_m));
            extent.push(way / both);
        }
        let ray = Ray::new(area, rig);
        let distances: Vec<f64> = depths.iter().map(|&z_m| ray.distance_m(z_m)).collect();
        let even = || {
            let log: Vec<f64> = depths.iter().map(|z_m| -libm::log(*z_m)).collect();
            Posterior::new(distances.clone(), &log)
        };
        let of = |log: &[f64]| Posterior::new(distances.clone(), log).or_else(even);
        let (Some(posterior), Some(size)) = (of(&joint), of(&of_size)) else {
            unreachable!("an even density on ascending depths is one");
        };
        let median = posterior.median_m();
        let i = distances.partition_point(|&distance| distance < median);
        let i = i.min(depths.len() - 1);
        let surface_m = (ray.depth_m(median) - extent[i]).max(0.3);
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

/// Likelihoods and extents of all stances for a box at a depth. How wide the box is tells how the
/// vehicle is turned, not how far it is.
fn sized(stances: &[Stance], seen: &SeenBox, z_m: f64, add: &mut impl FnMut(f64, f64)) {
    for of_body in stances.chunks(body::HEADINGS) {
        let mut fits = [[0.0; 2]; body::HEADINGS];
        let mut widths = 1e-9;
        for (fit, stance) in fits.iter_mut().zip(of_body) {
            *fit = stance.fits(seen, z_m);
            fit[0] += 1e-9;
            widths += fit[0];
        }
        for ([width, height], stance) in fits.iter().zip(of_body) {
            let likelihood = width / widths * body::HEADINGS as f64 * height;
            add(stance.share * with_unexplained(likelihood), stance.extent_m);
        }
    }
}

/// Likelihood of the pixels for a centre at a depth, `extent_m` behind the surface.
fn pixels(stereo: Option<&StereoEvidence>, rig: &StereoRig, z_m: f64, extent_m: f64) -> f64 {
    stereo.map_or(1.0, |stereo| {
        stereo.at(rig.disparity_px((z_m - extent_m).max(0.3)))
    })
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

/// The ray through the middle of a box: between depths and distances from the midpoint between the
/// cameras.
struct Ray {
    right: f64,
    down: f64,
    half_baseline_m: f64,
}

impl Ray {
    fn new(area: &PixelBox, rig: &StereoRig) -> Self {
        let [right, down, _] = rig.left.camera_from_pixel(area.center());
        let finite = |value: f64| if value.is_finite() { value } else { 0.0 };
        Self {
            right: finite(right),
            down: finite(down),
            half_baseline_m: 0.5 * rig.baseline_m,
        }
    }

    fn distance_m(&self, z_m: f64) -> f64 {
        let x = self.right * z_m - self.half_baseline_m;
        let y = self.down * z_m;
        (x * x + y * y + z_m * z_m).sqrt()
    }

    /// The inverse of [`Ray::distance_m`].
    fn depth_m(&self, distance_m: f64) -> f64 {
        let ray = 1.0 + self.right * self.right + self.down * self.down;
        let b = self.right * self.half_baseline_m;
        let c = self.half_baseline_m * self.half_baseline_m - distance_m * distance_m;
        (b + (b * b - ray * c).max(0.0).sqrt()) / ray
    }
}

/// Values from the first to the last, even in their logarithm.
fn log_spaced(first: f64, last: f64, count: usize) -> impl Iterator<Item = f64> {
    let step = libm::log(last / first) / (count - 1) as f64;
    (0..count).map(move |i| first * libm::exp(step * i as f64))
}
