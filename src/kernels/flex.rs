//! Kernels of our own on Flex, for 32-bit floats; anything else is composed.

use burn::backend::ops::{FloatTensorOps, ModuleOps};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Flex, TensorMetadata};
use burn::tensor::{DType, TensorData};

use super::chain::{self, Link};
use super::conv;
use super::depthwise;
use super::epilogue::{Activation, Epilogue};
use super::extension::{
    ConvExtent, ConvGeometry, KernelBackend, Residual, Tensors, activate, chain_link_by_link,
    pixels, planes,
};
use super::layout::{self, Pixels};
use super::norm::{self, BatchStatistics};
use super::packed::{self, Algorithm};
use super::pointwise::{self, Source};
use super::pool::{self, TwinInput};
use super::shape::ConvShape;
use super::weight_grad;
use super::windows;

type Tensor = FloatTensor<Flex>;

/// The shape of a convolution, where our kernels cover it.
fn covered(
    input: [usize; 4],
    extent: ConvExtent,
    geometry: ConvGeometry,
    tensors: &[&Tensor],
) -> Option<ConvShape> {
    let [batch, height_in, width_in, channels_in] = input;
    let depthwise = geometry.groups > 1;
    if tensors.iter().any(|tensor| tensor.dtype() != DType::F32)
        || depthwise && (extent.channels_in != 1 || channels_in != extent.channels_out)
        || extent.kernel[0] > windows::MAX_KERNEL
    {
        return None;
    }
    Some(ConvShape {
        batch,
        channels_in,
        channels_out: extent.channels_out,
        height_in,
        width_in,
        kernel: extent.kernel,
        stride: geometry.stride,
        padding: geometry.padding,
        depthwise,
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

/// The tensor's pixels where they lie, if the channels of each lie side by side.
fn view(tensor: &Tensor) -> Option<Pixels<'_>> {
    let [images, height, width, channels] = tensor.shape().dims();
    let layout = tensor.layout();
    let strides: Vec<usize> = layout
        .strides()
        .iter()
        .map(|&stride| usize::try_from(stride).ok())
        .collect::<Option<_>>()?;
    let &[image_stride, row_stride, pixel_stride, channel_stride] = &strides[..] else {
        return None;
    };
    // The stride along an axis of one element means nothing.
    let pixel_stride = match (width, height) {
        (1, 1) => channels,
        (1, _) => row_stride,
        _ => pixel_stride,
    };
    let regular = (channels == 1 || channel_stride == 1)
        && pixel_stride >= channels
        && (height == 1 || row_stride == width * pixel_stride);
    regular.then(|| Pixels {
        data: &tensor.storage::<f32>()[layout.start_offset()..],
        images,
        height,
        width,
        channels,
        pixel_stride,
        image_stride,
    })
}

/// Runs `work` on the tensor's pixels, rearranged where they do not lie side by side.
fn with_pixels<R>(tensor: &Tensor, work: impl FnOnce(Pixels) -> R) -> R {
    if let Some(pixels) = view(tensor) {
        return work(pixels);
    }
    let dims: [usize; 4] = tensor.shape().dims();
    let [images, height, width, channels] = dims;
    let planes = planes::<Flex>(tensor.clone());
    let values = with_values(&planes, |values| {
        layout::interleave(values, [images, channels, height * width])
    });
    work(Pixels::dense(&values, dims))
}

/// The tensor itself if its pixels can be read where they lie, or else a rearranged copy.
fn readable(tensor: Tensor) -> Tensor {
    if view(&tensor).is_some() {
        return tensor;
    }
    let dims: [usize; 4] = tensor.shape().dims();
    let values = with_pixels(&tensor, |pixels| {
        pixels.data[..dims.iter().product()].to_vec()
    });
    self::tensor(values, dims)
}

fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D]) -> Tensor {
    Tensor::from_data(TensorData::new(values, shape))
}

fn output_shape(shape: &ConvShape) -> [usize; 4] {
    [
        shape.batch,
        shape.height_out(),
        shape.width_out(),
        shape.channels_out,
    ]
}

fn extent(weight: &Tensor) -> ConvExtent {
    ConvExtent::of(weight.shape().dims())
}

/// Packs the weights and convolves.
fn forward(
    shape: &ConvShape,
    input: &Tensor,
    weight: &Tensor,
    bias: Option<&Tensor>,
    activation: Activation,
) -> Tensor {
    let algorithm = Algorithm::for_images(shape);
    let packed = with_values(weight, |weight| {
        packed::pack_weights(shape, algorithm, weight)
    });
    let bias = bias.map(|bias| with_values(bias, <[f32]>::to_vec));
    let epilogue = Epilogue {
        bias: bias.as_deref(),
        activation,
        residual: None,
    };
    let values = with_pixels(input, |input| {
        conv::forward(shape, algorithm, &[input.into()], &packed, &epilogue)
    });
    tensor(values, output_shape(shape))
}

