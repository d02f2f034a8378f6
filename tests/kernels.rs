//! The kernels against the operations that they replace, on shapes drawn at random.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "tests panic and report where the library must not"
)]

#[path = "support/devices.rs"]
mod devices;

use burn::tensor::module;
use burn::tensor::ops::ConvOptions;
use burn::tensor::{Device, Distribution, Tensor};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use twinsight::kernels::{self, Activation, ConvGeometry, TwinInput};

/// Largest difference of two tensors as a share of the largest expected value: 32-bit sums in
/// another order.
const TOLERANCE: f32 = 2e-5;

fn assert_same<const D: usize>(actual: Tensor<D>, expected: Tensor<D>, what: &str) {
    assert_eq!(actual.dims(), expected.dims(), "{what}");
    let scale = expected.clone().abs().max().into_scalar::<f32>().max(1e-3);
    let difference = (actual - expected).abs().max().into_scalar::<f32>();
    assert!(
        difference <= TOLERANCE * scale,
        "{what}: {difference} of {scale}"
    );
}

fn random<const D: usize>(shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::random(shape, Distribution::Uniform(-1.0, 1.0), device)
}

/// Runs an operation, whose tensors end with their channels, on `[batch, channels, height, width]`.
fn on_planes(input: Tensor<4>, operation: impl Fn(Tensor<4>) -> Tensor<4>) -> Tensor<4> {
    kernels::planes(operation(kernels::pixels(input)))
}

/// The other way round.
fn on_pixels(input: Tensor<4>, operation: impl Fn(Tensor<4>) -> Tensor<4>) -> Tensor<4> {
    kernels::pixels(operation(kernels::planes(input)))
}

/// A convolution that our kernels cover.
#[derive(Debug, Clone, Copy)]
struct Case {
    input: [usize; 4],
    weight: [usize; 4],
    geometry: ConvGeometry,
}

impl Case {
    fn draw(random: &mut Pcg64) -> Self {
        let sides = [1, 2, 3, 5, 7];
        let kernel = [
            sides[random.random_range(0..5)],
            sides[random.random_range(0..5)],
        ];
        let channels_in = random.random_range(1..20);
        let depthwise = random.random_bool(0.3);
        let channels_out = if depthwise {
            channels_in
        } else {
            random.random_range(1..20)
        };
        Self {
            input: [
                random.random_range(1..5),
                channels_in,
                random.random_range(7..34),
                random.random_range(7..50),
            ],
            weight: [
                channels_out,
                if depthwise { 1 } else { channels_in },
                kernel[0],
                kernel[1],
            ],
            geometry: ConvGeometry {
                stride: random.random_range(1..4),
                padding: random.random_range(0..=kernel[0].min(kernel[1]) / 2),
                groups: if depthwise { channels_in } else { 1 },
            },
        }
    }
}

fn composed(
    input: Tensor<4>,
    weight: Tensor<4>,
    bias: Option<Tensor<1>>,
    case: &Case,
) -> Tensor<4> {
    let ConvGeometry {
        stride,
        padding,
        groups,
    } = case.geometry;
    module::conv2d(
        input,
        weight,
        bias,
        ConvOptions::new([stride; 2], [padding; 2], [1; 2], groups),
    )
}

#[test]
fn convolutions_and_both_gradients_agree_with_the_composed_operation_on_200_shapes() {
    let device = Device::flex().autodiff();
    device.seed(11);
    let mut draw = Pcg64::seed_from_u64(5);
    for _ in 0..200 {
        let case = Case::draw(&mut draw);
        let what = format!("{case:?}");
        let input = random(case.input, &device).require_grad();
        let weight = random(case.weight, &device).require_grad();
        let expected = composed(input.clone(), weight.clone(), None, &case);
        let pull = random(expected.dims(), &device);
        let actual = on_planes(input.clone(), |x| {
            kernels::conv2d(x, weight.clone(), case.geometry)
        });
        assert_same(
            actual.clone().without_autodiff(),
            expected.clone().without_autodiff(),
            &format!("output {what}"),
        );
        let expected = (expected * pull.clone()).sum().backward();
        let actual = (actual * pull).sum().backward();
        assert_same(
            input.grad(&actual).unwrap(),
            input.grad(&expected).unwrap(),
            &format!("input gradient {what}"),
        );
        assert_same(
            weight.grad(&actual).unwrap(),
            weight.grad(&expected).unwrap(),
            &format!("weight gradient {what}"),
        );
    }
}

