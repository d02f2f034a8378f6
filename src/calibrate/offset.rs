//! The error of disparities from known distances: its constant, and as much of its shape as they say.

use super::fit::{RectificationFit, shape_slopes, spread_over_image};
use super::linear::{Cholesky, Matrix, add_outer, dot};
use super::reading::Reading;
use crate::error::{Error, Result};
use crate::geometry::{DisparityTerms, StereoRig};

/// Constant, then the terms of x, y, x² and x y.
const N: usize = 5;

/// Standard deviation of the constant before anything is measured, pixels.
const CONSTANT_STD_PX: f64 = 3.0;

/// Deviations beyond this many standard deviations count less (Huber).
const FAR: f64 = 1.5;

/// Standard deviation of a normal distribution over its median absolute deviation.
const MEDIAN_TO_STD: f64 = 1.4826;

/// Rounds of reweighting.
const ROUNDS: usize = 20;

/// A reading that is off by more than this, in standard deviations, is worth a word.
const WORTH_A_WORD: f64 = 4.0;

/// The correction that known distances give, and what they say of it.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownOffset {
    /// Constant and shape.
    pub terms: DisparityTerms,
    /// Root mean square of what the readings are off by after the correction, doubtful ones left out,
    /// pixels.
    pub rms_px: f64,
    /// For each reading, what it is off by after the correction, pixels.
    pub residuals_px: Vec<f64>,
    /// Readings, by their place in the list, that are off by so much that their row may be wrong.
    pub doubtful: Vec<usize>,
}

/// Solves for the constant of the correction, and for its other terms as far as the readings say
/// more of them than the rows of feature matches do.
///
/// # Errors
/// [`Error::Value`] without readings, or for ones that no correction of a calibrated rig explains.
pub fn offset_from_readings(
    readings: &[Reading],
    fit: &RectificationFit,
    rig: &StereoRig,
) -> Result<KnownOffset> {
    if readings.is_empty() {
        return Err(Error::value(
            "known distances",
            "none of their disparities could be measured",
            "give places with texture that both images show",
        ));
    }
    let shape = fit.shape(0.0);
    let before = [0.0, shape.x_px, shape.y_px, shape.xx_px, shape.xy_px];
    let information = prior(fit)?;
    let mut inflation = 1.0;
    let mut values = before;
    let mut covariance = [[0.0; N]; N];
    for _ in 0..ROUNDS {
        let residuals = residuals(readings, &values, rig);
        let mut matrix = information;
        let mut right = [0.0; N];
        for (reading, residual) in readings.iter().zip(&residuals) {
            let off = residual.abs() / (reading.std_px * inflation);
            let weight = FAR / off.max(FAR);
            let slopes = slopes(reading, rig);
            let scaled = weight / (reading.std_px * inflation).powi(2);
            add_outer(&mut matrix, &slopes, scaled);
            // As seen from the shape that is expected.
            let target = residual + dot(&slopes, &difference(&values, &before));
            for (right, slope) in right.iter_mut().zip(&slopes) {
                *right += scaled * slope * target;
            }
        }
        let cholesky = Cholesky::new(&matrix).ok_or_else(|| {
            Error::value(
                "known distances",
                "their disparities are no numbers",
                "give places with texture that both images show",
            )
        })?;
        let step = cholesky.solve(&right);
        values = std::array::from_fn(|i| before[i] + step[i]);
        covariance = cholesky.inverse();
        // Distances that scatter more than they should are known less well than they say: most of them,
        // not the few that are of something else.
        let mut off: Vec<f64> = readings
            .iter()
            .zip(&residuals)
            .map(|(reading, residual)| (residual / reading.std_px).abs())
            .collect();
        off.sort_by(f64::total_cmp);
        inflation = if off.len() > 1 {
            (MEDIAN_TO_STD * off[off.len() / 2]).max(1.0)
        } else {
            1.0
        };
    }
    let residuals = residuals(readings, &values, rig);
    let doubtful: Vec<usize> = readings
        .iter()
        .zip(&residuals)
        .enumerate()
        .filter(|(_, (reading, residual))| residual.abs() > WORTH_A_WORD * reading.std_px)
        .map(|(index, _)| index)
        .collect();
    let trusted = residuals.iter().enumerate();
    let squares: Vec<f64> = trusted
        .filter(|(index, _)| !doubtful.contains(index))
        .map(|(_, residual)| residual * residual)
        .collect();
    let rms_px = (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt();
    let of_shape = std::array::from_fn(|i| std::array::from_fn(|j| covariance[i + 1][j + 1]));
    let [constant_px, x_px, y_px, xx_px, xy_px] = values;
    let terms = DisparityTerms {
        focal_px: rig.left.focal_x_px,
        constant_px,
        constant_std_px: covariance[0][0].sqrt(),
        x_px,
        y_px,
        xx_px,
        xy_px,
        shape_std_px: spread_over_image(&of_shape, rig),
    };
    terms.check()?;
    Ok(KnownOffset {
        terms,
        rms_px,
        residuals_px: residuals,
        doubtful,
    })
}

/// What is known before: the constant hardly, the shape as rows show it.
fn prior(fit: &RectificationFit) -> Result<Matrix<N>> {
    let inverse = Cholesky::new(&fit.shape_covariance())
        .ok_or_else(|| {
            Error::value(
                "rectification",
                "its errors are no numbers",
                "give pairs of a textured scene",
            )
        })?
        .inverse();
    let mut information = [[0.0; N]; N];
    information[0][0] = 1.0 / (CONSTANT_STD_PX * CONSTANT_STD_PX);
    for (i, row) in inverse.iter().enumerate() {
        information[i + 1][1..].copy_from_slice(row);
    }
    Ok(information)
}

fn slopes(reading: &Reading, rig: &StereoRig) -> [f64; N] {
    let [x, y, xx, xy] = shape_slopes(reading.pixel, rig);
    [1.0, x, y, xx, xy]
}

/// What the readings are off by with these terms, pixels.
fn residuals(readings: &[Reading], values: &[f64; N], rig: &StereoRig) -> Vec<f64> {
    let residual = |reading: &Reading| {
        reading.measured_px - reading.expected_px - dot(&slopes(reading, rig), values)
    };
    readings.iter().map(residual).collect()
}

fn difference(a: &[f64; N], b: &[f64; N]) -> [f64; N] {
    std::array::from_fn(|i| a[i] - b[i])
}
