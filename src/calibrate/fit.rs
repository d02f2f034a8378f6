//! What feature matches say of a rig: how the right camera is turned against what its calibration
//! says, from the rows that features are off.
//!
//! In normalised coordinates (x, y of the right image, focal lengths from the principal point; d the
//! disparity) a right camera that is turned by small angles, shifted by a little or of another focal
//! length sees every point lower than the left camera by
//!
//! ```text
//! dv = shift + pitch (1 + y²) + roll x + scale y + yaw x y + rise d + advance y d + lens (x² + 3 y²)
//! ```
//!
//! and by the same causes further right by
//!
//! ```text
//! du = unknown + pitch x y - roll y + scale x + yaw x² + 2 lens x y
//! ```
//!
//! No vertical disparity depends on the unknown constant: a camera that looks a little to the side
//! and one whose principal point lies a little aside differ in nothing else. `lens` is half of the
//! decentring that the calibration left; its other half bends rows as a yaw does and disparities
//! half as much again, so where rows show the one the terms of yaw are that much less certain.

use serde::Serialize;

use super::linear::{Cholesky, Matrix, add_outer, dot, form};
use super::matching::FeatureMatch;
use super::spread::{self, Score};
use crate::error::{Error, Result};
use crate::geometry::{DisparityTerms, StereoRig};

/// The parameters, in the order of the module's formula.
const N: usize = 8;
const SHIFT: usize = 0;
const PITCH: usize = 1;
const ROLL: usize = 2;
const SCALE: usize = 3;
const YAW: usize = 4;
const RISE: usize = 5;
const ADVANCE: usize = 6;
const LENS: usize = 7;

/// Standard deviations of the parameters before anything is seen. Angles, scale and rise are wide
/// open. Shift and pitch differ by y² alone, rise and advance by the heights of near things: where
/// images are too flat to tell, cameras turn (shocks, warmth) rather than that their principal points
/// move or one of them stands ahead.
const PRIOR: [f64; N] = [0.0007, 0.05, 0.05, 0.05, 0.05, 0.05, 0.005, 0.002];

/// Standard deviations that the terms of x, y, x² and x y of the error of disparities have beside what
/// rows show, radians. Focal lengths along x that differ otherwise than those along y change no row;
/// KITTI's labels differ by this much there from what its rows say. Lenses bend columns as well.
const UNSEEN: [f64; 4] = [0.0006, 0.0001, 0.0003, 0.0001];

/// What matching finds wrong alike all over one of these parts, pixels: interpolation draws places
/// towards whole pixels. Measured on rendered pairs with known turns.
const BIAS_PX: f64 = 0.015;

/// Fewest matches that a fit is made of.
const LEAST_MATCHES: usize = 100;

/// Parts of the image, along x and y, whose matches share what the model does not know.
const CELLS: [usize; 2] = [8, 4];

/// Fewest of these parts that matches must lie in.
const LEAST_CELLS: usize = 10;

/// Rounds of reweighting: by Huber's weights first, which find the way from anywhere, then by Tukey's,
/// which leave outliers out.
const ROUNDS: usize = 30;

/// From the median of deviations to the standard deviation of a normal distribution.
const SIGMA_OF_MEDIAN: f64 = 1.4826;

/// Less than this is no spread but rounding, radians: a thousandth of a pixel.
const LEAST_SIGMA: f64 = 1e-6;

/// A value and its standard error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard error.
    pub std: f64,
}

impl Estimate {
    fn times(self, factor: f64) -> Self {
        Self {
            value: self.value * factor,
            std: self.std * factor.abs(),
        }
    }
}

