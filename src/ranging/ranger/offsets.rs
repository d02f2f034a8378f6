//! What all disparities of a frame are off by, as its vehicles tell.

use rayon::prelude::*;

use super::TrustedRig;
use super::stereo::StereoEvidence;
use super::witnessed::Witnessed;

/// A vehicle says how well something fits only up to this likelihood ratio: one that is boxed wrongly
/// must not decide for others.
const LEAST_FIT: f64 = 1e-3;

/// The logarithm of a vehicle's evidence.
pub(super) fn log_fit(evidence: f64) -> f64 {
    libm::log(evidence + LEAST_FIT)
}

/// What all disparities of a frame may be off by, as each of its vehicles sees it: vehicles are
/// rulers for each other.
pub(super) struct Offsets {
    /// Log-evidence of each vehicle for each offset.
    evidence: Vec<Vec<f64>>,
    std_px: f64,
}

/// Offsets that are tried, to both sides of none.
const OFFSETS: usize = 15;

/// All of them.
const TRIED: usize = 2 * OFFSETS + 1;

/// They go this many standard deviations far.
const OFFSET_REACH: f64 = 3.0;

impl Offsets {
    pub fn new(witnessed: &[Witnessed], pitches: &[(f64, f64)], rig: &TrustedRig) -> Self {
        let std_px = rig.disparity_std_px;
        if std_px <= 0.0 {
            return Self {
                evidence: Vec::new(),
                std_px,
            };
        }
        let offsets_px: Vec<f64> = (0..TRIED).map(|i| offset_px(i, std_px)).collect();
        let evidence = witnessed
            .par_iter()
            .map(|witnessed| {
                let stances = witnessed.stances(pitches);
                let evidence = witnessed.evidence(&stances, &rig.rig, &offsets_px);
                evidence.map_or_else(
                    || vec![0.0; TRIED],
                    |sums| sums.into_iter().map(log_fit).collect(),
                )
            })
            .collect();
        Self { evidence, std_px }
    }

    /// What a vehicle's stereo evidence is when disparities are off by what the other vehicles think.
    pub fn seen_by_others(&self, which: usize, stereo: &StereoEvidence) -> StereoEvidence {
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
pub(super) fn shared(rulers: usize) -> f64 {
    1.0 / (1.0 + SHARED_ERROR * rulers.saturating_sub(1) as f64)
}

/// Part of the variance of a ruler that all of them share.
const SHARED_ERROR: f64 = 0.25;
