//! Both networks in Burn's own layers, with the weights of ours: the comparison for training.
//!
//! Layer by layer the same functions on `[batch, channels, height, width]`, written as a user of
//! Burn would. Nothing here calls the library's kernels.

use burn::module::Module;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::nn::interpolate::{Interpolate2dConfig, InterpolateMode};
use burn::nn::pool::{AvgPool2dConfig, MaxPool2dConfig};
use burn::nn::{BatchNorm, BatchNormConfig, PaddingConfig2d};
use burn::tensor::activation::{relu, silu, softmax};
use burn::tensor::{Device, Tensor};
use twinsight::detector::{RawOutput, Yolo11};
use twinsight::nn::{self, Dense};
use twinsight::ranging::RangingNetwork;

/// A convolution with the same weights.
fn conv(ours: &nn::Conv, stride: usize, padding: usize, device: &Device) -> Conv2d {
    let [channels_out, per_group, kernel_h, kernel_w] = ours.weight.val().dims();
    // One input channel for many output channels is a depthwise convolution in both networks.
    let groups = if per_group == 1 && channels_out > 1 {
        channels_out
    } else {
        1
    };
    let mut conv = Conv2dConfig::new([per_group * groups, channels_out], [kernel_h, kernel_w])
        .with_stride([stride; 2])
        .with_padding(PaddingConfig2d::Explicit(
            padding, padding, padding, padding,
        ))
        .with_groups(groups)
        .with_bias(ours.bias.is_some())
        .init(device);
    conv.weight = ours.weight.clone();
    conv.bias.clone_from(&ours.bias);
    conv
}

#[derive(Module, Debug)]
struct Block {
    conv: Conv2d,
    bn: BatchNorm,
    #[module(skip)]
    activated: bool,
}

/// Turns blocks of ours into blocks of Burn's layers.
struct Builder<'a> {
    device: &'a Device,
}

impl Builder<'_> {
    fn block(&self, ours: &nn::ConvBlock) -> Block {
        self.with_stride(ours, 1)
    }

    fn with_stride(&self, ours: &nn::ConvBlock, stride: usize) -> Block {
        let [channels, _, kernel, _] = ours.conv.weight.val().dims();
        let mut norm = BatchNormConfig::new(channels);
        if let Some(bn) = &ours.bn {
            norm = norm.with_epsilon(bn.epsilon).with_momentum(bn.momentum);
        }
        Block {
            conv: conv(&ours.conv, stride, kernel / 2, self.device),
            bn: norm.init(self.device),
            activated: true,
        }
    }

    fn linear(&self, ours: &nn::ConvBlock) -> Block {
        Block {
            activated: false,
            ..self.block(ours)
        }
    }

    fn down(&self, ours: &nn::ConvBlock) -> Block {
        self.with_stride(ours, 2)
    }

    fn bottlenecks(&self, ours: &[nn::Bottleneck]) -> Vec<Bottleneck> {
        let bottleneck = |ours: &nn::Bottleneck| Bottleneck {
            cv1: self.block(&ours.cv1),
            cv2: self.block(&ours.cv2),
        };
        ours.iter().map(bottleneck).collect()
    }

    fn c3k2(&self, ours: &nn::C3k2) -> C3k2 {
        let c3k = |ours: &nn::C3k| C3k {
            cv1: self.block(&ours.cv1),
            cv2: self.block(&ours.cv2),
            cv3: self.block(&ours.cv3),
            m: self.bottlenecks(&ours.m),
        };
        C3k2 {
            cv1: self.block(&ours.cv1),
            cv2: self.block(&ours.cv2),
            bottlenecks: self.bottlenecks(&ours.bottlenecks),
            c3ks: ours.c3ks.iter().map(c3k).collect(),
        }
    }

    fn c2psa(&self, ours: &nn::C2psa) -> C2psa {
        let psa = |ours: &nn::PsaBlock| PsaBlock {
            qkv: self.linear(&ours.attn.qkv),
            proj: self.linear(&ours.attn.proj),
            pe: self.linear(&ours.attn.pe),
            widen: self.block(&ours.ffn[0]),
            narrow: self.linear(&ours.ffn[1]),
        };
        C2psa {
            cv1: self.block(&ours.cv1),
            cv2: self.block(&ours.cv2),
            m: ours.m.iter().map(psa).collect(),
        }
    }

    fn head(&self, ours: &twinsight::detector::Head) -> Vec<Level> {
        let blocks = |blocks: &[nn::ConvBlock]| blocks.iter().map(|b| self.block(b)).collect();
        ours.cv2
            .iter()
            .zip(&ours.cv3)
            .map(|(boxes, classes)| Level {
                boxes: blocks(&boxes.blocks),
                boxes_out: conv(&boxes.out, 1, 0, self.device),
                classes: blocks(&classes.blocks.concat()),
                classes_out: conv(&classes.out, 1, 0, self.device),
            })
            .collect()
    }
}

