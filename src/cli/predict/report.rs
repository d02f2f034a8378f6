//! What is said at the end of a prediction of many frames.

use std::time::Duration;

use twinsight::predict::PredictSummary;
use twinsight::{Error, Result};

use super::super::stderr;

/// Shows failed frames with their reasons and, unless it should be quiet, counts and times.
pub fn show(summary: &PredictSummary, quiet: bool) {
    for (frame, reason) in &summary.reasons {
        stderr::line(&format!("failed: {frame}: {reason}"));
    }
    let untold = summary.failed - summary.reasons.len() as u64;
    if untold > 0 {
        stderr::line(&format!(
            "failed: {untold} more; see the lines with \"error\""
        ));
    }
    if !quiet {
        stderr::line(&counts(summary));
        stderr::line(&times(summary));
    }
}

fn counts(summary: &PredictSummary) -> String {
    let used = summary.frames - summary.failed;
    let some = |count: u64, before: &str, what: &str| {
        if count == 0 {
            return String::new();
        }
        format!("{before}{count} {what}")
    };
    format!(
        "{used} of {} frames measured: {} vehicles, {} frames without any{}{}",
        summary.frames,
        summary.vehicles,
        summary.empty,
        some(
            summary.without_distance,
            ", ",
            "vehicles without a distance"
        ),
        some(summary.failed, "; ", "frames failed"),
    )
}

fn times(summary: &PredictSummary) -> String {
    let used = summary.frames - summary.failed;
    let secs = summary.elapsed.as_secs_f64();
    let rate = if secs > 0.0 { used as f64 / secs } else { 0.0 };
    let each = |time: Duration| time.as_secs_f64() * 1e3 / used.max(1) as f64;
    format!(
        "{secs:.1} s, {rate:.1} frames/s ({:.1} images/s); mean of a frame, ms: detect {:.1}, \
         pair {:.1}, distance {:.1}, write {:.1}; beside them read and decode {:.1}",
        2.0 * rate,
        each(summary.stages.detect),
        each(summary.stages.pair),
        each(summary.stages.range),
        each(summary.write),
        each(summary.read),
    )
}

/// Whether that counts as done.
pub fn verdict(summary: &PredictSummary, strict: bool) -> Result<()> {
    let (frames, failed) = (summary.frames, summary.failed);
    let first = summary.reasons.first().map(|(frame, _)| frame.as_str());
    if frames == 0 {
        return Err(Error::value(
            "input",
            "has no frames",
            "check what was given",
        ));
    }
    if failed == frames {
        return Err(Error::value(
            format!("{frames} frames"),
            "could not be used, not a single one",
            format!(
                "see the reasons above, first that of frame {}",
                first.unwrap_or_default()
            ),
        ));
    }
    if strict && failed > 0 {
        return Err(Error::value(
            format!("{failed} of {frames} frames"),
            "could not be used, and --strict allows none; the results of the others are kept",
            "see the reasons above",
        ));
    }
    Ok(())
}
