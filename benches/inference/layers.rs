//! Every convolution of both networks alone, as inference runs it.
//!
//! The list comes from the networks themselves: extents from their weights, image sizes from a
//! forward pass. A stride is the ratio of the sizes before and after a published layer.

use std::collections::BTreeMap;

use burn::module::{Module, ModuleVisitor, Param};
use burn::tensor::{Device, Distribution, Tensor};
use twinsight::Result;
use twinsight::detector::Scale;
use twinsight::kernels::packed::Algorithm;
use twinsight::kernels::shape::ConvShape;
use twinsight::kernels::{Activation, ConvGeometry, PackedConv};

use super::Bench;
use super::networks::{
    DETECTOR_INPUT, composite_area, detector, random_images, ranging, time_detector, time_ranging,
};
use super::report::{Effort, Timing, measure, wait};

/// Convolutions of one shape.
#[derive(Debug, Clone, Copy)]
struct Layer {
    shape: ConvShape,
    count: usize,
}

/// The convolutions of a network.
#[derive(Debug, Default)]
struct Layers {
    layers: Vec<Layer>,
}

impl Layers {
    fn add(&mut self, shape: ConvShape) {
        match self.layers.iter_mut().find(|layer| layer.shape == shape) {
            Some(layer) => layer.count += 1,
            None => self.layers.push(Layer { shape, count: 1 }),
        }
    }

    /// Weights of all convolutions.
    fn weights(&self) -> usize {
        let weights = |layer: &Layer| {
            let shape = layer.shape;
            layer.count * shape.channels_out * taps(&shape)
        };
        self.layers.iter().map(weights).sum()
    }
}

/// Input values that enter one output value.
fn taps(shape: &ConvShape) -> usize {
    if shape.depthwise {
        shape.kernel[0] * shape.kernel[1]
    } else {
        shape.fan_in()
    }
}

/// Operations of the plain convolution, two for each product, 10^9.
fn gflop(shape: &ConvShape) -> f64 {
    2.0 * (shape.batch * shape.output_len() * taps(shape)) as f64 / 1e9
}

/// Extents `[channels_out, channels_in / groups, kernel_h, kernel_w]` of all convolutions' weights
/// with their paths in the module, in its order.
fn conv_weights<M: Module>(network: &M) -> Vec<(Vec<String>, [usize; 4])> {
    #[derive(Default)]
    struct Collect {
        path: Vec<String>,
        found: Vec<(Vec<String>, [usize; 4])>,
    }
    impl ModuleVisitor for Collect {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Ok(extent) = <[usize; 4]>::try_from(&param.val().dims()[..]) {
                self.found.push((self.path.clone(), extent));
            }
        }
        fn enter_module(&mut self, name: &str, _: &str) {
            self.path.push(name.to_owned());
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.pop();
        }
    }
    let mut collect = Collect::default();
    network.visit(&mut collect);
    collect.found
}

/// The detector's convolutions on one image.
fn detector_layers(scale: Scale, device: &Device) -> Layers {
    let network = detector(scale, device);
    // Height and width of each published layer's output.
    let mut areas = BTreeMap::new();
    let input = random_images(1, DETECTOR_INPUT, device);
    let output = network
        .clone()
        .folded()
        .forward_observed(input, |layer, tensor| {
            let [_, _, height, width] = tensor.dims();
            areas.insert(layer, [height, width]);
        });
    let levels = output.levels.map(|level| {
        let [_, _, height, width] = level.dims();
        [height, width]
    });
    let before = |layer: usize| {
        let layer = layer.checked_sub(1)?;
        areas.get(&layer).copied()
    };
    let mut layers = Layers::default();
    for (path, [channels_out, per_group, kernel_h, kernel_w]) in conv_weights(&network) {
        // `layer4.cv1.conv.weight`, or `layer23.cv2.1.out.weight` for level 1 of the head.
        let number = |part: &str| part.trim_start_matches("layer").parse::<usize>().ok();
        let Some(layer) = path.first().and_then(|part| number(part)) else {
            continue;
        };
        let (area_in, area_out) = if let Some(&area) = areas.get(&layer) {
            (before(layer).unwrap_or(DETECTOR_INPUT), area)
        } else {
            let level = path.get(2).and_then(|part| number(part)).unwrap_or(0);
            (levels[level], levels[level])
        };
        let depthwise = per_group == 1 && channels_out > 1;
        layers.add(ConvShape {
            batch: 1,
            channels_in: if depthwise { channels_out } else { per_group },
            channels_out,
            height_in: area_in[0],
            width_in: area_in[1],
            kernel: [kernel_h, kernel_w],
            stride: area_in[0] / area_out[0],
            padding: kernel_h / 2,
            depthwise,
        });
    }
    layers
}

