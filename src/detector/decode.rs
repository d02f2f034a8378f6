//! From logits to boxes: anchor points, the expected distance of each side, pixels.

use burn::tensor::activation::{sigmoid, softmax};
use burn::tensor::{Device, Tensor, TensorData};

use super::head::{BOX_CHANNELS, FlatOutput, REG_MAX, RawOutput, STRIDES};
use crate::kernels;
use crate::kernels::expectation::{expected_bins, sigmoids};
use crate::kernels::layout::Pixels;

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
    let device = raw.levels[0].device();
    if kernels::is_native(&device)
        && let Some(decoded) = decode_native(raw, &anchors, &device)
    {
        return decoded;
    }
    decode_composed(raw, &anchors, &device)
}

/// [`decode`] from tensor operations.
fn decode_composed(raw: &RawOutput, anchors: &Anchors, device: &Device) -> Tensor<3> {
    let FlatOutput { boxes, scores } = raw.flatten();
    let (points, strides) = anchors.tensors(device);
    let sides = expected_sides(boxes);
    let low = points.clone() - sides.clone().narrow(1, 0, 2);
    let high = points + sides.narrow(1, 2, 2);
    let centers = (low.clone() + high.clone()).mul_scalar(0.5) * strides.clone();
    let sizes = (high - low) * strides;
    Tensor::cat(vec![centers, sizes, sigmoid(scores)], 1)
}

/// [`decode`] where the values lie: about thirty passes over them fewer.
fn decode_native(raw: &RawOutput, anchors: &Anchors, device: &Device) -> Option<Tensor<3>> {
    let [batch, channels, ..] = raw.levels[0].dims();
    let classes = channels - BOX_CHANNELS;
    let count = anchors.len();
    let mut output = vec![0.0; batch * (4 + classes) * count];
    let mut first = 0;
    for level in &raw.levels {
        let logits = kernels::pixels(level.clone());
        let dims = logits.dims();
        let area = dims[1] * dims[2];
        let logits = logits.try_into_vec_as::<f32>().ok()?;
        let sides = expected_bins(Pixels::dense(&logits, dims), 4, REG_MAX);
        for image in 0..batch {
            let output = &mut output[image * (4 + classes) * count..][..(4 + classes) * count];
            for index in 0..area {
                let anchor = first + index;
                let ([x, y], stride) = (anchors.points_grid[anchor], anchors.strides[anchor]);
                let pixel = image * area + index;
                let &[left, top, right, bottom] = sides[4 * pixel..].first_chunk()?;
                let [x_low, y_low, x_high, y_high] = [x - left, y - top, x + right, y + bottom];
                let center_size = [
                    (x_low + x_high) * 0.5,
                    (y_low + y_high) * 0.5,
                    x_high - x_low,
                    y_high - y_low,
                ];
                for (row, value) in center_size.into_iter().enumerate() {
                    output[row * count + anchor] = value * stride;
                }
                let scores = &logits[pixel * channels + BOX_CHANNELS..][..classes];
                for (class, &score) in scores.iter().enumerate() {
                    output[(4 + class) * count + anchor] = score;
                }
            }
        }
        first += area;
    }
    for output in output.chunks_exact_mut((4 + classes) * count) {
        sigmoids(&mut output[4 * count..]);
    }
    let shape = [batch, 4 + classes, count];
    Some(Tensor::from_data(TensorData::new(output, shape), device))
}

#[cfg(test)]
mod tests {
    use burn::tensor::Distribution;

    use super::*;

    #[test]
    fn decoding_where_the_values_lie_equals_decoding_with_tensors() {
        let device = Device::flex();
        for classes in [1, 3] {
            let levels = [(8, 12), (4, 6), (2, 3)].map(|(height, width)| {
                Tensor::random(
                    [2, BOX_CHANNELS + classes, height, width],
                    Distribution::Normal(0.0, 4.0),
                    &device,
                )
            });
            let raw = RawOutput { levels };
            let anchors = Anchors::new(64, 96);
            let native = decode_native(&raw, &anchors, &device).unwrap();
            let composed = decode_composed(&raw, &anchors, &device);
            native.into_data().assert_approx_eq::<f32>(
                &composed.into_data(),
                burn::tensor::Tolerance::relative(1e-5).set_absolute(1e-4),
            );
        }
    }
}
