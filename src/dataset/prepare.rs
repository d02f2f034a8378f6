//! Makes stage two's training data: the folder `composites` of a dataset.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use image::RgbImage;

use super::composite::{CompositeSize, composite, geometry_vector};
use super::composite_set::{CompositeStatistics, SplitCounts, composites_in, is_composite_name};
use super::frame::{Frame, Problem};
use super::reader::StereoDataset;
use super::{BoxKind, Split};
use crate::error::{Error, Result};
use crate::files;
use crate::imaging::{ChannelStatistics, save_png};
use crate::progress::{Progress, in_parallel};

/// What [`prepare`] did.
#[derive(Debug, Clone, PartialEq)]
pub struct PrepareReport {
    /// What now stands in `composites/statistics.toml`.
    pub statistics: CompositeStatistics,
    /// Files of an earlier preparation that did not belong any more.
    pub removed: usize,
    /// Frames whose images could not be used.
    pub problems: Vec<Problem>,
}

/// Writes a composite for every vehicle that is labelled in both images with a box of `kind`, and
/// the channel statistics over those of the training split.
///
/// Each file is written whole or not at all, and the statistics come last: a preparation that was
/// stopped is not taken for a finished one. The result is the same for any number of threads.
///
/// # Errors
/// [`Error::Dataset`] when no composite can be made, [`Error::Io`] when a file cannot be written,
/// [`Error::Interrupted`] when the user stopped it, [`Error::Value`] for an unusable size.
pub fn prepare(
    dataset: &StereoDataset,
    kind: BoxKind,
    size: CompositeSize,
    progress: &dyn Progress,
) -> Result<PrepareReport> {
    let size = CompositeSize::new(size.height, size.width)?;
    let folder = dataset.folder.join("composites");
    let statistics_path = CompositeStatistics::path(&dataset.folder);
    if statistics_path.exists() {
        fs::remove_file(&statistics_path).map_err(Error::io("remove", &statistics_path))?;
    }
    for split in Split::ALL {
        files::create_folder(folder.join(split.word()))?;
    }
    let outcomes = in_parallel(
        progress,
        "composites",
        "run the same command again to finish the composites",
        &dataset.frames,
        |frame| prepare_frame(dataset, frame, kind, size),
    )?;

    let mut counts = SplitCounts::default();
    let mut sums = ChannelSums::default();
    let mut problems = Vec::new();
    let mut expected: BTreeSet<(Split, String)> = BTreeSet::new();
    for (frame, outcome) in dataset.frames.iter().zip(outcomes) {
        let split = frame.row.split;
        *counts.of_mut(split) += outcome.names.len() as u64;
        if split == Split::Train {
            sums.add(&outcome.sums);
        }
        problems.extend(outcome.problem);
        expected.extend(outcome.names.into_iter().map(|name| (split, name)));
    }
    if expected.is_empty() {
        let reason = if problems.is_empty() {
            format!("no vehicle has a {kind} label in both images")
        } else {
            Problem::summary(&problems)
        };
        return Err(Error::dataset(
            &dataset.folder,
            format!("gives no composite: {reason}"),
            "choose the other kind of label or repair the dataset",
        ));
    }
    let removed = remove_strangers(&folder, &expected)?;
    let statistics = CompositeStatistics {
        kind,
        fingerprint: fingerprint(dataset, kind),
        size,
        counts,
        train: sums.statistics(),
    };
    statistics.write(&dataset.folder)?;
    Ok(PrepareReport {
        statistics,
        removed,
        problems,
    })
}

/// Whether the composites on disk are those that [`prepare`] would make of these labels, splits
/// and settings. Images are compared by the sizes of their files alone.
pub fn is_prepared(dataset: &StereoDataset, kind: BoxKind, size: CompositeSize) -> bool {
    let Ok(statistics) = CompositeStatistics::read(&dataset.folder) else {
        return false;
    };
    let complete = |split: Split| {
        let folder = dataset.folder.join("composites").join(split.word());
        composites_in(&folder).is_ok_and(|names| names.len() as u64 == statistics.counts.of(split))
    };
    statistics.kind == kind
        && statistics.size == size
        && statistics.fingerprint == fingerprint(dataset, kind)
        && Split::ALL.iter().all(|split| complete(*split))
}

/// What became of one frame.
#[derive(Debug, Default)]
struct FrameOutcome {
    /// File names without extension.
    names: Vec<String>,
    sums: ChannelSums,
    problem: Option<Problem>,
}