impl Block {
    fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let output = self.bn.forward(self.conv.forward(input));
        if self.activated { silu(output) } else { output }
    }
}

#[derive(Module, Debug)]
struct Bottleneck {
    cv1: Block,
    cv2: Block,
}

impl Bottleneck {
    fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        self.cv2.forward(self.cv1.forward(input.clone())) + input
    }
}

#[derive(Module, Debug)]
struct C3k {
    cv1: Block,
    cv2: Block,
    cv3: Block,
    m: Vec<Bottleneck>,
}

impl C3k {
    fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let deep = self.cv1.forward(input.clone());
        let deep = self.m.iter().fold(deep, |x, m| m.forward(x));
        self.cv3
            .forward(Tensor::cat(vec![deep, self.cv2.forward(input)], 1))
    }
}

#[derive(Module, Debug)]
struct C3k2 {
    cv1: Block,
    cv2: Block,
    bottlenecks: Vec<Bottleneck>,
    c3ks: Vec<C3k>,
}

impl C3k2 {
    fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let halves = self.cv1.forward(input);
        let mut parts = halves.chunk(2, 1);
        let mut last = parts[1].clone();
        for block in &self.bottlenecks {
            last = block.forward(last);
            parts.push(last.clone());
        }
        for block in &self.c3ks {
            last = block.forward(last);
            parts.push(last.clone());
        }
        self.cv2.forward(Tensor::cat(parts, 1))
    }
}

#[derive(Module, Debug)]
struct PsaBlock {
    qkv: Block,
    proj: Block,
    pe: Block,
    widen: Block,
    narrow: Block,
}

impl PsaBlock {
    fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let x = self.attend(input.clone()) + input;
        self.narrow.forward(self.widen.forward(x.clone())) + x
    }

    fn attend(&self, input: Tensor<4>) -> Tensor<4> {
        let [batch, channels, height, width] = input.dims();
        let heads = (channels / 64).max(1);
        let value = channels / heads;
        let key = value / 2;
        let qkv = self
            .qkv
            .forward(input)
            .reshape([batch, heads, 2 * key + value, height * width]);
        let queries = qkv.clone().narrow(2, 0, key);
        let keys = qkv.clone().narrow(2, key, key);
        let values = qkv.narrow(2, 2 * key, value);
        let scale = 1.0 / (key as f64).sqrt();
        let weights = softmax(queries.swap_dims(2, 3).matmul(keys).mul_scalar(scale), 3);
        let attended = values.clone().matmul(weights.swap_dims(2, 3));
        let shape = [batch, channels, height, width];
        let encoded = self.pe.forward(values.reshape(shape));
        self.proj.forward(attended.reshape(shape) + encoded)
    }
}

#[derive(Module, Debug)]
struct C2psa {
    cv1: Block,
    cv2: Block,
    m: Vec<PsaBlock>,
}

impl C2psa {
    fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let mut halves = self.cv1.forward(input).chunk(2, 1);
        let deep = halves[1].clone();
        halves[1] = self.m.iter().fold(deep, |x, block| block.forward(x));
        self.cv2.forward(Tensor::cat(halves, 1))
    }
}

#[derive(Module, Debug)]
struct Level {
    boxes: Vec<Block>,
    boxes_out: Conv2d,
    classes: Vec<Block>,
    classes_out: Conv2d,
}

impl Level {
    fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let boxes = self.boxes.iter().fold(input.clone(), |x, b| b.forward(x));
        let classes = self.classes.iter().fold(input, |x, b| b.forward(x));
        Tensor::cat(
            vec![
                self.boxes_out.forward(boxes),
                self.classes_out.forward(classes),
            ],
            1,
        )
    }
}

/// YOLO11 in Burn's layers.
#[derive(Module, Debug)]
pub struct Composed11 {
    stem: Vec<Block>,
    c3k2s: Vec<C3k2>,
    downs: Vec<Block>,
    sppf: Vec<Block>,
    c2psa: C2psa,
    head: Vec<Level>,
}

