//! Every part of a detector called with the input that it has in the whole, under the path that
//! it has in a state dict.

use std::collections::BTreeMap;

use burn::tensor::Tensor;
use burn::tensor::activation::softmax;
use twinsight::detector::decode::expected_sides;
use twinsight::detector::{Head, Yolo11};
use twinsight::kernels;
use twinsight::nn::{Attention, Bottleneck, C2psa, C3k, C3k2, ConvBlock, PsaBlock, Sppf};

use super::network;

/// Outputs of all parts of a detector, in short.
#[derive(Default)]
pub struct Trace {
    /// Summaries by path, such as `model.2.m.0.cv1.bn`.
    pub summaries: BTreeMap<String, Vec<f64>>,
}

/// Runs a block, whose tensors end with their channels, on `[batch, channels, height, width]`.
pub fn on_planes(block: impl Fn(Tensor<4>) -> Tensor<4>, input: Tensor<4>) -> Tensor<4> {
    kernels::planes(block(kernels::pixels(input)))
}

impl Trace {
    /// Runs a detector and then all of its parts on their own.
    pub fn of(detector: &Yolo11, input: &Tensor<4>) -> Self {
        let mut layers = vec![input.clone()];
        let mut outputs = BTreeMap::new();
        let raw = detector.forward_observed(input.clone(), |layer, output| {
            outputs.insert(layer, output.clone());
        });
        layers.extend(outputs.into_values());
        // Layer N reads what the layer before it has made, save for the head.
        let input = |layer: usize| layers[layer].clone();
        let mut trace = Self::default();
        let d = detector;
        for (layer, block) in [
            (0, &d.layer0),
            (1, &d.layer1),
            (3, &d.layer3),
            (5, &d.layer5),
            (7, &d.layer7),
            (17, &d.layer17),
            (20, &d.layer20),
        ] {
            trace.conv_block(&format!("model.{layer}"), block, input(layer));
        }
        for (layer, block) in [
            (2, &d.layer2),
            (4, &d.layer4),
            (6, &d.layer6),
            (8, &d.layer8),
            (13, &d.layer13),
            (16, &d.layer16),
            (19, &d.layer19),
            (22, &d.layer22),
        ] {
            trace.c3k2(&format!("model.{layer}"), block, input(layer));
        }
        trace.sppf("model.9", &d.layer9, input(9));
        trace.c2psa("model.10", &d.layer10, input(10));
        trace.head("model.23", &d.layer23, [input(17), input(20), input(23)]);
        // The constant convolution of the published network is a weighted sum here.
        let sides = expected_sides(raw.flatten().boxes);
        trace.note("model.23.dfl", &sides);
        trace.note("model.23.dfl.conv", &sides);
        trace
    }

    fn note<const D: usize>(&mut self, path: &str, output: &Tensor<D>) {
        let before = self
            .summaries
            .insert(path.to_owned(), network::summary(output));
        assert!(before.is_none(), "{path} is there twice");
    }

    fn conv_block(&mut self, path: &str, block: &ConvBlock, input: Tensor<4>) -> Tensor<4> {
        let convolved = on_planes(|x| block.conv.forward(x), input.clone());
        self.note(&format!("{path}.conv"), &convolved);
        let normalisation = block.bn.as_ref().unwrap();
        self.note(&format!("{path}.bn"), &normalisation.forward(convolved));
        let output = on_planes(|x| block.forward(x), input);
        self.note(path, &output);
        output
    }

    fn conv_blocks(&mut self, path: &str, blocks: &[ConvBlock], input: Tensor<4>) -> Tensor<4> {
        blocks.iter().enumerate().fold(input, |x, (index, block)| {
            self.conv_block(&format!("{path}.{index}"), block, x)
        })
    }

    fn bottleneck(&mut self, path: &str, block: &Bottleneck, input: Tensor<4>) -> Tensor<4> {
        let hidden = self.conv_block(&format!("{path}.cv1"), &block.cv1, input.clone());
        self.conv_block(&format!("{path}.cv2"), &block.cv2, hidden);
        let output = on_planes(|x| block.forward(x), input);
        self.note(path, &output);
        output
    }

    fn c3k(&mut self, path: &str, block: &C3k, input: Tensor<4>) -> Tensor<4> {
        let mut deep = self.conv_block(&format!("{path}.cv1"), &block.cv1, input.clone());
        for (index, inner) in block.m.iter().enumerate() {
            deep = self.bottleneck(&format!("{path}.m.{index}"), inner, deep);
        }
        self.note(&format!("{path}.m"), &deep);
        let past = self.conv_block(&format!("{path}.cv2"), &block.cv2, input.clone());
        let both = Tensor::cat(vec![deep, past], 1);
        self.conv_block(&format!("{path}.cv3"), &block.cv3, both);
        let output = on_planes(|x| block.forward(x), input);
        self.note(path, &output);
        output
    }

