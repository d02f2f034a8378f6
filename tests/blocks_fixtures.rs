//! The detector's building blocks against reference numbers, each alone, on every device.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "tests panic and report where the library must not"
)]

mod support;

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use serde_json::Value;
use support::devices;
use support::fixture::{Fixture, assert_close};
use support::formula::{self, Fill};
use support::network;
use twinsight::detector::weights::tensor_name;
use twinsight::kernels;
use twinsight::nn::{
    AttentionConfig, BottleneckConfig, C2psaConfig, C3k2Config, C3kConfig, ConvBlockConfig,
    PsaBlockConfig, SppfConfig,
};
use twinsight::weights::StateDict;

/// One block of the fixture.
struct Case<'a> {
    label: &'a str,
    settings: &'a Value,
    shape: [usize; 4],
    device: Device,
}

impl Case<'_> {
    fn argument(&self, index: usize) -> Option<usize> {
        self.settings["args"][index].as_u64().map(|n| n as usize)
    }

    fn size(&self, index: usize) -> usize {
        self.argument(index)
            .unwrap_or_else(|| panic!("{}: argument {index}", self.label))
    }

    /// Fills the block and runs it; also gives its tensors after the pass.
    fn run<M: Module>(
        &self,
        block: M,
        forward: impl Fn(&M, Tensor<4>) -> Tensor<4>,
    ) -> (Tensor<4>, StateDict) {
        let tag = self.settings["tag"].as_str().unwrap();
        let fill = Fill::plain(tag, self.settings["gain"].as_f64().unwrap());
        let block = network::fill(block, &fill, block_name);
        let numbers = formula::units(&format!("{tag}#in"), self.shape.iter().product());
        let input = Tensor::from_data(TensorData::new(numbers, self.shape), &self.device);
        let output = kernels::planes(forward(&block, kernels::pixels(input)));
        (output, StateDict::of(&block.valid(), block_name))
    }
}

fn block_name(path: &str) -> String {
    format!("m.{}", tensor_name(path))
}

fn run(case: &Case) -> (Tensor<4>, StateDict) {
    let device = &case.device;
    let [_, channels, ..] = case.shape;
    match case.settings["block"].as_str().unwrap() {
        "conv" => {
            let config = ConvBlockConfig::new(channels, case.size(0))
                .with_kernel_size(case.argument(1).unwrap_or(1))
                .with_stride(case.argument(2).unwrap_or(1))
                .with_groups(case.argument(3).unwrap_or(1))
                .with_activated(case.settings["args"][4].as_bool().unwrap_or(true));
            case.run(config.init(device), twinsight::nn::ConvBlock::forward)
        }
        "bottleneck" => {
            let config = BottleneckConfig::new(case.size(0), case.size(1));
            case.run(config.init(device), twinsight::nn::Bottleneck::forward)
        }
        "c3k" => {
            let config = C3kConfig::new(case.size(0));
            case.run(config.init(device), twinsight::nn::C3k::forward)
        }
        "c3k2" => {
            let c3k = case.settings["args"][2].as_bool().unwrap();
            let expansion = case.settings["args"][3].as_f64().unwrap();
            let config = C3k2Config::new(channels, case.size(0), case.size(1), c3k, expansion);
            case.run(config.init(device), twinsight::nn::C3k2::forward)
        }
        "sppf" => {
            let config = SppfConfig::new(channels, case.size(0));
            case.run(config.init(device), twinsight::nn::Sppf::forward)
        }
        "attention" => {
            let config = AttentionConfig::new(channels);
            case.run(config.init(device), twinsight::nn::Attention::forward)
        }
        "psablock" => {
            let config = PsaBlockConfig::new(channels);
            case.run(config.init(device), twinsight::nn::PsaBlock::forward)
        }
        "c2psa" => {
            let config = C2psaConfig::new(case.size(0), case.size(1));
            case.run(config.init(device), twinsight::nn::C2psa::forward)
        }
        other => panic!("{}: there is no block {other}", case.label),
    }
}

#[test]
fn every_block_gives_the_reference_output_and_statistics() {
    let fixture = Fixture::load("blocks");
    let blocks = fixture.meta("blocks").unwrap();
    let blocks = blocks.as_object().unwrap();
    assert_eq!(blocks.len(), 12);
    for (device_name, device) in devices::every() {
        for (label, settings) in blocks {
            let shape = settings["input_shape"].as_array().unwrap();
            let shape: Vec<usize> = shape.iter().map(|n| n.as_u64().unwrap() as usize).collect();
            let train = settings["mode"] == "train";
            let device = device.clone();
            let case = Case {
                label,
                settings,
                shape: shape.try_into().unwrap(),
                device: if train { device.autodiff() } else { device },
            };
            let (output, state) = run(&case);
            let what = format!("{label} on {device_name}");
            let (shape, expected) = fixture.f32(&format!("{label}.out"));
            assert_eq!(output.dims().to_vec(), shape, "{what}");
            assert_close(&network::values(&output), &expected, 1e-5, &what);
            let statistics = fixture.names_after(&format!("{label}.after."));
            assert_eq!(statistics.len(), if train { 2 } else { 0 });
            for name in statistics {
                let (_, expected) = fixture.f32(&format!("{label}.after.{name}"));
                let (_, actual) = &state.tensors[&name];
                assert_close(actual, &expected, 1e-6, &format!("{name} of {what}"));
            }
        }
    }
}
