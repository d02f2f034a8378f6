//! The backend extension: the operations, and how they are composed where a backend has no kernels
//! of its own.
#![allow(
    deprecated,
    reason = "ndarray stays selectable for as long as Burn ships it"
)]

use burn::backend::ops::{ConvOptions, InterpolateMode, InterpolateOptions};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, ExtensionType, TensorMetadata, backend_extension};
use burn::tensor::{IntDType, Shape, Slice};

use super::bands::{longest_sum, weight_grad_by_bands};
use super::epilogue::Activation;
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
    /// Stride 1, no padding, one group.
    pub const PLAIN: Self = Self {
        stride: 1,
        padding: 0,
        groups: 1,
    };

    /// As Burn's own options.
    pub(super) fn options(self) -> ConvOptions<2> {
        ConvOptions::new([self.stride; 2], [self.padding; 2], [1; 2], self.groups)
    }
}

/// Extent of a convolution's weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ConvExtent {
    /// Output channels.
    pub channels_out: usize,
    /// Input channels that an output channel sees.
    pub channels_in: usize,
    /// Kernel height and width.
    pub kernel: [usize; 2],
}

impl ConvExtent {
    /// The extent of weights `[channels_out, channels_in, kernel_h, kernel_w]`.
    pub fn of([channels_out, channels_in, kernel_h, kernel_w]: [usize; 4]) -> Self {
        Self {
            channels_out,
            channels_in,
            kernel: [kernel_h, kernel_w],
        }
    }

    pub(super) fn dims(self) -> [usize; 4] {
        let [kernel_h, kernel_w] = self.kernel;
        [self.channels_out, self.channels_in, kernel_h, kernel_w]
    }
}

/// A few tensors in order, such as the inputs of a convolution.
#[derive(ExtensionType)]
pub enum Tensors<B: Backend> {
    /// One alone.
    One(FloatTensor<B>),
    /// Two.
    Two(FloatTensor<B>, FloatTensor<B>),
    /// Three.
    Three(FloatTensor<B>, FloatTensor<B>, FloatTensor<B>),
    /// Four.
    Four(
        FloatTensor<B>,
        FloatTensor<B>,
        FloatTensor<B>,
        FloatTensor<B>,
    ),
}

impl<B: Backend> Tensors<B> {
    /// Most tensors.
    pub const MOST: usize = 4;

    /// All of them; None where there are none or too many.
    pub fn from_vec(tensors: Vec<FloatTensor<B>>) -> Option<Self> {
        let mut tensors = tensors.into_iter();
        let first = tensors.next()?;
        match std::array::from_fn(|_| tensors.next()) {
            [None, None, None, None] => Some(Self::One(first)),
            [Some(b), None, None, None] => Some(Self::Two(first, b)),
            [Some(b), Some(c), None, None] => Some(Self::Three(first, b, c)),
            [Some(b), Some(c), Some(d), None] => Some(Self::Four(first, b, c, d)),
            _ => None,
        }
    }

    /// The tensors in order.
    pub fn into_vec(self) -> Vec<FloatTensor<B>> {
        match self {
            Self::One(a) => vec![a],
            Self::Two(a, b) => vec![a, b],
            Self::Three(a, b, c) => vec![a, b, c],
            Self::Four(a, b, c, d) => vec![a, b, c, d],
        }
    }
}

/// What is added to a convolution's output.
#[derive(ExtensionType)]
pub enum Residual<B: Backend> {
    /// Nothing.
    None,
    /// A tensor of the output's shape.
    Of(FloatTensor<B>),
}

/// Operations that a backend may do in one piece; the defaults compose Burn's own.
///
/// Images are `[batch, height, width, channels]`, weights `[channels_out, channels_in / groups,
/// kernel_h, kernel_w]`.
#[backend_extension(
    Flex: cfg(feature = "flex"),
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(any(feature = "wgpu", feature = "cuda")),
    Remote: cfg(feature = "remote"),
    Autodiff
)]
pub trait KernelBackend: Backend {
    /// Convolution alone.
    fn conv2d_plain(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        geometry: ConvGeometry,
    ) -> FloatTensor<Self> {
        let output = Self::conv2d(planes::<Self>(input), weight, None, geometry.options());
        pixels::<Self>(output)
    }

