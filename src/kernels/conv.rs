//! Ungrouped convolution on slices: forward and gradient of the input.
//!
//! A tile holds a few neighbouring positions and two vectors of output channels; its sums stay in
//! registers while all taps and input channels pass by. Input values are broadcast straight from
//! the images, so a pointwise convolution rearranges nothing; larger kernels copy a band of
//! input rows with its zeros into the second-level cache first. How work is split never changes the
//! order of a sum: results are the same for any number of threads.

use super::depthwise;
use super::epilogue::{Epilogue, SharedOutput};
use super::layout::Pixels;
use super::packed::{self, Algorithm, Packed};
use super::pointwise::{self, MAX_SOURCES, Source, join};
use super::shape::ConvShape;
use super::windows::Windows;
use super::winograd;

/// `y = activation(conv(x, w) + b) + residual`, with the sources' channels in sequence as `x`;
/// returns `[batch, height_out, width_out, channels_out]`.
///
/// `weights` are packed by [`packed::pack_weights`] for `algorithm`.
pub fn forward(
    shape: &ConvShape,
    algorithm: Algorithm,
    sources: &[Source],
    weights: &[f32],
    epilogue: &Epilogue,
) -> Vec<f32> {
    let packed = |depth| Packed {
        data: weights,
        channels: shape.channels_out,
        depth,
    };
    if shape.is_pointwise() && algorithm == Algorithm::Direct && sources.len() <= MAX_SOURCES {
        return pointwise::forward(shape, sources, packed(shape.channels_in), epilogue);
    }
    let joined: Vec<f32>;
    let pixels = if let [
        Source {
            pixels,
            doubled: false,
        },
    ] = sources
    {
        *pixels
    } else {
        joined = join(sources, shape.height_in, shape.width_in);
        let dims = [
            shape.batch,
            shape.height_in,
            shape.width_in,
            shape.channels_in,
        ];
        Pixels::dense(&joined, dims)
    };
    match algorithm {
        Algorithm::Depthwise => depthwise::forward(shape, pixels, weights, epilogue),
        Algorithm::Winograd => {
            let depth = winograd::POINTS * shape.channels_in;
            winograd::forward(shape, pixels, packed(depth), epilogue)
        }
        Algorithm::Direct => {
            let windows = Windows::forward(shape);
            let mut output = Vec::with_capacity(shape.batch * shape.output_len());
            windows.run(
                pixels,
                packed(shape.fan_in()),
                epilogue,
                SharedOutput::new(&mut output),
            );
            // SAFETY: the windows' positions are all pixels of the output, which was reserved.
            unsafe { output.set_len(shape.batch * shape.output_len()) };
            output
        }
    }
}

/// Gradient of the input, `[batch, height_in, width_in, channels_in]`; `grad` has the output's
/// size and `weight` its own order.
pub fn backward_input(shape: &ConvShape, grad: Pixels, weight: &[f32]) -> Vec<f32> {
    let ConvShape {
        channels_in,
        channels_out,
        kernel: [kernel_h, kernel_w],
        stride,
        padding,
        ..
    } = *shape;
    let taps = kernel_h * kernel_w;
    let at =
        |channel: usize, c: usize, tap: usize| weight[(c * channels_in + channel) * taps + tap];
    // With stride 1 it is a convolution itself, with the mirrored kernel.
    if stride == 1 && kernel_h == kernel_w && padding < kernel_h {
        let mirrored = ConvShape {
            channels_in: channels_out,
            channels_out: channels_in,
            height_in: shape.height_out(),
            width_in: shape.width_out(),
            padding: kernel_h - 1 - padding,
            ..*shape
        };
        let algorithm = Algorithm::of(&mirrored);
        let packed = if algorithm == Algorithm::Winograd {
            winograd::pack(channels_in, channels_out, |channel, c, tap| {
                at(channel, c, taps - 1 - tap)
            })
        } else {
            packed::pack(channels_in, taps * channels_out, |channel, k| {
                at(channel, k % channels_out, taps - 1 - k / channels_out)
            })
        };
        return forward(
            &mirrored,
            algorithm,
            &[grad.into()],
            &packed,
            &Epilogue::default(),
        );
    }
    // Otherwise one convolution for every phase of the stride: the pixels of a phase see the same
    // taps. Pixels of a phase without taps, and beyond the last window, stay zero.
    let mut output = vec![0.0; shape.batch * shape.input_len()];
    let shared = SharedOutput::new(&mut output);
    for phase in 0..stride * stride {
        let phases = [phase / stride, phase % stride];
        let size = [shape.height_in, shape.width_in];
        let phase_axis = |axis: usize| {
            let r = phases[axis];
            let taps = shape.kernel[axis].saturating_sub(r).div_ceil(stride);
            // Pixel `stride * m + r - padding` sees outputs `m - (taps - 1) ..= m`.
            let first = padding.saturating_sub(r).div_ceil(stride);
            let origin = first * stride + r - padding;
            let count = size[axis].saturating_sub(origin).div_ceil(stride);
            (taps, first, origin, count)
        };
        let [vertical, horizontal] = [phase_axis(0), phase_axis(1)];
        let (rows, columns) = (vertical.0, horizontal.0);
        if rows * columns == 0 || vertical.3 * horizontal.3 == 0 {
            continue;
        }
        let windows = Windows {
            kernel: [rows, columns],
            stride: 1,
            corner: [vertical, horizontal].map(|axis| axis.1 as isize - (axis.0 as isize - 1)),
            positions: [vertical.3, horizontal.3],
            origin: [vertical.2, horizontal.2],
            step: stride,
            output: size,
        };
        let packed = packed::pack(channels_in, rows * columns * channels_out, |channel, k| {
            let (tap, c) = (k / channels_out, k % channels_out);
            let ky = phases[0] + stride * (rows - 1 - tap / columns);
            let kx = phases[1] + stride * (columns - 1 - tap % columns);
            at(channel, c, ky * kernel_w + kx)
        });
        let weights = Packed {
            data: &packed,
            channels: channels_in,
            depth: rows * columns * channels_out,
        };
        windows.run(grad, weights, &Epilogue::default(), shared);
    }
    output
}
