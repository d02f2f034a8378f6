//! Convolution, and the convolution - batch normalisation - activation block of YOLO11.

use burn::config::Config;
use burn::module::{Initializer, Module, Param};
use burn::nn::{BatchNorm, BatchNormConfig};
use burn::tensor::{Device, Tensor};

use crate::kernels::{self, Activation, ConvGeometry, PackedConv};

/// Constant of every batch normalisation in the network.
const BATCH_NORM_EPSILON: f64 = 1e-3;
/// Share of the newest batch in the running statistics.
const BATCH_NORM_MOMENTUM: f64 = 0.03;

/// Settings of a [`Conv`].
#[derive(Config, Debug)]
pub struct ConvConfig {
    channels_in: usize,
    channels_out: usize,
    kernel_size: usize,
    #[config(default = 1)]
    stride: usize,
    #[config(default = 0)]
    padding: usize,
    #[config(default = 1)]
    groups: usize,
    #[config(default = true)]
    bias: bool,
    /// Bound of the uniform weights times the square root of the fan-in. 1 is PyTorch's default;
    /// the square root of 3 keeps the variance through a linear layer, that of 6 through ReLU.
    #[config(default = 1.0)]
    gain: f64,
}

/// A two-dimensional convolution on [`crate::kernels`].
#[derive(Module, Debug)]
pub struct Conv {
    /// `[channels_out, channels_in / groups, kernel, kernel]`.
    pub weight: Param<Tensor<4>>,
    /// `[channels_out]`, absent before a batch normalisation.
    pub bias: Option<Param<Tensor<1>>>,
    /// The weights once more, in the kernels' order; only for inference.
    #[module(skip)]
    packed: Option<PackedConv>,
    #[module(skip)]
    geometry: ConvGeometry,
}

impl ConvConfig {
    /// A convolution with weights uniform in `+-gain / sqrt(fan_in)` and, with the default gain, a
    /// bias alike; with another gain the bias is zero.
    pub fn init(&self, device: &Device) -> Conv {
        let per_group = self.channels_in / self.groups;
        let fan_in = per_group * self.kernel_size * self.kernel_size;
        let bound = 1.0 / (fan_in as f64).sqrt();
        let weights = Initializer::Uniform {
            min: -bound * self.gain,
            max: bound * self.gain,
        };
        let biases = if self.gain == 1.0 {
            Initializer::Uniform {
                min: -bound,
                max: bound,
            }
        } else {
            Initializer::Zeros
        };
        let shape = [
            self.channels_out,
            per_group,
            self.kernel_size,
            self.kernel_size,
        ];
        Conv {
            weight: weights.init(shape, device),
            bias: self.bias.then(|| biases.init([self.channels_out], device)),
            packed: None,
            geometry: ConvGeometry {
                stride: self.stride,
                padding: self.padding,
                groups: self.groups,
            },
        }
    }
}

impl Conv {
    /// Convolves.
    ///
    /// # Shapes
    /// - input: `[batch, height, width, channels_in]`
    /// - output: `[batch, height_out, width_out, channels_out]`
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        self.forward_joined(vec![input], None, Activation::None)
    }

    /// `activation(conv(inputs) + bias) + residual`.
    fn forward_joined(
        &self,
        inputs: Vec<Tensor<4>>,
        residual: Option<Tensor<4>>,
        activation: Activation,
    ) -> Tensor<4> {
        if let (Some(packed), Some(bias)) = (&self.packed, &self.bias) {
            return packed.forward(inputs, bias.val(), residual, activation);
        }
        let input = kernels::join(inputs);
        let weight = self.weight.val();
        let output = match &self.bias {
            Some(bias) => kernels::conv2d_act(input, weight, bias.val(), self.geometry, activation),
            None => kernels::conv2d(input, weight, self.geometry),
        };
        add(output, residual)
    }

    /// The packed weights and the bias, once [`Conv::packed`] has made them.
    pub fn link(&self) -> Option<(&PackedConv, Tensor<1>)> {
        let bias = self.bias.as_ref()?;
        Some((self.packed.as_ref()?, bias.val()))
    }

    /// The same function with its weights packed for inference.
    pub fn packed(mut self) -> Self {
        self.packed = Some(PackedConv::new(self.weight.val(), self.geometry));
        self
    }
}

fn add(output: Tensor<4>, residual: Option<Tensor<4>>) -> Tensor<4> {
    match residual {
        Some(residual) => output + residual,
        None => output,
    }
}

/// Settings of a [`ConvBlock`].
#[derive(Config, Debug)]
pub struct ConvBlockConfig {
    channels_in: usize,
    channels_out: usize,
    #[config(default = 1)]
    kernel_size: usize,
    #[config(default = 1)]
    stride: usize,
    #[config(default = 1)]
    groups: usize,
    /// SiLU, or none ("linear").
    #[config(default = true)]
    activated: bool,
}