/// How well a rig is rectified, by its vertical disparities.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RectificationFit {
    /// How much lower the right image shows the middle of the left one's view: rows, pixels. A camera
    /// that is turned up or down and one whose principal point moved differ only far from the middle.
    pub row_offset_px: Estimate,
    /// The part of it that is taken for a turn of the right camera upwards, degrees.
    pub pitch_deg: Estimate,
    /// Turn of the right camera about its optical axis, counter-clockwise as it looks, degrees: rows
    /// change to the side.
    pub roll_deg: Estimate,
    /// Turn of the right camera to the left, degrees, as far as curved rows show it: disparities
    /// change with the square of the place. The constant that it adds to them cannot be seen.
    pub yaw_deg: Estimate,
    /// How much longer the right camera's focal length is, percent: rows change from top to bottom.
    pub focal_percent: Estimate,
    /// How much higher the right camera stands, percent of the baseline: rows of near things are off.
    pub rise_percent: Estimate,
    /// How much rows bend towards the left and right border, times the squared distance from the
    /// middle in focal lengths, pixels: no turn of a camera does that, but its lens.
    pub bend_px: Estimate,
    /// Standard deviation of the rows that remain, pixels.
    pub sigma_px: f64,
    /// Standard deviation of the rows before the fit, outliers left out, pixels.
    pub sigma_before_px: f64,
    /// The rows that the rig is off by what was found, nineteen of twenty matches are off by less;
    /// pixels.
    pub rows_off_px: f64,
    /// Matches that the fit rests on.
    pub matches: usize,
    /// Matches that were left out as wrong.
    pub outliers: usize,
    /// Pairs that they are of.
    pub frames: usize,
    #[serde(skip)]
    parameters: [f64; N],
    #[serde(skip)]
    covariance: Matrix<N>,
    #[serde(skip)]
    rig: StereoRig,
}

/// A match in normalised coordinates.
struct Row {
    slopes: [f64; N],
    dv: f64,
    frame: u32,
    cell: usize,
}

impl RectificationFit {
    /// Fits matches of rectified images of this rig.
    ///
    /// # Errors
    /// [`Error::Value`] for fewer than 100 matches, or matches in a small part of the image only.
    pub fn new(matches: &[FeatureMatch], rig: &StereoRig) -> Result<Self> {
        let rows: Vec<Row> = matches.iter().map(|m| row(m, rig)).collect();
        let mut cells: Vec<usize> = rows.iter().map(|row| row.cell).collect();
        cells.sort_unstable();
        cells.dedup();
        if rows.len() < LEAST_MATCHES || cells.len() < LEAST_CELLS {
            return Err(Error::value(
                format!(
                    "{} features in {} of {} parts of the image",
                    rows.len(),
                    cells.len(),
                    CELLS[0] * CELLS[1]
                ),
                "are found in both images, too few to say how the cameras stand",
                "give more pairs, with texture all over the image: streets, trees, no fog, no blur",
            ));
        }
        let (parameters, weights, sigma) = robust(&rows)?;
        let bias = BIAS_PX / rig.left.focal_y_px;
        let covariance = covariance(&rows, &weights, (&parameters, sigma), bias)?;
        let used = weights.iter().filter(|weight| **weight > 0.0).count();
        let mut frames: Vec<u32> = rows.iter().map(|row| row.frame).collect();
        frames.sort_unstable();
        frames.dedup();
        let focal_px = rig.left.focal_y_px;
        let kept = |value: &dyn Fn(&Row) -> f64| -> Vec<f64> {
            let pairs = rows.iter().zip(&weights);
            let kept = pairs.filter(|(_, weight)| **weight > 0.0);
            kept.map(|(row, _)| value(row).abs()).collect()
        };
        let mut off = kept(&|row| dot(&row.slopes, &parameters));
        off.sort_unstable_by(f64::total_cmp);
        let before = SIGMA_OF_MEDIAN * median(&mut kept(&|row| row.dv));
        let of = |index: usize, factor: f64| {
            Estimate {
                value: parameters[index],
                std: covariance[index][index].sqrt(),
            }
            .times(factor)
        };
        let mut middle = [0.0; N];
        (middle[SHIFT], middle[PITCH]) = (1.0, 1.0);
        let degrees = 1.0_f64.to_degrees();
        Ok(Self {
            row_offset_px: Estimate {
                value: dot(&middle, &parameters) * focal_px,
                std: form(&covariance, &middle, &middle).sqrt() * focal_px,
            },
            pitch_deg: of(PITCH, degrees),
            roll_deg: of(ROLL, degrees),
            yaw_deg: of(YAW, degrees),
            focal_percent: of(SCALE, 100.0),
            rise_percent: of(RISE, 100.0),
            bend_px: of(LENS, focal_px),
            sigma_px: sigma * focal_px,
            sigma_before_px: before * focal_px,
            rows_off_px: off.get(off.len() * 19 / 20).copied().unwrap_or_default() * focal_px,
            matches: used,
            outliers: rows.len() - used,
            frames: frames.len(),
            parameters,
            covariance,
            rig: *rig,
        })
    }

