//! Burn's gradient of a convolution's weights, a few images or rows at a time.

use std::sync::atomic::{AtomicUsize, Ordering};

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata};
use burn::tensor::Slice;

use super::extension::ConvGeometry;

/// Set by [`limit_sums`].
static LONGEST_SUM: AtomicUsize = AtomicUsize::new(usize::MAX);

/// From now on, lets Burn's gradients of weights add up at most so many products in one go.
///
/// Mesa's software adapter ends a shader's loops after 65,535 rounds in all, without a word, and
/// what it returns then is wrong by up to 90 %. Bands of 16,384 outputs come out right there.
#[cfg(feature = "wgpu")]
pub(crate) fn limit_sums(longest: usize) {
    LONGEST_SUM.fetch_min(longest.max(1), Ordering::Relaxed);
}

/// Most products that are added up in one go.
pub(super) fn longest_sum() -> usize {
    LONGEST_SUM.load(Ordering::Relaxed)
}

/// The gradient of a convolution's weights as a sum over images, and over bands of rows where one
/// image alone has more than `longest` outputs. Input and gradient are `[batch, channels, height,
/// width]`.
///
/// A gradient is a sum over all outputs, so any division of them gives the same up to rounding.
pub(super) fn weight_grad_by_bands<B: Backend>(
    input: FloatTensor<B>,
    weight: &FloatTensor<B>,
    grad: FloatTensor<B>,
    geometry: ConvGeometry,
    longest: usize,
) -> FloatTensor<B> {
    let [batch, _, height, width] = grad.shape().dims::<4>();
    if batch * height * width <= longest {
        return B::conv2d_weight_backward(input, weight.clone(), grad, geometry.options());
    }
    let images = (longest / (height * width)).clamp(1, batch);
    let rows = (longest / (images * width)).clamp(1, height);
    let input = padded::<B>(input, geometry.padding);
    let plain = ConvGeometry {
        padding: 0,
        ..geometry
    };
    let kernel_height = weight.shape()[2];
    let mut sum: Option<FloatTensor<B>> = None;
    for first_image in (0..batch).step_by(images) {
        let image_range = first_image..(first_image + images).min(batch);
        for first_row in (0..height).step_by(rows) {
            let row_range = first_row..(first_row + rows).min(height);
            // The rows of the input that these rows of the output have seen.
            let start = row_range.start * geometry.stride;
            let end = (row_range.end - 1) * geometry.stride + kernel_height;
            let input = part::<B>(&input, image_range.clone(), start..end);
            let grad = part::<B>(&grad, image_range.clone(), row_range);
            let band = B::conv2d_weight_backward(input, weight.clone(), grad, plain.options());
            sum = Some(match sum {
                Some(sum) => B::float_add(sum, band),
                None => band,
            });
        }
    }
    sum.unwrap_or_else(|| unreachable!("more outputs than the longest sum are some outputs"))
}

/// Some images and rows of a tensor.
fn part<B: Backend>(
    tensor: &FloatTensor<B>,
    images: std::ops::Range<usize>,
    rows: std::ops::Range<usize>,
) -> FloatTensor<B> {
    let [_, channels, _, width] = tensor.shape().dims::<4>();
    B::float_slice(
        tensor.clone(),
        &[
            Slice::from(images),
            Slice::from(0..channels),
            Slice::from(rows),
            Slice::from(0..width),
        ],
    )
}

/// A tensor with zeros around each image.
fn padded<B: Backend>(tensor: FloatTensor<B>, padding: usize) -> FloatTensor<B> {
    if padding == 0 {
        return tensor;
    }
    let [batch, channels, height, width] = tensor.shape().dims::<4>();
    let zeros = |height: usize, width: usize| {
        let shape = [batch, channels, height, width].into();
        let (device, dtype) = (tensor.device(), tensor.dtype());
        B::float_zeros(shape, &device, dtype.into())
    };
    let (beside, above) = (zeros(height, padding), zeros(padding, width + 2 * padding));
    let wide = B::float_cat(vec![beside.clone(), tensor.clone(), beside], 3);
    B::float_cat(vec![above.clone(), wide, above], 2)
}
