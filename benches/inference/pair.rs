//! A stereo pair to metres: stage by stage from files, and how the cost grows.
//!
//! The detector runs as it would on any image. What it finds with fresh weights means nothing, so
//! pairing and distance work on planted detections, whose number is then known.

use std::hint::black_box;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use burn::tensor::Device;
use image::imageops::{self, FilterType};
use image::{Rgb, RgbImage};
use tempfile::TempDir;
use twinsight::dataset::{BoxKind, CompositeSize};
use twinsight::detector::nms::NmsConfig;
use twinsight::detector::{Detection, DetectorHeader, Scale, VehicleDetector};
use twinsight::geometry::{PixelBox, StereoRig};
use twinsight::imaging::{ChannelStatistics, load_pair, load_rgb, save_png};
use twinsight::pairing::search::search;
use twinsight::pairing::{PairingConfig, PairingMode, pair};
use twinsight::ranging::{Crops, DistanceEstimator, RangingHeader, Readout, Sighting};
use twinsight::{Error, Result};

use super::Bench;
use super::networks::{detector, ranging};
use super::report::{Effort, Report, Timing, measure, milliseconds};
use super::scene;

/// Width and height of the images.
const SIZE: [u32; 2] = [2048, 1080];
/// Long side of the detector's input for them.
const IMAGE_SIZE: u32 = 640;
const VEHICLES: [usize; 3] = [1, 4, scene::MOST_VEHICLES];
/// Sizes of half and double the pixels, each with the long side of the detector's input that
/// grows alike.
const SIZES: [([u32; 2], u32); 3] = [([1448, 764], 448), (SIZE, IMAGE_SIZE), ([2896, 1528], 896)];

/// For parts of a pair.
const PART: Effort = Effort {
    time: Duration::from_millis(500),
    runs: 5,
};

/// Both networks for a rig.
pub struct Networks {
    pub detector: VehicleDetector,
    pub estimator: DistanceEstimator,
    pub rig: StereoRig,
}

impl Networks {
    pub fn new(scale: Scale, size: [u32; 2], image_size: u32, device: &Device) -> Result<Self> {
        let rig = scene::rig(size)?;
        let version = env!("CARGO_PKG_VERSION").to_owned();
        let classes = vec!["car".to_owned()];
        Ok(Self {
            detector: VehicleDetector::new(
                &detector(scale, device),
                DetectorHeader {
                    network: DetectorHeader::NETWORK.to_owned(),
                    version: version.clone(),
                    scale,
                    classes: classes.clone(),
                    image_size,
                    normalization: DetectorHeader::NORMALIZATION.to_owned(),
                    box_kind: BoxKind::Sphere,
                    rig,
                },
                device,
            ),
            estimator: DistanceEstimator::new(
                &ranging(device)?,
                RangingHeader {
                    network: RangingHeader::NETWORK.to_owned(),
                    version,
                    composite: CompositeSize::FULL,
                    readout: Readout::Distance,
                    crops: Crops::RightLeft,
                    sizes: None,
                    normalization: ChannelStatistics::IDENTITY,
                    box_kind: BoxKind::Sphere,
                    classes,
                    rig,
                },
                device,
            ),
            rig,
        })
    }

    /// Letterbox, detector and suppression.
    fn detect(&self, [left, right]: [&RgbImage; 2], mode: PairingMode) -> Result<()> {
        let images = match mode {
            PairingMode::Detect => &[left, right][..],
            PairingMode::Search => &[left],
        };
        black_box(self.detector.detect(images, &NmsConfig::prediction())?);
        Ok(())
    }

    fn pair(&self, images: [&RgbImage; 2], planted: &[Vec<Detection>; 2], mode: PairingMode) {
        let [left, right] = planted;
        let config = PairingConfig::default();
        match mode {
            PairingMode::Detect => {
                black_box(pair(left, right, &self.rig, &config));
            }
            PairingMode::Search => {
                black_box(search(images, left, &self.rig, &config));
            }
        }
    }

    /// Crops and distance network.
    fn range(&self, images: [&RgbImage; 2], [left, right]: &[Vec<Detection>; 2]) -> Result<()> {
        let sightings: Vec<Sighting> = left
            .iter()
            .zip(right)
            .map(|(left, right)| Sighting {
                images,
                boxes: [left.box_pixel, right.box_pixel],
            })
            .collect();
        black_box(self.estimator.estimate(&sightings, &self.rig)?);
        Ok(())
    }
}

/// A pair in memory with one vehicle.
pub struct PairInMemory {
    networks: Networks,
    left: RgbImage,
    right: RgbImage,
}

impl PairInMemory {
    pub fn new(scale: Scale, device: &Device) -> Result<Self> {
        let [width, height] = SIZE;
        let left = RgbImage::from_fn(width, height, |x, y| Rgb([x as u8, y as u8, (x ^ y) as u8]));
        Ok(Self {
            networks: Networks::new(scale, SIZE, IMAGE_SIZE, device)?,
            right: left.clone(),
            left,
        })
    }