/// Convolution without bias, batch normalisation and SiLU: "Conv" in YOLO11's tables.
#[derive(Module, Debug)]
pub struct ConvBlock {
    /// The convolution; it has a bias only once the normalisation is folded into it.
    pub conv: Conv,
    /// The normalisation; absent once folded.
    pub bn: Option<BatchNorm>,
    #[module(skip)]
    activation: Activation,
}

impl ConvBlockConfig {
    /// A block whose output is `ceil(input / stride)` pixels in size.
    pub fn init(&self, device: &Device) -> ConvBlock {
        ConvBlock {
            conv: ConvConfig::new(self.channels_in, self.channels_out, self.kernel_size)
                .with_stride(self.stride)
                .with_padding(self.kernel_size / 2)
                .with_groups(self.groups)
                .with_bias(false)
                .init(device),
            bn: Some(
                BatchNormConfig::new(self.channels_out)
                    .with_epsilon(BATCH_NORM_EPSILON)
                    .with_momentum(BATCH_NORM_MOMENTUM)
                    .init(device),
            ),
            activation: if self.activated {
                Activation::Silu
            } else {
                Activation::None
            },
        }
    }
}

impl ConvBlock {
    /// Convolves, normalises and activates.
    ///
    /// Normalises by the batch's statistics when the input is on an autodiff device and the
    /// normalisation is in training state, by the running statistics otherwise.
    ///
    /// # Shapes
    /// - input: `[batch, height, width, channels_in]`
    /// - output: `[batch, height_out, width_out, channels_out]`
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        self.forward_joined(vec![input], None)
    }

    /// [`ConvBlock::forward`] of several inputs, their channels one behind the other, those of half
    /// the largest height and width doubled; then the residual is added. Folded blocks copy nothing
    /// for it.
    ///
    /// # Shapes
    /// - inputs: `[batch, height, width, channels]` each
    /// - residual and output: `[batch, height_out, width_out, channels_out]`
    pub fn forward_joined(&self, inputs: Vec<Tensor<4>>, residual: Option<Tensor<4>>) -> Tensor<4> {
        let Some(bn) = &self.bn else {
            return self.conv.forward_joined(inputs, residual, self.activation);
        };
        let input = kernels::join(inputs);
        let output = if input.device().is_autodiff() && bn.training.is_enabled() {
            self.forward_train(bn, input)
        } else {
            let (weight, bias) = folded(self.conv.weight.val(), bn);
            kernels::conv2d_act(input, weight, bias, self.conv.geometry, self.activation)
        };
        add(output, residual)
    }

    fn forward_train(&self, bn: &BatchNorm, input: Tensor<4>) -> Tensor<4> {
        let output = self.conv.forward(input);
        let [batch, height, width, _] = output.dims();
        let norm = kernels::batch_norm_act(
            output,
            bn.gamma.val(),
            bn.beta.val(),
            bn.epsilon as f32,
            self.activation,
        );
        // The running variance is the unbiased one, unlike the one that normalises.
        let count = (batch * height * width) as f64;
        let unbiased = norm
            .variance
            .detach()
            .mul_scalar(count / (count - 1.0).max(1.0));
        let mix = |running: Tensor<1>, batch: Tensor<1>| {
            running
                .mul_scalar(1.0 - bn.momentum)
                .add(batch.mul_scalar(bn.momentum))
                .detach()
        };
        bn.running_mean
            .update(mix(bn.running_mean.value_sync(), norm.mean.detach()));
        bn.running_var
            .update(mix(bn.running_var.value_sync(), unbiased));
        norm.output
    }

    /// The same function for inference: the normalisation merged into the convolution, and its
    /// weights packed.
    pub fn folded(mut self) -> Self {
        if let Some(bn) = self.bn.take() {
            let (weight, bias) = folded(self.conv.weight.val(), &bn);
            // Parameters start a graph of their own.
            self.conv.weight = Param::from_tensor(weight.detach());
            self.conv.bias = Some(Param::from_tensor(bias.detach()));
        }
        // Also of a block that is folded already: its weights may be others by now.
        self.conv = self.conv.packed();
        self
    }
}

/// `W' = W gamma / sqrt(var + eps)` and `b' = beta - mean gamma / sqrt(var + eps)`.
fn folded(weight: Tensor<4>, bn: &BatchNorm) -> (Tensor<4>, Tensor<1>) {
    let device = weight.device();
    let mean = bn.running_mean.value_sync().to_device(&device);
    let variance = bn.running_var.value_sync().to_device(&device);
    let scale = bn.gamma.val() / (variance + bn.epsilon).sqrt();
    let bias = bn.beta.val() - mean * scale.clone();
    let [channels] = scale.dims();
    (weight * scale.reshape([channels, 1, 1, 1]), bias)
}