    fn c3k2(&mut self, path: &str, block: &C3k2, input: Tensor<4>) {
        let halves = self.conv_block(&format!("{path}.cv1"), &block.cv1, input);
        let hidden = halves.dims()[1] / 2;
        let mut last = halves.clone().narrow(1, hidden, hidden);
        let mut parts = vec![halves];
        for (index, inner) in block.bottlenecks.iter().enumerate() {
            last = self.bottleneck(&format!("{path}.m.{index}"), inner, last);
            parts.push(last.clone());
        }
        for (index, inner) in block.c3ks.iter().enumerate() {
            last = self.c3k(&format!("{path}.m.{index}"), inner, last);
            parts.push(last.clone());
        }
        self.conv_block(&format!("{path}.cv2"), &block.cv2, Tensor::cat(parts, 1));
    }

    fn sppf(&mut self, path: &str, block: &Sppf, input: Tensor<4>) {
        let mut stages = vec![self.conv_block(&format!("{path}.cv1"), &block.cv1, input)];
        let pool = burn::nn::pool::MaxPool2dConfig::new([5, 5])
            .with_strides([1, 1])
            .with_padding(burn::nn::PaddingConfig2d::Explicit(2, 2, 2, 2))
            .init();
        for stage in 0..3 {
            stages.push(pool.forward(stages[stage].clone()));
        }
        self.conv_block(&format!("{path}.cv2"), &block.cv2, Tensor::cat(stages, 1));
    }

    fn attention(&mut self, path: &str, block: &Attention, input: Tensor<4>) -> Tensor<4> {
        let [batch, channels, height, width] = input.dims();
        let (heads, value, key) = (channels / 64, 64, 32);
        let rows = self.conv_block(&format!("{path}.qkv"), &block.qkv, input.clone());
        let rows = rows.reshape([batch, heads, 2 * key + value, height * width]);
        let queries = rows.clone().narrow(2, 0, key);
        let keys = rows.clone().narrow(2, key, key);
        let values = rows.narrow(2, 2 * key, value);
        let scores = queries.transpose().matmul(keys) * (1.0 / (key as f64).sqrt());
        let attended = values.clone().matmul(softmax(scores, 3).transpose());
        let values = values.reshape([batch, channels, height, width]);
        let positions = self.conv_block(&format!("{path}.pe"), &block.pe, values);
        let sum = attended.reshape([batch, channels, height, width]) + positions;
        self.conv_block(&format!("{path}.proj"), &block.proj, sum);
        let output = on_planes(|x| block.forward(x), input);
        self.note(path, &output);
        output
    }

    fn psa_block(&mut self, path: &str, block: &PsaBlock, input: Tensor<4>) -> Tensor<4> {
        let x = self.attention(&format!("{path}.attn"), &block.attn, input.clone()) + input.clone();
        let ffn = self.conv_blocks(&format!("{path}.ffn"), &block.ffn, x);
        self.note(&format!("{path}.ffn"), &ffn);
        let output = on_planes(|x| block.forward(x), input);
        self.note(path, &output);
        output
    }

    fn c2psa(&mut self, path: &str, block: &C2psa, input: Tensor<4>) {
        let halves = self.conv_block(&format!("{path}.cv1"), &block.cv1, input);
        let hidden = halves.dims()[1] / 2;
        let mut deep = halves.clone().narrow(1, hidden, hidden);
        for (index, inner) in block.m.iter().enumerate() {
            deep = self.psa_block(&format!("{path}.m.{index}"), inner, deep);
        }
        self.note(&format!("{path}.m"), &deep);
        let both = Tensor::cat(vec![halves.narrow(1, 0, hidden), deep], 1);
        self.conv_block(&format!("{path}.cv2"), &block.cv2, both);
    }

    fn head(&mut self, path: &str, head: &Head, inputs: [Tensor<4>; 3]) {
        for (level, input) in inputs.into_iter().enumerate() {
            let (boxes, classes) = (&head.cv2[level], &head.cv3[level]);
            let branch = format!("{path}.cv2.{level}");
            let x = self.conv_blocks(&branch, &boxes.blocks, input.clone());
            let x = on_planes(|x| boxes.out.forward(x), x);
            self.note(&format!("{branch}.2"), &x);
            self.note(&branch, &x);
            let branch = format!("{path}.cv3.{level}");
            let x = classes
                .blocks
                .iter()
                .enumerate()
                .fold(input, |x, (index, pair)| {
                    let pair_path = format!("{branch}.{index}");
                    let x = self.conv_blocks(&pair_path, pair, x);
                    self.note(&pair_path, &x);
                    x
                });
            let x = on_planes(|x| classes.out.forward(x), x);
            self.note(&format!("{branch}.2"), &x);
            self.note(&branch, &x);
        }
    }
}
