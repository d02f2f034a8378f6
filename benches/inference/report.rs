//! Timing, and the cases that were timed.

use std::fmt::Write as _;
use std::hint::black_box;
use std::time::{Duration, Instant};

use burn::tensor::{Device, Tensor};
use twinsight::{Error, Result};

/// How long and how often a case runs at least.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    pub time: Duration,
    pub runs: usize,
}

impl Effort {
    /// For networks and whole pairs.
    pub const WHOLE: Self = Self {
        time: Duration::from_secs(2),
        runs: 5,
    };
    /// For one of many small cases.
    pub const BRIEF: Self = Self {
        time: Duration::from_millis(60),
        runs: 5,
    };
    /// For cases that take seconds.
    pub const FEW: Self = Self {
        time: Duration::from_millis(500),
        runs: 2,
    };
    /// For cases that take seconds and hardly vary.
    pub const ONCE: Self = Self {
        time: Duration::ZERO,
        runs: 1,
    };
}

/// The runs of one case.
#[derive(Debug, Clone, Copy)]
pub struct Timing {
    pub runs: usize,
    pub least_ms: f64,
    pub median_ms: f64,
}

/// Runs a case repeatedly; the first run, which allocates, does not count.
pub fn measure(effort: Effort, mut work: impl FnMut() -> Result<()>) -> Result<Timing> {
    work()?;
    let mut times_ms = Vec::new();
    let started = Instant::now();
    while times_ms.len() < effort.runs || started.elapsed() < effort.time {
        let run = Instant::now();
        work()?;
        times_ms.push(milliseconds(run.elapsed()));
    }
    times_ms.sort_by(f64::total_cmp);
    Ok(Timing {
        runs: times_ms.len(),
        least_ms: times_ms[0],
        median_ms: times_ms[times_ms.len() / 2],
    })
}

pub fn milliseconds(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

/// Ends a run of a small result: those of a graphics card are not there before they are read.
pub fn read<const D: usize>(tensor: Tensor<D>) {
    black_box(tensor.into_data());
}

/// Ends a run of a large result, which is only waited for.
pub fn wait<const D: usize>(tensor: Tensor<D>, device: &Device) -> Result<()> {
    black_box(tensor);
    device.sync().map_err(|source| {
        Error::device(
            format!("{device:?}"),
            source.to_string(),
            "try another device",
        )
    })
}

/// Every case in the order in which it was measured.
#[derive(Debug, Default)]
pub struct Report {
    lines: String,
}

impl Report {
    /// Notes a case.
    pub fn add(&mut self, case: &str, milliseconds: f64) {
        // Writing to a string cannot fail.
        writeln!(self.lines, "{case}\t{milliseconds:.3}").ok();
    }

    /// Prints the heading of [`Report::print`].
    pub fn print_heading() {
        println!(
            "{:<32} {:>5} {:>12} {:>12}",
            "case", "runs", "minimum ms", "median ms"
        );
    }

    /// Notes and prints a case.
    pub fn print(&mut self, case: &str, timing: Timing) {
        let Timing {
            runs,
            least_ms,
            median_ms,
        } = timing;
        println!("{case:<32} {runs:>5} {least_ms:>12.2} {median_ms:>12.2}");
        self.add(case, least_ms);
    }

    /// Lines `case<TAB>milliseconds`.
    pub fn lines(&self) -> &str {
        &self.lines
    }
}