#[test]
fn weight_gradients_of_large_images_agree_on_every_device() {
    let flex = Device::flex();
    flex.seed(12);
    // More outputs than a software graphics adapter can add up in one go: in one image, in several,
    // with strides that leave rows over.
    for (input, weight, stride, padding) in [
        ([1, 2, 230, 301], [3, 2, 3, 3], 1, 1),
        ([5, 3, 120, 111], [4, 3, 3, 3], 1, 0),
        ([2, 2, 301, 330], [3, 2, 3, 3], 2, 1),
        ([9, 4, 90, 80], [2, 4, 1, 1], 1, 0),
    ] {
        let geometry = ConvGeometry {
            stride,
            padding,
            groups: 1,
        };
        let (input, weight) = (random(input, &flex), random(weight, &flex));
        let pull = random(
            on_planes(input.clone(), |x| {
                kernels::conv2d(x, weight.clone(), geometry)
            })
            .dims(),
            &flex,
        );
        let gradient = |device: &Device| {
            let device = device.clone().autodiff();
            let [input, weight, pull] = [&input, &weight, &pull]
                .map(|tensor| Tensor::<4>::from_data(tensor.to_data(), &device));
            let weight = weight.require_grad();
            let output = on_planes(input, |x| kernels::conv2d(x, weight.clone(), geometry));
            let grads = (output * pull).sum().backward();
            Tensor::<4>::from_data(weight.grad(&grads).unwrap().into_data(), &flex)
        };
        let expected = gradient(&flex);
        for (name, device) in devices::every() {
            let what = format!("{:?} on {name}", input.dims());
            assert_same(gradient(&device), expected.clone(), &what);
        }
    }
}

#[test]
fn bias_and_activation_in_one_pass_agree_with_separate_operations() {
    let device = Device::flex().autodiff();
    device.seed(12);
    let mut draw = Pcg64::seed_from_u64(6);
    for activation in [Activation::None, Activation::Silu, Activation::Relu].repeat(12) {
        let case = Case::draw(&mut draw);
        let what = format!("{activation:?} {case:?}");
        let input = random(case.input, &device).require_grad();
        let weight = random(case.weight, &device);
        let bias = random([case.weight[0]], &device).require_grad();
        let sums = composed(input.clone(), weight.clone(), Some(bias.clone()), &case);
        let expected = match activation {
            Activation::None => sums,
            Activation::Silu => burn::tensor::activation::silu(sums),
            Activation::Relu => burn::tensor::activation::relu(sums),
        };
        let fused = on_planes(input.clone().without_autodiff(), |x| {
            kernels::conv2d_act(
                x,
                weight.clone().without_autodiff(),
                bias.clone().without_autodiff(),
                case.geometry,
                activation,
            )
        });
        assert_same(fused, expected.clone().without_autodiff(), &what);
        let pull = random(expected.dims(), &device);
        let actual = on_planes(input.clone(), |x| {
            kernels::conv2d_act(x, weight.clone(), bias.clone(), case.geometry, activation)
        });
        let expected = (expected * pull.clone()).sum().backward();
        let actual = (actual * pull).sum().backward();
        assert_same(
            input.grad(&actual).unwrap(),
            input.grad(&expected).unwrap(),
            &what,
        );
        assert_same(
            bias.grad(&actual).unwrap(),
            bias.grad(&expected).unwrap(),
            &what,
        );
    }
}

#[test]
fn normalisation_with_activation_agrees_with_burns_own_and_so_do_its_gradients() {
    let device = Device::flex().autodiff();
    device.seed(13);
    for (shape, activation) in [
        ([3, 5, 7, 9], Activation::Silu),
        ([2, 16, 6, 10], Activation::None),
        ([1, 3, 40, 33], Activation::Silu),
        ([4, 1, 2, 2], Activation::Relu),
    ] {
        let what = format!("{shape:?} {activation:?}");
        let input = (random(shape, &device) * 3.0 + 2.0).detach().require_grad();
        let gamma = (random([shape[1]], &device) + 2.0).detach().require_grad();
        let beta = random([shape[1]], &device).require_grad();
        let norm = kernels::batch_norm_act(
            kernels::pixels(input.clone()),
            gamma.clone(),
            beta.clone(),
            1e-3,
            activation,
        );
        let output = kernels::planes(norm.output);
        let plain = module::batch_norm_train(input.clone(), gamma.clone(), beta.clone(), 1e-3);
        let expected = match activation {
            Activation::None => plain.output,
            Activation::Silu => burn::tensor::activation::silu(plain.output),
            Activation::Relu => burn::tensor::activation::relu(plain.output),
        };
        assert_same(
            output.clone().without_autodiff(),
            expected.clone().without_autodiff(),
            &what,
        );
        assert_same(
            norm.mean.without_autodiff(),
            plain.mean.without_autodiff(),
            &what,
        );
        assert_same(
            norm.variance.without_autodiff(),
            plain.variance.without_autodiff(),
            &what,
        );
        let pull = random(shape, &device);
        let expected = (expected * pull.clone()).sum().backward();
        let actual = (output * pull).sum().backward();
        assert_same(
            input.grad(&actual).unwrap(),
            input.grad(&expected).unwrap(),
            &what,
        );
        assert_same(
            gamma.grad(&actual).unwrap(),
            gamma.grad(&expected).unwrap(),
            &what,
        );
        assert_same(
            beta.grad(&actual).unwrap(),
            beta.grad(&expected).unwrap(),
            &what,
        );
    }
}