    /// How many rows lower than in the left image the rig's right image shows a match, less what was
    /// found: what remains; pixels.
    pub fn residual_px(&self, of: &FeatureMatch) -> f64 {
        let row = row(of, &self.rig);
        (row.dv - dot(&row.slopes, &self.parameters)) * self.rig.left.focal_y_px
    }

    /// The same before anything is subtracted.
    pub fn rows_px(&self, of: &FeatureMatch) -> f64 {
        row(of, &self.rig).dv * self.rig.left.focal_y_px
    }

    /// What vertical disparities show of the error of disparities: everything but its constant, which
    /// is 0, with the standard deviation given.
    pub fn shape(&self, constant_std_px: f64) -> DisparityTerms {
        let focal_px = self.rig.left.focal_x_px;
        // What is seen too far right in the right image has too small a disparity.
        let [x_px, y_px, xx_px, xy_px] =
            SHAPE.map(|slopes| -focal_px * dot(&slopes, &self.parameters));
        DisparityTerms {
            focal_px,
            constant_px: 0.0,
            constant_std_px,
            x_px,
            y_px,
            xx_px,
            xy_px,
            shape_std_px: spread_over_image(&self.shape_covariance(), &self.rig),
        }
    }

    /// The covariance of the terms of x, y, x² and x y of [`RectificationFit::shape`], square pixels.
    pub(super) fn shape_covariance(&self) -> Matrix<4> {
        let focal_px = self.rig.left.focal_x_px;
        let mut covariance = SHAPE.map(|a| SHAPE.map(|b| form(&self.covariance, &a, &b)));
        let mut unseen = UNSEEN;
        // The half of the decentring that rows show is as large as the one that they do not.
        unseen[2] = unseen[2].hypot(self.parameters[LENS]);
        for (i, unseen) in unseen.iter().enumerate() {
            covariance[i][i] += unseen * unseen;
        }
        covariance.map(|row| row.map(|value| value * focal_px * focal_px))
    }

    /// The rotation vector of the right camera against the rectified axes that rows show, radians:
    /// pitch and roll. Yaw shows in rows as well, but its larger effect, on disparities, would be
    /// guessed from the smaller one.
    pub(super) fn turn(&self) -> [f64; 3] {
        let [shift, pitch, roll] = [SHIFT, PITCH, ROLL].map(|i| self.parameters[i]);
        [-(shift + pitch), 0.0, roll]
    }

    /// How much higher the right camera stands, parts of the baseline.
    pub(super) fn rise(&self) -> f64 {
        self.parameters[RISE]
    }
}

/// How the terms of x, y, x² and x y of the right image's horizontal error come from the parameters.
const SHAPE: [[f64; N]; 4] = {
    let mut slopes = [[0.0; N]; 4];
    slopes[0][SCALE] = 1.0;
    slopes[1][ROLL] = -1.0;
    slopes[2][YAW] = 1.0;
    slopes[3][PITCH] = 1.0;
    slopes[3][LENS] = 2.0;
    slopes
};

/// The values of x, y, x² and x y at a pixel of the left image.
pub(super) fn shape_slopes(pixel: [f64; 2], rig: &StereoRig) -> [f64; 4] {
    let [x, y, _] = rig.left.camera_from_pixel(pixel);
    [x, y, x * x, x * y]
}

/// Root mean square over the image of the standard deviation of a sum of terms.
pub(super) fn spread_over_image(covariance: &Matrix<4>, rig: &StereoRig) -> f64 {
    const POINTS: u32 = 16;
    let mut sum = 0.0;
    for row in 0..POINTS {
        for column in 0..POINTS {
            let part = |i: u32| (f64::from(i) + 0.5) / f64::from(POINTS);
            let pixel = [
                part(column) * f64::from(rig.left.width),
                part(row) * f64::from(rig.left.height),
            ];
            let slopes = shape_slopes(pixel, rig);
            sum += form(covariance, &slopes, &slopes);
        }
    }
    (sum / f64::from(POINTS * POINTS)).sqrt()
}