impl KernelBackend for Flex {
    fn conv2d_plain(input: Tensor, weight: Tensor, geometry: ConvGeometry) -> Tensor {
        let tensors = [&input, &weight];
        match covered(input.shape().dims(), extent(&weight), geometry, &tensors) {
            Some(shape) => forward(&shape, &input, &weight, None, Activation::None),
            None => pixels::<Self>(Self::conv2d(
                planes::<Self>(input),
                weight,
                None,
                geometry.options(),
            )),
        }
    }

    fn conv2d_bias_act(
        input: Tensor,
        weight: Tensor,
        bias: Tensor,
        geometry: ConvGeometry,
        activation: Activation,
    ) -> Tensor {
        let tensors = [&input, &weight, &bias];
        match covered(input.shape().dims(), extent(&weight), geometry, &tensors) {
            Some(shape) => forward(&shape, &input, &weight, Some(&bias), activation),
            None => pixels::<Self>(activate::<Self>(
                Self::conv2d(
                    planes::<Self>(input),
                    weight,
                    Some(bias),
                    geometry.options(),
                ),
                activation,
            )),
        }
    }

    fn conv2d_pack(weight: Tensor, geometry: ConvGeometry) -> Tensor {
        let extent = extent(&weight);
        // The size of the images plays no part in how weights are packed.
        let channels_in = extent.channels_in * geometry.groups;
        let input = [1, extent.kernel[0], extent.kernel[1], channels_in];
        let Some(shape) = covered(input, extent, geometry, &[&weight]) else {
            let len = weight.shape().num_elements();
            return Self::float_reshape(weight, [len].into());
        };
        let packed = with_values(&weight, |weight| {
            packed::pack_weights(&shape, Algorithm::of(&shape), weight)
        });
        let len = packed.len();
        tensor(packed, [len])
    }

    fn conv2d_packed(
        inputs: Tensors<Self>,
        packed: Tensor,
        bias: Tensor,
        residual: Residual<Self>,
        extent: ConvExtent,
        geometry: ConvGeometry,
        activation: Activation,
    ) -> Tensor {
        let inputs: Vec<Tensor> = inputs.into_vec().into_iter().map(readable).collect();
        let residual = match residual {
            Residual::Of(residual) => Some(readable(residual)),
            Residual::None => None,
        };
        let sources: Vec<Pixels> = inputs.iter().filter_map(view).collect();
        let height = sources
            .iter()
            .map(|source| source.height)
            .max()
            .unwrap_or(0);
        let width = sources.iter().map(|source| source.width).max().unwrap_or(0);
        let sources: Vec<Source> = sources
            .into_iter()
            .map(|pixels| Source {
                pixels,
                doubled: pixels.height != height,
            })
            .collect();
        let channels = sources.iter().map(|source| source.pixels.channels).sum();
        let batch = sources.first().map_or(0, |source| source.pixels.images);
        let dims = [batch, height, width, channels];
        let Some(shape) = covered(dims, extent, geometry, &[&packed, &bias]) else {
            // Weights were left as they are.
            let weight = Self::float_reshape(packed, extent.dims().into());
            let joined = tensor(pointwise::join(&sources, height, width), dims);
            let output = Self::conv2d_bias_act(joined, weight, bias, geometry, activation);
            return match residual {
                Some(residual) => Self::float_add(output, residual),
                None => output,
            };
        };
        let values = with_values(&bias, |bias| {
            with_values(&packed, |packed| {
                let epilogue = Epilogue {
                    bias: Some(bias),
                    activation,
                    residual: residual.as_ref().and_then(view),
                };
                conv::forward(&shape, Algorithm::of(&shape), &sources, packed, &epilogue)
            })
        });
        tensor(values, output_shape(&shape))
    }

    fn conv2d_chain_pool(
        input: Tensor,
        packed: Tensors<Self>,
        biases: Tensors<Self>,
        extents: Vec<ConvExtent>,
        kind: TwinInput,
    ) -> Tensor {
        let (packed, biases) = (packed.into_vec(), biases.into_vec());
        let mut size = input.shape().dims::<4>();
        let is_covered = extents.iter().enumerate().all(|(i, &extent)| {
            let tensors = [&input, &packed[i], &biases[i]];
            let Some(shape) = covered(size, extent, ConvGeometry::PLAIN, &tensors) else {
                return false;
            };
            size = output_shape(&shape);
            true
        });
        if !is_covered {
            return chain_link_by_link::<Self>(input, packed, biases, extents, kind);
        }
        let [packed, biases] = [packed, biases].map(|tensors| {
            let tensors = tensors.iter();
            tensors
                .map(|tensor| with_values(tensor, <[f32]>::to_vec))
                .collect::<Vec<_>>()
        });
        let links: Vec<Link> = extents
            .iter()
            .enumerate()
            .map(|(i, extent)| Link {
                channels_out: extent.channels_out,
                kernel: extent.kernel,
                weights: &packed[i],
                bias: &biases[i],
            })
            .collect();
        let values = with_pixels(&input, |input| chain::forward(input, &links, kind));
        let [batch, height, width, channels] = size;
        let images = match kind {
            TwinInput::Shared => 2 * batch,
            TwinInput::Stacked => batch,
        };
        tensor(values, [images, height / 2, width / 2, channels])
    }

