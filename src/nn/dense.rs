//! Fully connected layer with weights in `[outputs, inputs]` order.

use burn::config::Config;
use burn::module::{Initializer, Module, Param};
use burn::tensor::{Device, Tensor};

/// Settings of a [`Dense`].
#[derive(Config, Debug)]
pub struct DenseConfig {
    inputs: usize,
    outputs: usize,
    /// Bound of the uniform weights times the square root of the inputs; see
    /// [`ConvConfig`](super::ConvConfig).
    #[config(default = 1.0)]
    gain: f64,
}

/// `x W^T + b`.
#[derive(Module, Debug)]
pub struct Dense {
    /// `[outputs, inputs]`.
    pub weight: Param<Tensor<2>>,
    /// `[outputs]`.
    pub bias: Param<Tensor<1>>,
}

impl DenseConfig {
    /// A layer with weights uniform in `+-gain / sqrt(inputs)` and zero bias.
    pub fn init(&self, device: &Device) -> Dense {
        let bound = self.gain / (self.inputs as f64).sqrt();
        let initializer = Initializer::Uniform {
            min: -bound,
            max: bound,
        };
        Dense {
            weight: initializer.init([self.outputs, self.inputs], device),
            bias: Initializer::Zeros.init([self.outputs], device),
        }
    }
}

impl Dense {
    /// # Shapes
    /// - input: `[batch, inputs]`
    /// - output: `[batch, outputs]`
    pub fn forward(&self, input: Tensor<2>) -> Tensor<2> {
        input.matmul(self.weight.val().transpose()) + self.bias.val().unsqueeze()
    }
}
