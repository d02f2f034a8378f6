//! The detection head: box distributions and class scores at three strides.

use burn::config::Config;
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};

use crate::kernels;
use crate::nn::{Conv, ConvBlock, ConvBlockConfig, ConvConfig};

/// Bins of the distribution of each box side.
pub const REG_MAX: usize = 16;
/// Channels of a level's box output: four sides.
pub const BOX_CHANNELS: usize = 4 * REG_MAX;
/// Input pixels per cell of the three levels.
pub const STRIDES: [usize; 3] = [8, 16, 32];

/// Initial value of the box branch's last bias.
const BOX_BIAS: f64 = 2.0;

/// Settings of a [`Head`].
#[derive(Config, Debug)]
pub struct HeadConfig {
    /// Channels of the three inputs.
    channels: [usize; 3],
    classes: usize,
    /// Hidden width of the class branch; the usual one where absent.
    #[config(default = "None")]
    class_width: Option<usize>,
}

/// The box branch of one level.
#[derive(Module, Debug)]
pub struct BoxBranch {
    /// Two 3x3 convolutions.
    pub blocks: Vec<ConvBlock>,
    /// 1x1 to 64 channels: 16 bins for left, top, right, bottom.
    pub out: Conv,
}

/// The class branch of one level.
#[derive(Module, Debug)]
pub struct ClassBranch {
    /// Twice a depthwise 3x3 and a 1x1 convolution.
    pub blocks: Vec<Vec<ConvBlock>>,
    /// 1x1 to the classes.
    pub out: Conv,
}

/// The head over three levels.
#[derive(Module, Debug)]
pub struct Head {
    /// Box branches, stride 8 first.
    pub cv2: Vec<BoxBranch>,
    /// Class branches, stride 8 first.
    pub cv3: Vec<ClassBranch>,
}

/// What the head says before decoding: per level `[batch, 64 + classes, height, width]`, box
/// channels first, strides 8, 16, 32.
#[derive(Debug, Clone)]
pub struct RawOutput {
    /// The three levels.
    pub levels: [Tensor<4>; 3],
}

/// The logits of all levels, one column an anchor point: level by level, row by row.
#[derive(Debug, Clone)]
pub struct FlatOutput {
    /// `[batch, 64, anchors]`: channel `16 * side + bin`.
    pub boxes: Tensor<3>,
    /// `[batch, classes, anchors]`.
    pub scores: Tensor<3>,
}

impl HeadConfig {
    /// A head with fresh weights and biases that start from rare, small boxes.
    pub fn init(&self, device: &Device) -> Head {
        let first = self.channels[0];
        let box_width = (first / 4).max(BOX_CHANNELS);
        let class_width = self
            .class_width
            .unwrap_or_else(|| first.max(self.classes.min(100)));
        let block = |from, to, kernel, groups| {
            ConvBlockConfig::new(from, to)
                .with_kernel_size(kernel)
                .with_groups(groups)
                .init(device)
        };
        let bias = |conv: &mut Conv, value: f64| {
            let [channels, ..] = conv.weight.lazy_shape().dims::<4>();
            conv.bias = Some(Param::from_tensor(Tensor::full([channels], value, device)));
        };
        let cv2 = self
            .channels
            .iter()
            .map(|&from| {
                let mut branch = BoxBranch {
                    blocks: vec![
                        block(from, box_width, 3, 1),
                        block(box_width, box_width, 3, 1),
                    ],
                    out: ConvConfig::new(box_width, BOX_CHANNELS, 1).init(device),
                };
                bias(&mut branch.out, BOX_BIAS);
                branch
            })
            .collect();
        let cv3 = self
            .channels
            .iter()
            .zip(STRIDES)
            .map(|(&from, stride)| {
                let mut branch = ClassBranch {
                    blocks: vec![
                        vec![block(from, from, 3, from), block(from, class_width, 1, 1)],
                        vec![
                            block(class_width, class_width, 3, class_width),
                            block(class_width, class_width, 1, 1),
                        ],
                    ],
                    out: ConvConfig::new(class_width, self.classes, 1).init(device),
                };
                bias(&mut branch.out, class_bias(self.classes, stride));
                branch
            })
            .collect();
        Head { cv2, cv3 }
    }
}

/// Initial class logit: about five objects in a 640-pixel image, spread over classes and cells.
fn class_bias(classes: usize, stride: usize) -> f64 {
    let cells = (640.0 / stride as f64).powi(2);
    (5.0 / classes as f64 / cells).ln()
}

impl Head {
    /// # Shapes
    /// - inputs: `[batch, height / stride, width / stride, channels]` for strides 8, 16, 32
    pub fn forward(&self, inputs: [Tensor<4>; 3]) -> RawOutput {
        let mut level = 0;
        let levels = inputs.map(|input| {
            let (boxes, classes) = (&self.cv2[level], &self.cv3[level]);
            level += 1;
            let x = boxes
                .blocks
                .iter()
                .fold(input.clone(), |x, block| block.forward(x));
            let y = classes
                .blocks
                .iter()
                .flatten()
                .fold(input, |x, block| block.forward(x));
            let output = Tensor::cat(vec![boxes.out.forward(x), classes.out.forward(y)], 3);
            kernels::planes(output)
        });
        RawOutput { levels }
    }

    /// Batch normalisation merged, for inference.
    pub fn folded(self) -> Self {
        let fold = |blocks: Vec<ConvBlock>| blocks.into_iter().map(ConvBlock::folded).collect();
        Self {
            cv2: self
                .cv2
                .into_iter()
                .map(|branch| BoxBranch {
                    blocks: fold(branch.blocks),
                    out: branch.out.packed(),
                })
                .collect(),
            cv3: self
                .cv3
                .into_iter()
                .map(|branch| ClassBranch {
                    blocks: branch.blocks.into_iter().map(fold).collect(),
                    out: branch.out.packed(),
                })
                .collect(),
        }
    }

    /// Replaces the last class convolutions by fresh ones for another number of classes.
    pub fn reset_classes(&mut self, classes: usize, device: &Device) {
        for (branch, stride) in self.cv3.iter_mut().zip(STRIDES) {
            let [_, width, ..] = branch.out.weight.lazy_shape().dims::<4>();
            branch.out = ConvConfig::new(width, classes, 1).init(device);
            let bias = Tensor::full([classes], class_bias(classes, stride), device);
            branch.out.bias = Some(Param::from_tensor(bias));
        }
    }
}

impl RawOutput {
    /// All levels side by side.
    pub fn flatten(&self) -> FlatOutput {
        let flat = self.levels.each_ref().map(|level| {
            let [batch, channels, height, width] = level.dims();
            level.clone().reshape([batch, channels, height * width])
        });
        let all = Tensor::cat(flat.to_vec(), 2); // [batch, 64 + classes, anchors]
        let [_, channels, _] = all.dims();
        FlatOutput {
            boxes: all.clone().narrow(1, 0, BOX_CHANNELS),
            scores: all.narrow(1, BOX_CHANNELS, channels - BOX_CHANNELS),
        }
    }
}
