//! What feeds training: rendered pairs, augmented images and composites.

use std::hint::black_box;
use std::time::Instant;

use burn_dataset::Dataset as _;
use image::RgbImage;
use rand_pcg::Pcg64;
use rayon::prelude::*;
use tempfile::TempDir;
use twinsight::dataset::{
    BoxKind, CompositeSize, DetectionSource, Frame, Split, StereoDataset, StereoLabel,
    composite_into_planes,
};
use twinsight::detector::letterbox;
use twinsight::generate::{GenerateConfig, generate};
use twinsight::geometry::StereoRig;
use twinsight::geometry::letterbox::Size;
use twinsight::imaging::ChannelStatistics;
use twinsight::progress::Silent;
use twinsight::render::RigPose;
use twinsight::train::TrainConfig;
use twinsight::train::augment::{DetectionAugment, Scene, augmented_letterbox};
use twinsight::{Error, Result};

use super::Bench;
use super::report::{Effort, measure, milliseconds};
use super::scene;

/// Width and height of the rendered pairs.
const SIZES: [[u32; 2]; 2] = [[640, 360], [1024, 576]];
/// Distances of the views of one scene, metres.
const DISTANCES_M: [f64; 4] = [10.0, 20.0, 40.0, 60.0];
/// Frames of the dataset whose making is timed, and of the one that is loaded.
const FRAMES_MADE: u32 = 12;
const FRAMES_LOADED: u32 = 16;
/// Items of a training batch.
const BATCH: usize = 16;
/// Decoded images that are kept, bytes: all of them.
const CACHE: usize = 1 << 30;

fn temporary_folder() -> Result<TempDir> {
    tempfile::tempdir().map_err(Error::io("create a folder in", std::env::temp_dir()))
}

/// Makes a dataset of training frames in two scenes; returns milliseconds.
fn write_dataset(folder: &TempDir, frames: u32, [width, height]: [u32; 2]) -> Result<f64> {
    let config = GenerateConfig {
        frames,
        frames_per_scene: frames / 2,
        width,
        height,
        val_fraction: 0.0,
        ..GenerateConfig::default()
    };
    let started = Instant::now();
    generate(&config, folder.path(), &Silent)?;
    Ok(milliseconds(started.elapsed()))
}

/// Notes and prints a case that handles so many items.
fn print_rate(bench: &mut Bench, case: &str, items: usize, milliseconds: f64, unit: &str) {
    println!(
        "{case:<40} {milliseconds:>10.2} {:>10.1} {unit}/s",
        items as f64 / milliseconds * 1e3
    );
    bench.report.add(case, milliseconds);
}

/// The section `renderer`.
pub fn run_renderer(bench: &mut Bench) -> Result<()> {
    bench.machine.print_rates()?;
    println!("{:<40} {:>10} {:>10}", "case", "ms", "rate");
    let stage = scene::stage();
    let views = DISTANCES_M
        .iter()
        .map(|&distance_m| scene::view(&stage, distance_m))
        .collect::<Result<Vec<RigPose>>>()?;
    for size in SIZES {
        let [width, height] = size;
        let rig = scene::rig(size)?;
        let timing = measure(Effort::ONCE, || {
            black_box(scene::render_views(&stage, &rig, &views));
            Ok(())
        })?;
        let case = format!("render_{}x{width}x{height}", views.len());
        print_rate(bench, &case, views.len(), timing.least_ms, "pairs");
        let folder = temporary_folder()?;
        let elapsed = write_dataset(&folder, FRAMES_MADE, size)?;
        let case = format!("generate_{FRAMES_MADE}x{width}x{height}");
        print_rate(bench, &case, FRAMES_MADE as usize, elapsed, "pairs");
    }
    println!("render: views of one scene; generate: also scenes, visibility, labels and PNG files");
    Ok(())
}

