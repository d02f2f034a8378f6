//! A run folder with fresh networks: it finds nonsense, at once.

use std::path::Path;

use twinsight::dataset::BoxKind;
use twinsight::detector::{DetectorHeader, Scale, VehicleDetector, Yolo11Config};
use twinsight::device::DeviceName;
use twinsight::geometry::StereoRig;
use twinsight::imaging::ChannelStatistics;
use twinsight::ranging::{Crops, DistanceEstimator, RangingConfig, RangingHeader, Readout};
use twinsight::train::StageFolder;

/// Writes both networks for images of 16:9 with two classes, the detector's input `image_size`
/// pixels wide.
pub fn write_run(run: &Path, image_size: u32) {
    let device = DeviceName::FLEX.open().unwrap();
    let classes = ["car", "truck"].map(str::to_owned).to_vec();
    let rig = StereoRig::from_hfov(64, 36, 90.0, 0.8).unwrap();
    let detector = Yolo11Config::new(Scale::N, classes.len()).init(&device);
    let folder = StageFolder::new(run, "detector");
    folder.create().unwrap();
    let header = DetectorHeader {
        network: DetectorHeader::NETWORK.to_owned(),
        version: "0".to_owned(),
        scale: Scale::N,
        classes: classes.clone(),
        image_size,
        normalization: DetectorHeader::NORMALIZATION.to_owned(),
        box_kind: BoxKind::Tight,
        rig,
    };
    VehicleDetector::save(&detector, &header, &folder.best()).unwrap();

    let composite = "324x162".parse().unwrap();
    let network = RangingConfig::for_size(composite).init(&device).unwrap();
    let folder = StageFolder::new(run, "distance");
    folder.create().unwrap();
    let header = RangingHeader {
        network: RangingHeader::NETWORK.to_owned(),
        version: "0".to_owned(),
        composite,
        readout: Readout::Size,
        crops: Crops::default(),
        sizes: None,
        normalization: ChannelStatistics {
            mean: [0.4; 3],
            std: [0.2; 3],
        },
        box_kind: BoxKind::Tight,
        classes,
        rig,
    };
    DistanceEstimator::save(&network, &header, &folder.best()).unwrap();
}

/// A picture full of texture; another seed is another scene, and `shift` moves it to the left.
pub fn texture(width: u32, height: u32, seed: u32, shift: u32) -> image::RgbImage {
    image::RgbImage::from_fn(width, height, |x, y| {
        let (x, y) = ((x + shift) >> 1, y >> 1);
        let mut value = x
            .wrapping_mul(0x9E37_79B1)
            .wrapping_add(y.wrapping_mul(0x85EB_CA77))
            .wrapping_add(seed.wrapping_mul(0xC2B2_AE3D));
        value = (value ^ value >> 15).wrapping_mul(0x2C1B_3C6D);
        value ^= value >> 12;
        image::Rgb([0, 8, 16].map(|bits| (value >> bits) as u8))
    })
}
