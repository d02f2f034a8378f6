//! Least squares that wrong matches do not move, with honest standard errors.

use super::linear::{Cholesky, Matrix, add_outer, dot};
use super::spread::{Score, covariance};

/// Rounds of reweighting: by Huber's weights first, which find the way from anywhere, then by Tukey's,
/// which leave outliers out.
const ROUNDS: usize = 30;

/// Standard deviations from which on Huber's weights sink, and at which Tukey's reach 0.
const BOUNDS: [f64; 2] = [1.5, 4.685];

/// From the median of sizes to the standard deviation of a normal distribution.
pub(super) const SIGMA_OF_MEDIAN: f64 = 1.4826;

/// Less than this is no spread but rounding, radians: a thousandth of a pixel.
const LEAST_SIGMA: f64 = 1e-6;

/// An observation: a value that should be the sum of the parameters times these slopes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row<const N: usize> {
    pub slopes: [f64; N],
    pub value: f64,
    /// Its frame and the part of the image that it lies in: what shares them shares errors.
    pub frame: u32,
    pub cell: usize,
}

impl<const N: usize> Row<N> {
    /// What parameters leave of it.
    pub fn residual(&self, parameters: &[f64; N]) -> f64 {
        self.value - dot(&self.slopes, parameters)
    }
}

/// Parameters and how well they are known.
#[derive(Debug, Clone)]
pub(super) struct Solution<const N: usize> {
    pub parameters: [f64; N],
    pub covariance: Matrix<N>,
    /// For each row, 0 for those that are left out to 1.
    pub weights: Vec<f64>,
    /// Standard deviation of what remains of the rows, by its median: outliers hardly count.
    pub sigma: f64,
}

/// Solves for parameters that are 0 within standard deviations `prior` before anything is seen,
/// starting at `start`. `bias` is the error that all rows of one part of the image may share in all
/// frames. None where rows are no finite numbers.
pub(super) fn solve<const N: usize>(
    rows: &[Row<N>],
    prior: &[f64; N],
    start: [f64; N],
    bias: f64,
) -> Option<Solution<N>> {
    let mut prior_information = [[0.0; N]; N];
    for (i, spread) in prior.iter().enumerate() {
        prior_information[i][i] = 1.0 / (spread * spread);
    }
    let mut parameters = start;
    let mut weights = vec![1.0; rows.len()];
    let mut sigma = LEAST_SIGMA;
    let mut bread = prior_information;
    for round in 0..ROUNDS {
        let residuals = rows.iter().map(|row| row.residual(&parameters));
        let sizes: Vec<f64> = residuals.map(f64::abs).collect();
        sigma = (SIGMA_OF_MEDIAN * median(&mut sizes.clone())).max(LEAST_SIGMA);
        for (weight, size) in weights.iter_mut().zip(&sizes) {
            *weight = weight_of(size / sigma, 2 * round < ROUNDS);
        }
        let mut information = prior_information;
        let mut right = [0.0; N];
        for (row, weight) in rows.iter().zip(&weights) {
            let weight = weight / (sigma * sigma);
            add_outer(&mut information, &row.slopes, weight);
            for (right, slope) in right.iter_mut().zip(&row.slopes) {
                *right += weight * slope * row.value;
            }
        }
        let cholesky = Cholesky::new(&information)?;
        parameters = cholesky.solve(&right);
        bread = cholesky.inverse();
    }
    let pairs = rows.iter().zip(&weights);
    let scores: Vec<Score<N>> = pairs
        .map(|(row, weight)| {
            let residual = row.residual(&parameters);
            let weight = weight / (sigma * sigma);
            Score {
                own: row.slopes.map(|slope| weight * slope * residual),
                bias: row.slopes.map(|slope| weight * slope * bias),
                frame: row.frame,
                cell: row.cell,
            }
        })
        .collect();
    Some(Solution {
        parameters,
        covariance: covariance(&scores, &bread, &prior_information),
        weights,
        sigma,
    })
}

/// The weight of a residual, in standard deviations.
fn weight_of(size: f64, is_early: bool) -> f64 {
    let [huber, tukey] = BOUNDS;
    if is_early {
        return huber / size.max(huber);
    }
    let part = (size / tukey).min(1.0);
    let rest = 1.0 - part * part;
    rest * rest
}

