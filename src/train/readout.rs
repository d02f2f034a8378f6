//! A good start for the distance network's last layer.

use burn::tensor::{Tensor, TensorData};

use crate::ranging::RangingNetwork;

/// Weight of the penalty on the standardised coefficients: decides between box width and height,
/// which say the same for square boxes, and hardly changes the fit.
const RIDGE: f64 = 1e-3;

/// A training vehicle as the last layer sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadoutSample {
    /// Normalised box width and height.
    pub geometry: [f64; 2],
    /// What the last layer makes of the image's features alone, without bias.
    pub from_features: f64,
    /// True distance, metres.
    pub distance_m: f64,
}

/// Sets the last layer's bias and geometry weights to the regression of what the image's features
/// leave unexplained on the box size. The features' own weights stay as they are: fitted to
/// untrained features they would be huge, and the first steps would blow the network up.
///
/// Each vehicle is weighted by the inverse square of its distance, as the loss's relative term
/// does.
pub fn fit_readout(mut network: RangingNetwork, samples: &[ReadoutSample]) -> RangingNetwork {
    if samples.is_empty() {
        return network;
    }
    let (slopes, bias) = regress(samples);
    network.out.weight = network.out.weight.map(|tensor| {
        let [_, inputs] = tensor.dims();
        let features = tensor.clone().narrow(1, 0, inputs - 2);
        let slopes = TensorData::new(slopes.map(|slope| slope as f32).to_vec(), [1, 2]);
        let slopes = Tensor::from_data(slopes, &tensor.device());
        Tensor::cat(vec![features, slopes], 1)
            .detach()
            .set_require_grad(tensor.is_require_grad())
    });
    network.out.bias = network.out.bias.map(|tensor| {
        Tensor::full([1], bias, &tensor.device()).set_require_grad(tensor.is_require_grad())
    });
    network
}

/// Weighted ridge regression: slopes of both box sides and the constant.
fn regress(samples: &[ReadoutSample]) -> ([f64; 2], f64) {
    let total: f64 = samples
        .iter()
        .map(|sample| sample.distance_m.powi(-2))
        .sum();
    let mean = |value: &dyn Fn(&ReadoutSample) -> f64| -> f64 {
        samples
            .iter()
            .map(|sample| value(sample) * sample.distance_m.powi(-2))
            .sum::<f64>()
            / total
    };
    let rest = |sample: &ReadoutSample| sample.distance_m - sample.from_features;
    let rest_mean = mean(&rest);
    let means = [0, 1].map(|side| mean(&|sample| sample.geometry[side]));
    let spreads = [0, 1].map(|side| {
        mean(&|sample| (sample.geometry[side] - means[side]).powi(2))
            .sqrt()
            .max(1e-9)
    });
    let standard =
        |sample: &ReadoutSample, side: usize| (sample.geometry[side] - means[side]) / spreads[side];
    let product = |a: usize, b: usize| mean(&|sample| standard(sample, a) * standard(sample, b));
    let (aa, ab, bb) = (product(0, 0) + RIDGE, product(0, 1), product(1, 1) + RIDGE);
    let [a, b] =
        [0, 1].map(|side| mean(&|sample| standard(sample, side) * (rest(sample) - rest_mean)));
    let determinant = aa * bb - ab * ab;
    let slopes = [
        (bb * a - ab * b) / determinant / spreads[0],
        (aa * b - ab * a) / determinant / spreads[1],
    ];
    (
        slopes,
        rest_mean - slopes[0] * means[0] - slopes[1] * means[1],
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_law_is_found_even_when_width_and_height_say_the_same() {
        let samples: Vec<ReadoutSample> = (1..50)
            .map(|step| {
                let width = f64::from(step) / 500.0;
                let from_features = f64::from(step % 7);
                ReadoutSample {
                    geometry: [width, width * 16.0 / 9.0],
                    from_features,
                    distance_m: 60.0 - 300.0 * width + from_features,
                }
            })
            .collect();
        let (slopes, bias) = regress(&samples);
        for sample in &samples {
            let [width, height] = sample.geometry;
            let fitted = bias + slopes[0] * width + slopes[1] * height + sample.from_features;
            assert!(
                (fitted - sample.distance_m).abs() < 0.1,
                "{fitted} {sample:?}"
            );
        }
    }
}