impl Composed11 {
    pub fn of(ours: &Yolo11, device: &Device) -> Self {
        let b = Builder { device };
        let c3k2s = [
            &ours.layer2,
            &ours.layer4,
            &ours.layer6,
            &ours.layer8,
            &ours.layer13,
            &ours.layer16,
            &ours.layer19,
            &ours.layer22,
        ];
        let downs = [
            &ours.layer3,
            &ours.layer5,
            &ours.layer7,
            &ours.layer17,
            &ours.layer20,
        ];
        Self {
            stem: vec![b.down(&ours.layer0), b.down(&ours.layer1)],
            c3k2s: c3k2s.map(|block| b.c3k2(block)).into(),
            downs: downs.map(|block| b.down(block)).into(),
            sppf: vec![b.block(&ours.layer9.cv1), b.block(&ours.layer9.cv2)],
            c2psa: b.c2psa(&ours.layer10),
            head: b.head(&ours.layer23),
        }
    }

    /// # Shapes
    /// - input: `[batch, 3, height, width]`
    pub fn forward(&self, input: Tensor<4>) -> RawOutput {
        let double = Interpolate2dConfig::new()
            .with_scale_factor(Some([2.0; 2]))
            .with_mode(InterpolateMode::Nearest)
            .init();
        let [l2, l4, l6, l8, l13, l16, l19, l22] = &self.c3k2s[..] else {
            unreachable!("built with eight");
        };
        let [l3, l5, l7, l17, l20] = &self.downs[..] else {
            unreachable!("built with five");
        };
        let x = self.stem.iter().fold(input, |x, block| block.forward(x));
        let x4 = l4.forward(l3.forward(l2.forward(x)));
        let x6 = l6.forward(l5.forward(x4.clone()));
        let x8 = l8.forward(l7.forward(x6.clone()));
        let x10 = self.c2psa.forward(self.pool(x8));
        let join = |a: Tensor<4>, b: Tensor<4>| Tensor::cat(vec![a, b], 1);
        let x13 = l13.forward(join(double.forward(x10.clone()), x6));
        let x16 = l16.forward(join(double.forward(x13.clone()), x4));
        let x19 = l19.forward(join(l17.forward(x16.clone()), x13));
        let x22 = l22.forward(join(l20.forward(x19.clone()), x10));
        let mut level = 0;
        let levels = [x16, x19, x22].map(|x| {
            level += 1;
            self.head[level - 1].forward(x)
        });
        RawOutput { levels }
    }

    fn pool(&self, input: Tensor<4>) -> Tensor<4> {
        let pool = MaxPool2dConfig::new([5, 5])
            .with_strides([1, 1])
            .with_padding(PaddingConfig2d::Explicit(2, 2, 2, 2))
            .init();
        let mut stages = vec![self.sppf[0].forward(input)];
        for stage in 0..3 {
            stages.push(pool.forward(stages[stage].clone()));
        }
        self.sppf[1].forward(Tensor::cat(stages, 1))
    }
}

/// The distance network in Burn's layers, the first block's convolutions run once for both
/// pathways, the others on the stacked pathways.
#[derive(Module, Debug)]
pub struct ComposedRanging {
    blocks: Vec<Vec<Conv2d>>,
    fc1: Dense,
    fc2: Dense,
    out: Dense,
}

impl ComposedRanging {
    pub fn of(ours: &RangingNetwork, device: &Device) -> Self {
        let block = |block: &Vec<nn::Conv>| block.iter().map(|c| conv(c, 1, 0, device)).collect();
        Self {
            blocks: ours.blocks.iter().map(block).collect(),
            fc1: ours.fc1.clone(),
            fc2: ours.fc2.clone(),
            out: ours.out.clone(),
        }
    }

    /// # Shapes
    /// - composite: `[batch, 3, height, width]`
    /// - geometry: `[batch, 2]`
    /// - output: `[batch, 1]`
    pub fn forward(&self, composite: Tensor<4>, geometry: Tensor<2>) -> Tensor<2> {
        let maximum = MaxPool2dConfig::new([2, 2]).with_strides([2, 2]).init();
        let average = AvgPool2dConfig::new([2, 2]).with_strides([2, 2]).init();
        let [batch, ..] = composite.dims();
        let mut x = composite;
        for (index, block) in self.blocks.iter().enumerate() {
            x = block.iter().fold(x, |x, conv| conv.forward(x));
            let [a, b] = if index == 0 {
                [x.clone(), x]
            } else {
                [
                    x.clone().narrow(0, 0, batch),
                    x.clone().narrow(0, batch, batch),
                ]
            };
            x = relu(Tensor::cat(vec![maximum.forward(a), average.forward(b)], 0));
        }
        let [_, channels, height, width] = x.dims();
        let flat = [0, batch].map(|first| {
            x.clone()
                .narrow(0, first, batch)
                .reshape([batch, channels * height * width])
        });
        let x = relu(self.fc1.forward(Tensor::cat(flat.to_vec(), 1)));
        let x = relu(self.fc2.forward(x));
        self.out.forward(Tensor::cat(vec![x, geometry], 1))
    }
}
