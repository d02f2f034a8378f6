//! The YOLO11 network: backbone, neck and head, layer by layer as published.

use burn::config::Config;
use burn::module::Module;
use burn::tensor::{Device, Tensor};

use super::config::Scale;
use super::head::{Head, HeadConfig, RawOutput};
use crate::kernels;
use crate::nn::{
    C2psa, C2psaConfig, C3k2, C3k2Config, ConvBlock, ConvBlockConfig, Sppf, SppfConfig,
};

/// Settings of a [`Yolo11`].
#[derive(Config, Debug)]
pub struct Yolo11Config {
    /// Size.
    pub scale: Scale,
    /// Number of classes.
    pub classes: usize,
    /// Width of the head's class branch where it is not the usual one, as after loading weights
    /// that were trained for another number of classes.
    #[config(default = "None")]
    pub class_width: Option<usize>,
}

/// Is shown the number and the output of a layer.
type Observer<'a> = &'a mut dyn FnMut(usize, &Tensor<4>);

/// The detector. Field `layerN` is layer N of the published table; the layers in between
/// (up-sampling and concatenation) hold no weights.
#[derive(Module, Debug)]
#[allow(
    missing_docs,
    reason = "the fields are numbered as in the published table"
)]
pub struct Yolo11 {
    pub layer0: ConvBlock,
    pub layer1: ConvBlock,
    pub layer2: C3k2,
    pub layer3: ConvBlock,
    pub layer4: C3k2,
    pub layer5: ConvBlock,
    pub layer6: C3k2,
    pub layer7: ConvBlock,
    pub layer8: C3k2,
    pub layer9: Sppf,
    pub layer10: C2psa,
    pub layer13: C3k2,
    pub layer16: C3k2,
    pub layer17: ConvBlock,
    pub layer19: C3k2,
    pub layer20: ConvBlock,
    pub layer22: C3k2,
    pub layer23: Head,
}

impl Yolo11Config {
    /// A detector with fresh weights.
    pub fn init(&self, device: &Device) -> Yolo11 {
        let scale = self.scale;
        let c = |nominal| scale.channels(nominal);
        let down = |from, to| {
            ConvBlockConfig::new(from, to)
                .with_kernel_size(3)
                .with_stride(2)
                .init(device)
        };
        let c3k2 = |from, nominal, c3k, expansion| {
            C3k2Config::new(
                from,
                c(nominal),
                scale.repeats(),
                c3k || scale.c3k_everywhere(),
                expansion,
            )
            .init(device)
        };
        Yolo11 {
            layer0: down(3, c(64)),
            layer1: down(c(64), c(128)),
            layer2: c3k2(c(128), 256, false, 0.25),
            layer3: down(c(256), c(256)),
            layer4: c3k2(c(256), 512, false, 0.25),
            layer5: down(c(512), c(512)),
            layer6: c3k2(c(512), 512, true, 0.5),
            layer7: down(c(512), c(1024)),
            layer8: c3k2(c(1024), 1024, true, 0.5),
            layer9: SppfConfig::new(c(1024), c(1024)).init(device),
            layer10: C2psaConfig::new(c(1024), scale.repeats()).init(device),
            layer13: c3k2(c(1024) + c(512), 512, false, 0.5),
            layer16: c3k2(c(512) + c(512), 256, false, 0.5),
            layer17: down(c(256), c(256)),
            layer19: c3k2(c(256) + c(512), 512, false, 0.5),
            layer20: down(c(512), c(512)),
            layer22: c3k2(c(512) + c(1024), 1024, true, 0.5),
            layer23: HeadConfig::new([c(256), c(512), c(1024)], self.classes)
                .with_class_width(self.class_width)
                .init(device),
        }
    }
}