    pub fn image(&self) -> &RgbImage {
        &self.left
    }

    pub fn networks(&self) -> &Networks {
        &self.networks
    }

    /// One vehicle for the distance network.
    pub fn sighting(&self) -> Sighting<'_> {
        let area = PixelBox::new(900.0, 500.0, 1000.0, 600.0);
        Sighting {
            images: [&self.left, &self.right],
            boxes: [area, area],
        }
    }

    /// Letterbox, detector on both, suppression, pairing, crops of one vehicle, distance network.
    pub fn run(&self) -> Result<()> {
        let Networks {
            detector,
            estimator,
            rig,
        } = &self.networks;
        let found = detector.detect(&[&self.left, &self.right], &NmsConfig::prediction())?;
        black_box(pair(&found[0], &found[1], rig, &PairingConfig::default()));
        black_box(estimator.estimate(&[self.sighting()], rig)?);
        Ok(())
    }
}

/// Milliseconds of each stage of one pair.
#[derive(Debug, Clone, Copy)]
struct Stages {
    decode: f64,
    detect: f64,
    pair: f64,
    range: f64,
}

impl Stages {
    fn total(&self) -> f64 {
        self.decode + self.detect + self.pair + self.range
    }
}

/// A pair in files, with the networks for it.
struct PairInFiles {
    networks: Networks,
    files: [PathBuf; 2],
    planted: [Vec<Detection>; 2],
}

impl PairInFiles {
    fn once(&self, mode: PairingMode) -> Result<Stages> {
        let mut last = Instant::now();
        let mut lap = || {
            let now = Instant::now();
            let lap = milliseconds(now - last);
            last = now;
            lap
        };
        let [left, right] = load_pair(&self.files[0], &self.files[1])?;
        let decode = lap();
        let images = [&left, &right];
        self.networks.detect(images, mode)?;
        let detect = lap();
        self.networks.pair(images, &self.planted, mode);
        let pair = lap();
        self.networks.range(images, &self.planted)?;
        Ok(Stages {
            decode,
            detect,
            pair,
            range: lap(),
        })
    }

    /// The stages of the fastest run.
    fn fastest(&self, mode: PairingMode) -> Result<Stages> {
        let mut best: Option<Stages> = None;
        measure(Effort::WHOLE, || {
            let stages = self.once(mode)?;
            if best.is_none_or(|best| stages.total() < best.total()) {
                best = Some(stages);
            }
            Ok(())
        })?;
        best.ok_or_else(|| {
            Error::value("benchmark", "a case did not run", "report this as a defect")
        })
    }
}

/// Writes the pair at a size, resized from the rendered one.
fn write_pair(folder: &TempDir, images: &[RgbImage; 2], size: [u32; 2]) -> Result<[PathBuf; 2]> {
    let [width, height] = size;
    let files = ["left", "right"].map(|side| folder.path().join(format!("{side}_{width}.png")));
    for (file, image) in files.iter().zip(images) {
        if image.dimensions() == (width, height) {
            save_png(file, image)?;
        } else {
            save_png(
                file,
                &imageops::resize(image, width, height, FilterType::Triangle),
            )?;
        }
    }
    Ok(files)
}

/// The section `pair`.
pub fn run(bench: &mut Bench) -> Result<()> {
    println!("in memory, one vehicle");
    bench.machine.print_rates()?;
    Report::print_heading();
    for scale in [Scale::N, Scale::M] {
        let case = PairInMemory::new(scale, &bench.device)?;
        let timing = measure(Effort::WHOLE, || case.run())?;
        bench
            .report
            .print(&format!("pair_2048x1080_{scale}"), timing);
    }
    let folder =
        tempfile::tempdir().map_err(Error::io("create a folder in", std::env::temp_dir()))?;
    let images = scene::pair(SIZE)?;
    let files = write_pair(&folder, &images, SIZE)?;
    from_files(bench, &files)?;
    by_vehicles(bench, &images)?;
    by_pixels(bench, &folder, &images)
}

