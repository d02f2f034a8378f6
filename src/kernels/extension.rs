//! The backend extension: what each backend does, and how gradients flow.
#![allow(
    deprecated,
    reason = "ndarray stays selectable for as long as Burn ships it"
)]

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::ops::ConvOptions;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, TensorMetadata, backend_extension};
use burn::tensor::{IntDType, Shape, Slice};

use super::conv::Activation;
use super::pool::TwinInput;

/// Stride, padding and groups of a convolution, the same along both axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ConvGeometry {
    /// Distance of two outputs, pixels.
    pub stride: usize,
    /// Zeros on each of the four sides.
    pub padding: usize,
    /// 1, or the number of channels for a depthwise convolution.
    pub groups: usize,
}

impl ConvGeometry {
    /// As Burn's own options.
    fn options(self) -> ConvOptions<2> {
        ConvOptions::new([self.stride; 2], [self.padding; 2], [1; 2], self.groups)
    }
}

/// Operations that a backend may do in one piece; the defaults compose Burn's own.
#[backend_extension(
    Flex: cfg(feature = "flex"),
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(any(feature = "wgpu", feature = "cuda")),
    Autodiff
)]
pub trait KernelBackend: Backend {
    /// Convolution alone.
    fn conv2d_plain(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        geometry: ConvGeometry,
    ) -> FloatTensor<Self> {
        Self::conv2d(input, weight, None, geometry.options())
    }

    /// Convolution, bias and activation.
    fn conv2d_bias_act(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        geometry: ConvGeometry,
        activation: Activation,
    ) -> FloatTensor<Self> {
        let output = Self::conv2d(input, weight, Some(bias), geometry.options());
        activate::<Self>(output, activation)
    }

    /// Gradient of a convolution's input.
    fn conv2d_input_grad(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        geometry: ConvGeometry,
    ) -> FloatTensor<Self> {
        Self::conv2d_x_backward(input, weight, grad, geometry.options())
    }

    /// Gradient of a convolution's weights.
    fn conv2d_weight_grad(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        geometry: ConvGeometry,
    ) -> FloatTensor<Self> {
        Self::conv2d_weight_backward(input, weight, grad, geometry.options())
    }

    /// Gradient of a convolution's bias: the sum of the output's gradient over all but channels.
    fn channel_sum(grad: FloatTensor<Self>) -> FloatTensor<Self> {
        let channels = grad.shape()[1];
        let sums = Self::float_sum_dim(Self::float_sum_dim(Self::float_sum_dim(grad, 0), 2), 3);
        Self::float_reshape(sums, Shape::new([channels]))
    }

    /// Batch normalisation by the batch's statistics and activation; also mean and variance.
    fn batch_norm_act(
        input: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        epsilon: f32,
        activation: Activation,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        let norm = Self::batch_norm_train(input, gamma, beta, f64::from(epsilon));
        (
            activate::<Self>(norm.output, activation),
            norm.mean,
            norm.variance,
        )
    }

    /// Gradients of [`KernelBackend::batch_norm_act`]: input, gamma, beta.
    #[allow(
        clippy::too_many_arguments,
        reason = "a forward pass and the gradient of its output"
    )]
    fn batch_norm_act_grad(
        input: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        epsilon: f32,
        activation: Activation,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        let epsilon = f64::from(epsilon);
        let before = Self::batch_norm(
            input.clone(),
            gamma.clone(),
            beta,
            mean.clone(),
            variance.clone(),
            epsilon,
        );
        let grad = activate_grad::<Self>(before, grad, activation);
        let grads = Self::batch_norm_train_backward(input, gamma, mean, variance, epsilon, grad);
        (grads.x_grad, grads.gamma_grad, grads.beta_grad)
    }

    /// 2x2 pooling and ReLU of both pathways, stacked along the batch.
    fn twin_pool(input: FloatTensor<Self>, kind: TwinInput) -> FloatTensor<Self> {
        let (kernel, stride, padding) = POOL;
        let (a, b) = pathways::<Self>(input, kind);
        let a = Self::max_pool2d(a, kernel, stride, padding, [1, 1], false);
        let b = Self::avg_pool2d(b, kernel, stride, padding, true, false);
        Self::relu(Self::float_cat(vec![a, b], 0))
    }

    /// Gradient of [`KernelBackend::twin_pool`].
    fn twin_pool_grad(
        input: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        kind: TwinInput,
    ) -> FloatTensor<Self> {
        let (kernel, stride, padding) = POOL;
        let (a, b) = pathways::<Self>(input, kind);
        let (grad_a, grad_b) = halves::<Self>(grad);
        let dilation = [1, 1];
        let pooled = Self::max_pool2d_with_indices(
            a.clone(),
            kernel,
            stride,
            padding,
            dilation,
            false,
            IntDType::I32,
        );
        let grad_a = Self::relu_backward(pooled.output, grad_a);
        let grad_a = Self::max_pool2d_with_indices_backward(
            a,
            kernel,
            stride,
            padding,
            dilation,
            false,
            grad_a,
            pooled.indices,
        )
        .x_grad;
        let mean = Self::avg_pool2d(b.clone(), kernel, stride, padding, true, false);
        let grad_b = Self::relu_backward(mean, grad_b);
        let grad_b = Self::avg_pool2d_backward(b, grad_b, kernel, stride, padding, true, false);
        match kind {
            TwinInput::Shared => Self::float_add(grad_a, grad_b),
            TwinInput::Stacked => Self::float_cat(vec![grad_a, grad_b], 0),
        }
    }
}