/// Writes all composites of one frame; the pair is decoded once, and only if a vehicle needs it.
fn prepare_frame(
    dataset: &StereoDataset,
    frame: &Frame,
    kind: BoxKind,
    size: CompositeSize,
) -> Result<FrameOutcome> {
    let mut outcome = FrameOutcome::default();
    let vehicles = frame.vehicles(kind);
    if vehicles.is_empty() {
        return Ok(outcome);
    }
    let [left, right] = match frame.load(dataset.rig()) {
        Ok(pair) => pair,
        Err(error) => {
            outcome.problem = Some(Problem::of_frame(frame.row.stamp, error.to_string()));
            return Ok(outcome);
        }
    };
    let folder = dataset
        .folder
        .join("composites")
        .join(frame.row.split.word());
    for vehicle in vehicles {
        let (left_box, right_box) = (&vehicle.left.box_pixel, &vehicle.right.box_pixel);
        let stacked = composite(&left, &right, left_box, right_box, size);
        let [norm_w, norm_h] = geometry_vector(left_box, right_box, left.width(), left.height());
        let name = format!("{}_{}", frame.name(), vehicle.id);
        save_png(folder.join(format!("{name}.png")), &stacked)?;
        let line = format!("{},{norm_w},{norm_h}\n", vehicle.distance_m);
        files::write_atomically(folder.join(format!("{name}.txt")), line.as_bytes())?;
        outcome.sums.add_image(&stacked);
        outcome.names.push(name);
    }
    Ok(outcome)
}

/// Sums over pixel levels per channel. Integers, so neither order nor threads change the result.
#[derive(Debug, Clone, Copy, Default)]
struct ChannelSums {
    pixels: u64,
    levels: [u64; 3],
    squares: [u64; 3],
}

impl ChannelSums {
    fn add_image(&mut self, image: &RgbImage) {
        for pixel in image.as_raw().chunks_exact(3) {
            for (channel, level) in pixel.iter().enumerate() {
                let level = u64::from(*level);
                self.levels[channel] += level;
                self.squares[channel] += level * level;
            }
        }
        self.pixels += u64::from(image.width()) * u64::from(image.height());
    }

    fn add(&mut self, other: &Self) {
        self.pixels += other.pixels;
        for channel in 0..3 {
            self.levels[channel] += other.levels[channel];
            self.squares[channel] += other.squares[channel];
        }
    }

    /// Mean and standard deviation of `level / 255`; none without pixels.
    fn statistics(&self) -> Option<ChannelStatistics> {
        if self.pixels == 0 {
            return None;
        }
        let pixels = u128::from(self.pixels);
        let per_channel = |value: &dyn Fn(usize) -> f64| [value(0), value(1), value(2)];
        Some(ChannelStatistics {
            mean: per_channel(&|channel| self.levels[channel] as f64 / self.pixels as f64 / 255.0),
            std: per_channel(&|channel| {
                let (sum, squares) = (
                    u128::from(self.levels[channel]),
                    u128::from(self.squares[channel]),
                );
                // n^2 times the variance, exactly; the difference of the two rounded terms would
                // lose half of the digits.
                let scaled = pixels * squares - sum * sum;
                (scaled as f64).sqrt() / self.pixels as f64 / 255.0
            }),
        })
    }
}

/// Removes composites and half-written files that do not belong to this preparation; whatever else
/// a user put there stays.
fn remove_strangers(folder: &Path, expected: &BTreeSet<(Split, String)>) -> Result<usize> {
    let mut removed = 0;
    for split in Split::ALL {
        let folder = folder.join(split.word());
        for entry in fs::read_dir(&folder).map_err(Error::io("read", &folder))? {
            let path = entry.map_err(Error::io("read", &folder))?.path();
            let name = path
                .file_name()
                .and_then(|name| name.to_str())
                .unwrap_or_default();
            let ours = match name.rsplit_once('.') {
                Some((stem, "png" | "txt")) if is_composite_name(stem) => {
                    !expected.contains(&(*split, stem.to_owned()))
                }
                _ => name.starts_with(files::TEMPORARY_PREFIX),
            };
            if ours {
                fs::remove_file(&path).map_err(Error::io("remove", &path))?;
                removed += 1;
            }
        }
    }
    Ok(removed)
}

/// A number that changes when labels, splits, rig or image files change.
fn fingerprint(dataset: &StereoDataset, kind: BoxKind) -> String {
    // FNV-1a: stable for ever and good enough to notice a change; nobody attacks it.
    let mut hash: u64 = 0xcbf2_9ce4_8422_2325;
    let mut add = |text: &str| {
        for byte in text.bytes().chain([b'\n']) {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    };
    let camera = dataset.rig().left;
    add(&format!("{}x{}", camera.width, camera.height));
    for frame in &dataset.frames {
        add(&format!("{} {}", frame.name(), frame.row.split));
        for (_, image) in frame.images() {
            let length = fs::metadata(&image.path).map_or(0, |metadata| metadata.len());
            add(&length.to_string());
            for label in image.labels_of(kind) {
                add(&label.to_line());
            }
        }
    }
    format!("{hash:016x}")
}

#[cfg(test)]
mod tests;
