//! A camera matrix and a baseline in two lines, for rectified images.
//!
//! ```text
//! 754.6 0.0 489.3 0.0 754.6 265.8 0.0 0.0 1.0
//! 0.063
//! ```
//!
//! Line 1: nine numbers, the matrix row by row, pixels; line 2: the distance between the cameras,
//! metres. As people give it to `FoundationStereo` and others. Both cameras are the same.

use super::entries::{Matrix, number};
use super::format::Format;
use super::{HALF_PIXEL, LoadOptions};
use crate::error::{Error, Result};
use crate::geometry::CalibrationParts;

const REMEDY: &str = "write two lines: the nine numbers of the camera matrix row by row, and the \
                      distance between the cameras in metres";

/// Two lines.
pub(super) struct TwoLines;

impl Format for TwoLines {
    fn name(&self) -> &'static str {
        "two lines"
    }

    fn sign(&self) -> &'static str {
        "nine numbers of the camera matrix and the baseline"
    }

    fn matches(&self, text: &str) -> bool {
        let first = text
            .lines()
            .map(str::trim)
            .find(|line| !line.is_empty() && !line.starts_with('#'));
        let word = first.and_then(|line| {
            line.split([' ', ',', '\t', '['])
                .find(|word| !word.is_empty())
        });
        word.is_some_and(|word| word.parse::<f64>().is_ok())
    }

    fn parse(&self, texts: &[&str], options: &LoadOptions) -> Result<CalibrationParts> {
        let text = texts.first().copied().unwrap_or_default();
        parse(text, options.baseline_m)
    }
}

fn parse(text: &str, baseline_m: Option<f64>) -> Result<CalibrationParts> {
    let lines: Vec<(usize, Vec<f64>)> = (1..)
        .zip(text.lines())
        .map(|(line_number, line)| (line_number, line.split('#').next().unwrap_or_default()))
        .filter(|(_, line)| !line.trim().is_empty())
        .map(|(line_number, line)| {
            let words = line.split([' ', ',', ';', '\t', '[', ']']);
            let numbers = words
                .filter(|word| !word.is_empty())
                .map(|word| number(word, &format!("line {line_number}")))
                .collect::<Result<_>>()?;
            Ok((line_number, numbers))
        })
        .collect::<Result<_>>()?;
    let wrong =
        |line: usize, problem: String| Err(Error::value(format!("line {line}"), problem, REMEDY));
    let (matrix, baseline) = match &lines[..] {
        [(_, matrix), (_, baseline)] => (matrix, Some(baseline)),
        [(_, matrix)] => (matrix, None),
        // The matrix in three lines, as it is printed.
        [(_, a), (_, b), (_, c), rest @ ..] if a.len() == 3 && rest.len() <= 1 => (
            &[&a[..], b, c].concat(),
            rest.first().map(|(_, baseline)| baseline),
        ),
        _ => {
            return wrong(
                lines.get(2).map_or(1, |(line, _)| *line),
                format!("there are {} lines with numbers", lines.len()),
            );
        }
    };
    if matrix.len() != 9 {
        return wrong(
            lines.first().map_or(1, |(line, _)| *line),
            format!("has {} numbers, not the 9 of a camera matrix", matrix.len()),
        );
    }
    let last = lines.last().map_or(1, |(line, _)| *line);
    let baseline_m = match (baseline.map(Vec::as_slice), baseline_m) {
        (_, Some(given)) => given,
        (Some([own]), None) => *own,
        (Some(other), None) => {
            return wrong(
                last,
                format!("has {} numbers, not one baseline", other.len()),
            );
        }
        (None, None) => {
            return Err(Error::value(
                format!("line {}", last + 1),
                "the baseline is missing",
                "write the distance between the cameras in metres there, or give --calib-baseline",
            ));
        }
    };
    let matrix = Matrix {
        rows: 3,
        columns: 3,
        values: matrix.clone(),
    };
    let intrinsics = matrix.intrinsics("camera matrix", HALF_PIXEL)?;
    Ok(CalibrationParts::rectified(
        None,
        [intrinsics; 2],
        baseline_m,
    ))
}
