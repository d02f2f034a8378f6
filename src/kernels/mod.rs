//! The operations that both networks spend their time in, as a Burn backend extension.
//!
//! [`conv2d`], [`conv2d_act`] and [`batch_norm_act`] run on every backend: composed from Burn's
//! own operations in general, and as kernels of our own on Flex, the default CPU backend. The
//! kernels need no column matrix: [`PlaneLayout`](shape::PlaneLayout) pads the input once so that
//! every tap of a convolution reads contiguous memory, and one register-tiled product serves the
//! forward pass, the input's gradient and every stride.
//!
//! `unsafe` code lives in this module only.
#![allow(
    clippy::inline_always,
    reason = "code compiled for a vector width must be inlined into the function that enables it"
)]
#![allow(
    unsafe_code,
    reason = "vector loads and disjoint parallel stores; each block says why it is sound"
)]

pub mod conv;
pub mod depthwise;
mod extension;
#[cfg(feature = "flex")]
mod flex;
mod gradients;
mod memory;
pub mod norm;
pub mod pool;
pub mod shape;
pub mod simd;
pub mod weight_grad;

use burn::backend::Dispatch;
use burn::tensor::Tensor;

pub use conv::Activation;
pub use extension::{ConvGeometry, KernelBackend};
pub use memory::keep_freed_memory;
pub use pool::TwinInput;

/// Convolution without bias or activation, differentiable.
///
/// # Shapes
/// - `input`: `[batch, channels_in, height, width]`
/// - `weight`: `[channels_out, channels_in / groups, kernel_h, kernel_w]`
/// - output: `[batch, channels_out, height_out, width_out]`
pub fn conv2d(input: Tensor<4>, weight: Tensor<4>, geometry: ConvGeometry) -> Tensor<4> {
    let output = <Dispatch as KernelBackend>::conv2d_plain(
        input.into_dispatch(),
        weight.into_dispatch(),
        geometry,
    );
    Tensor::from_dispatch(output)
}

/// Convolution with bias and activation in one pass over the output.
///
/// # Shapes
/// As [`conv2d`], with `bias` `[channels_out]`.
pub fn conv2d_act(
    input: Tensor<4>,
    weight: Tensor<4>,
    bias: Tensor<1>,
    geometry: ConvGeometry,
    activation: Activation,
) -> Tensor<4> {
    let output = <Dispatch as KernelBackend>::conv2d_bias_act(
        input.into_dispatch(),
        weight.into_dispatch(),
        bias.into_dispatch(),
        geometry,
        activation,
    );
    Tensor::from_dispatch(output)
}

/// What [`batch_norm_act`] returns.
#[derive(Debug, Clone)]
pub struct NormOutput {
    /// Normalised and activated, in the input's shape.
    pub output: Tensor<4>,
    /// Mean of the batch, `[channels]`; carries no gradient.
    pub mean: Tensor<1>,
    /// Biased variance of the batch, `[channels]`; carries no gradient.
    pub variance: Tensor<1>,
}

/// Batch normalisation by the batch's own statistics, then the activation, differentiable.
///
/// # Shapes
/// - `input` and output: `[batch, channels, height, width]`
/// - `gamma`, `beta`: `[channels]`
pub fn batch_norm_act(
    input: Tensor<4>,
    gamma: Tensor<1>,
    beta: Tensor<1>,
    epsilon: f32,
    activation: Activation,
) -> NormOutput {
    let (output, mean, variance) = <Dispatch as KernelBackend>::batch_norm_act(
        input.into_dispatch(),
        gamma.into_dispatch(),
        beta.into_dispatch(),
        epsilon,
        activation,
    );
    NormOutput {
        output: Tensor::from_dispatch(output),
        mean: Tensor::from_dispatch(mean),
        variance: Tensor::from_dispatch(variance),
    }
}

/// 2x2 pooling with stride 2 and ReLU of both pathways of the ranging network, differentiable.
///
/// # Shapes
/// - `input`: `[batch, channels, height, width]`, or twice the batch when stacked
/// - output: `[2 batch, channels, height / 2, width / 2]`, maximum pathway first
pub fn twin_pool(input: Tensor<4>, kind: TwinInput) -> Tensor<4> {
    Tensor::from_dispatch(<Dispatch as KernelBackend>::twin_pool(
        input.into_dispatch(),
        kind,
    ))
}
