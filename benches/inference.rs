//! Inference latency: both networks alone, and a stereo pair from pixels to metres.
//!
//! `cargo bench` prints a table. With `TWINSIGHT_BENCH_TSV` set to a file it also writes lines
//! `case<TAB>milliseconds` (minimum over the runs). `TWINSIGHT_BENCH_DEVICE` chooses the device.
//! Weights are fresh: latency does not depend on their values.
#![allow(
    clippy::print_stdout,
    reason = "a benchmark reports on standard output"
)]

use std::fmt::Write as _;
use std::hint::black_box;
use std::time::{Duration, Instant};

use burn::tensor::{Device, Distribution, Tensor};
use image::{Rgb, RgbImage};
use twinsight::Result;
use twinsight::dataset::{BoxKind, CompositeSize};
use twinsight::detector::nms::NmsConfig;
use twinsight::detector::{DetectorHeader, Scale, VehicleDetector, Yolo11Config, decode};
use twinsight::device::DeviceName;
use twinsight::files;
use twinsight::geometry::{PixelBox, StereoRig};
use twinsight::imaging::ChannelStatistics;
use twinsight::pairing::{PairingConfig, pair};
use twinsight::ranging::{DistanceEstimator, RangingConfig, RangingHeader, Sighting};

/// Every case runs at least this long and this often.
const LEAST_TIME: Duration = Duration::from_secs(2);
const LEAST_RUNS: usize = 5;

/// One measured case.
struct Timing {
    case: String,
    runs: usize,
    least_ms: f64,
    median_ms: f64,
}

fn measure(case: &str, mut work: impl FnMut() -> Result<()>) -> Result<Timing> {
    work()?; // the first run allocates
    let mut times_ms = Vec::new();
    let started = Instant::now();
    while times_ms.len() < LEAST_RUNS || started.elapsed() < LEAST_TIME {
        let run = Instant::now();
        work()?;
        times_ms.push(run.elapsed().as_secs_f64() * 1e3);
    }
    times_ms.sort_by(f64::total_cmp);
    Ok(Timing {
        case: case.to_owned(),
        runs: times_ms.len(),
        least_ms: times_ms[0],
        median_ms: times_ms[times_ms.len() / 2],
    })
}

/// A read-back ends each run: results of a graphics card are not there before it.
fn read(tensor: Tensor<2>) {
    black_box(tensor.into_data());
}

fn detector_case(scale: Scale, device: &Device) -> Result<Timing> {
    let network = Yolo11Config::new(scale, 1).init(device).folded();
    let input = Tensor::<4>::random([1, 3, 352, 640], Distribution::Uniform(0.0, 1.0), device);
    measure(&format!("yolo11{scale}_1x3x352x640"), || {
        read(decode::decode(&network.forward(input.clone())).squeeze_dim(0));
        Ok(())
    })
}

fn distance_case(device: &Device) -> Result<Timing> {
    let network = RangingConfig::for_size(CompositeSize::FULL)
        .init(device)?
        .packed();
    let composite = Tensor::<4>::random([1, 3, 828, 414], Distribution::Uniform(0.0, 1.0), device);
    let geometry = Tensor::<2>::full([1, 2], 0.1, device);
    measure("distance_1x3x828x414", || {
        read(network.forward(composite.clone(), geometry.clone()));
        Ok(())
    })
}

/// A pair of 2048x1080 images in memory: letterbox, detector on both, suppression, pairing, crops
/// of one vehicle, distance network.
fn pair_case(scale: Scale, device: &Device) -> Result<Timing> {
    let rig = StereoRig::from_hfov(2048, 1080, 90.0, 0.8)?;
    let version = env!("CARGO_PKG_VERSION").to_owned();
    let classes = vec!["car".to_owned()];
    let detector = VehicleDetector::new(
        &Yolo11Config::new(scale, 1).init(device),
        DetectorHeader {
            network: DetectorHeader::NETWORK.to_owned(),
            version: version.clone(),
            scale,
            classes: classes.clone(),
            image_size: 640,
            normalization: DetectorHeader::NORMALIZATION.to_owned(),
            box_kind: BoxKind::Sphere,
            rig,
        },
        device,
    );
    let estimator = DistanceEstimator::new(
        &RangingConfig::for_size(CompositeSize::FULL).init(device)?,
        RangingHeader {
            network: RangingHeader::NETWORK.to_owned(),
            version,
            composite: CompositeSize::FULL,
            normalization: ChannelStatistics::IDENTITY,
            box_kind: BoxKind::Sphere,
            classes,
            rig,
        },
        device,
    );
    let left = RgbImage::from_fn(2048, 1080, |x, y| Rgb([x as u8, y as u8, (x ^ y) as u8]));
    let right = left.clone();
    let area = PixelBox::new(900.0, 500.0, 1000.0, 600.0);
    measure(&format!("pair_2048x1080_{scale}"), || {
        let found = detector.detect(&[&left, &right], &NmsConfig::prediction())?;
        black_box(pair(&found[0], &found[1], &rig, &PairingConfig::default()));
        let sighting = Sighting {
            images: [&left, &right],
            boxes: [area, area],
        };
        black_box(estimator.estimate(&[sighting])?);
        Ok(())
    })
}

fn main() -> Result<()> {
    // `cargo bench` passes `--bench`; `cargo test` runs bench targets without it.
    if !std::env::args().any(|argument| argument == "--bench") {
        return Ok(());
    }
    twinsight::kernels::keep_freed_memory();
    let name = std::env::var("TWINSIGHT_BENCH_DEVICE").unwrap_or_else(|_| "flex".to_owned());
    let device = name.parse::<DeviceName>()?.open()?;
    println!(
        "inference latency on {name}, {} threads",
        rayon::current_num_threads()
    );
    println!(
        "{:<24} {:>5} {:>12} {:>12}",
        "case", "runs", "minimum ms", "median ms"
    );
    let cases: [&dyn Fn() -> Result<Timing>; 5] = [
        &|| detector_case(Scale::N, &device),
        &|| detector_case(Scale::M, &device),
        &|| distance_case(&device),
        &|| pair_case(Scale::N, &device),
        &|| pair_case(Scale::M, &device),
    ];
    let mut lines = String::new();
    for case in cases {
        let Timing {
            case,
            runs,
            least_ms,
            median_ms,
        } = case()?;
        println!("{case:<24} {runs:>5} {least_ms:>12.2} {median_ms:>12.2}");
        // Writing to a string cannot fail.
        writeln!(lines, "{case}\t{least_ms:.3}").ok();
    }
    if let Some(path) = std::env::var_os("TWINSIGHT_BENCH_TSV") {
        files::write_atomically(std::path::PathBuf::from(path), lines.as_bytes())?;
    }
    Ok(())
}
