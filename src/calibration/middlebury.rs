//! Middlebury's and ETH3D's `calib.txt`, of rectified pairs.
//!
//! ```text
//! cam0=[3979.911 0 1244.772; 0 3979.911 1019.507; 0 0 1]
//! cam1=[3979.911 0 1369.115; 0 3979.911 1019.507; 0 0 1]
//! doffs=124.343
//! baseline=193.001           millimetres
//! width=2964
//! height=1988
//! ```

use super::entries::{Matrix, number};
use super::format::Format;
use super::{HALF_PIXEL, LoadOptions};
use crate::error::{Error, Result};
use crate::geometry::CalibrationParts;

const REMEDY: &str = "copy the file again from the dataset";

/// Middlebury's file.
pub(super) struct Middlebury;

impl Format for Middlebury {
    fn name(&self) -> &'static str {
        "Middlebury"
    }

    fn sign(&self) -> &'static str {
        "cam0=[f 0 cx; 0 f cy; 0 0 1], baseline= in mm"
    }

    fn matches(&self, text: &str) -> bool {
        text.lines().any(|line| value_of(line, "cam0").is_some())
    }

    fn parse(&self, texts: &[&str], _options: &LoadOptions) -> Result<CalibrationParts> {
        let text = texts.first().copied().unwrap_or_default();
        let left = required(text, "cam0", 9)?;
        let mut right = match values(text, "cam1")? {
            Some(_) => required(text, "cam1", 9)?,
            None => left.clone(),
        };
        if values(text, "cam1")?.is_none() {
            // The principal points differ by this.
            right[2] += required(text, "doffs", 1)?[0];
        }
        let intrinsics = |name: &str, values: &[f64]| {
            let matrix = Matrix {
                rows: 3,
                columns: 3,
                values: values.to_vec(),
            };
            matrix.intrinsics(name, HALF_PIXEL)
        };
        let size = match (values(text, "width")?, values(text, "height")?) {
            (Some(width), Some(height)) => {
                Some([whole(&width, "width")?, whole(&height, "height")?])
            }
            _ => None,
        };
        Ok(CalibrationParts::rectified(
            size,
            [intrinsics("cam0", &left)?, intrinsics("cam1", &right)?],
            required(text, "baseline", 1)?[0] / 1000.0,
        ))
    }
}

/// What stands behind a name and its `=`.
fn value_of<'a>(line: &'a str, name: &str) -> Option<&'a str> {
    let rest = line.trim().strip_prefix(name)?.trim_start();
    rest.strip_prefix('=')
}

/// The numbers behind a name; none where it is not there.
fn values(text: &str, name: &str) -> Result<Option<Vec<f64>>> {
    let Some(value) = text.lines().find_map(|line| value_of(line, name)) else {
        return Ok(None);
    };
    value
        .split([' ', '[', ']', ';', ',', '\t'])
        .filter(|word| !word.is_empty())
        .map(|word| number(word, name))
        .collect::<Result<_>>()
        .map(Some)
}

fn required(text: &str, name: &str, count: usize) -> Result<Vec<f64>> {
    match values(text, name)? {
        Some(values) if values.len() == count => Ok(values),
        Some(values) => Err(Error::value(
            name,
            format!("has {} numbers, not {count}", values.len()),
            REMEDY,
        )),
        None => Err(Error::value(name, "is missing", REMEDY)),
    }
}

fn whole(values: &[f64], name: &str) -> Result<u32> {
    match values {
        [value] if value.fract() == 0.0 && (1.0..=32_768.0).contains(value) => Ok(*value as u32),
        _ => Err(Error::value(
            format!("{name} = {values:?}"),
            "is no size of an image",
            REMEDY,
        )),
    }
}
