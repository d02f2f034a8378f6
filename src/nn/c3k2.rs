//! The C3k2 block: the detector's workhorse.

use burn::config::Config;
use burn::module::Module;
use burn::tensor::{Device, Tensor};

use super::{Bottleneck, BottleneckConfig, C3k, C3kConfig, ConvBlock, ConvBlockConfig};

/// Settings of a [`C3k2`].
#[derive(Config, Debug)]
pub struct C3k2Config {
    channels_in: usize,
    channels_out: usize,
    /// Inner blocks.
    blocks: usize,
    /// Inner blocks are [`C3k`] rather than [`Bottleneck`].
    c3k: bool,
    /// Hidden width as a share of the output channels.
    expansion: f64,
}

/// `cv2(cat[y0, y1, m0(y1), m1(m0(y1)), ..])` with `y0, y1` the halves of `cv1(x)`.
#[derive(Module, Debug)]
pub struct C3k2 {
    /// 1x1 to twice the hidden channels.
    pub cv1: ConvBlock,
    /// 1x1 over everything.
    pub cv2: ConvBlock,
    /// Inner blocks of the plain kind; empty where `c3ks` is not.
    pub bottlenecks: Vec<Bottleneck>,
    /// Inner blocks of the C3k kind; empty where `bottlenecks` is not.
    pub c3ks: Vec<C3k>,
    #[module(skip)]
    hidden: usize,
}

impl C3k2Config {
    /// A block with fresh weights.
    pub fn init(&self, device: &Device) -> C3k2 {
        let hidden = (self.channels_out as f64 * self.expansion) as usize;
        let (plain, c3k) = if self.c3k {
            (0, self.blocks)
        } else {
            (self.blocks, 0)
        };
        C3k2 {
            cv1: ConvBlockConfig::new(self.channels_in, 2 * hidden).init(device),
            cv2: ConvBlockConfig::new((2 + self.blocks) * hidden, self.channels_out).init(device),
            bottlenecks: (0..plain)
                .map(|_| BottleneckConfig::new(hidden, hidden / 2).init(device))
                .collect(),
            c3ks: (0..c3k)
                .map(|_| C3kConfig::new(hidden).init(device))
                .collect(),
            hidden,
        }
    }
}

impl C3k2 {
    /// # Shapes
    /// - input: `[batch, height, width, channels_in]`
    /// - output: `[batch, height, width, channels_out]`
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        self.forward_joined(vec![input])
    }

    /// [`C3k2::forward`] of several inputs as [`ConvBlock::forward_joined`] takes them.
    pub fn forward_joined(&self, inputs: Vec<Tensor<4>>) -> Tensor<4> {
        let halves = self.cv1.forward_joined(inputs, None); // [batch, height, width, 2 hidden]
        let mut last = halves.clone().narrow(3, self.hidden, self.hidden);
        let mut parts = vec![halves];
        for block in &self.bottlenecks {
            last = block.forward(last);
            parts.push(last.clone());
        }
        for block in &self.c3ks {
            last = block.forward(last);
            parts.push(last.clone());
        }
        self.cv2.forward_joined(parts, None)
    }

    /// Batch normalisation merged, for inference.
    pub fn folded(self) -> Self {
        Self {
            cv1: self.cv1.folded(),
            cv2: self.cv2.folded(),
            bottlenecks: self
                .bottlenecks
                .into_iter()
                .map(Bottleneck::folded)
                .collect(),
            c3ks: self.c3ks.into_iter().map(C3k::folded).collect(),
            hidden: self.hidden,
        }
    }
}
