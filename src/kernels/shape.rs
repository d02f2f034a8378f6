//! What a convolution is, and how its input is laid out so that no column matrix is ever built.

/// Floats that may be read past the last plane by a vector of the widest kind.
const SLACK: usize = 128;

/// A two-dimensional convolution without dilation, ungrouped or fully depthwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ConvShape {
    /// Images.
    pub batch: usize,
    /// Channels of the input.
    pub channels_in: usize,
    /// Channels of the output.
    pub channels_out: usize,
    /// Input height.
    pub height_in: usize,
    /// Input width.
    pub width_in: usize,
    /// Kernel height and width.
    pub kernel: [usize; 2],
    /// Stride of both axes.
    pub stride: usize,
    /// Zeros on each of the four sides.
    pub padding: usize,
}

impl ConvShape {
    /// Output height.
    pub fn height_out(&self) -> usize {
        (self.height_in + 2 * self.padding - self.kernel[0]) / self.stride + 1
    }

    /// Output width.
    pub fn width_out(&self) -> usize {
        (self.width_in + 2 * self.padding - self.kernel[1]) / self.stride + 1
    }

    /// Elements of one input image.
    pub fn input_len(&self) -> usize {
        self.channels_in * self.height_in * self.width_in
    }

    /// Elements of one output image.
    pub fn output_len(&self) -> usize {
        self.channels_out * self.height_out() * self.width_out()
    }

    /// Weights of one output channel of an ungrouped convolution.
    pub fn fan_in(&self) -> usize {
        self.channels_in * self.kernel[0] * self.kernel[1]
    }

    /// The input can be read where it lies.
    pub fn is_pointwise(&self) -> bool {
        self.kernel == [1, 1] && self.stride == 1 && self.padding == 0
    }
}

/// Padded input planes of one image, one per channel and stride phase.
///
/// Every tap of the kernel then reads a *contiguous* run of a plane: output position `p`
/// (row-major with the planes' own pitch) needs element `offset(tap) + p`, for any stride. The
/// few positions between the output's width and the pitch are computed and dropped. With stride 1
/// the zeros on a row's right are the zeros on the next row's left.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PlaneLayout {
    /// Stride of the convolution: there are `stride * stride` phases.
    pub stride: usize,
    /// Zeros before the first row and column.
    pub padding: usize,
    /// Rows of a plane.
    pub rows: usize,
    /// Distance of two rows.
    pub pitch: usize,
    /// Size of the images that are laid out.
    pub image: [usize; 2],
    /// Images whose planes of one channel and phase lie one behind the other.
    pub images: usize,
}

impl PlaneLayout {
    /// The layout of a convolution's input.
    pub fn new(shape: &ConvShape) -> Self {
        let [kernel_h, kernel_w] = shape.kernel;
        let stride = shape.stride;
        let extra = (kernel_w - 1) / stride;
        // Zeros shared by neighbouring rows are possible only where a plane is not split.
        let shared = if stride == 1 {
            shape.padding.min(extra)
        } else {
            0
        };
        Self {
            stride,
            padding: shape.padding,
            rows: shape.height_out() + (kernel_h - 1) / stride,
            pitch: shape.width_out() + extra - shared,
            image: [shape.height_in, shape.width_in],
            images: 1,
        }
    }

    /// Elements of one plane.
    pub fn plane_len(&self) -> usize {
        self.rows * self.pitch
    }

    /// Elements of the planes of one channel.
    pub fn channel_len(&self) -> usize {
        self.plane_len() * self.images * self.stride * self.stride
    }

    /// Elements of a buffer for this many channels, with room for reads past the end.
    pub fn buffer_len(&self, channels: usize) -> usize {
        self.channel_len() * channels + SLACK
    }

    /// Where tap (`ky`, `kx`) of a channel's kernel reads for output position 0.
    pub fn offset(&self, channel: usize, ky: usize, kx: usize) -> usize {
        let s = self.stride;
        let phase = (ky % s) * s + kx % s;
        channel * self.channel_len()
            + phase * self.plane_len() * self.images
            + (ky / s) * self.pitch
            + kx / s
    }

    /// Positions from the first output to the last one.
    pub fn positions(&self, height_out: usize, width_out: usize) -> usize {
        (height_out - 1) * self.pitch + width_out
    }

