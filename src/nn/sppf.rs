//! Spatial pyramid pooling, fast form.

use burn::config::Config;
use burn::module::Module;
use burn::nn::PaddingConfig2d;
use burn::nn::pool::{MaxPool2d, MaxPool2dConfig};
use burn::tensor::{Device, Tensor};

use super::{ConvBlock, ConvBlockConfig};

/// Settings of an [`Sppf`].
#[derive(Config, Debug)]
pub struct SppfConfig {
    channels_in: usize,
    channels_out: usize,
}

/// Three 5x5 maximum pools in sequence, all four stages concatenated.
#[derive(Module, Debug)]
pub struct Sppf {
    /// 1x1 to half the input's channels.
    pub cv1: ConvBlock,
    /// 1x1 over the four stages.
    pub cv2: ConvBlock,
    pool: MaxPool2d,
}

impl SppfConfig {
    /// A block with fresh weights.
    pub fn init(&self, device: &Device) -> Sppf {
        let hidden = self.channels_in / 2;
        Sppf {
            cv1: ConvBlockConfig::new(self.channels_in, hidden).init(device),
            cv2: ConvBlockConfig::new(4 * hidden, self.channels_out).init(device),
            // The padding is minus infinity: SiLU's outputs can be negative.
            pool: MaxPool2dConfig::new([5, 5])
                .with_strides([1, 1])
                .with_padding(PaddingConfig2d::Explicit(2, 2, 2, 2))
                .init(),
        }
    }
}

impl Sppf {
    /// # Shapes
    /// - input: `[batch, channels_in, height, width]`
    /// - output: `[batch, channels_out, height, width]`
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let mut stages = vec![self.cv1.forward(input)];
        for stage in 0..3 {
            stages.push(self.pool.forward(stages[stage].clone()));
        }
        self.cv2.forward(Tensor::cat(stages, 1))
    }

    /// Batch normalisation merged, for inference.
    pub fn folded(self) -> Self {
        Self {
            cv1: self.cv1.folded(),
            cv2: self.cv2.folded(),
            pool: self.pool,
        }
    }
}