/// Stages of a pair from PNG files, one vehicle.
fn from_files(bench: &mut Bench, files: &[PathBuf; 2]) -> Result<()> {
    let bytes = std::fs::metadata(&files[0]).map_or(0, |metadata| metadata.len());
    println!(
        "\nfrom PNG files of {:.1} MB each, one vehicle: milliseconds of the fastest run",
        bytes as f64 / 1e6
    );
    bench.machine.print_rates()?;
    let [alone, both] = [
        measure(PART, || {
            for file in files {
                black_box(load_rgb(file)?);
            }
            Ok(())
        })?,
        measure(PART, || {
            black_box(load_pair(&files[0], &files[1])?);
            Ok(())
        })?,
    ]
    .map(|timing| timing.least_ms);
    println!("decoding one after the other {alone:.2}, at the same time {both:.2}");
    bench.report.add("decode_2048x1080_one_by_one", alone);
    bench.report.add("decode_2048x1080_pair", both);
    println!(
        "{:<8} {:<8} {:>9} {:>9} {:>9} {:>9} {:>9}",
        "scale", "pairing", "decode", "detect", "pair", "range", "total"
    );
    for scale in [Scale::N, Scale::M] {
        let case = PairInFiles {
            networks: Networks::new(scale, SIZE, IMAGE_SIZE, &bench.device)?,
            files: files.clone(),
            planted: scene::planted(1, SIZE),
        };
        for mode in PairingMode::ALL {
            let stages = case.fastest(mode)?;
            let Stages {
                decode,
                detect,
                pair,
                range,
            } = stages;
            let total = stages.total();
            println!(
                "{:<8} {mode:<8} {decode:>9.2} {detect:>9.2} {pair:>9.2} {range:>9.2} {total:>9.2}",
                scale.letter()
            );
            let name = format!("pair_files_2048x1080_{scale}_{mode}");
            for (stage, value) in [
                ("", total),
                ("_decode", decode),
                ("_detect", detect),
                ("_pair", pair),
                ("_range", range),
            ] {
                bench.report.add(&format!("{name}{stage}"), value);
            }
        }
    }
    bench.machine.print_rates()
}

/// Cost against the number of vehicles, in memory.
fn by_vehicles(bench: &mut Bench, [left, right]: &[RgbImage; 2]) -> Result<()> {
    println!("\nby vehicles in the frame, scale n, in memory: milliseconds");
    println!(
        "{:>8} {:>9} {:>9} {:>9} {:>9} {:>14} {:>16}",
        "vehicles", "detect", "assign", "search", "range", "range/vehicle", "product GFLOP/s"
    );
    let networks = Networks::new(Scale::N, SIZE, IMAGE_SIZE, &bench.device)?;
    let images = [left, right];
    for vehicles in VEHICLES {
        let planted = scene::planted(vehicles, SIZE);
        let product = bench.machine.product_rate()?;
        let detect = measure(PART, || networks.detect(images, PairingMode::Detect))?;
        let [assign, searched] = PairingMode::ALL.map(|mode| {
            measure(Effort::BRIEF, || {
                networks.pair(images, &planted, mode);
                Ok(())
            })
        });
        let range = measure(PART, || networks.range(images, &planted))?;
        let [detect, assign, searched, range] =
            [detect, assign?, searched?, range].map(|timing: Timing| timing.least_ms);
        println!(
            "{vehicles:>8} {detect:>9.2} {assign:>9.3} {searched:>9.2} {range:>9.2} {:>14.2} {product:>16.0}",
            range / vehicles as f64
        );
        let name = format!("vehicles_{vehicles}");
        bench.report.add(&format!("{name}_assign"), assign);
        bench.report.add(&format!("{name}_search"), searched);
        bench.report.add(&format!("{name}_range"), range);
    }
    Ok(())
}

/// Cost against the number of pixels, of the images and of the detector's input.
fn by_pixels(bench: &mut Bench, folder: &TempDir, images: &[RgbImage; 2]) -> Result<()> {
    println!("\nby pixels, scale n, one vehicle, from files: milliseconds");
    println!(
        "{:<12} {:>6} {:>9} {:>9} {:>9} {:>9} {:>9} {:>18} {:>16}",
        "image",
        "input",
        "decode",
        "detect",
        "search",
        "range",
        "total",
        "(decode+detect)/MP",
        "product GFLOP/s"
    );
    for (size, image_size) in SIZES {
        let [width, height] = size;
        let product = bench.machine.product_rate()?;
        let case = PairInFiles {
            networks: Networks::new(Scale::N, size, image_size, &bench.device)?,
            files: write_pair(folder, images, size)?,
            planted: scene::planted(1, size),
        };
        let stages = case.fastest(PairingMode::Detect)?;
        let [left, right] = load_pair(&case.files[0], &case.files[1])?;
        let searched = measure(Effort::BRIEF, || {
            case.networks
                .pair([&left, &right], &case.planted, PairingMode::Search);
            Ok(())
        })?;
        let megapixels = 2.0 * f64::from(width * height) / 1e6;
        println!(
            "{:<12} {image_size:>6} {:>9.2} {:>9.2} {:>9.2} {:>9.2} {:>9.2} {:>18.2} {product:>16.0}",
            format!("{width}x{height}"),
            stages.decode,
            stages.detect,
            searched.least_ms,
            stages.range,
            stages.total(),
            (stages.decode + stages.detect) / megapixels
        );
        let name = format!("pixels_{width}x{height}");
        bench.report.add(&format!("{name}_decode"), stages.decode);
        bench.report.add(&format!("{name}_detect"), stages.detect);
        bench
            .report
            .add(&format!("{name}_search"), searched.least_ms);
    }
    Ok(())
}