/// The section `loader`.
pub fn run_loader(bench: &mut Bench) -> Result<()> {
    let folder = temporary_folder()?;
    write_dataset(&folder, FRAMES_LOADED, SIZES[0])?;
    let dataset = StereoDataset::open(folder.path())?;
    bench.machine.print_rates()?;
    println!("{:<40} {:>10} {:>10}", "batch of 16", "ms", "rate");
    for (name, cache) in [("decoded", CACHE), ("files", 0)] {
        let milliseconds = time_images(&dataset, cache)?;
        let case = format!("load_images_{name}");
        print_rate(bench, &case, BATCH, milliseconds, "images");
    }
    let frames: Vec<&Frame> = dataset.split(Split::Train);
    let vehicles: Vec<(&Frame, StereoLabel)> = frames
        .iter()
        .flat_map(|frame| {
            let vehicles = frame.vehicles(BoxKind::Sphere);
            vehicles.into_iter().map(|label| (*frame, label))
        })
        .take(BATCH)
        .collect();
    let rig = dataset.rig();
    let decoded = vehicles
        .iter()
        .map(|(frame, _)| frame.load(rig))
        .collect::<Result<Vec<_>>>()?;
    for size in [CompositeSize::QUICK, CompositeSize::FULL] {
        for (name, images) in [("decoded", Some(&decoded[..])), ("files", None)] {
            let milliseconds = time_composites(&vehicles, images, rig, size)?;
            let case = format!("load_composites_{size}_{name}");
            print_rate(bench, &case, vehicles.len(), milliseconds, "composites");
        }
    }
    println!("decoded: images kept in memory; files: decoded from 640x360 PNG files every time");
    Ok(())
}

/// Milliseconds of a batch of augmented images, as the detector's training loads it.
fn time_images(dataset: &StereoDataset, cache: usize) -> Result<f64> {
    let settings = TrainConfig::preset("quick")?.detector;
    let augment = DetectionAugment {
        hsv: settings.hsv,
        zoom: settings.zoom,
        shift: settings.shift,
        flip: settings.flip,
    };
    let rig = dataset.rig();
    let original = Size::new(rig.left.width, rig.left.height);
    let input = letterbox(original, settings.image_size)?.size();
    let source = DetectionSource::new(dataset, Split::Train, BoxKind::Sphere, cache);
    let mut planes = vec![0.0; BATCH * 3 * input.area()];
    let timing = measure(Effort::FEW, || {
        planes
            .par_chunks_exact_mut(3 * input.area())
            .enumerate()
            .try_for_each(|(index, planes)| {
                let item = source.get(index % source.len()).map_err(|source| {
                    Error::training(source.to_string(), "free some space for temporary files")
                })?;
                let mut random = Pcg64::new(1, index as u128);
                let scene = Scene {
                    image: &item.image,
                    boxes: &item.boxes,
                    ignored: &item.ignored,
                };
                augmented_letterbox(scene, input, &augment, &mut random, planes)
                    .map(black_box)
                    .map(|_| ())
            })
    })?;
    Ok(timing.least_ms)
}

/// Milliseconds of the composites of some vehicles; without `images` they are decoded first.
fn time_composites(
    vehicles: &[(&Frame, StereoLabel)],
    images: Option<&[[RgbImage; 2]]>,
    rig: &StereoRig,
    size: CompositeSize,
) -> Result<f64> {
    let mut planes = vec![0.0; vehicles.len() * size.plane_values()];
    let timing = measure(Effort::FEW, || {
        planes
            .par_chunks_exact_mut(size.plane_values())
            .zip(vehicles)
            .enumerate()
            .try_for_each(|(index, (planes, (frame, label)))| {
                let loaded;
                let [left, right] = if let Some(images) = images {
                    &images[index]
                } else {
                    loaded = frame.load(rig)?;
                    &loaded
                };
                composite_into_planes(
                    [left, right],
                    [&label.left.box_pixel, &label.right.box_pixel],
                    size,
                    &ChannelStatistics::IDENTITY,
                    planes,
                );
                Ok(())
            })
    })?;
    Ok(timing.least_ms)
}
