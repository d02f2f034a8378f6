//! What the machine can do: the rate that everything else is a share of.

use burn::tensor::{Device, Distribution, Tensor};
use twinsight::Result;
use twinsight::kernels::{Activation, ConvGeometry, PackedConv, simd};

use super::Bench;
use super::report::{Effort, measure, wait};

/// Side of the square matrices whose product is measured beside other cases.
const SIDE: usize = 1024;
/// Side of the largest matrices.
const LARGE_SIDE: usize = 2048;
/// Channels in and out of the pointwise convolution, and its image's height and width.
const CHANNELS: usize = 512;
const AREA: [usize; 2] = [32, 64];

/// Work whose rate is known, ready to run.
pub struct Machine {
    device: Device,
    factors: [Tensor<2>; 2],
    pointwise: PackedConv,
    bias: Tensor<1>,
    image: Tensor<4>,
}

fn random<const D: usize>(shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::random(shape, Distribution::Uniform(-1.0, 1.0), device)
}

/// Operations of a convolution or product, in units of 10^9 a second.
fn rate(operations: usize, milliseconds: f64) -> f64 {
    operations as f64 / milliseconds / 1e6
}

impl Machine {
    pub fn new(device: &Device) -> Self {
        let geometry = ConvGeometry {
            stride: 1,
            padding: 0,
            groups: 1,
        };
        Self {
            device: device.clone(),
            factors: [(); 2].map(|()| random([SIDE, SIDE], device)),
            pointwise: PackedConv::new(random([CHANNELS, CHANNELS, 1, 1], device), geometry),
            bias: random([CHANNELS], device),
            image: random([1, AREA[0], AREA[1], CHANNELS], device),
        }
    }

    /// Rate of Burn's matrix product right now, GFLOP/s.
    pub fn product_rate(&self) -> Result<f64> {
        self.rate_of(&self.factors, Effort::BRIEF)
    }

    fn rate_of(&self, [a, b]: &[Tensor<2>; 2], effort: Effort) -> Result<f64> {
        let [side, _] = a.dims();
        let timing = measure(effort, || wait(a.clone().matmul(b.clone()), &self.device))?;
        Ok(rate(2 * side * side * side, timing.least_ms))
    }

    /// Rate of our own pointwise convolution right now, GFLOP/s.
    pub fn pointwise_rate(&self) -> Result<f64> {
        let timing = measure(Effort::BRIEF, || {
            let output = self.pointwise.forward(
                vec![self.image.clone()],
                self.bias.clone(),
                None,
                Activation::None,
            );
            wait(output, &self.device)
        })?;
        let operations = 2 * CHANNELS * CHANNELS * AREA[0] * AREA[1];
        Ok(rate(operations, timing.least_ms))
    }

    /// Says beside a table how fast the machine is right now.
    pub fn print_rates(&self) -> Result<()> {
        println!(
            "machine now: matrix product {:.0} GFLOP/s, pointwise convolution {:.0} GFLOP/s",
            self.product_rate()?,
            self.pointwise_rate()?
        );
        Ok(())
    }
}

/// The vector extension that the kernels use.
fn vectors() -> &'static str {
    match simd::vector_lanes() {
        16 => "AVX-512",
        8 => "AVX2 with FMA",
        4 => "NEON",
        _ => "none",
    }
}

/// The section `machine`.
pub fn run(bench: &mut Bench) -> Result<()> {
    let device = &bench.device;
    println!(
        "threads {}, vector extension {}",
        rayon::current_num_threads(),
        vectors()
    );
    let machine = &bench.machine;
    let large = [(); 2].map(|()| random([LARGE_SIDE, LARGE_SIDE], device));
    println!("{:<40} {:>10} {:>10} {:>10}", "GFLOP/s", "1", "2", "3");
    let rows: [(String, &dyn Fn() -> Result<f64>); 3] = [
        (format!("matrix product {SIDE}x{SIDE}"), &|| {
            machine.product_rate()
        }),
        (format!("matrix product {LARGE_SIDE}x{LARGE_SIDE}"), &|| {
            machine.rate_of(&large, Effort::BRIEF)
        }),
        (
            format!(
                "pointwise {CHANNELS}->{CHANNELS} on {}x{}",
                AREA[0], AREA[1]
            ),
            &|| machine.pointwise_rate(),
        ),
    ];
    // Three times round, so that a change of the machine's speed shows.
    let mut rates = [[0.0; 3]; 3];
    for round in 0..3 {
        for (row, (_, rate)) in rates.iter_mut().zip(&rows) {
            row[round] = rate()?;
        }
    }
    for ((name, _), [a, b, c]) in rows.iter().zip(rates) {
        println!("{name:<40} {a:>10.0} {b:>10.0} {c:>10.0}");
    }
    Ok(())
}