/// Settings of every pooling in the ranging network, as Burn's operations take them.
const POOL: ([usize; 2], [usize; 2], [usize; 2]) = ([2, 2], [2, 2], [0, 0]);

/// The inputs of the maximum and the average pathway.
fn pathways<B: Backend>(
    tensor: FloatTensor<B>,
    kind: TwinInput,
) -> (FloatTensor<B>, FloatTensor<B>) {
    match kind {
        TwinInput::Shared => (tensor.clone(), tensor),
        TwinInput::Stacked => halves::<B>(tensor),
    }
}

/// The first and the second half along the batch.
fn halves<B: Backend>(tensor: FloatTensor<B>) -> (FloatTensor<B>, FloatTensor<B>) {
    let shape = tensor.shape();
    let half = shape[0] / 2;
    let slices = |start: usize| {
        let rest = shape.iter().skip(1).map(|&side| Slice::from(0..side));
        std::iter::once(Slice::from(start..start + half))
            .chain(rest)
            .collect::<Vec<_>>()
    };
    (
        B::float_slice(tensor.clone(), &slices(0)),
        B::float_slice(tensor, &slices(half)),
    )
}

/// The activation from Burn's own operations.
fn activate<B: Backend>(x: FloatTensor<B>, activation: Activation) -> FloatTensor<B> {
    match activation {
        Activation::None => x,
        Activation::Relu => B::relu(x),
        Activation::Silu => B::float_mul(x.clone(), B::sigmoid(x)),
    }
}

/// The gradient before the activation, from the one after it; `x` is the activation's argument.
fn activate_grad<B: Backend>(
    x: FloatTensor<B>,
    grad: FloatTensor<B>,
    activation: Activation,
) -> FloatTensor<B> {
    match activation {
        Activation::None => grad,
        Activation::Relu => B::relu_backward(x, grad),
        Activation::Silu => {
            // d(x s)/dx = s + x s (1 - s) with s = sigmoid(x)
            let s = B::sigmoid(x.clone());
            let rest = B::float_add_scalar(B::float_neg(s.clone()), 1.0.into());
            let slope = B::float_add(s.clone(), B::float_mul(x, B::float_mul(s, rest)));
            B::float_mul(grad, slope)
        }
    }
}

#[cfg(feature = "ndarray")]
impl KernelBackend for burn::backend::NdArray {}

#[cfg(any(feature = "wgpu", feature = "cuda"))]
impl KernelBackend for burn::backend::Cube {}

impl<B: KernelBackend, C: CheckpointStrategy> KernelBackend for Autodiff<B, C> {
    fn conv2d_plain(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        geometry: ConvGeometry,
    ) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct Conv;

        impl<B: KernelBackend> Backward<B, 2> for Conv {
            type State = (FloatTensor<B>, FloatTensor<B>, ConvGeometry);

            fn backward(
                self,
                ops: Ops<Self::State, 2>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let [node_input, node_weight] = ops.parents;
                let grad = grads.consume::<B>(&ops.node);
                let (input, weight, geometry) = ops.state;
                if let Some(node) = node_input {
                    let input_grad =
                        B::conv2d_input_grad(input.clone(), weight.clone(), grad.clone(), geometry);
                    grads.register::<B>(node.id, input_grad);
                }
                if let Some(node) = node_weight {
                    grads.register::<B>(
                        node.id,
                        B::conv2d_weight_grad(input, weight, grad, geometry),
                    );
                }
            }
        }

