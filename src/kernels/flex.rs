//! Kernels of our own on Flex, for 32-bit floats; anything else is composed.

use burn::backend::ops::ModuleOps;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Flex, TensorMetadata};
use burn::tensor::{DType, TensorData};

use super::conv::{self, Activation};
use super::depthwise;
use super::extension::{ConvGeometry, KernelBackend, activate};
use super::norm::{self, BatchStatistics, NormShape};
use super::pool::{self, TwinInput, TwinShape};
use super::shape::ConvShape;
use super::weight_grad;

type Tensor = FloatTensor<Flex>;

/// The shape, where our kernels cover it.
fn covered(input: &Tensor, weight: &Tensor, geometry: ConvGeometry) -> Option<ConvShape> {
    if input.dtype() != DType::F32 || weight.dtype() != DType::F32 {
        return None;
    }
    let [batch, channels_in, height_in, width_in] = input.shape().dims();
    let [channels_out, per_group, kernel_h, kernel_w] = weight.shape().dims();
    let depthwise = geometry.groups > 1;
    if depthwise && (per_group != 1 || channels_in != channels_out) {
        return None;
    }
    Some(ConvShape {
        batch,
        channels_in,
        channels_out,
        height_in,
        width_in,
        kernel: [kernel_h, kernel_w],
        stride: geometry.stride,
        padding: geometry.padding,
    })
}

/// Runs `work` on the tensor's values in row-major order.
fn with_values<R>(tensor: &Tensor, work: impl FnOnce(&[f32]) -> R) -> R {
    if let Some((start, end)) = tensor.layout().contiguous_offsets() {
        return work(&tensor.storage::<f32>()[start..end]);
    }
    let tensor = tensor.to_contiguous();
    let len = tensor.shape().num_elements();
    work(&tensor.storage::<f32>()[..len])
}

fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D]) -> Tensor {
    Tensor::from_data(TensorData::new(values, shape))
}

fn output_shape(shape: &ConvShape) -> [usize; 4] {
    [
        shape.batch,
        shape.channels_out,
        shape.height_out(),
        shape.width_out(),
    ]
}

fn forward(
    shape: &ConvShape,
    geometry: ConvGeometry,
    input: &Tensor,
    weight: &Tensor,
    bias: Option<&Tensor>,
    activation: Activation,
) -> Tensor {
    let run = if geometry.groups > 1 {
        depthwise::forward
    } else {
        conv::forward
    };
    let values = with_values(input, |input| {
        with_values(weight, |weight| match bias {
            None => run(shape, input, weight, None, activation),
            Some(bias) => with_values(bias, |bias| {
                run(shape, input, weight, Some(bias), activation)
            }),
        })
    });
    tensor(values, output_shape(shape))
}

impl KernelBackend for Flex {
    fn conv2d_plain(input: Tensor, weight: Tensor, geometry: ConvGeometry) -> Tensor {
        match covered(&input, &weight, geometry) {
            Some(shape) => forward(&shape, geometry, &input, &weight, None, Activation::None),
            None => Self::conv2d(input, weight, None, geometry.options()),
        }
    }

    fn conv2d_bias_act(
        input: Tensor,
        weight: Tensor,
        bias: Tensor,
        geometry: ConvGeometry,
        activation: Activation,
    ) -> Tensor {
        match covered(&input, &weight, geometry) {
            Some(shape) => forward(&shape, geometry, &input, &weight, Some(&bias), activation),
            None => activate::<Self>(
                Self::conv2d(input, weight, Some(bias), geometry.options()),
                activation,
            ),
        }
    }

    fn conv2d_input_grad(
        input: Tensor,
        weight: Tensor,
        grad: Tensor,
        geometry: ConvGeometry,
    ) -> Tensor {
        let Some(shape) = covered(&input, &weight, geometry) else {
            return Self::conv2d_x_backward(input, weight, grad, geometry.options());
        };
        let run = if geometry.groups > 1 {
            depthwise::backward_input
        } else {
            conv::backward_input
        };
        let values = with_values(&grad, |grad| {
            with_values(&weight, |weight| run(&shape, grad, weight))
        });
        tensor(
            values,
            [
                shape.batch,
                shape.channels_in,
                shape.height_in,
                shape.width_in,
            ],
        )
    }

