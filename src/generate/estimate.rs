//! How long a run will take and how much disk it will fill, from its first frame.

use std::time::Duration;

use super::write::Target;
use crate::error::{Error, Result};

/// What one frame cost.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// Preparing its scene, on one thread while the others render.
    pub scene: Duration,
    /// Rendering and writing it, on all threads.
    pub frame: Duration,
    /// Its files.
    pub bytes: u64,
}

/// What is left to do.
#[derive(Debug, Clone, Copy)]
pub(super) struct Work {
    pub scenes: usize,
    pub frames: usize,
    pub threads: usize,
}

/// The estimate in words.
///
/// # Errors
/// Less free disk than the frames will need.
pub(super) fn announce(sample: Sample, work: Work, target: &Target) -> Result<String> {
    let seconds = sample.frame.as_secs_f64() * work.frames as f64
        + sample.scene.as_secs_f64() * work.scenes as f64 / work.threads.max(1) as f64;
    let bytes = sample.bytes.saturating_mul(work.frames as u64);
    let free = fs4::available_space(target.root()).ok();
    if let Some(free) = free.filter(|&free| free < bytes) {
        return Err(Error::dataset(
            target.root(),
            format!(
                "needs about {} more for {} frames, but only {} are free",
                size(bytes),
                work.frames,
                size(free)
            ),
            "free some space, ask for fewer or smaller frames, or choose a folder on another disk; \
             what is there is kept",
        ));
    }
    let free = free.map_or_else(String::new, |free| format!(" of {} free", size(free)));
    Ok(format!(
        "{} frames to go: about {} on {} threads, and {}{free}",
        work.frames,
        span(seconds),
        work.threads,
        size(bytes),
    ))
}

/// A number of bytes with its unit.
fn size(bytes: u64) -> String {
    let bytes = bytes as f64;
    if bytes < 1e9 {
        format!("{:.0} MB", bytes / 1e6)
    } else {
        format!("{:.1} GB", bytes / 1e9)
    }
}

/// A time with its unit.
fn span(seconds: f64) -> String {
    if seconds < 90.0 {
        format!("{seconds:.0} seconds")
    } else if seconds < 5400.0 {
        format!("{:.0} minutes", seconds / 60.0)
    } else {
        format!("{:.1} hours", seconds / 3600.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_unit_that_people_would_choose() {
        assert_eq!(
            [size(590_000_000), size(57_300_000_000)],
            ["590 MB", "57.3 GB"]
        );
        assert_eq!(
            [span(20.4), span(200.0), span(18_000.0)],
            ["20 seconds", "3 minutes", "5.0 hours"]
        );
    }
}