    /// Convolution, bias and activation.
    fn conv2d_bias_act(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        geometry: ConvGeometry,
        activation: Activation,
    ) -> FloatTensor<Self> {
        let input = planes::<Self>(input);
        let output = Self::conv2d(input, weight, Some(bias), geometry.options());
        pixels::<Self>(activate::<Self>(output, activation))
    }

    /// Weights in the form that [`KernelBackend::conv2d_packed`] takes, of one dimension.
    #[allow(
        unused_variables,
        reason = "the kernels' packing depends on the geometry"
    )]
    fn conv2d_pack(weight: FloatTensor<Self>, geometry: ConvGeometry) -> FloatTensor<Self> {
        let len = weight.shape().num_elements();
        Self::float_reshape(weight, Shape::new([len]))
    }

    /// `activation(conv(inputs) + bias) + residual` with packed weights, for inference. The
    /// inputs' channels follow one another; inputs of half the first one's size are doubled.
    fn conv2d_packed(
        #[extension_type] inputs: Tensors<Self>,
        packed: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        #[extension_type] residual: Residual<Self>,
        extent: ConvExtent,
        geometry: ConvGeometry,
        activation: Activation,
    ) -> FloatTensor<Self> {
        let weight = Self::float_reshape(packed, Shape::from(extent.dims()));
        let input = join::<Self>(inputs.into_vec());
        let output = Self::conv2d_bias_act(input, weight, bias, geometry, activation);
        match residual {
            Residual::Of(residual) => Self::float_add(output, residual),
            Residual::None => output,
        }
    }

    /// Unpadded convolutions with stride 1, one after the other, each with packed weights and a bias,
    /// then [`KernelBackend::twin_pool`]; for inference.
    fn conv2d_chain_pool(
        input: FloatTensor<Self>,
        #[extension_type] packed: Tensors<Self>,
        #[extension_type] biases: Tensors<Self>,
        extents: Vec<ConvExtent>,
        kind: TwinInput,
    ) -> FloatTensor<Self> {
        chain_link_by_link::<Self>(input, packed.into_vec(), biases.into_vec(), extents, kind)
    }

    /// Gradient of a convolution's input.
    fn conv2d_input_grad(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        geometry: ConvGeometry,
    ) -> FloatTensor<Self> {
        let (input, grad) = (planes::<Self>(input), planes::<Self>(grad));
        pixels::<Self>(Self::conv2d_x_backward(
            input,
            weight,
            grad,
            geometry.options(),
        ))
    }

    /// Gradient of a convolution's weights.
    fn conv2d_weight_grad(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        geometry: ConvGeometry,
    ) -> FloatTensor<Self> {
        let (input, grad) = (planes::<Self>(input), planes::<Self>(grad));
        weight_grad_by_bands::<Self>(input, &weight, grad, geometry, longest_sum())
    }

    /// Gradient of a convolution's bias: the sum of the output's gradient over all but channels.
    fn channel_sum(grad: FloatTensor<Self>) -> FloatTensor<Self> {
        let channels = grad.shape()[3];
        let sums = Self::float_sum_dim(Self::float_sum_dim(Self::float_sum_dim(grad, 0), 1), 2);
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
        let input = planes::<Self>(input);
        let norm = Self::batch_norm_train(input, gamma, beta, f64::from(epsilon));
        (
            pixels::<Self>(activate::<Self>(norm.output, activation)),
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
        let (input, grad) = (planes::<Self>(input), planes::<Self>(grad));
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
        (
            pixels::<Self>(grads.x_grad),
            grads.gamma_grad,
            grads.beta_grad,
        )
    }

    /// 2x2 pooling and ReLU of both pathways, stacked along the batch.
    fn twin_pool(input: FloatTensor<Self>, kind: TwinInput) -> FloatTensor<Self> {
        let (kernel, stride, padding) = POOL;
        let (a, b) = pathways::<Self>(planes::<Self>(input), kind);
        let a = Self::max_pool2d(a, kernel, stride, padding, [1, 1], false);
        let b = Self::avg_pool2d(b, kernel, stride, padding, true, false);
        pixels::<Self>(Self::relu(Self::float_cat(vec![a, b], 0)))
    }

    /// Gradient of [`KernelBackend::twin_pool`].
    fn twin_pool_grad(
        input: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        kind: TwinInput,
    ) -> FloatTensor<Self> {
        let (kernel, stride, padding) = POOL;
        let (a, b) = pathways::<Self>(planes::<Self>(input), kind);
        let (grad_a, grad_b) = halves::<Self>(planes::<Self>(grad));
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
        pixels::<Self>(match kind {
            TwinInput::Shared => Self::float_add(grad_a, grad_b),
            TwinInput::Stacked => Self::float_cat(vec![grad_a, grad_b], 0),
        })
    }

    /// Maximum of the `size x size` pixels around each pixel.
    fn local_maximum(input: FloatTensor<Self>, size: usize) -> FloatTensor<Self> {
        let padding = [size / 2; 2];
        let input = planes::<Self>(input);
        pixels::<Self>(Self::max_pool2d(
            input,
            [size; 2],
            [1, 1],
            padding,
            [1, 1],
            false,
        ))
    }

    /// Every pixel four times: twice the height and width.
    fn double(input: FloatTensor<Self>) -> FloatTensor<Self> {
        let [_, height, width, _] = input.shape().dims();
        let nearest = InterpolateOptions::new(InterpolateMode::Nearest);
        let input = planes::<Self>(input);
        pixels::<Self>(Self::interpolate(input, [2 * height, 2 * width], nearest))
    }

    /// Gradient of [`KernelBackend::double`]: the sum of each 2x2 window.
    fn double_grad(grad: FloatTensor<Self>) -> FloatTensor<Self> {
        let (kernel, stride, padding) = POOL;
        let mean = Self::avg_pool2d(planes::<Self>(grad), kernel, stride, padding, true, false);
        pixels::<Self>(Self::float_mul_scalar(mean, 4.0.into()))
    }
}