    /// Lays out one channel (`height * width` values) of image number `image` into its planes.
    pub fn fill_channel(&self, input: &[f32], image: usize, planes: &mut [f32]) {
        let [height, width] = self.image;
        let (s, padding) = (self.stride, self.padding);
        let planes = planes
            .chunks_exact_mut(self.plane_len())
            .skip(image)
            .step_by(self.images);
        for (phase, plane) in planes.enumerate() {
            let (phase_y, phase_x) = (phase / s, phase % s);
            // First column of the plane that holds a pixel, and the pixel it holds.
            let first = padding.saturating_sub(phase_x).div_ceil(s).min(self.pitch);
            let first_x = first * s + phase_x - padding;
            let count = width
                .saturating_sub(first_x)
                .div_ceil(s)
                .min(self.pitch - first);
            for (row, values) in plane.chunks_exact_mut(self.pitch).enumerate() {
                let y = (row * s + phase_y).wrapping_sub(padding);
                if y >= height || count == 0 {
                    values.fill(0.0);
                    continue;
                }
                values[..first].fill(0.0);
                values[first + count..].fill(0.0);
                let source = &input[y * width + first_x..(y + 1) * width];
                if s == 1 {
                    values[first..first + count].copy_from_slice(&source[..count]);
                } else {
                    for (value, pixel) in values[first..first + count]
                        .iter_mut()
                        .zip(source.iter().step_by(s))
                    {
                        *value = *pixel;
                    }
                }
            }
        }
    }

    /// Lays out [`PlaneLayout::images`] whole images of so many channels; `planes` is resized to
    /// [`PlaneLayout::buffer_len`].
    pub fn fill(&self, input: &[f32], channels: usize, planes: &mut Vec<f32>) {
        planes.resize(self.buffer_len(channels), 0.0);
        let used = self.channel_len() * channels;
        let area = self.image[0] * self.image[1];
        for (index, source) in input.chunks_exact(area).enumerate() {
            let (image, channel) = (index / channels, index % channels);
            let target = &mut planes[channel * self.channel_len()..][..self.channel_len()];
            self.fill_channel(source, image, target);
        }
        planes[used..].fill(0.0);
    }
}

/// Where computed positions go: position (row, column) of the planes' pitch is pixel
/// (`origin + step * row`, ...) of the image, if it lies inside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OutputMap {
    /// Distance of two rows of positions.
    pub pitch: usize,
    /// Rows and columns of positions that mean something.
    pub extent: [usize; 2],
    /// Pixel of position (0, 0); may lie outside.
    pub origin: [isize; 2],
    /// Pixels between neighbouring positions.
    pub step: usize,
    /// Height and width of the image.
    pub image: [usize; 2],
}

/// A run of positions and the pixels they become.
#[derive(Debug, Clone, Copy, Default)]
pub struct Segment {
    /// First value of the run within its tile.
    pub source: usize,
    /// First pixel within its plane.
    pub target: usize,
    /// Length of the run.
    pub len: usize,
}

impl OutputMap {
    /// Positions from the first to the last meaningful one.
    pub fn positions(&self) -> usize {
        (self.extent[0] - 1) * self.pitch + self.extent[1]
    }

    /// Cuts the positions `start..start + len` into runs that stay in one row; returns how many.
    pub fn segments(&self, start: usize, len: usize, segments: &mut [Segment]) -> usize {
        let [height, width] = self.image.map(|v| v as isize);
        let step = self.step as isize;
        let mut count = 0;
        let mut position = start;
        let end = (start + len).min(self.positions());
        while position < end {
            let (row, column) = (position / self.pitch, position % self.pitch);
            let run = (self.pitch - column).min(end - position);
            let y = self.origin[0] + step * row as isize;
            // Columns whose pixel lies in 0..width.
            let low = (-self.origin[1]).max(0).unsigned_abs().div_ceil(self.step);
            let high = ((width - self.origin[1] + step - 1).max(0) / step).unsigned_abs();
            let from = column.max(low);
            let to = (column + run).min(self.extent[1]).min(high);
            if (0..height).contains(&y) && from < to {
                let x = self.origin[1] + step * from as isize;
                segments[count] = Segment {
                    source: position - start + from - column,
                    target: (y * width + x).unsigned_abs(),
                    len: to - from,
                };
                count += 1;
            }
            position += run;
        }
        count
    }
}