impl Yolo11 {
    /// Runs the network.
    ///
    /// # Shapes
    /// - input: `[batch, 3, height, width]`, RGB in 0..1, both sides multiples of 32
    /// - output: the head's raw output at strides 8, 16 and 32
    ///
    /// # Panics
    /// When a side of the input is not a multiple of 32.
    pub fn forward(&self, input: Tensor<4>) -> RawOutput {
        kernels::on_pool(&input.device(), || self.run(input, None))
    }

    /// [`Yolo11::forward`], showing the output of every layer 0 to 22 as it is made, `[batch,
    /// channels, height, width]`.
    ///
    /// # Panics
    /// As [`Yolo11::forward`].
    pub fn forward_observed(
        &self,
        input: Tensor<4>,
        mut observe: impl FnMut(usize, &Tensor<4>),
    ) -> RawOutput {
        self.run(input, Some(&mut observe))
    }

    fn run(&self, input: Tensor<4>, mut observe: Option<Observer>) -> RawOutput {
        let [_, _, height, width] = input.dims();
        assert!(
            height % 32 == 0 && width % 32 == 0,
            "input {width}x{height}: both sides must be multiples of 32"
        );
        let mut layer = |index: usize, output: Tensor<4>| {
            if let Some(observe) = &mut observe {
                observe(index, &kernels::planes(output.clone()));
            }
            output
        };
        let x = layer(0, self.layer0.forward(kernels::pixels(input)));
        let x = layer(1, self.layer1.forward(x));
        let x = layer(2, self.layer2.forward(x));
        let x = layer(3, self.layer3.forward(x));
        let x4 = layer(4, self.layer4.forward(x));
        let x = layer(5, self.layer5.forward(x4.clone()));
        let x6 = layer(6, self.layer6.forward(x));
        let x = layer(7, self.layer7.forward(x6.clone()));
        let x = layer(8, self.layer8.forward(x));
        let x = layer(9, self.layer9.forward(x));
        let x10 = layer(10, self.layer10.forward(x));
        // Layers 11, 12, 14, 15, 18 and 21 double and join, which the layer behind them does while
        // it reads. Top-down the doubled tensor comes first.
        let x12 = vec![x10.clone(), x6];
        let x13 = layer(13, self.layer13.forward_joined(x12.clone()));
        let x15 = vec![x13.clone(), x4];
        let x16 = layer(16, self.layer16.forward_joined(x15.clone()));
        // Bottom-up.
        let x17 = layer(17, self.layer17.forward(x16.clone()));
        let x18 = vec![x17, x13.clone()];
        let x19 = layer(19, self.layer19.forward_joined(x18.clone()));
        let x20 = layer(20, self.layer20.forward(x19.clone()));
        let x21 = vec![x20, x10.clone()];
        let x22 = layer(22, self.layer22.forward_joined(x21.clone()));
        if let Some(observe) = &mut observe {
            for (index, input) in [(11, x10), (14, x13)] {
                observe(index, &kernels::planes(kernels::double(input)));
            }
            for (index, inputs) in [(12, x12), (15, x15), (18, x18), (21, x21)] {
                observe(index, &kernels::planes(kernels::join(inputs)));
            }
        }
        self.layer23.forward([x16, x19, x22])
    }

    /// The same function for inference with every batch normalisation merged into its
    /// convolution.
    pub fn folded(self) -> Self {
        Self {
            layer0: self.layer0.folded(),
            layer1: self.layer1.folded(),
            layer2: self.layer2.folded(),
            layer3: self.layer3.folded(),
            layer4: self.layer4.folded(),
            layer5: self.layer5.folded(),
            layer6: self.layer6.folded(),
            layer7: self.layer7.folded(),
            layer8: self.layer8.folded(),
            layer9: self.layer9.folded(),
            layer10: self.layer10.folded(),
            layer13: self.layer13.folded(),
            layer16: self.layer16.folded(),
            layer17: self.layer17.folded(),
            layer19: self.layer19.folded(),
            layer20: self.layer20.folded(),
            layer22: self.layer22.folded(),
            layer23: self.layer23.folded(),
        }
    }
}
