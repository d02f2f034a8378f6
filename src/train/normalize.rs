//! Data-dependent first weights for the distance network.

use burn::module::Param;
use burn::tensor::Tensor;
use burn::tensor::activation::relu;

use crate::kernels::{self, TwinInput};
use crate::nn::{Conv, Dense};
use crate::ranging::RangingNetwork;

/// Least spread of a channel that is still scaled up.
const LEAST_SPREAD: f64 = 1e-6;

/// Scales and shifts every layer so that its outputs on the given composites have mean zero and
/// variance one, channel by channel and layer by layer (after Mishkin and Matas, "All you need is a
/// good init", 2016).
///
/// Twelve convolutions without normalisation between them otherwise leave features that are nearly
/// the same for every image: the constant parts add up through the pools, the informative parts
/// do not.
pub fn normalize_layers(mut network: RangingNetwork, composites: Tensor<4>) -> RangingNetwork {
    let [batch, ..] = composites.dims();
    let mut x = kernels::pixels(composites);
    let blocks = std::mem::take(&mut network.blocks);
    for (index, block) in blocks.into_iter().enumerate() {
        let mut layers = Vec::with_capacity(block.len());
        for layer in block {
            let (layer, output) = normalize_conv(layer, x);
            layers.push(layer);
            x = output;
        }
        network.blocks.push(layers);
        let input = if index == 0 {
            TwinInput::Shared
        } else {
            TwinInput::Stacked
        };
        x = kernels::twin_pool(x, input);
    }
    let x = kernels::planes(x);
    let [_, channels, height, width] = x.dims();
    let half = |start: usize| {
        x.clone()
            .narrow(0, start, batch)
            .reshape([batch, channels * height * width])
    };
    let flat = Tensor::cat(vec![half(0), half(batch)], 1);
    let (fc1, output) = normalize_dense(network.fc1, flat);
    let (fc2, _) = normalize_dense(network.fc2, relu(output));
    network.fc1 = fc1;
    network.fc2 = fc2;
    network
}

/// Normalises a convolution's channels; also returns its new output.
fn normalize_conv(mut layer: Conv, input: Tensor<4>) -> (Conv, Tensor<4>) {
    let output = layer.forward(input);
    let [batch, height, width, channels] = output.dims();
    let rows = output
        .clone()
        .reshape([batch * height * width, channels])
        .swap_dims(0, 1);
    let (mean, factor) = moments(rows, 1);
    layer.weight = scaled(layer.weight, factor.clone().reshape([channels, 1, 1, 1]));
    layer.bias = layer
        .bias
        .map(|bias| shifted(bias, mean.clone(), factor.clone()));
    let shape = [1, 1, 1, channels];
    (
        layer,
        (output - mean.reshape(shape)) * factor.reshape(shape),
    )
}

/// Normalises a fully connected layer's outputs; also returns them.
fn normalize_dense(mut layer: Dense, input: Tensor<2>) -> (Dense, Tensor<2>) {
    let output = layer.forward(input);
    let [_, outputs] = output.dims();
    let (mean, factor) = moments(output.clone().swap_dims(0, 1), 1);
    layer.weight = scaled(layer.weight, factor.clone().reshape([outputs, 1]));
    layer.bias = shifted(layer.bias, mean.clone(), factor.clone());
    (layer, (output - mean.unsqueeze()) * factor.unsqueeze())
}

/// Mean of each row and the factor that brings its variance to one.
fn moments(rows: Tensor<2>, axis: usize) -> (Tensor<1>, Tensor<1>) {
    let [count, _] = rows.dims();
    let mean = rows.clone().mean_dim(axis);
    let variance = (rows - mean.clone()).square().mean_dim(axis);
    let factor = variance.sqrt().clamp_min(LEAST_SPREAD).recip();
    (mean.reshape([count]), factor.reshape([count]))
}

fn scaled<const D: usize>(param: Param<Tensor<D>>, factor: Tensor<D>) -> Param<Tensor<D>> {
    param.map(|tensor| tensor * factor)
}

fn shifted(param: Param<Tensor<1>>, mean: Tensor<1>, factor: Tensor<1>) -> Param<Tensor<1>> {
    param.map(|tensor| (tensor - mean) * factor)
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, Distribution};

    use super::*;
    use crate::ranging::RangingConfig;

    #[test]
    fn hidden_features_of_the_same_composites_vary_by_one_around_zero_before_their_activation() {
        let device = Device::flex();
        device.seed(3);
        let network = RangingConfig::new(340, 170).init(&device).unwrap();
        let composites = Tensor::random([6, 3, 340, 170], Distribution::Normal(0.0, 1.0), &device);
        let network = normalize_layers(network, composites.clone());
        let features = network.features(composites);
        let outputs = network.fc2.forward(features.fc1); // [batch, features]
        let (mean, factor) = moments(outputs.swap_dims(0, 1), 1);
        assert!(mean.abs().max().into_scalar::<f32>() < 1e-2);
        assert!((factor - 1.0).abs().max().into_scalar::<f32>() < 1e-2);
    }
}
