//! The operations that both networks spend their time in, as a Burn backend extension.
//!
//! They run on every backend: composed from Burn's own operations in general, and as kernels of our
//! own on Flex, the default CPU backend.
//!
//! Images are `[batch, height, width, channels]` here, unlike in Burn's own operations: with the
//! channels innermost one register-tiled product serves convolutions of every kernel and stride,
//! both gradients and Winograd's algorithm, without a column matrix, and joining or splitting
//! channels needs no copy. [`pixels`] and [`planes`] lead from one order to the other.
//!
//! `unsafe` code lives in this module only.
#![allow(
    clippy::inline_always,
    reason = "code compiled for a vector width must be inlined into the function that enables it"
)]
#![allow(
    clippy::needless_range_loop,
    reason = "indices name the rows and columns of register tiles, several arrays at a time"
)]
#![allow(
    unsafe_code,
    reason = "vector loads and disjoint parallel stores; each block says why it is sound"
)]

#[cfg(target_arch = "x86_64")]
mod avx512;
pub(crate) mod bands;
pub mod chain;
pub mod conv;
pub mod depthwise;
pub mod epilogue;
pub mod expectation;
mod extension;
#[cfg(feature = "flex")]
mod flex;
mod gradients;
pub mod layout;
mod memory;
pub mod norm;
pub mod packed;
pub mod pointwise;
pub mod pool;
pub mod shape;
pub mod simd;
pub mod weight_grad;
mod windows;
pub mod winograd;
mod winograd_grad;

use burn::backend::Dispatch;
use burn::tensor::{Device, Tensor};

pub use epilogue::Activation;
pub use extension::{ConvExtent, ConvGeometry, KernelBackend, Residual, Tensors};
pub use memory::keep_freed_memory;
pub use pool::TwinInput;

/// Whether tensors on the device are in the processor's memory and go through our own kernels.
pub fn is_native(device: &Device) -> bool {
    #[cfg(feature = "flex")]
    if *device == Device::flex() {
        return true;
    }
    let _ = device;
    false
}

/// Runs a network's forward pass where its kernels start fastest: on a thread of the pool that they
/// share their work out to, if the device has kernels of our own.
///
/// From another thread every kernel would hand its work over and sleep until it is done: two
/// changes of threads, a hundred times in a small detector. Passes that record gradients stay on
/// their thread, since Burn's running statistics belong to the thread that updates them.
pub fn on_pool<R: Send>(device: &Device, work: impl FnOnce() -> R + Send) -> R {
    if is_native(device) && !device.is_autodiff() {
        rayon::scope(|_| work())
    } else {
        work()
    }
}

/// Convolution without bias or activation, differentiable.
///
/// # Shapes
/// - `input`: `[batch, height, width, channels_in]`
/// - `weight`: `[channels_out, channels_in / groups, kernel_h, kernel_w]`
/// - output: `[batch, height_out, width_out, channels_out]`
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

/// A convolution's weights in the order in which the device's kernels read them: made once, for
/// inference.
#[derive(Debug, Clone)]
pub struct PackedConv {
    packed: Tensor<1>,
    extent: ConvExtent,
    geometry: ConvGeometry,
}

impl PackedConv {
    /// Packs weights `[channels_out, channels_in / groups, kernel_h, kernel_w]`.
    pub fn new(weight: Tensor<4>, geometry: ConvGeometry) -> Self {
        let extent = ConvExtent::of(weight.dims());
        let packed = <Dispatch as KernelBackend>::conv2d_pack(weight.into_dispatch(), geometry);
        Self {
            packed: Tensor::from_dispatch(packed),
            extent,
            geometry,
        }
    }

    /// `activation(conv(inputs) + bias) + residual`.
    ///
    /// Nothing is copied to join the inputs where the convolution is pointwise.
    ///
    /// # Shapes
    /// - `inputs`: `[batch, height, width, channels]` each; their channels follow one another, and
    ///   those of half the height and width are doubled
    /// - `bias`: `[channels_out]`
    /// - `residual` and output: `[batch, height_out, width_out, channels_out]`
    pub fn forward(
        &self,
        inputs: Vec<Tensor<4>>,
        bias: Tensor<1>,
        residual: Option<Tensor<4>>,
        activation: Activation,
    ) -> Tensor<4> {
        let parts = if inputs.len() > Tensors::<Dispatch>::MOST {
            vec![join(inputs)]
        } else {
            inputs
        };
        let parts = parts.into_iter().map(Tensor::into_dispatch).collect();
        let Some(parts) = Tensors::from_vec(parts) else {
            unreachable!("a convolution has an input");
        };
        let residual = residual.map_or(Residual::None, |residual| {
            Residual::Of(residual.into_dispatch())
        });
        let output = <Dispatch as KernelBackend>::conv2d_packed(
            parts,
            self.packed.clone().into_dispatch(),
            bias.into_dispatch(),
            residual,
            self.extent,
            self.geometry,
            activation,
        );
        Tensor::from_dispatch(output)
    }
}

