//! Merging of linear convolutions: two in a row are one, exactly.

use burn::tensor::Tensor;

use crate::kernels::{self, ConvGeometry};

/// The single convolution that equals `second` after `first`, both stride 1 and unpadded.
///
/// Tap `t` of the merged kernel is the sum over `a + b = t` of `second[a] first[b]`, which is
/// itself a convolution of the kernels and differentiable in both.
///
/// # Shapes
/// - `first`: weight `[hidden, channels_in, k1, k1]`, bias `[hidden]`
/// - `second`: weight `[channels_out, hidden, k2, k2]`, bias `[channels_out]`
/// - output: weight `[channels_out, channels_in, k1 + k2 - 1, k1 + k2 - 1]`, bias `[channels_out]`
pub fn compose_convolutions(
    first: (Tensor<4>, Tensor<1>),
    second: (Tensor<4>, Tensor<1>),
) -> (Tensor<4>, Tensor<1>) {
    let [channels_out, hidden, kernel, _] = second.0.dims();
    // The first kernel's input channels become images: [channels_in, k1, k1, hidden].
    let images = first.0.permute([1, 2, 3, 0]);
    let geometry = ConvGeometry {
        stride: 1,
        padding: kernel - 1,
        groups: 1,
    };
    let weight =
        kernels::conv2d(images, second.0.clone().flip([2, 3]), geometry).permute([3, 0, 1, 2]);
    let sums = second
        .0
        .sum_dim(3)
        .sum_dim(2)
        .reshape([channels_out, hidden]);
    let carried = sums
        .matmul(first.1.reshape([hidden, 1]))
        .reshape([channels_out]);
    (weight, second.1 + carried)
}
