//! Depthwise convolution on slices: one small kernel per channel, no sums over channels.

use rayon::prelude::*;

use super::conv::{Activation, sum};
use super::shape::{ConvShape, OutputMap, PlaneLayout, Segment};
use super::simd;

/// Positions worked on at a time; small enough that sums stay in the first-level cache.
const RUN: usize = 512;

/// `y = activation(depthwise_conv(x, w) + b)`; `weight` is `[channels, 1, kernel_h, kernel_w]`.
pub fn forward(
    shape: &ConvShape,
    input: &[f32],
    weight: &[f32],
    bias: Option<&[f32]>,
    activation: Activation,
) -> Vec<f32> {
    let layout = PlaneLayout::new(shape);
    let offsets = offsets(shape, &layout);
    let (height_out, width_out) = (shape.height_out(), shape.width_out());
    let map = OutputMap {
        pitch: layout.pitch,
        extent: [height_out, width_out],
        origin: [0, 0],
        step: 1,
        image: [height_out, width_out],
    };
    let mut output = vec![0.0; shape.batch * shape.output_len()];
    output
        .par_chunks_exact_mut(height_out * width_out)
        .zip(input.par_chunks_exact(shape.height_in * shape.width_in))
        .enumerate()
        .for_each_init(Vec::new, |planes, (index, (out, plane))| {
            let channel = index % shape.channels_out;
            layout.fill(plane, 1, planes);
            let weight = &weight[channel * offsets.len()..][..offsets.len()];
            let bias = bias.map_or(0.0, |bias| bias[channel]);
            simd::vectorized(|| taps(planes, &offsets, weight, bias, activation, &map, out));
        });
    output
}

/// Gradient of the input.
pub fn backward_input(shape: &ConvShape, grad: &[f32], weight: &[f32]) -> Vec<f32> {
    let [kernel_h, kernel_w] = shape.kernel;
    let (height_out, width_out) = (shape.height_out(), shape.width_out());
    // Seen from the gradient: a convolution with the mirrored kernel over the gradient spread out
    // by the stride.
    let spread = [
        (height_out - 1) * shape.stride + 1,
        (width_out - 1) * shape.stride + 1,
    ];
    let mirrored = ConvShape {
        height_in: spread[0],
        width_in: spread[1],
        stride: 1,
        padding: kernel_h.max(kernel_w) - 1,
        ..*shape
    };
    let layout = PlaneLayout::new(&mirrored);
    let reach = mirrored.padding;
    let mut offsets = Vec::new();
    for ky in 0..kernel_h {
        for kx in 0..kernel_w {
            offsets.push(layout.offset(0, reach - ky, reach - kx));
        }
    }
    let map = OutputMap {
        pitch: layout.pitch,
        extent: [
            (shape.height_in + shape.padding).min(spread[0] + kernel_h - 1),
            (shape.width_in + shape.padding).min(spread[1] + kernel_w - 1),
        ],
        origin: [-(shape.padding as isize); 2],
        step: 1,
        image: [shape.height_in, shape.width_in],
    };
    let mut output = vec![0.0; shape.batch * shape.input_len()];
    output
        .par_chunks_exact_mut(shape.height_in * shape.width_in)
        .zip(grad.par_chunks_exact(height_out * width_out))
        .enumerate()
        .for_each_init(
            || (Vec::new(), vec![0.0; spread[0] * spread[1]]),
            |(planes, spread_grad), (index, (out, plane))| {
                let channel = index % shape.channels_out;
                if shape.stride == 1 {
                    layout.fill(plane, 1, planes);
                } else {
                    for (y, row) in plane.chunks_exact(width_out).enumerate() {
                        for (x, value) in row.iter().enumerate() {
                            spread_grad[y * shape.stride * spread[1] + x * shape.stride] = *value;
                        }
                    }
                    layout.fill(spread_grad, 1, planes);
                }
                let weight = &weight[channel * offsets.len()..][..offsets.len()];
                simd::vectorized(|| {
                    taps(planes, &offsets, weight, 0.0, Activation::None, &map, out);
                });
            },
        );
    output
}

/// Gradient of the weights, `[channels, 1, kernel_h, kernel_w]`.
pub fn backward_weight(shape: &ConvShape, input: &[f32], grad: &[f32]) -> Vec<f32> {
    let layout = PlaneLayout::new(shape);
    let offsets = offsets(shape, &layout);
    let (height_out, width_out) = (shape.height_out(), shape.width_out());
    let (area_in, area_out) = (shape.height_in * shape.width_in, height_out * width_out);
    let mut gradient = vec![0.0; shape.channels_out * offsets.len()];
    gradient
        .par_chunks_exact_mut(offsets.len())
        .enumerate()
        .for_each_init(Vec::new, |planes, (channel, sums)| {
            let mut products = vec![0.0; width_out];
            for image in 0..shape.batch {
                let plane = image * shape.channels_out + channel;
                layout.fill(&input[plane * area_in..][..area_in], 1, planes);
                let grad = &grad[plane * area_out..][..area_out];
                simd::vectorized(|| {
                    for (total, &offset) in sums.iter_mut().zip(&offsets) {
                        products.fill(0.0);
                        for (y, row) in grad.chunks_exact(width_out).enumerate() {
                            let values = &planes[offset + y * layout.pitch..][..width_out];
                            for ((product, value), grad) in products.iter_mut().zip(values).zip(row)
                            {
                                *product += value * grad;
                            }
                        }
                        *total += sum(&products);
                    }
                });
            }
        });
    gradient
}

fn offsets(shape: &ConvShape, layout: &PlaneLayout) -> Vec<usize> {
    let [kernel_h, kernel_w] = shape.kernel;
    (0..kernel_h * kernel_w)
        .map(|tap| layout.offset(0, tap / kernel_w, tap % kernel_w))
        .collect()
}

/// Weighted sum of shifted planes for every position of one channel.
#[inline(always)]
fn taps(
    planes: &[f32],
    offsets: &[usize],
    weight: &[f32],
    bias: f32,
    activation: Activation,
    map: &OutputMap,
    out: &mut [f32],
) {
    let mut sums = [0.0_f32; RUN];
    let mut segments = [Segment::default(); RUN];
    let total = map.positions();
    let mut start = 0;
    while start < total {
        let len = RUN.min(total - start);
        let sums = &mut sums[..len];
        sums.fill(bias);
        for (&offset, &weight) in offsets.iter().zip(weight) {
            let values = &planes[offset + start..offset + start + len];
            for (sum, value) in sums.iter_mut().zip(values) {
                *sum += weight * value;
            }
        }
        if activation == Activation::Silu {
            for x in sums.iter_mut() {
                *x *= simd::sigmoid(*x);
            }
        } else if activation == Activation::Relu {
            for x in sums.iter_mut() {
                *x = x.max(0.0);
            }
        }
        let count = map.segments(start, len, &mut segments);
        for segment in &segments[..count] {
            out[segment.target..segment.target + segment.len]
                .copy_from_slice(&sums[segment.source..segment.source + segment.len]);
        }
        start += len;
    }
}
