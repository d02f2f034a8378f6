//! The network: five blocks of linear convolutions, pooled by maximum and by average.

use burn::config::Config;
use burn::module::{Module, Param};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};

use super::compose_convolutions;
use crate::dataset::CompositeSize;
use crate::error::Result;
use crate::kernels::{self, Activation, ConvGeometry, PackedConv, TwinInput};
use crate::nn::{Conv, ConvConfig, Dense, DenseConfig};

/// Channels through the convolutions of each block, its input first (paper, section 5.1).
pub const BLOCK_CHANNELS: [&[usize]; 5] = [
    &[3, 32, 32, 32],
    &[32, 25, 25, 25],
    &[25, 18, 18],
    &[18, 10, 10],
    &[10, 5, 5],
];

const HIDDEN: [usize; 2] = [128, 64];

/// Bounds of the initial weights that keep the signal's variance through a linear convolution and
/// through a layer behind ReLU. With smaller ones twelve convolutions in a row leave the network
/// blind to its input, and training stands still for hundreds of steps.
const LINEAR_GAIN: f64 = 1.732_050_8;
const RELU_GAIN: f64 = 2.449_489_7;

/// Settings of a [`RangingNetwork`].
#[derive(Config, Debug)]
pub struct RangingConfig {
    /// Height of the composite, pixels.
    pub height: usize,
    /// Width of the composite, pixels.
    pub width: usize,
    /// Numbers in the geometry vector: normalised box width and height, and what is measured
    /// besides.
    #[config(default = 2)]
    pub geometry: usize,
}

/// The twin-branch network (paper, section 5; twelve convolutions as listed in 5.1).
#[derive(Module, Debug)]
pub struct RangingNetwork {
    /// 3x3 convolutions of each block, shared by both pathways.
    pub blocks: Vec<Vec<Conv>>,
    /// All features to 128.
    pub fc1: Dense,
    /// 128 to 64.
    pub fc2: Dense,
    /// 64 features and the geometry vector to metres.
    pub out: Dense,
    /// The first block merged into one convolution and packed, with its bias; only for inference.
    #[module(skip)]
    first_block: Option<(PackedConv, Tensor<1>)>,
}

/// What the network computes on the way to its result.
#[derive(Debug, Clone)]
pub struct RangingFeatures {
    /// Output of each block after pooling and ReLU, `[2 batch, ..]`: pathway A (maximum), then B
    /// (average).
    pub blocks: Vec<Tensor<4>>,
    /// Flattened features, A then B, `[batch, features]`.
    pub flat: Tensor<2>,
    /// After the first hidden layer, `[batch, 128]`.
    pub fc1: Tensor<2>,
    /// After the second hidden layer, `[batch, 64]`.
    pub fc2: Tensor<2>,
}

impl RangingConfig {
    /// The settings for a composite size.
    pub fn for_size(size: CompositeSize) -> Self {
        Self::new(size.height as usize, size.width as usize)
    }

    /// Features after flattening both pathways.
    pub fn features(&self) -> usize {
        let side = |side: usize| {
            BLOCK_CHANNELS.iter().fold(side, |side, channels| {
                side.saturating_sub(2 * (channels.len() - 1)) / 2
            })
        };
        2 * BLOCK_CHANNELS[4][2] * side(self.height) * side(self.width)
    }

    /// A network with fresh weights.
    ///
    /// # Errors
    /// A composite so small that no feature is left.
    pub fn init(&self, device: &Device) -> Result<RangingNetwork> {
        CompositeSize::new(self.height as u32, self.width as u32)?;
        let blocks = BLOCK_CHANNELS
            .iter()
            .map(|channels| {
                let layers = channels.windows(2).enumerate();
                layers
                    .map(|(layer, pair)| {
                        let after_relu = layer == 0 && pair[0] != 3;
                        let gain = if after_relu { RELU_GAIN } else { LINEAR_GAIN };
                        ConvConfig::new(pair[0], pair[1], 3)
                            .with_gain(gain)
                            .init(device)
                    })
                    .collect()
            })
            .collect();
        Ok(RangingNetwork {
            blocks,
            fc1: DenseConfig::new(self.features(), HIDDEN[0])
                .with_gain(RELU_GAIN)
                .init(device),
            fc2: DenseConfig::new(HIDDEN[0], HIDDEN[1])
                .with_gain(RELU_GAIN)
                .init(device),
            out: DenseConfig::new(HIDDEN[1] + self.geometry, 1).init(device),
            first_block: None,
        })
    }
}