fn row(of: &FeatureMatch, rig: &StereoRig) -> Row {
    let [left_x, left_y, _] = rig.left.camera_from_pixel(of.left);
    let [x, right_y, _] = rig.right.camera_from_pixel(of.right);
    let (y, d) = (left_y, left_x - x);
    let mut slopes = [0.0; N];
    slopes[SHIFT] = 1.0;
    slopes[PITCH] = 1.0 + y * y;
    slopes[ROLL] = x;
    slopes[SCALE] = y;
    slopes[YAW] = x * y;
    slopes[RISE] = d;
    slopes[ADVANCE] = y * d;
    slopes[LENS] = x * x + 3.0 * y * y;
    let cell = |pixel: f64, side: u32, cells: usize| {
        ((pixel / f64::from(side) * cells as f64) as usize).min(cells - 1)
    };
    Row {
        slopes,
        dv: right_y - left_y,
        frame: of.frame,
        cell: cell(of.left[1], rig.left.height, CELLS[1]) * CELLS[0]
            + cell(of.left[0], rig.left.width, CELLS[0]),
    }
}

/// Parameters, weights of the rows and standard deviation of what remains, by iteratively reweighted
/// least squares.
fn robust(rows: &[Row]) -> Result<([f64; N], Vec<f64>, f64)> {
    let mut values: Vec<f64> = rows.iter().map(|row| row.dv).collect();
    let mut parameters = [0.0; N];
    parameters[PITCH] = median(&mut values);
    let mut weights = vec![1.0; rows.len()];
    let mut sigma = LEAST_SIGMA;
    for round in 0..ROUNDS {
        let residuals: Vec<f64> = rows
            .iter()
            .map(|row| row.dv - dot(&row.slopes, &parameters))
            .collect();
        let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
        sigma = (SIGMA_OF_MEDIAN * median(&mut sizes)).max(LEAST_SIGMA);
        for (weight, residual) in weights.iter_mut().zip(&residuals) {
            let size = residual.abs() / sigma;
            *weight = if round < ROUNDS / 2 {
                1.0 / size.max(1.5) * 1.5
            } else {
                let part = (size / 4.685).min(1.0);
                (1.0 - part * part) * (1.0 - part * part)
            };
        }
        parameters = solve(rows, &weights, sigma)?.0;
    }
    Ok((parameters, weights, sigma))
}

/// Weighted least squares with the prior: parameters and the information that they rest on.
fn solve(rows: &[Row], weights: &[f64], sigma: f64) -> Result<([f64; N], Cholesky<N>)> {
    let mut information = prior();
    let mut right = [0.0; N];
    for (row, weight) in rows.iter().zip(weights) {
        let weight = weight / (sigma * sigma);
        add_outer(&mut information, &row.slopes, weight);
        for (right, slope) in right.iter_mut().zip(&row.slopes) {
            *right += weight * slope * row.dv;
        }
    }
    let cholesky = Cholesky::new(&information).ok_or_else(unsolvable)?;
    Ok((cholesky.solve(&right), cholesky))
}

fn prior() -> Matrix<N> {
    let mut information = [[0.0; N]; N];
    for (i, spread) in PRIOR.iter().enumerate() {
        information[i][i] = 1.0 / (spread * spread);
    }
    information
}

fn unsolvable() -> Error {
    Error::value(
        "features",
        "their places are not finite numbers, or all the same",
        "give pairs of a textured scene",
    )
}

fn covariance(
    rows: &[Row],
    weights: &[f64],
    (parameters, sigma): (&[f64; N], f64),
    bias: f64,
) -> Result<Matrix<N>> {
    let (_, cholesky) = solve(rows, weights, sigma)?;
    let pairs = rows.iter().zip(weights);
    let scores: Vec<Score<N>> = pairs
        .map(|(row, weight)| {
            let residual = row.dv - dot(&row.slopes, parameters);
            let weight = weight / (sigma * sigma);
            Score {
                score: row.slopes.map(|slope| weight * slope * residual),
                bias: row.slopes.map(|slope| weight * slope * bias),
                frame: row.frame,
                cell: row.cell,
            }
        })
        .collect();
    Ok(spread::covariance(&scores, &cholesky.inverse(), &prior()))
}

/// The median; 0 of nothing.
fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
