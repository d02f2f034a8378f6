//! How long a pair takes, from files to metres, stage by stage.

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::dataset::{Frame, StereoDataset};
use crate::error::Result;
use crate::pipeline::StereoRanger;

/// Pairs that are timed.
const PAIRS: usize = 20;

/// Pairs before them, while memory is still being claimed.
const WARM_UP: usize = 2;

/// One stage of the pipeline; a row of `latency.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LatencyRow {
    /// "decode", "detect", "pair", "range" or "all".
    pub stage: String,
    /// Pairs timed, one after the other.
    pub pairs: usize,
    /// Vehicles in them.
    pub vehicles: usize,
    /// Least, milliseconds.
    pub least_ms: f64,
    /// Median, milliseconds.
    pub median_ms: f64,
    /// Mean, milliseconds.
    pub mean_ms: f64,
    /// What 95 % do not exceed, milliseconds.
    pub p95_ms: f64,
}

/// Times pairs one by one as `predict` runs them: the two files are decoded after each other.
///
/// # Errors
/// A device that fails. Frames that cannot be read are left out.
pub(super) fn measure(
    ranger: &StereoRanger,
    dataset: &StereoDataset,
    frames: &[&Frame],
) -> Result<Vec<LatencyRow>> {
    let count = frames.len().min(PAIRS);
    let mut times: [Vec<Duration>; 5] = Default::default();
    let mut vehicles = 0;
    let chosen = (0..count).map(|i| frames[i * frames.len() / count]);
    let warm_up = frames.iter().copied().take(WARM_UP);
    for (i, frame) in warm_up.clone().chain(chosen).enumerate() {
        let started = Instant::now();
        let Ok([left, right]) = frame.load(dataset.rig()) else {
            continue;
        };
        let decode = started.elapsed();
        let (found, stages) = ranger.estimate_timed(&left, &right)?;
        if i < warm_up.len() {
            continue;
        }
        vehicles += found.len();
        let all = decode + stages.detect + stages.pair + stages.range;
        let parts = [decode, stages.detect, stages.pair, stages.range, all];
        for (times, part) in times.iter_mut().zip(parts) {
            times.push(part);
        }
    }
    let names = ["decode", "detect", "pair", "range", "all"];
    let rows = names
        .iter()
        .zip(times)
        .filter(|(_, times)| !times.is_empty());
    Ok(rows
        .map(|(name, times)| row(name, times, vehicles))
        .collect())
}

fn row(stage: &str, mut times: Vec<Duration>, vehicles: usize) -> LatencyRow {
    times.sort();
    let ms = |time: Duration| time.as_secs_f64() * 1e3;
    let sum: Duration = times.iter().sum();
    let last = times.len() - 1;
    LatencyRow {
        stage: stage.to_owned(),
        pairs: times.len(),
        vehicles,
        least_ms: ms(times[0]),
        median_ms: ms(times[times.len() / 2]),
        mean_ms: ms(sum) / times.len() as f64,
        p95_ms: ms(times[(last * 95).div_ceil(100)]),
    }
}