/// The median; 0 of nothing.
pub(super) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line 0.5 + 2 x through points of 12 frames and 8 parts of the image, with even scatter; what
    /// is added depends on a point's number, frame and part.
    fn line(added: impl Fn(usize, u32, usize) -> f64) -> Vec<Row<2>> {
        (0..960)
            .map(|i| {
                let (frame, cell) = ((i / 80) as u32, i % 8);
                let x = cell as f64 / 8.0 + (i % 7) as f64 / 80.0;
                let scatter = ((i * 37 % 101) as f64 / 100.0 - 0.5) * 0.03;
                Row {
                    slopes: [1.0, x],
                    value: 0.5 + 2.0 * x + scatter + added(i, frame, cell),
                    frame,
                    cell,
                }
            })
            .collect()
    }

    fn solved(rows: &[Row<2>]) -> Solution<2> {
        solve(rows, &[100.0; 2], [0.0; 2], 0.0).unwrap()
    }

    fn std(solution: &Solution<2>) -> [f64; 2] {
        [0, 1].map(|i| solution.covariance[i][i].sqrt())
    }

    #[test]
    fn a_third_of_outliers_does_not_move_the_line() {
        let solution = solved(&line(|i, _, _| {
            if i % 3 == 0 {
                0.3 + (i % 50) as f64 / 20.0
            } else {
                0.0
            }
        }));
        let [a, b] = solution.parameters;
        assert!((a - 0.5).abs() < 0.005 && (b - 2.0).abs() < 0.01, "{a} {b}");
        let left_out = solution.weights.iter().filter(|w| **w == 0.0).count();
        assert_eq!(left_out, 320);
        assert!(
            (0.008..0.02).contains(&solution.sigma),
            "{}",
            solution.sigma
        );
    }

    #[test]
    fn errors_that_frames_or_parts_share_make_standard_errors_larger() {
        let random = |i: u64| ((i * 7919 + 13) % 1009) as f64 / 1009.0 - 0.5;
        let alone = std(&solved(&line(|_, _, _| 0.0)));
        let by_frame = std(&solved(&line(|_, frame, _| {
            0.05 * random(u64::from(frame))
        })));
        let by_part = std(&solved(&line(|_, _, cell| 0.05 * random(cell as u64 + 70))));
        assert!(alone[0] < 0.001, "{alone:?}");
        // Twelve frames, each off by a seventieth.
        assert!((0.002..0.008).contains(&by_frame[0]), "{by_frame:?}");
        assert!(by_part[0] > 4.0 * alone[0], "{by_part:?} {alone:?}");
        let biased = solve(&line(|_, _, _| 0.0), &[100.0; 2], [0.0; 2], 0.01).unwrap();
        assert!(
            (0.003..0.02).contains(&std(&biased)[0]),
            "{:?}",
            std(&biased)
        );
    }

    #[test]
    fn a_prior_decides_what_rows_leave_open() {
        // One place alone: only the sum of both parameters shows.
        let mut rows = line(|_, _, _| 0.0);
        for row in &mut rows {
            row.slopes = [1.0, 1.0];
            row.value = 3.0;
        }
        let solution = solve(&rows, &[0.1, 10.0], [0.0; 2], 0.0).unwrap();
        let [a, b] = solution.parameters;
        assert!((a + b - 3.0).abs() < 1e-6 && a.abs() < 0.01, "{a} {b}");
        assert!(std(&solution)[0] > 0.09, "{:?}", std(&solution));
    }

    #[test]
    fn rows_that_are_no_numbers_have_no_solution() {
        let rows = line(|_, _, _| f64::NAN);
        assert!(solve(&rows, &[1.0; 2], [0.0; 2], 0.0).is_none_or(|s| s.parameters[0].is_nan()));
        let mut rows = line(|_, _, _| 0.0);
        rows[5].slopes[0] = f64::INFINITY;
        assert!(solve(&rows, &[1.0; 2], [0.0; 2], 0.0).is_none());
    }
}