#[test]
fn twin_pooling_agrees_with_burns_pools_and_so_do_its_gradients() {
    let device = Device::flex().autodiff();
    device.seed(14);
    for (kind, shape) in [
        (TwinInput::Shared, [3, 4, 9, 14]),
        (TwinInput::Stacked, [4, 3, 8, 7]),
        (TwinInput::Stacked, [2, 1, 2, 2]),
    ] {
        let what = format!("{kind:?} {shape:?}");
        let input = random(shape, &device).require_grad();
        let (a, b) = match kind {
            TwinInput::Shared => (input.clone(), input.clone()),
            TwinInput::Stacked => {
                let half = shape[0] / 2;
                (
                    input.clone().narrow(0, 0, half),
                    input.clone().narrow(0, half, half),
                )
            }
        };
        let a = burn::nn::pool::MaxPool2dConfig::new([2, 2])
            .with_strides([2, 2])
            .init()
            .forward(a);
        let b = burn::nn::pool::AvgPool2dConfig::new([2, 2])
            .with_strides([2, 2])
            .init()
            .forward(b);
        let expected = burn::tensor::activation::relu(Tensor::cat(vec![a, b], 0));
        let actual = on_planes(input.clone(), |x| kernels::twin_pool(x, kind));
        assert_same(
            actual.clone().without_autodiff(),
            expected.clone().without_autodiff(),
            &what,
        );
        let pull = random(expected.dims(), &device);
        let expected = (expected * pull.clone()).sum().backward();
        let actual = (actual * pull).sum().backward();
        assert_same(
            input.grad(&actual).unwrap(),
            input.grad(&expected).unwrap(),
            &what,
        );
    }
}

#[test]
fn results_are_the_same_to_the_bit_for_one_thread_and_for_several() {
    let device = Device::flex().autodiff();
    device.seed(15);
    let input = random([5, 21, 30, 9], &device);
    let weight = random([11, 9, 3, 3], &device).require_grad();
    let geometry = ConvGeometry {
        stride: 2,
        padding: 1,
        groups: 1,
    };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let output = kernels::conv2d(input.clone(), weight.clone(), geometry);
            let grads = output.clone().square().sum().backward();
            let output = output.without_autodiff().into_data();
            (output, weight.grad(&grads).unwrap().into_data())
        })
    };
    let (output, grad) = run(1);
    for threads in [2, 3, 7] {
        let (other_output, other_grad) = run(threads);
        assert_eq!(output.as_bytes(), other_output.as_bytes());
        assert_eq!(grad.as_bytes(), other_grad.as_bytes());
    }
}

#[test]
fn narrower_vectors_pass_the_same_tests() {
    const VARIABLE: &str = "TWINSIGHT_SIMD";
    if std::env::var_os(VARIABLE).is_some() {
        return; // in a process started below
    }
    for width in ["avx2", "scalar"] {
        let output = std::process::Command::new(std::env::current_exe().unwrap())
            .env(VARIABLE, width)
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success(), "{width}: {text}");
        assert!(text.contains("test result: ok"), "{width}: {text}");
    }
}

#[test]
fn packed_convolutions_join_double_and_add_as_the_separate_operations_do() {
    type Parts = &'static [(usize, bool)];
    let device = Device::flex();
    device.seed(16);
    // Parts by channels and whether they are of half the size; output channels, kernel, stride.
    let cases: [(Parts, usize, usize, usize); 6] = [
        (&[(5, false)], 7, 1, 1),
        (&[(16, true), (9, false)], 33, 1, 1),
        (&[(3, false), (20, true), (8, false), (1, true)], 16, 1, 1),
        (
            &[(4, false), (4, false), (4, false), (4, false), (4, true)],
            10,
            1,
            1,
        ),
        (&[(12, false), (6, true)], 18, 3, 1),
        (&[(8, true), (8, false)], 20, 3, 2),
    ];
    for (parts, channels_out, kernel, stride) in cases {
        let what = format!("{parts:?} -> {channels_out}, {kernel}x{kernel}, stride {stride}");
        let inputs: Vec<Tensor<4>> = parts
            .iter()
            .map(|&(channels, half)| {
                let [height, width] = if half { [9, 13] } else { [18, 26] };
                // A part of a wider stack: pixels are further apart than their channels.
                random([2, height, width, channels + 3], &device).narrow(3, 2, channels)
            })
            .collect();
        let channels: usize = parts.iter().map(|part| part.0).sum();
        let weight = random([channels_out, channels, kernel, kernel], &device);
        let bias = random([channels_out], &device);
        let geometry = ConvGeometry {
            stride,
            padding: kernel / 2,
            groups: 1,
        };
        let joined = kernels::join(inputs.clone());
        let sums = on_pixels(joined, |planes| {
            let options = ConvOptions::new([stride; 2], [kernel / 2; 2], [1; 2], 1);
            module::conv2d(planes, weight.clone(), Some(bias.clone()), options)
        });
        let residual = random(sums.dims(), &device);
        let expected = burn::tensor::activation::silu(sums) + residual.clone();
        let packed = kernels::PackedConv::new(weight, geometry);
        let actual = packed.forward(inputs, bias, Some(residual), Activation::Silu);
        assert_same(actual, expected, &what);
    }
}