    fn conv2d_input_grad(
        input: Tensor,
        weight: Tensor,
        grad: Tensor,
        geometry: ConvGeometry,
    ) -> Tensor {
        let dims: [usize; 4] = input.shape().dims();
        let tensors = [&input, &weight, &grad];
        let Some(shape) = covered(dims, extent(&weight), geometry, &tensors) else {
            let (input, grad) = (planes::<Self>(input), planes::<Self>(grad));
            return pixels::<Self>(Self::conv2d_x_backward(
                input,
                weight,
                grad,
                geometry.options(),
            ));
        };
        let run = if shape.depthwise {
            depthwise::backward_input
        } else {
            conv::backward_input
        };
        let values = with_pixels(&grad, |grad| {
            with_values(&weight, |weight| run(&shape, grad, weight))
        });
        tensor(values, dims)
    }

    fn conv2d_weight_grad(
        input: Tensor,
        weight: Tensor,
        grad: Tensor,
        geometry: ConvGeometry,
    ) -> Tensor {
        let tensors = [&input, &weight, &grad];
        let Some(shape) = covered(input.shape().dims(), extent(&weight), geometry, &tensors) else {
            let (input, grad) = (planes::<Self>(input), planes::<Self>(grad));
            return Self::conv2d_weight_backward(input, weight, grad, geometry.options());
        };
        let run = if shape.depthwise {
            depthwise::backward_weight
        } else {
            weight_grad::backward_weight
        };
        let values = with_pixels(&input, |input| {
            with_pixels(&grad, |grad| run(&shape, input, grad))
        });
        tensor(values, weight.shape().dims::<4>())
    }

    fn channel_sum(grad: Tensor) -> Tensor {
        let [_, _, _, channels] = grad.shape().dims();
        let sums = with_values(&grad, |grad| norm::channel_sums(channels, grad));
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
        let channels = dims[3];
        let (output, statistics) = with_values(&input, |input| {
            let statistics = norm::statistics(channels, input);
            let output = with_values(&gamma, |gamma| {
                with_values(&beta, |beta| {
                    norm::forward(input, gamma, beta, &statistics, epsilon, activation)
                })
            });
            (output, statistics)
        });
        (
            tensor(output, dims),
            tensor(statistics.mean, [channels]),
            tensor(statistics.variance, [channels]),
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
        let statistics = BatchStatistics {
            mean: with_values(&mean, <[f32]>::to_vec),
            variance: with_values(&variance, <[f32]>::to_vec),
        };
        let [gamma, beta] = [gamma, beta].map(|values| with_values(&values, <[f32]>::to_vec));
        let grads = with_values(&input, |input| {
            with_values(&grad, |grad| {
                norm::backward(input, &gamma, &beta, &statistics, epsilon, activation, grad)
            })
        });
        let channels = [dims[3]];
        (
            tensor(grads.input, dims),
            tensor(grads.gamma, channels),
            tensor(grads.beta, channels),
        )
    }

    fn twin_pool(input: Tensor, kind: TwinInput) -> Tensor {
        let [batch, height, width, channels] = input.shape().dims();
        let images = match kind {
            TwinInput::Shared => 2 * batch,
            TwinInput::Stacked => batch,
        };
        let values = with_pixels(&input, |input| pool::forward(input, kind));
        tensor(values, [images, height / 2, width / 2, channels])
    }

    fn twin_pool_grad(input: Tensor, grad: Tensor, kind: TwinInput) -> Tensor {
        let dims: [usize; 4] = input.shape().dims();
        let values = with_pixels(&input, |input| {
            with_pixels(&grad, |grad| pool::backward(input, grad, kind))
        });
        tensor(values, dims)
    }

    fn local_maximum(input: Tensor, size: usize) -> Tensor {
        let dims: [usize; 4] = input.shape().dims();
        let values = with_pixels(&input, |input| pool::local_maximum(input, size));
        tensor(values, dims)
    }

    fn double(input: Tensor) -> Tensor {
        let [batch, height, width, channels] = input.shape().dims();
        let values = with_pixels(&input, |pixels| {
            let source = Source {
                pixels,
                doubled: true,
            };
            pointwise::join(&[source], 2 * height, 2 * width)
        });
        tensor(values, [batch, 2 * height, 2 * width, channels])
    }

    fn double_grad(grad: Tensor) -> Tensor {
        let [batch, height, width, channels] = grad.shape().dims();
        let values = with_pixels(&grad, pool::window_sums);
        tensor(values, [batch, height / 2, width / 2, channels])
    }
}