/// `[batch, channels, height, width]`, as Burn's operations want it.
pub(super) fn planes<B: Backend>(pixels: FloatTensor<B>) -> FloatTensor<B> {
    B::float_permute(pixels, &[0, 3, 1, 2])
}

/// `[batch, height, width, channels]`, as the kernels want it.
pub(super) fn pixels<B: Backend>(planes: FloatTensor<B>) -> FloatTensor<B> {
    B::float_permute(planes, &[0, 2, 3, 1])
}

/// All channels of several inputs, those of half the first one's size doubled.
fn join<B: KernelBackend>(inputs: Vec<FloatTensor<B>>) -> FloatTensor<B> {
    let height = inputs.iter().map(|input| input.shape()[1]).max();
    let inputs: Vec<_> = inputs
        .into_iter()
        .map(|input| {
            if Some(input.shape()[1]) == height {
                input
            } else {
                B::double(input)
            }
        })
        .collect();
    B::float_cat(inputs, 3)
}

/// [`KernelBackend::conv2d_chain_pool`] from one convolution at a time.
pub(super) fn chain_link_by_link<B: KernelBackend>(
    input: FloatTensor<B>,
    packed: Vec<FloatTensor<B>>,
    biases: Vec<FloatTensor<B>>,
    extents: Vec<ConvExtent>,
    kind: TwinInput,
) -> FloatTensor<B> {
    let links = packed.into_iter().zip(biases).zip(extents);
    let output = links.fold(input, |x, ((packed, bias), extent)| {
        let (x, residual) = (Tensors::One(x), Residual::None);
        let (geometry, activation) = (ConvGeometry::PLAIN, Activation::None);
        B::conv2d_packed(x, packed, bias, residual, extent, geometry, activation)
    });
    B::twin_pool(output, kind)
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
pub(super) fn activate<B: Backend>(x: FloatTensor<B>, activation: Activation) -> FloatTensor<B> {
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

// A worker composes the operations of its own backend's.
#[cfg(feature = "remote")]
impl KernelBackend for burn::backend::Remote {}
