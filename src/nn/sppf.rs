//! Spatial pyramid pooling, fast form.

use burn::config::Config;
use burn::module::Module;
use burn::tensor::{Device, Tensor};

use super::{ConvBlock, ConvBlockConfig};
use crate::kernels;

/// Side of the pooled windows.
const POOL_SIZE: usize = 5;

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
}

impl SppfConfig {
    /// A block with fresh weights.
    pub fn init(&self, device: &Device) -> Sppf {
        let hidden = self.channels_in / 2;
        Sppf {
            cv1: ConvBlockConfig::new(self.channels_in, hidden).init(device),
            cv2: ConvBlockConfig::new(4 * hidden, self.channels_out).init(device),
        }
    }
}

impl Sppf {
    /// # Shapes
    /// - input: `[batch, height, width, channels_in]`
    /// - output: `[batch, height, width, channels_out]`
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let mut stages = vec![self.cv1.forward(input)];
        for stage in 0..3 {
            stages.push(kernels::local_maximum(stages[stage].clone(), POOL_SIZE));
        }
        self.cv2.forward_joined(stages, None)
    }

    /// Batch normalisation merged, for inference.
    pub fn folded(self) -> Self {
        Self {
            cv1: self.cv1.folded(),
            cv2: self.cv2.folded(),
        }
    }
}
