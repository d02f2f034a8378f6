//! A good start for the distance network's last layer.

use burn::module::Param;
use burn::tensor::{Tensor, TensorData};

use crate::ranging::RangingNetwork;

/// Weight of the penalty on standardised coefficients, per training vehicle.
const RIDGE: f64 = 0.02;

/// Sets the last layer to the ridge regression of distance on features and geometry, each vehicle
/// weighted by the inverse square of its distance, as the loss's relative term does.
///
/// `features` are rows of `[features.., norm_w, norm_h]`.
pub fn fit_readout(
    mut network: RangingNetwork,
    features: &[Vec<f64>],
    distances_m: &[f64],
) -> RangingNetwork {
    let Some(width) = features.first().map(Vec::len) else {
        return network;
    };
    let weights: Vec<f64> = distances_m
        .iter()
        .map(|distance| distance.powi(-2))
        .collect();
    let total: f64 = weights.iter().sum();
    let weighted = |values: &dyn Fn(usize) -> f64| -> f64 {
        weights
            .iter()
            .enumerate()
            .map(|(row, weight)| weight * values(row))
            .sum::<f64>()
            / total
    };
    let target_mean = weighted(&|row| distances_m[row]);
    let means: Vec<f64> = (0..width)
        .map(|column| weighted(&|row| features[row][column]))
        .collect();
    let deviations: Vec<f64> = (0..width)
        .map(|column| weighted(&|row| (features[row][column] - means[column]).powi(2)).sqrt())
        .collect();
    // Constant columns (features that are never active) get no weight.
    let standard = |row: usize, column: usize| {
        let deviation = deviations[column];
        if deviation > 1e-9 {
            (features[row][column] - means[column]) / deviation
        } else {
            0.0
        }
    };
    let mut matrix = vec![vec![0.0; width + 1]; width];
    for (row, weight) in weights.iter().enumerate() {
        let weight = weight / total;
        let values: Vec<f64> = (0..width).map(|column| standard(row, column)).collect();
        for i in 0..width {
            for j in 0..width {
                matrix[i][j] += weight * values[i] * values[j];
            }
            matrix[i][width] += weight * values[i] * (distances_m[row] - target_mean);
        }
    }
    for (i, row) in matrix.iter_mut().enumerate() {
        row[i] += RIDGE;
    }
    let solution = solve(matrix);
    let slopes: Vec<f64> = solution
        .iter()
        .zip(&deviations)
        .map(|(value, deviation)| {
            if *deviation > 1e-9 {
                value / deviation
            } else {
                0.0
            }
        })
        .collect();
    let shift: f64 = slopes
        .iter()
        .zip(&means)
        .map(|(slope, mean)| slope * mean)
        .sum();
    let replace = |values: Vec<f32>| {
        move |tensor: Tensor<1>| {
            Tensor::from_data(TensorData::new(values, tensor.dims()), &tensor.device())
                .set_require_grad(tensor.is_require_grad())
        }
    };
    let slopes: Vec<f32> = slopes.into_iter().map(|slope| slope as f32).collect();
    let weight: Param<Tensor<2>> = network.out.weight.clone();
    network.out.weight = weight.map(|tensor| {
        Tensor::from_data(TensorData::new(slopes, tensor.dims()), &tensor.device())
            .set_require_grad(tensor.is_require_grad())
    });
    network.out.bias = network
        .out
        .bias
        .map(replace(vec![(target_mean - shift) as f32]));
    network
}

/// Solves a symmetric positive definite system given as rows with the right-hand side last.
fn solve(mut rows: Vec<Vec<f64>>) -> Vec<f64> {
    let count = rows.len();
    for pivot in 0..count {
        let (above, below) = rows.split_at_mut(pivot + 1);
        let lead = &above[pivot];
        for row in below {
            let factor = row[pivot] / lead[pivot];
            for (value, lead) in row[pivot..].iter_mut().zip(&lead[pivot..]) {
                *value -= factor * lead;
            }
        }
    }
    let mut solution = vec![0.0; count];
    for pivot in (0..count).rev() {
        let known: f64 = (pivot + 1..count)
            .map(|i| rows[pivot][i] * solution[i])
            .sum();
        solution[pivot] = (rows[pivot][count] - known) / rows[pivot][pivot];
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
}
