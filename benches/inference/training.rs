//! Optimiser steps with our kernels and with Burn's own operations.
//!
//! A step is what the training loop does: forward, loss, backward, clipping (detector), Adam and
//! averaged weights (detector). The inputs are random and ready in memory. Each kind runs in a
//! process of its own, so that its peak memory is known.

use burn::module::Module;
use burn::optim::{GradientsParams, ModuleOptimizer};
use burn::tensor::{Device, Tensor};
use twinsight::detector::assign::Target;
use twinsight::detector::decode::Anchors;
use twinsight::detector::loss::{ImageTargets, LossGains, detection_loss};
use twinsight::detector::{RawOutput, Scale};
use twinsight::ranging::ranging_loss;
use twinsight::train::optimizer::{
    AverageRule, clip_gradients, detector_optimizer, distance_optimizer, flat_values, initialize,
    scalar,
};
use twinsight::train::{OptimizerKind, TrainConfig};
use twinsight::{Error, Result};

use super::Bench;
use super::child::{self, Numbers};
use super::composed::{Composed11, ComposedRanging};
use super::memory::{add_peak, mib_or_not};
use super::networks::{composite_area, detector, random_images, ranging};
use super::report::{Effort, Timing, measure};

/// Side of the detector's input, and images and composites a step.
const SIDE: usize = 320;
const IMAGES: usize = 16;
const COMPOSITES: usize = 4;
/// Learning rate of the steps; weights do not matter.
const RATE: f64 = 1e-4;
/// Our kernels, and Burn's operations.
const OPERATIONS: [&str; 2] = ["own", "burn"];
/// What a child compares instead of taking steps.
const DIFFERENCE: &str = "difference";
/// Times that each kind of step is measured.
const ROUNDS: usize = 2;

/// The optimiser and what else belongs to a step.
struct Step {
    optimizer: ModuleOptimizer,
    clip_norm: Option<f64>,
    average: Option<AverageRule>,
}

impl Step {
    fn detector() -> Result<Self> {
        let settings = TrainConfig::preset("quick")?.detector;
        Ok(Self {
            optimizer: detector_optimizer(settings.optimizer, settings.weight_decay, None)?,
            clip_norm: Some(settings.clip_norm),
            average: Some(AverageRule {
                longest: settings.ema_decay,
                ramp: settings.ema_ramp,
            }),
        })
    }

    fn distance() -> Self {
        Self {
            optimizer: distance_optimizer(OptimizerKind::Adam),
            clip_norm: None,
            average: None,
        }
    }

    /// Time of a step.
    fn time<M: Module>(
        mut self,
        mut model: M,
        loss: impl Fn(&M) -> Result<Tensor<1>>,
    ) -> Result<Timing> {
        initialize(&model);
        let mut average = self.average.map(|rule| (rule, flat_values(&model)));
        let mut updates = 0;
        measure(Effort::FEW, || {
            let total = loss(&model)?;
            // The training loop reads the loss at every step.
            scalar(&total)?;
            let mut grads = GradientsParams::from_grads(total.backward(), &model);
            if let Some(longest) = self.clip_norm {
                (grads, _) = clip_gradients(&model, grads, longest)?;
            }
            model = self.optimizer.step(RATE, model.clone(), grads);
            if let Some((rule, values)) = &mut average {
                updates += 1;
                *values = rule.update(std::mem::take(values), &model, updates);
            }
            Ok(())
        })
    }
}

/// The detector's loss with one vehicle in each image.
fn vehicle_loss(output: &RawOutput, anchors: &Anchors) -> Result<Tensor<1>> {
    let [batch, ..] = output.levels[0].dims();
    let vehicle = Target {
        class: 0,
        box_letterbox: [140.0, 150.0, 180.0, 180.0],
    };
    let targets = vec![ImageTargets::from(vec![vehicle]); batch];
    let loss = detection_loss(&output.flatten(), &targets, anchors, LossGains::default())?;
    Ok(loss.total)
}

fn time_detector(is_own: bool, device: &Device) -> Result<Timing> {
    let device = device.clone().autodiff();
    let network = detector(Scale::N, &device);
    let input = random_images(IMAGES, [SIDE; 2], &device);
    let anchors = Anchors::new(SIDE, SIDE);
    let step = Step::detector()?;
    if is_own {
        return step.time(network, |network| {
            vehicle_loss(&network.forward(input.clone()), &anchors)
        });
    }
    step.time(Composed11::of(&network, &device), |network| {
        vehicle_loss(&network.forward(input.clone()), &anchors)
    })
}

