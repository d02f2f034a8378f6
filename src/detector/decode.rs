//! From logits to boxes: anchor points, the expected distance of each side, pixels.

use burn::tensor::activation::{sigmoid, softmax};
use burn::tensor::{Device, Tensor, TensorData};

use super::head::{FlatOutput, REG_MAX, RawOutput, STRIDES};

/// The anchor points of an input size: one a cell, level by level, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Anchors {
    /// Centre (x, y) of each cell in units of its stride.
    pub points_grid: Vec<[f32; 2]>,
    /// Stride of each point, input pixels.
    pub strides: Vec<f32>,
}

impl Anchors {
    /// The points of an input of `height x width` pixels, both multiples of 32.
    pub fn new(height: usize, width: usize) -> Self {
        let mut points_grid = Vec::new();
        let mut strides = Vec::new();
        for stride in STRIDES {
            for y in 0..height / stride {
                for x in 0..width / stride {
                    points_grid.push([x as f32 + 0.5, y as f32 + 0.5]);
                    strides.push(stride as f32);
                }
            }
        }
        Self {
            points_grid,
            strides,
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.strides.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.strides.is_empty()
    }

    /// Points as `[1, 2, anchors]` and strides as `[1, 1, anchors]`.
    fn tensors(&self, device: &Device) -> (Tensor<3>, Tensor<3>) {
        let x = self.points_grid.iter().map(|point| point[0]);
        let y = self.points_grid.iter().map(|point| point[1]);
        let points: Vec<f32> = x.chain(y).collect();
        (
            Tensor::from_data(TensorData::new(points, [1, 2, self.len()]), device),
            Tensor::from_data(
                TensorData::new(self.strides.clone(), [1, 1, self.len()]),
                device,
            ),
        )
    }
}

/// The expected distance of each side from the anchor point, in units of the stride.
///
/// # Shapes
/// - input: `[batch, 64, anchors]`
/// - output: `[batch, 4, anchors]`: left, top, right, bottom
pub fn expected_sides(boxes: Tensor<3>) -> Tensor<3> {
    let [batch, _, anchors] = boxes.dims();
    let device = boxes.device();
    let bins: Vec<f32> = (0..REG_MAX as u16).map(f32::from).collect();
    let bins = Tensor::<4>::from_data(TensorData::new(bins, [1, 1, REG_MAX, 1]), &device);
    let probabilities = softmax(boxes.reshape([batch, 4, REG_MAX, anchors]), 2);
    (probabilities * bins)
        .sum_dim(2)
        .reshape([batch, 4, anchors])
}

/// Decodes the network's output.
///
/// # Shapes
/// - output: `[batch, 4 + classes, anchors]`: centre x, centre y, width, height in pixels of the
///   network's input, then class probabilities
pub fn decode(raw: &RawOutput) -> Tensor<3> {
    let [_, _, height, width] = raw.levels[0].dims();
    let anchors = Anchors::new(height * STRIDES[0], width * STRIDES[0]);
    let FlatOutput { boxes, scores } = raw.flatten();
    let (points, strides) = anchors.tensors(&boxes.device());
    let sides = expected_sides(boxes);
    let low = points.clone() - sides.clone().narrow(1, 0, 2);
    let high = points + sides.narrow(1, 2, 2);
    let centers = (low.clone() + high.clone()).mul_scalar(0.5) * strides.clone();
    let sizes = (high - low) * strides;
    Tensor::cat(vec![centers, sizes, sigmoid(scores)], 1)
}
