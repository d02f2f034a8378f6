//! The residual bottleneck, and the C3k block of two of them.

use burn::config::Config;
use burn::module::Module;
use burn::tensor::{Device, Tensor};

use super::{ConvBlock, ConvBlockConfig};

/// Settings of a [`Bottleneck`].
#[derive(Config, Debug)]
pub struct BottleneckConfig {
    channels: usize,
    hidden: usize,
}

/// `x + cv2(cv1(x))`, both 3x3.
#[derive(Module, Debug)]
pub struct Bottleneck {
    /// 3x3, channels to hidden.
    pub cv1: ConvBlock,
    /// 3x3, hidden to channels.
    pub cv2: ConvBlock,
}

impl BottleneckConfig {
    /// A bottleneck with fresh weights.
    pub fn init(&self, device: &Device) -> Bottleneck {
        let conv = |channels_in, channels_out| {
            ConvBlockConfig::new(channels_in, channels_out)
                .with_kernel_size(3)
                .init(device)
        };
        Bottleneck {
            cv1: conv(self.channels, self.hidden),
            cv2: conv(self.hidden, self.channels),
        }
    }
}

impl Bottleneck {
    /// # Shapes
    /// - input and output: `[batch, height, width, channels]`
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let hidden = self.cv1.forward(input.clone());
        self.cv2.forward_joined(vec![hidden], Some(input))
    }

    /// Batch normalisation merged, for inference.
    pub fn folded(self) -> Self {
        Self {
            cv1: self.cv1.folded(),
            cv2: self.cv2.folded(),
        }
    }
}

/// Settings of a [`C3k`].
#[derive(Config, Debug)]
pub struct C3kConfig {
    channels: usize,
}

/// `cv3(cat[m(cv1(x)), cv2(x)])` with two bottlenecks `m`.
#[derive(Module, Debug)]
pub struct C3k {
    /// 1x1 to half the channels, before the bottlenecks.
    pub cv1: ConvBlock,
    /// 1x1 to half the channels, past them.
    pub cv2: ConvBlock,
    /// 1x1 over both.
    pub cv3: ConvBlock,
    /// The bottlenecks, in sequence.
    pub m: Vec<Bottleneck>,
}

impl C3kConfig {
    /// A block with fresh weights.
    pub fn init(&self, device: &Device) -> C3k {
        let hidden = self.channels / 2;
        C3k {
            cv1: ConvBlockConfig::new(self.channels, hidden).init(device),
            cv2: ConvBlockConfig::new(self.channels, hidden).init(device),
            cv3: ConvBlockConfig::new(2 * hidden, self.channels).init(device),
            m: (0..2)
                .map(|_| BottleneckConfig::new(hidden, hidden).init(device))
                .collect(),
        }
    }
}

impl C3k {
    /// # Shapes
    /// - input and output: `[batch, height, width, channels]`
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let deep = self
            .m
            .iter()
            .fold(self.cv1.forward(input.clone()), |x, m| m.forward(x));
        let past = self.cv2.forward(input);
        self.cv3.forward_joined(vec![deep, past], None)
    }

    /// Batch normalisation merged, for inference.
    pub fn folded(self) -> Self {
        Self {
            cv1: self.cv1.folded(),
            cv2: self.cv2.folded(),
            cv3: self.cv3.folded(),
            m: self.m.into_iter().map(Bottleneck::folded).collect(),
        }
    }
}
