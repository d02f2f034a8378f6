//! The network: four strided convolutions and a hidden layer.

use burn::config::Config;
use burn::module::Module;
use burn::tensor::activation::silu;
use burn::tensor::{Device, Tensor};

use super::{SIDE_PX, VIEW_CHANNELS, VIEW_NUMBERS};
use crate::kernels;
use crate::nn::{ConvBlock, ConvBlockConfig, Dense, DenseConfig};

/// Channels of the blocks, each of half the height and width of the one before.
const CHANNELS: [usize; 4] = [40, 48, 72, 96];

/// Bound of a layer behind SiLU, as of one behind ReLU.
const ACTIVATED_GAIN: f64 = 2.449_489_7;

/// Settings of a [`SizeNetwork`].
#[derive(Config, Debug)]
pub struct SizeConfig {
    /// Features of the hidden layer.
    #[config(default = 64)]
    pub hidden: usize,
}

/// The size network.
#[derive(Module, Debug)]
pub struct SizeNetwork {
    /// 3x3 convolutions of stride 2.
    pub blocks: Vec<ConvBlock>,
    /// All features of the last block, and the numbers beside the crop.
    pub hidden: Dense,
    /// To the outputs.
    pub out: Dense,
}

/// What the network says.
#[derive(Debug, Clone)]
pub struct SizeOutput {
    /// Mean and logarithm of the standard deviation of the log-size, then of the extent, in standard
    /// deviations of the training vehicles: `[batch, 4]`.
    pub witness: Tensor<2>,
    /// Cosine and sine of the azimuth, sine of the elevation, logarithms of length, width and height,
    /// in standard deviations of the training vehicles: `[batch, 6]`. Learnt beside the witness, which
    /// they explain; nothing reads them.
    pub pose: Tensor<2>,
    /// The hidden features, which the guard judges: `[batch, hidden]`.
    pub features: Tensor<2>,
}

impl SizeConfig {
    /// A network with fresh weights.
    pub fn init(&self, device: &Device) -> SizeNetwork {
        let mut channels = VIEW_CHANNELS;
        let blocks = CHANNELS
            .iter()
            .map(|&out| {
                let block = ConvBlockConfig::new(channels, out)
                    .with_kernel_size(3)
                    .with_stride(2)
                    .init(device);
                channels = out;
                block
            })
            .collect();
        let side = SIDE_PX as usize >> CHANNELS.len();
        let inputs = channels * side * side + VIEW_NUMBERS;
        SizeNetwork {
            blocks,
            hidden: DenseConfig::new(inputs, self.hidden)
                .with_gain(ACTIVATED_GAIN)
                .init(device),
            out: DenseConfig::new(self.hidden, SizeNetwork::WITNESS + SizeNetwork::POSE)
                .init(device),
        }
    }
}

impl SizeNetwork {
    /// Outputs that are the witness.
    pub const WITNESS: usize = 4;
    /// Outputs that say which vehicle it is and from where it is seen.
    pub const POSE: usize = 6;

    /// # Shapes
    /// - crops: `[batch, SIDE_PX, SIDE_PX, VIEW_CHANNELS]`
    /// - numbers: `[batch, VIEW_NUMBERS]`
    pub fn forward(&self, crops: Tensor<4>, numbers: Tensor<2>) -> SizeOutput {
        kernels::on_pool(&crops.device(), || self.forward_here(crops, numbers))
    }

    fn forward_here(&self, crops: Tensor<4>, numbers: Tensor<2>) -> SizeOutput {
        let x = self.blocks.iter().fold(crops, |x, block| block.forward(x));
        let [batch, height, width, channels] = x.dims();
        let flat = x.reshape([batch, height * width * channels]);
        let hidden = silu(self.hidden.forward(Tensor::cat(vec![flat, numbers], 1)));
        let output = self.out.forward(hidden.clone());
        SizeOutput {
            witness: output.clone().narrow(1, 0, Self::WITNESS),
            pose: output.narrow(1, Self::WITNESS, Self::POSE),
            features: hidden,
        }
    }

    /// The same function with its normalisation merged into the convolutions, for inference.
    pub fn folded(mut self) -> Self {
        self.blocks = self.blocks.into_iter().map(ConvBlock::folded).collect();
        self
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Distribution;

    use super::*;

    #[test]
    fn the_folded_network_says_the_same() {
        let device = Device::flex();
        device.seed(5);
        let network = SizeConfig::new().init(&device);
        let crops = Tensor::random([3, 64, 64, 4], Distribution::Normal(0.0, 1.0), &device);
        let numbers = Tensor::random([3, VIEW_NUMBERS], Distribution::Normal(0.0, 1.0), &device);
        let plain = network.forward(crops.clone(), numbers.clone());
        let folded = network.folded().forward(crops, numbers);
        assert_eq!(plain.witness.dims(), [3, 4]);
        assert_eq!(plain.pose.dims(), [3, 6]);
        let difference = (plain.witness - folded.witness).abs().max();
        assert!(difference.into_scalar::<f32>() < 1e-4);
        let difference = (plain.features - folded.features).abs().max();
        assert!(difference.into_scalar::<f32>() < 1e-4);
    }
}
