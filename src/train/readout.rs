//! A good start for the distance network's last layer.

use burn::tensor::{Tensor, TensorData};

use crate::ranging::RangingNetwork;

/// Weight of the penalty on standardised coefficients: as if a tenth of each column's variance
/// were noise.
const RIDGE: f64 = 0.1;

/// Sets the last layer to the ridge regression of its wanted output on features and geometry.
///
/// Metres are large numbers, and Adam at its usual rate walks there slowly; from the regression on
/// the untrained features the first steps already pull at the right ends.
///
/// `rows` hold the last layer's inputs of each training vehicle, `weights` how much it counts.
pub fn fit_readout(
    mut network: RangingNetwork,
    rows: &[Vec<f64>],
    outputs: &[f64],
    weights: &[f64],
) -> RangingNetwork {
    if rows.is_empty() {
        return network;
    }
    let (slopes, bias) = regress(rows, outputs, weights);
    network.out.weight = network.out.weight.map(|tensor| {
        let slopes: Vec<f32> = slopes.iter().map(|slope| *slope as f32).collect();
        Tensor::from_data(TensorData::new(slopes, tensor.dims()), &tensor.device())
            .set_require_grad(tensor.is_require_grad())
    });
    network.out.bias = network.out.bias.map(|tensor| {
        Tensor::full([1], bias, &tensor.device()).set_require_grad(tensor.is_require_grad())
    });
    network
}

/// Weighted ridge regression: one slope a column, and the constant.
fn regress(rows: &[Vec<f64>], targets: &[f64], weights: &[f64]) -> (Vec<f64>, f64) {
    let width = rows[0].len();
    let total: f64 = weights.iter().sum();
    let mean = |value: &dyn Fn(usize) -> f64| -> f64 {
        weights
            .iter()
            .enumerate()
            .map(|(row, weight)| weight * value(row))
            .sum::<f64>()
            / total
    };
    let target_mean = mean(&|row| targets[row]);
    let means: Vec<f64> = (0..width)
        .map(|column| mean(&|row| rows[row][column]))
        .collect();
    let spreads: Vec<f64> = (0..width)
        .map(|column| mean(&|row| (rows[row][column] - means[column]).powi(2)).sqrt())
        .collect();
    // Columns that never change, such as features that are never active, get no slope.
    let scale = |column: usize| {
        if spreads[column] > 1e-6 {
            1.0 / spreads[column]
        } else {
            0.0
        }
    };
    let mut matrix = vec![vec![0.0; width + 1]; width];
    for ((row, target), weight) in rows.iter().zip(targets).zip(weights) {
        let values: Vec<f64> = (0..width)
            .map(|column| (row[column] - means[column]) * scale(column))
            .collect();
        for (i, line) in matrix.iter_mut().enumerate() {
            for (j, cell) in line[..width].iter_mut().enumerate() {
                *cell += weight / total * values[i] * values[j];
            }
            line[width] += weight / total * values[i] * (target - target_mean);
        }
    }
    for (i, line) in matrix.iter_mut().enumerate() {
        line[i] += RIDGE;
    }
    let slopes: Vec<f64> = solve(matrix)
        .iter()
        .enumerate()
        .map(|(column, slope)| slope * scale(column))
        .collect();
    let shift: f64 = slopes
        .iter()
        .zip(&means)
        .map(|(slope, mean)| slope * mean)
        .sum();
    (slopes, target_mean - shift)
}

/// Solves a symmetric positive definite system given as lines with the right-hand side last.
fn solve(mut lines: Vec<Vec<f64>>) -> Vec<f64> {
    let count = lines.len();
    for pivot in 0..count {
        let (above, below) = lines.split_at_mut(pivot + 1);
        let lead = &above[pivot];
        for line in below {
            let factor = line[pivot] / lead[pivot];
            for (value, lead) in line[pivot..].iter_mut().zip(&lead[pivot..]) {
                *value -= factor * lead;
            }
        }
    }
    let mut solution = vec![0.0; count];
    for pivot in (0..count).rev() {
        let known: f64 = (pivot + 1..count)
            .map(|i| lines[pivot][i] * solution[i])
            .sum();
        solution[pivot] = (lines[pivot][count] - known) / lines[pivot][pivot];
    }
    solution
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_system_is_solved() {
        let solution = solve(vec![vec![4.0, 1.0, 9.0], vec![1.0, 3.0, 5.0]]);
        assert!((solution[0] - 2.0).abs() < 1e-12 && (solution[1] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_fit_beats_the_mean_and_columns_that_never_change_get_no_slope() {
        let rows: Vec<Vec<f64>> = (0..60)
            .map(|i| vec![f64::from(i) / 60.0, 3.0, f64::from(i % 7)])
            .collect();
        let targets: Vec<f64> = rows
            .iter()
            .map(|row| 10.0 + 40.0 * row[0] + row[2])
            .collect();
        let weights: Vec<f64> = targets.iter().map(|target| target.powi(-2)).collect();
        let (slopes, bias) = regress(&rows, &targets, &weights);
        assert_eq!(slopes[1], 0.0);
        for (row, target) in rows.iter().zip(&targets) {
            let fitted = bias + row.iter().zip(&slopes).map(|(v, s)| v * s).sum::<f64>();
            assert!((fitted - target).abs() < 5.0, "{fitted} {target}");
        }
    }
}