fn time_ranging(is_own: bool, device: &Device) -> Result<Timing> {
    let device = device.clone().autodiff();
    let network = ranging(&device)?;
    let input = random_images(COMPOSITES, composite_area(), &device);
    let geometry = Tensor::<2>::full([COMPOSITES, 2], 0.1, &device);
    let targets = Tensor::<2>::full([COMPOSITES, 1], 30.0, &device);
    let step = Step::distance();
    let loss = |predicted| ranging_loss(predicted, targets.clone()).total;
    if is_own {
        return step.time(network, |network| {
            Ok(loss(network.forward(input.clone(), geometry.clone())))
        });
    }
    step.time(ComposedRanging::of(&network, &device), |network| {
        Ok(loss(network.forward(input.clone(), geometry.clone())))
    })
}

/// Largest difference between two tensors, as a share of the largest value.
fn difference<const D: usize>(a: Tensor<D>, b: Tensor<D>) -> Result<f64> {
    let largest = scalar(&a.clone().abs().max())?;
    Ok(scalar(&(a - b).abs().max())? / largest)
}

/// Largest difference between the outputs of both kinds of network, training mode.
fn differences(network: &str, device: &Device) -> Result<f64> {
    let device = device.clone().autodiff();
    if network == "detector" {
        let ours = detector(Scale::N, &device);
        let composed = Composed11::of(&ours, &device);
        let input = random_images(2, [SIDE; 2], &device);
        let outputs = [ours.forward(input.clone()), composed.forward(input)];
        let [ours, composed] = outputs.map(|output| {
            Tensor::cat(
                output.levels.map(|level| level.flatten::<2>(1, 3)).to_vec(),
                1,
            )
        });
        return difference(ours, composed);
    }
    let ours = ranging(&device)?;
    let composed = ComposedRanging::of(&ours, &device);
    let input = random_images(1, composite_area(), &device);
    let geometry = Tensor::<2>::full([1, 2], 0.1, &device);
    difference(
        ours.forward(input.clone(), geometry.clone()),
        composed.forward(input, geometry),
    )
}

/// In a child: steps of a network, with our kernels or with Burn's operations, or the difference
/// between the two.
pub fn child(network: &str, operations: &str, device: &Device) -> Result<Numbers> {
    let mut numbers = Numbers::new();
    if operations == DIFFERENCE {
        numbers.insert(operations.to_owned(), differences(network, device)?);
        return Ok(numbers);
    }
    let is_own = operations == OPERATIONS[0];
    let timing = match network {
        "detector" => time_detector(is_own, device)?,
        _ => time_ranging(is_own, device)?,
    };
    numbers.insert("step_ms".to_owned(), timing.least_ms);
    add_peak(&mut numbers);
    Ok(numbers)
}

/// The section `training`.
pub fn run(bench: &mut Bench) -> Result<()> {
    println!(
        "{:<34} {:<6} {:>10} {:>10} {:>14} {:>16}",
        "optimiser step", "by", "ms", "images/s", "peak memory", "product GFLOP/s"
    );
    let (height, width) = (composite_area()[0], composite_area()[1]);
    let networks = [
        (
            "detector",
            format!("yolo11n {SIDE}x{SIDE}, batch {IMAGES}"),
            format!("train_yolo11n_{IMAGES}x3x{SIDE}x{SIDE}"),
            IMAGES,
        ),
        (
            "distance",
            format!("distance {height}x{width}, batch {COMPOSITES}"),
            format!("train_distance_{COMPOSITES}x3x{height}x{width}"),
            COMPOSITES,
        ),
    ];
    for (network, title, case, batch) in networks {
        // Alternating, so that a change of the machine's speed meets both; the faster round counts.
        let mut least_ms = [f64::INFINITY; 2];
        for _ in 0..ROUNDS {
            for (operations, least_ms) in OPERATIONS.iter().zip(&mut least_ms) {
                let product = bench.machine.product_rate()?;
                let numbers = child::run(&["training", network, operations])?;
                let step_ms = number(&numbers, "step_ms")?;
                println!(
                    "{title:<34} {operations:<6} {step_ms:>10.0} {:>10.2} {:>14} {product:>16.0}",
                    batch as f64 / step_ms * 1e3,
                    mib_or_not(&numbers, "peak_mib")
                );
                *least_ms = step_ms.min(*least_ms);
            }
        }
        for (operations, least_ms) in OPERATIONS.iter().zip(least_ms) {
            bench.report.add(&format!("{case}_{operations}"), least_ms);
        }
        let numbers = child::run(&["training", network, DIFFERENCE])?;
        println!(
            "{title}: {:.2} times as fast; outputs differ by {:.1e} of the largest value",
            least_ms[1] / least_ms[0],
            number(&numbers, DIFFERENCE)?
        );
    }
    println!("own: our kernels; burn: the same network in Burn's layers, on the same device");
    Ok(())
}

fn number(numbers: &Numbers, name: &str) -> Result<f64> {
    numbers.get(name).copied().ok_or_else(|| {
        Error::value(
            "the benchmark's child process",
            format!("did not say its {name}"),
            "report this as a defect",
        )
    })
}