        match Conv
            .prepare::<C>([input.node(), weight.node()])
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => {
                let (input, weight) = (input.into_primitive(), weight.into_primitive());
                let output = B::conv2d_plain(input.clone(), weight.clone(), geometry);
                prep.finish((input, weight, geometry), output)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::conv2d_plain(
                input.into_primitive(),
                weight.into_primitive(),
                geometry,
            )),
        }
    }

    fn conv2d_bias_act(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        geometry: ConvGeometry,
        activation: Activation,
    ) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct ConvBias;

        impl<B: KernelBackend> Backward<B, 3> for ConvBias {
            type State = (FloatTensor<B>, FloatTensor<B>, ConvGeometry);

            fn backward(
                self,
                ops: Ops<Self::State, 3>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let [node_input, node_weight, node_bias] = ops.parents;
                let grad = grads.consume::<B>(&ops.node);
                let (input, weight, geometry) = ops.state;
                if let Some(node) = node_bias {
                    grads.register::<B>(node.id, B::channel_sum(grad.clone()));
                }
                if let Some(node) = node_input {
                    let input_grad =
                        B::conv2d_input_grad(input.clone(), weight.clone(), grad.clone(), geometry);
                    grads.register::<B>(node.id, input_grad);
                }
                if let Some(node) = node_weight {
                    grads.register::<B>(
                        node.id,
                        B::conv2d_weight_grad(input, weight, grad, geometry),
                    );
                }
            }
        }

        let output = match ConvBias
            .prepare::<C>([input.node(), weight.node(), bias.node()])
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => {
                let (input, weight) = (input.into_primitive(), weight.into_primitive());
                let output = B::conv2d_bias_act(
                    input.clone(),
                    weight.clone(),
                    bias.into_primitive(),
                    geometry,
                    Activation::None,
                );
                prep.finish((input, weight, geometry), output)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::conv2d_bias_act(
                input.into_primitive(),
                weight.into_primitive(),
                bias.into_primitive(),
                geometry,
                Activation::None,
            )),
        };
        activate::<Self>(output, activation)
    }

    fn batch_norm_act(
        input: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        epsilon: f32,
        activation: Activation,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        #[derive(Debug)]
        struct NormAct;

        impl<B: KernelBackend> Backward<B, 3> for NormAct {
            /// Input, gamma, beta, mean, variance.
            type State = ([FloatTensor<B>; 5], f32, Activation);

            fn backward(
                self,
                ops: Ops<Self::State, 3>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let grad = grads.consume::<B>(&ops.node);
                let ([input, gamma, beta, mean, variance], epsilon, activation) = ops.state;
                let (input_grad, gamma_grad, beta_grad) = B::batch_norm_act_grad(
                    input, gamma, beta, mean, variance, grad, epsilon, activation,
                );
                for (node, grad) in ops
                    .parents
                    .into_iter()
                    .zip([input_grad, gamma_grad, beta_grad])
                {
                    if let Some(node) = node {
                        grads.register::<B>(node.id, grad);
                    }
                }
            }
        }

        let prepared = NormAct
            .prepare::<C>([input.node(), gamma.node(), beta.node()])
            .compute_bound()
            .stateful();
        #[allow(
            clippy::redundant_closure_for_method_calls,
            reason = "the method's type is not exported"
        )]
        let [input, gamma, beta] = [input, gamma, beta].map(|tensor| tensor.into_primitive());
        let (output, mean, variance) = B::batch_norm_act(
            input.clone(),
            gamma.clone(),
            beta.clone(),
            epsilon,
            activation,
        );
        let output = match prepared {
            OpsKind::Tracked(prep) => {
                let state = [input, gamma, beta, mean.clone(), variance.clone()];
                prep.finish((state, epsilon, activation), output)
            }
            OpsKind::UnTracked(prep) => prep.finish(output),
        };
        (
            output,
            <Self as burn::backend::AutodiffBackend>::from_inner(mean),
            <Self as burn::backend::AutodiffBackend>::from_inner(variance),
        )
    }

    fn twin_pool(input: FloatTensor<Self>, kind: TwinInput) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct TwinPool;

        impl<B: KernelBackend> Backward<B, 1> for TwinPool {
            type State = (FloatTensor<B>, TwinInput);

            fn backward(
                self,
                ops: Ops<Self::State, 1>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let grad = grads.consume::<B>(&ops.node);
                let (input, kind) = ops.state;
                if let [Some(node)] = ops.parents {
                    grads.register::<B>(node.id, B::twin_pool_grad(input, grad, kind));
                }
            }
        }

        match TwinPool
            .prepare::<C>([input.node()])
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => {
                let input = input.into_primitive();
                prep.finish((input.clone(), kind), B::twin_pool(input, kind))
            }
            OpsKind::UnTracked(prep) => prep.finish(B::twin_pool(input.into_primitive(), kind)),
        }
    }
}

#[cfg(feature = "flex")]
mod flex {
    //! Kernels of our own on Flex, for 32-bit floats; anything else is composed.

    use burn::backend::ops::ModuleOps;
    use burn::backend::tensor::FloatTensor;
    use burn::backend::{Flex, TensorMetadata};
    use burn::tensor::{DType, TensorData};

    use super::super::conv::{self, Activation};
    use super::super::depthwise;
    use super::super::norm::{self, BatchStatistics, NormShape};
    use super::super::pool::{self, TwinInput, TwinShape};
    use super::super::shape::ConvShape;
    use super::super::weight_grad;
    use super::{ConvGeometry, KernelBackend};

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
                None => super::activate::<Self>(
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
}
