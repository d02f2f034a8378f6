//! Both networks alone, from input tensor to result.

use burn::tensor::{Device, Distribution, Tensor};
use twinsight::Result;
use twinsight::dataset::CompositeSize;
use twinsight::detector::{Scale, Yolo11, Yolo11Config, decode};
use twinsight::ranging::{RangingConfig, RangingNetwork};

use super::Bench;
use super::report::{Effort, Report, Timing, measure, read};

/// Height and width of the detector's input for 2048x1080 images.
pub const DETECTOR_INPUT: [usize; 2] = [352, 640];

pub fn detector(scale: Scale, device: &Device) -> Yolo11 {
    Yolo11Config::new(scale, 1).init(device)
}

pub fn ranging(device: &Device) -> Result<RangingNetwork> {
    RangingConfig::for_size(CompositeSize::FULL).init(device)
}

pub fn random_images(batch: usize, [height, width]: [usize; 2], device: &Device) -> Tensor<4> {
    Tensor::random(
        [batch, 3, height, width],
        Distribution::Uniform(0.0, 1.0),
        device,
    )
}

/// Height and width of the full composite.
pub fn composite_area() -> [usize; 2] {
    let size = CompositeSize::FULL;
    [size.height as usize, size.width as usize]
}

/// A detector for inference, decoding included.
pub fn time_detector(scale: Scale, device: &Device) -> Result<Timing> {
    let network = detector(scale, device).folded();
    let input = random_images(1, DETECTOR_INPUT, device);
    measure(Effort::WHOLE, || {
        read(decode::decode(&network.forward(input.clone())));
        Ok(())
    })
}

/// The distance network for inference.
pub fn time_ranging(device: &Device) -> Result<Timing> {
    let network = ranging(device)?.packed();
    let composite = random_images(1, composite_area(), device);
    let geometry = Tensor::<2>::full([1, 2], 0.1, device);
    measure(Effort::WHOLE, || {
        read(network.forward(composite.clone(), geometry.clone()));
        Ok(())
    })
}

/// The section `networks`.
pub fn run(bench: &mut Bench) -> Result<()> {
    bench.machine.print_rates()?;
    Report::print_heading();
    for scale in [Scale::N, Scale::M] {
        let timing = time_detector(scale, &bench.device)?;
        bench
            .report
            .print(&format!("yolo11{scale}_1x3x352x640"), timing);
    }
    let timing = time_ranging(&bench.device)?;
    bench.report.print("distance_1x3x828x414", timing);
    bench.machine.print_rates()
}