/// The distance network's convolutions on one composite: the first block merged into one, and both
/// pathways stacked behind it.
fn ranging_layers(device: &Device) -> Result<Layers> {
    let network = ranging(device)?;
    let features = network.features(random_images(1, composite_area(), device));
    let [height_in, width_in] = composite_area();
    let mut shape = ConvShape {
        batch: 1,
        channels_in: 0,
        channels_out: 0,
        height_in,
        width_in,
        kernel: [0; 2],
        stride: 1,
        padding: 0,
        depthwise: false,
    };
    let with_weight = |shape: ConvShape, weight: [usize; 4]| ConvShape {
        channels_in: weight[1],
        channels_out: weight[0],
        kernel: [weight[2], weight[3]],
        ..shape
    };
    let mut layers = Layers::default();
    let (merged, _) = network.merged_first_block();
    layers.add(with_weight(shape, merged.dims()));
    for (block, pooled) in network.blocks.iter().zip(&features.blocks).skip(1) {
        let [batch, ..] = pooled.dims();
        let before = features
            .blocks
            .iter()
            .take_while(|other| other.dims() != pooled.dims());
        if let Some([_, _, height, width]) = before.last().map(Tensor::dims) {
            (shape.height_in, shape.width_in) = (height, width);
        }
        shape.batch = batch;
        for conv in block {
            shape = with_weight(shape, conv.weight.val().dims());
            layers.add(shape);
            (shape.height_in, shape.width_in) = (shape.height_out(), shape.width_out());
        }
    }
    Ok(layers)
}

/// One convolution with packed weights, bias and activation.
fn time_layer(shape: &ConvShape, activation: Activation, device: &Device) -> Result<Timing> {
    fn random<const D: usize>(shape: [usize; D], device: &Device) -> Tensor<D> {
        Tensor::random(shape, Distribution::Uniform(-1.0, 1.0), device)
    }
    let [kernel_h, kernel_w] = shape.kernel;
    let (per_group, groups) = if shape.depthwise {
        (1, shape.channels_in)
    } else {
        (shape.channels_in, 1)
    };
    let weight = random([shape.channels_out, per_group, kernel_h, kernel_w], device);
    let geometry = ConvGeometry {
        stride: shape.stride,
        padding: shape.padding,
        groups,
    };
    let conv = PackedConv::new(weight, geometry);
    let bias = random([shape.channels_out], device);
    let input = random(
        [
            shape.batch,
            shape.height_in,
            shape.width_in,
            shape.channels_in,
        ],
        device,
    );
    measure(Effort::BRIEF, || {
        let output = conv.forward(vec![input.clone()], bias.clone(), None, activation);
        wait(output, device)
    })
}

fn name(shape: &ConvShape) -> String {
    let sides = if shape.kernel[0] == shape.kernel[1] {
        format!("k{}", shape.kernel[0])
    } else {
        format!("k{}x{}", shape.kernel[0], shape.kernel[1])
    };
    let depthwise = if shape.depthwise { "d" } else { "" };
    format!(
        "{}-{}_{sides}s{}{depthwise}_{}x{}x{}",
        shape.channels_in,
        shape.channels_out,
        shape.stride,
        shape.batch,
        shape.height_in,
        shape.width_in
    )
}

/// Prints and notes all convolutions of a network; `whole` is the network's own time.
fn table(
    bench: &mut Bench,
    network: &str,
    layers: &Layers,
    activation: Activation,
    whole: impl FnOnce(&Device) -> Result<Timing>,
) -> Result<()> {
    println!("\n{network}: convolutions by shape");
    bench.machine.print_rates()?;
    println!(
        "{:<34} {:>5} {:>8} {:>9} {:>8} {:>9} {:>6}  algorithm",
        "in-out_kernel,stride_batch,h,w", "count", "GFLOP", "ms", "GFLOP/s", "product", "share"
    );
    let (mut sum_gflop, mut sum_ms, mut product_ms, mut count) = (0.0, 0.0, 0.0, 0);
    for layer in &layers.layers {
        let shape = &layer.shape;
        let product = bench.machine.product_rate()?;
        let Timing { least_ms, .. } = time_layer(shape, activation, &bench.device)?;
        let rate = gflop(shape) / least_ms * 1e3;
        println!(
            "{:<34} {:>5} {:>8.4} {:>9.4} {:>8.0} {:>9.0} {:>5.0}%  {:?}",
            name(shape),
            layer.count,
            gflop(shape),
            least_ms,
            rate,
            product,
            100.0 * rate / product,
            Algorithm::of(shape)
        );
        bench
            .report
            .add(&format!("{network}_layer_{}", name(shape)), least_ms);
        let times = layer.count as f64;
        sum_gflop += times * gflop(shape);
        sum_ms += times * least_ms;
        product_ms += times * gflop(shape) / product * 1e3;
        count += layer.count;
    }
    let rate = sum_gflop / sum_ms * 1e3;
    println!(
        "{:<34} {count:>5} {sum_gflop:>8.4} {sum_ms:>9.4} {rate:>8.0} {:>9.0} {:>5.0}%",
        "all convolutions",
        sum_gflop / product_ms * 1e3,
        100.0 * product_ms / sum_ms
    );
    let Timing { least_ms, .. } = whole(&bench.device)?;
    println!("whole network {least_ms:.2} ms; GFLOP and shares count the plain convolution");
    bench.machine.print_rates()
}

/// The section `layers`.
pub fn run(bench: &mut Bench) -> Result<()> {
    for scale in [Scale::N, Scale::M] {
        let layers = detector_layers(scale, &bench.device);
        let parameters = detector(scale, &bench.device).num_params();
        table(
            bench,
            &format!("yolo11{scale}"),
            &layers,
            Activation::Silu,
            |device| time_detector(scale, device),
        )?;
        println!(
            "{} convolution weights of {parameters} parameters, running statistics included",
            layers.weights()
        );
    }
    let layers = ranging_layers(&bench.device)?;
    table(bench, "distance", &layers, Activation::None, time_ranging)?;
    println!(
        "{} convolution weights with the first block's three 3x3 convolutions merged into one 7x7",
        layers.weights()
    );
    Ok(())
}