/// Unpadded convolutions with stride 1, one after the other, then [`twin_pool`], for inference.
///
/// The kernels of the default device compute a few rows at a time of everything; no convolution's
/// output is written to memory as a whole.
///
/// # Shapes
/// - `input`: `[batch, height, width, channels]`, or twice the batch when stacked
/// - `links`: packed weights and biases `[channels_out]`, at least one
/// - output: `[2 batch, height / 2, width / 2, channels]` of the last convolution's output
pub fn conv2d_chain_pool(
    input: Tensor<4>,
    links: &[(&PackedConv, Tensor<1>)],
    kind: TwinInput,
) -> Tensor<4> {
    let tensors = |tensor: &dyn Fn(&(&PackedConv, Tensor<1>)) -> Tensor<1>| {
        let tensors = links.iter().map(|link| tensor(link).into_dispatch());
        Tensors::from_vec(tensors.collect())
    };
    let packed = tensors(&|(conv, _)| conv.packed.clone());
    let biases = tensors(&|(_, bias)| bias.clone());
    let (Some(packed), Some(biases)) = (packed, biases) else {
        // Longer chains go link by link.
        let output = links.iter().fold(input, |x, (conv, bias)| {
            conv.forward(vec![x], bias.clone(), None, Activation::None)
        });
        return twin_pool(output, kind);
    };
    let extents = links.iter().map(|(conv, _)| conv.extent).collect();
    let output = <Dispatch as KernelBackend>::conv2d_chain_pool(
        input.into_dispatch(),
        packed,
        biases,
        extents,
        kind,
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
/// - `input` and output: `[batch, height, width, channels]`
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
/// - `input`: `[batch, height, width, channels]`, or twice the batch when stacked
/// - output: `[2 batch, height / 2, width / 2, channels]`, maximum pathway first
pub fn twin_pool(input: Tensor<4>, kind: TwinInput) -> Tensor<4> {
    Tensor::from_dispatch(<Dispatch as KernelBackend>::twin_pool(
        input.into_dispatch(),
        kind,
    ))
}

/// Maximum of the `size x size` pixels around each pixel (`size` odd), differentiable.
///
/// # Shapes
/// - `input` and output: `[batch, height, width, channels]`
pub fn local_maximum(input: Tensor<4>, size: usize) -> Tensor<4> {
    Tensor::from_dispatch(<Dispatch as KernelBackend>::local_maximum(
        input.into_dispatch(),
        size,
    ))
}

/// All channels of several inputs, those of half the largest height and width doubled;
/// differentiable.
///
/// # Shapes
/// - `inputs`: `[batch, height, width, channels]` each
/// - output: `[batch, height, width, all channels]`
pub fn join(inputs: Vec<Tensor<4>>) -> Tensor<4> {
    let height = inputs.iter().map(|input| input.dims()[1]).max();
    let inputs = inputs.into_iter().map(|input| {
        if Some(input.dims()[1]) == height {
            input
        } else {
            double(input)
        }
    });
    Tensor::cat(inputs.collect(), 3)
}

/// Every pixel four times, differentiable.
///
/// # Shapes
/// - `input`: `[batch, height, width, channels]`
/// - output: `[batch, 2 height, 2 width, channels]`
pub fn double(input: Tensor<4>) -> Tensor<4> {
    Tensor::from_dispatch(<Dispatch as KernelBackend>::double(input.into_dispatch()))
}

/// From `[batch, channels, height, width]` to `[batch, height, width, channels]`.
pub fn pixels(planes: Tensor<4>) -> Tensor<4> {
    planes.permute([0, 2, 3, 1])
}

/// From `[batch, height, width, channels]` to `[batch, channels, height, width]`.
pub fn planes(pixels: Tensor<4>) -> Tensor<4> {
    pixels.permute([0, 3, 1, 2])
}