    fn conv2d_weight_grad(
        input: Tensor,
        weight: Tensor,
        grad: Tensor,
        geometry: ConvGeometry,
    ) -> Tensor {
        let Some(shape) = covered(&input, &weight, geometry) else {
            return Self::conv2d_weight_backward(input, weight, grad, geometry.options());
        };
        let run = if geometry.groups > 1 {
            depthwise::backward_weight
        } else {
            weight_grad::backward_weight
        };
        let values = with_values(&input, |input| {
            with_values(&grad, |grad| run(&shape, input, grad))
        });
        tensor(values, weight.shape().dims::<4>())
    }

    fn channel_sum(grad: Tensor) -> Tensor {
        let [_, channels, height, width] = grad.shape().dims();
        let sums = with_values(&grad, |grad| {
            norm::channel_sums(channels, height * width, grad)
        });
        tensor(sums, [channels])
    }

    fn batch_norm_act(
        input: Tensor,
        gamma: Tensor,
        beta: Tensor,
        epsilon: f32,
        activation: Activation,
    ) -> (Tensor, Tensor, Tensor) {
        let dims: [usize; 4] = input.shape().dims();
        let shape = NormShape {
            channels: dims[1],
            area: dims[2] * dims[3],
        };
        let (output, statistics) = with_values(&input, |input| {
            let statistics = norm::statistics(shape, input);
            let output = with_values(&gamma, |gamma| {
                with_values(&beta, |beta| {
                    norm::forward(shape, input, gamma, beta, &statistics, epsilon, activation)
                })
            });
            (output, statistics)
        });
        (
            tensor(output, dims),
            tensor(statistics.mean, [shape.channels]),
            tensor(statistics.variance, [shape.channels]),
        )
    }

    fn batch_norm_act_grad(
        input: Tensor,
        gamma: Tensor,
        beta: Tensor,
        mean: Tensor,
        variance: Tensor,
        grad: Tensor,
        epsilon: f32,
        activation: Activation,
    ) -> (Tensor, Tensor, Tensor) {
        let dims: [usize; 4] = input.shape().dims();
        let shape = NormShape {
            channels: dims[1],
            area: dims[2] * dims[3],
        };
        let statistics = BatchStatistics {
            mean: with_values(&mean, <[f32]>::to_vec),
            variance: with_values(&variance, <[f32]>::to_vec),
        };
        let [gamma, beta] = [gamma, beta].map(|values| with_values(&values, <[f32]>::to_vec));
        let grads = with_values(&input, |input| {
            with_values(&grad, |grad| {
                norm::backward(
                    shape,
                    input,
                    &gamma,
                    &beta,
                    &statistics,
                    epsilon,
                    activation,
                    grad,
                )
            })
        });
        (
            tensor(grads.input, dims),
            tensor(grads.gamma, [shape.channels]),
            tensor(grads.beta, [shape.channels]),
        )
    }

    fn twin_pool(input: Tensor, kind: TwinInput) -> Tensor {
        let [batch, channels, height, width] = input.shape().dims();
        let shape = TwinShape {
            planes: batch * channels,
            size: [height, width],
            input: kind,
        };
        let batch_out = if kind == TwinInput::Shared {
            2 * batch
        } else {
            batch
        };
        let [rows, columns] = shape.pooled();
        let values = with_values(&input, |input| pool::forward(&shape, input));
        tensor(values, [batch_out, channels, rows, columns])
    }

    fn twin_pool_grad(input: Tensor, grad: Tensor, kind: TwinInput) -> Tensor {
        let dims: [usize; 4] = input.shape().dims();
        let [batch, channels, height, width] = dims;
        let shape = TwinShape {
            planes: batch * channels,
            size: [height, width],
            input: kind,
        };
        let values = with_values(&input, |input| {
            with_values(&grad, |grad| pool::backward(&shape, input, grad))
        });
        tensor(values, dims)
    }
}
