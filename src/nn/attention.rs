//! Position-sensitive attention: the detector's only look at the whole image.

use burn::config::Config;
use burn::module::Module;
use burn::tensor::activation::softmax;
use burn::tensor::{Device, Tensor};

use super::{ConvBlock, ConvBlockConfig};
use crate::kernels;

/// Settings of an [`Attention`].
#[derive(Config, Debug)]
pub struct AttentionConfig {
    channels: usize,
}

/// Multi-head self-attention over pixels with a depthwise convolution as positional encoding.
#[derive(Module, Debug)]
pub struct Attention {
    /// 1x1, linear: queries, keys and values, head by head.
    pub qkv: ConvBlock,
    /// 1x1, linear.
    pub proj: ConvBlock,
    /// 3x3 depthwise, linear.
    pub pe: ConvBlock,
    #[module(skip)]
    heads: usize,
    #[module(skip)]
    key_width: usize,
    #[module(skip)]
    head_width: usize,
}

impl AttentionConfig {
    /// Attention with fresh weights.
    pub fn init(&self, device: &Device) -> Attention {
        let channels = self.channels;
        let heads = (channels / 64).max(1);
        let head_width = channels / heads;
        let key_width = head_width / 2;
        let linear = |config: ConvBlockConfig| config.with_activated(false).init(device);
        Attention {
            qkv: linear(ConvBlockConfig::new(
                channels,
                channels + 2 * key_width * heads,
            )),
            proj: linear(ConvBlockConfig::new(channels, channels)),
            pe: linear(
                ConvBlockConfig::new(channels, channels)
                    .with_kernel_size(3)
                    .with_groups(channels),
            ),
            heads,
            key_width,
            head_width,
        }
    }
}

impl Attention {
    /// # Shapes
    /// - input and output: `[batch, height, width, channels]`
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        self.forward_residual(input, None)
    }

    /// [`Attention::forward`] with something added to its output.
    fn forward_residual(&self, input: Tensor<4>, residual: Option<Tensor<4>>) -> Tensor<4> {
        let [batch, height, width, channels] = input.dims();
        let (key, value) = (self.key_width, self.head_width);
        let pixels = height * width;
        let qkv = kernels::planes(self.qkv.forward(input)).reshape([
            batch,
            self.heads,
            2 * key + value,
            pixels,
        ]);
        let queries = qkv.clone().narrow(2, 0, key); // [batch, heads, key, pixels]
        let keys = qkv.clone().narrow(2, key, key); // [batch, heads, key, pixels]
        let values = qkv.narrow(2, 2 * key, value); // [batch, heads, value, pixels]
        let scale = 1.0 / (key as f64).sqrt();
        let scores = queries.swap_dims(2, 3).matmul(keys).mul_scalar(scale); // [.., query, key]
        let weights = softmax(scores, 3);
        let attended = values
            .clone()
            .matmul(weights.swap_dims(2, 3)) // [batch, heads, value, pixels]
            .reshape([batch, channels, height, width]);
        let values = values.reshape([batch, channels, height, width]);
        let input = self.pe.forward_joined(
            vec![kernels::pixels(values)],
            Some(kernels::pixels(attended)),
        );
        self.proj.forward_joined(vec![input], residual)
    }

    /// Batch normalisation merged, for inference.
    pub fn folded(self) -> Self {
        Self {
            qkv: self.qkv.folded(),
            proj: self.proj.folded(),
            pe: self.pe.folded(),
            ..self
        }
    }
}

/// Settings of a [`PsaBlock`].
#[derive(Config, Debug)]
pub struct PsaBlockConfig {
    channels: usize,
}

/// `x + attn(x)`, then `x + ffn(x)`.
#[derive(Module, Debug)]
pub struct PsaBlock {
    /// Attention over pixels.
    pub attn: Attention,
    /// 1x1 to twice the channels with SiLU, then 1x1 back, linear.
    pub ffn: Vec<ConvBlock>,
}

impl PsaBlockConfig {
    /// A block with fresh weights.
    pub fn init(&self, device: &Device) -> PsaBlock {
        let channels = self.channels;
        PsaBlock {
            attn: AttentionConfig::new(channels).init(device),
            ffn: vec![
                ConvBlockConfig::new(channels, 2 * channels).init(device),
                ConvBlockConfig::new(2 * channels, channels)
                    .with_activated(false)
                    .init(device),
            ],
        }
    }
}

impl PsaBlock {
    /// # Shapes
    /// - input and output: `[batch, height, width, channels]`
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let x = self.attn.forward_residual(input.clone(), Some(input));
        let [widen, narrow] = &self.ffn[..] else {
            unreachable!("the block has two feed-forward layers");
        };
        narrow.forward_joined(vec![widen.forward(x.clone())], Some(x))
    }

    /// Batch normalisation merged, for inference.
    pub fn folded(self) -> Self {
        Self {
            attn: self.attn.folded(),
            ffn: self.ffn.into_iter().map(ConvBlock::folded).collect(),
        }
    }
}

/// Settings of a [`C2psa`].
#[derive(Config, Debug)]
pub struct C2psaConfig {
    channels: usize,
    blocks: usize,
}

/// Half of the channels through [`PsaBlock`]s, the other half past them.
#[derive(Module, Debug)]
pub struct C2psa {
    /// 1x1 over the input.
    pub cv1: ConvBlock,
    /// 1x1 over both halves.
    pub cv2: ConvBlock,
    /// The attention blocks, in sequence.
    pub m: Vec<PsaBlock>,
    #[module(skip)]
    hidden: usize,
}

impl C2psaConfig {
    /// A block with fresh weights.
    pub fn init(&self, device: &Device) -> C2psa {
        let hidden = self.channels / 2;
        C2psa {
            cv1: ConvBlockConfig::new(self.channels, 2 * hidden).init(device),
            cv2: ConvBlockConfig::new(2 * hidden, self.channels).init(device),
            m: (0..self.blocks)
                .map(|_| PsaBlockConfig::new(hidden).init(device))
                .collect(),
            hidden,
        }
    }
}

impl C2psa {
    /// # Shapes
    /// - input and output: `[batch, height, width, channels]`
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let halves = self.cv1.forward(input);
        let past = halves.clone().narrow(3, 0, self.hidden);
        let deep = halves.narrow(3, self.hidden, self.hidden);
        let deep = self.m.iter().fold(deep, |x, block| block.forward(x));
        self.cv2.forward_joined(vec![past, deep], None)
    }

    /// Batch normalisation merged, for inference.
    pub fn folded(self) -> Self {
        Self {
            cv1: self.cv1.folded(),
            cv2: self.cv2.folded(),
            m: self.m.into_iter().map(PsaBlock::folded).collect(),
            hidden: self.hidden,
        }
    }
}
