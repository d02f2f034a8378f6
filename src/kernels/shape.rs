//! What a convolution is.

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
    /// Every output channel sees the input channel of its number alone.
    pub depthwise: bool,
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