impl RangingNetwork {
    /// Estimates distances.
    ///
    /// # Shapes
    /// - composite: `[batch, 3, height, width]`, right crop on top, normalised
    /// - geometry: `[batch, numbers]`, see [`RangingConfig::geometry`]
    /// - output: `[batch, 1]`, metres of what the [`Readout`](super::Readout) says
    pub fn forward(&self, composite: Tensor<4>, geometry: Tensor<2>) -> Tensor<2> {
        kernels::on_pool(&composite.device(), || {
            self.readout(self.features(composite).fc2, geometry)
        })
    }

    /// The last layer: features and geometry to metres.
    pub fn readout(&self, features: Tensor<2>, geometry: Tensor<2>) -> Tensor<2> {
        self.out.forward(Tensor::cat(vec![features, geometry], 1))
    }

    /// Everything up to the last layer.
    ///
    /// Two exact rearrangements save most of the work. The first block's convolutions are linear
    /// and the same for both pathways, so they run once, merged into one 7x7 convolution. From
    /// then on the pathways' batches are stacked, since they share their weights.
    pub fn features(&self, composite: Tensor<4>) -> RangingFeatures {
        let [batch, ..] = composite.dims();
        let composite = kernels::pixels(composite);
        let mut x = if let Some((packed, bias)) = &self.first_block {
            kernels::conv2d_chain_pool(composite, &[(packed, bias.clone())], TwinInput::Shared)
        } else {
            let (weight, bias) = self.merged_first_block();
            let plain = ConvGeometry::PLAIN;
            let x = kernels::conv2d_act(composite, weight, bias, plain, Activation::None);
            kernels::twin_pool(x, TwinInput::Shared)
        }; // maximum first, then average
        let mut blocks = vec![kernels::planes(x.clone())];
        for block in &self.blocks[1..] {
            let links: Option<Vec<_>> = block.iter().map(Conv::link).collect();
            x = if let Some(links) = links {
                kernels::conv2d_chain_pool(x, &links, TwinInput::Stacked)
            } else {
                let x = block.iter().fold(x, |x, layer| layer.forward(x));
                kernels::twin_pool(x, TwinInput::Stacked)
            };
            blocks.push(kernels::planes(x.clone()));
        }
        let x = kernels::planes(x);
        let [_, channels, height, width] = x.dims();
        let side = channels * height * width;
        let a = x.clone().narrow(0, 0, batch).reshape([batch, side]);
        let b = x.narrow(0, batch, batch).reshape([batch, side]);
        let flat = Tensor::cat(vec![a, b], 1);
        let fc1 = relu(self.fc1.forward(flat.clone()));
        let fc2 = relu(self.fc2.forward(fc1.clone()));
        RangingFeatures {
            blocks,
            flat,
            fc1,
            fc2,
        }
    }

    /// The same function with all weights packed for inference.
    ///
    /// Only the first block's convolutions are merged. Behind them a 3x3 convolution costs 2.25
    /// multiplications a weight and pixel (see [`kernels::winograd`]), which no merged
    /// kernel undercuts: with the average pooling a 3x3 kernel becomes 4x4 at every other pixel,
    /// 4 multiplications.
    pub fn packed(mut self) -> Self {
        let (weight, bias) = self.merged_first_block();
        self.first_block = Some((
            PackedConv::new(weight.detach(), ConvGeometry::PLAIN),
            bias.detach(),
        ));
        self.blocks = self
            .blocks
            .into_iter()
            .map(|block| block.into_iter().map(Conv::packed).collect())
            .collect();
        self
    }

    /// The first block's three 3x3 convolutions as one 7x7 convolution: weight `[32, 3, 7, 7]` and
    /// bias `[32]`.
    pub fn merged_first_block(&self) -> (Tensor<4>, Tensor<1>) {
        let mut layers = self.blocks[0].iter().map(|layer| {
            let bias = layer.bias.as_ref().map(Param::val);
            let bias = bias.unwrap_or_else(|| {
                let weight = layer.weight.val();
                Tensor::zeros([weight.dims()[0]], &weight.device())
            });
            (layer.weight.val(), bias)
        });
        // A block has at least one convolution by construction.
        let first = layers
            .next()
            .unwrap_or_else(|| unreachable!("block without convolutions"));
        layers.fold(first, compose_convolutions)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_composite_leaves_1680_features_and_the_quick_one_60() {
        assert_eq!(RangingConfig::new(828, 414).features(), 1680);
        assert_eq!(RangingConfig::new(340, 170).features(), 60);
    }

    #[test]
    fn a_composite_that_leaves_nothing_is_refused() {
        let error = RangingConfig::new(220, 110)
            .init(&Device::flex())
            .unwrap_err();
        assert!(error.to_string().contains("324x162"), "{error}");
    }
}
