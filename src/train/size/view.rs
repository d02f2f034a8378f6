//! Training vehicles as the size network sees them, changed at random.

use image::{Rgb, RgbImage};
use rand::RngExt as _;
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::samples::{Patch, Sample, SampleSet};
use super::{SizeInputs, SizeRecipe};
use crate::dataset::BoxKind;
use crate::error::Result;
use crate::geometry::{PixelBox, StereoRig};
use crate::imaging::crop_resized;
use crate::ranging::size::{
    SIDE_PX, SizeNetwork, SizeView, VIEW_CHANNELS, crop_area, write_pixels,
};

/// Largest shift and change of size of the crop around its box, as shares.
const SHIFT: f64 = 0.06;
const ZOOM: f64 = 0.08;

/// Share of the crops that lose resolution, and the fewest pixels that are left of a side.
const COARSE: f64 = 0.4;
const COARSEST_PX: u32 = 20;

/// Largest spread of noise, counts.
const NOISE_COUNTS: f64 = 5.0;

/// Least and largest part of the box's side that something hides.
const HIDDEN: [f64; 2] = [0.1, 0.35];

/// What is to be said of a crop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Logarithm of the box's metric size.
    pub log_size: f64,
    /// Extent along the line of sight, metres.
    pub extent_m: Option<f64>,
    /// Cosine and sine of the azimuth, sine of the elevation, logarithms of length, width and height.
    pub pose: Option<[f64; SizeNetwork::POSE]>,
}

/// Crops with their targets, before they go to a device.
pub struct LoadedViews {
    pub inputs: SizeInputs,
    pub targets: Vec<Target>,
}

impl Sample {
    /// Logarithm of the labelled box's metric size.
    pub fn log_size(&self, rig: &StereoRig) -> f64 {
        SizeView::of_box(&self.box_pixel, rig.camera(self.side)).log_size(self.z_m)
    }
}

impl Patch {
    /// An area of the image in the patch's pixels.
    pub fn within(&self, area: &PixelBox) -> PixelBox {
        let [x, y] = self.corner;
        PixelBox::new(
            area.x_min - x,
            area.y_min - y,
            area.x_max - x,
            area.y_max - y,
        )
    }
}

impl SizeRecipe {
    /// Loads crops; in an epoch they are changed at random.
    pub(super) fn views(
        &self,
        samples: &SampleSet,
        items: &[usize],
        epoch: Option<u32>,
    ) -> Result<LoadedViews> {
        let mut pixels = vec![0.0; items.len() * SizeInputs::PIXELS];
        let seen: Vec<(SizeView, Target)> = pixels
            .par_chunks_exact_mut(SizeInputs::PIXELS)
            .zip(items)
            .map(|(pixels, &item)| {
                let random = epoch.map(|epoch| {
                    let stream = (u128::from(epoch) << 64) | item as u128;
                    Pcg64::new(u128::from(self.seed) + 2, stream)
                });
                self.see(samples, item, random, pixels)
            })
            .collect::<Result<_>>()?;
        let (views, targets) = seen.into_iter().unzip();
        Ok(LoadedViews {
            inputs: SizeInputs { pixels, views },
            targets,
        })
    }

    /// One crop, the numbers beside it and what is to be said of it.
    fn see(
        &self,
        samples: &SampleSet,
        item: usize,
        random: Option<Pcg64>,
        pixels: &mut [f32],
    ) -> Result<(SizeView, Target)> {
        let sample = &samples.samples[item];
        let patch = samples.patch(item)?;
        let camera = self.rig.camera(sample.side);
        let target = |view: &SizeView| Target {
            log_size: view.log_size(sample.z_m),
            extent_m: sample.extent_m,
            pose: sample.pose,
        };
        let Some(mut random) = random else {
            let area = sample.box_pixel;
            let view = SizeView::of_box(&area, camera);
            let window = crop_area(&area);
            let crop = crop_resized(&patch.image, &patch.within(&window), SIDE_PX, SIDE_PX);
            let tone = write_pixels(&crop, &area, &window, pixels);
            return Ok((view.clone().with_picture(pixels, tone), target(&view)));
        };
        let mut area = self.moved_edges(sample.box_pixel, &mut random);
        if self.kind == BoxKind::Tight {
            area = area.clipped(f64::from(camera.width), f64::from(camera.height));
        }
        if area.width() < 1.0 || area.height() < 1.0 {
            area = sample.box_pixel;
        }
        let view = SizeView::of_box(&area, camera);
        let window = moved_window(&crop_area(&area), &mut random);
        let within = patch.within(&window);
        let mut crop = if random.random_bool(COARSE) {
            let side = random.random_range(COARSEST_PX..SIDE_PX);
            let coarse = crop_resized(&patch.image, &within, side, side);
            let whole = PixelBox::new(0.0, 0.0, f64::from(side), f64::from(side));
            crop_resized(&coarse, &whole, SIDE_PX, SIDE_PX)
        } else {
            crop_resized(&patch.image, &within, SIDE_PX, SIDE_PX)
        };
        if random.random_bool(self.settings.occlusion) {
            hide(&mut crop, &mut random);
        }
        self.change_colors(&mut crop, &mut random);
        write_pixels(&crop, &area, &window, pixels);
        let mut target = target(&view);
        if !random.random_bool(self.settings.flip) {
            return Ok((view, target));
        }
        mirror(pixels);
        if let Some(pose) = &mut target.pose {
            pose[1] = -pose[1];
        }
        Ok((view.mirrored(), target))
    }

    /// Moves the edges of a box as a detector's errors do.
    fn moved_edges(&self, area: PixelBox, random: &mut Pcg64) -> PixelBox {
        let mut moved =
            |edge: f64, side: f64| edge + self.settings.box_jitter * side * bell(random);
        let (width, height) = (area.width(), area.height());
        PixelBox::new(
            moved(area.x_min, width),
            moved(area.y_min, height),
            moved(area.x_max, width),
            moved(area.y_max, height),
        )
    }

    /// Changes gamma and the channels' gains, and adds noise.
    fn change_colors(&self, crop: &mut RgbImage, random: &mut Pcg64) {
        let strength = self.settings.photometric;
        let gamma = (strength * random.random_range(-1.5..1.5)).exp();
        let gains: [f64; 3] =
            std::array::from_fn(|_| 1.0 + 0.5 * strength * random.random_range(-1.0..1.0));
        let levels: Vec<[f64; 3]> = (0..256)
            .map(|level| {
                let value = 255.0 * (f64::from(level) / 255.0).powf(gamma);
                gains.map(|gain| gain * value)
            })
            .collect();
        let noise = random.random_range(0.0..=NOISE_COUNTS);
        for pixel in crop.pixels_mut() {
            for (channel, value) in pixel.0.iter_mut().enumerate() {
                let changed = levels[usize::from(*value)][channel] + noise * bell(random);
                *value = changed.round().clamp(0.0, 255.0) as u8;
            }
        }
    }
}

/// The sum of three uniform numbers is close to normal with variance 1, and bounded.
fn bell(random: &mut Pcg64) -> f64 {
    (0..3).map(|_| random.random_range(-1.0..1.0)).sum()
}

/// Moves and resizes a square.
fn moved_window(window: &PixelBox, random: &mut Pcg64) -> PixelBox {
    let side = window.width() * (1.0 + random.random_range(-ZOOM..ZOOM));
    let center = window
        .center()
        .map(|at| at + side * random.random_range(-SHIFT..SHIFT));
    PixelBox::from_center(center, side, side)
}

/// Hides a part of a crop behind a rectangle of one colour.
fn hide(crop: &mut RgbImage, random: &mut Pcg64) {
    let side = f64::from(SIDE_PX);
    let mut span = || {
        let length = side * random.random_range(HIDDEN[0]..HIDDEN[1]);
        let start = random.random_range(0.0..side - length);
        start as u32..(start + length) as u32
    };
    let (columns, rows) = (span(), span());
    let color = Rgb([(); 3].map(|()| random.random_range(0..=255_u8)));
    for y in rows {
        for x in columns.clone() {
            crop.put_pixel(x, y, color);
        }
    }
}

/// Mirrors a crop `[SIDE_PX, SIDE_PX, VIEW_CHANNELS]`.
fn mirror(pixels: &mut [f32]) {
    let side = SIDE_PX as usize;
    for row in pixels.chunks_exact_mut(side * VIEW_CHANNELS) {
        for x in 0..side / 2 {
            for channel in 0..VIEW_CHANNELS {
                let (a, b) = (x, side - 1 - x);
                row.swap(a * VIEW_CHANNELS + channel, b * VIEW_CHANNELS + channel);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::fixture::Fixture;
    use crate::progress::Silent;
    use crate::train::TrainConfig;
    use burn::tensor::Device;

    fn recipe(change: impl Fn(&mut TrainConfig)) -> SizeRecipe {
        let fixture = Fixture::lawful(10);
        let mut config = TrainConfig::preset("quick").unwrap();
        config.box_kind = BoxKind::Tight;
        change(&mut config);
        SizeRecipe::new(&config, &fixture.open(), &Device::flex(), &Silent).unwrap()
    }

    #[test]
    fn a_crop_depends_on_seed_epoch_and_item_and_on_nothing_else() {
        let recipe = recipe(|_| {});
        let load = |epoch, items: &[usize]| {
            let loaded = recipe.views(&recipe.train, items, Some(epoch)).unwrap();
            (loaded.inputs.pixels, loaded.targets)
        };
        let (pixels, targets) = load(3, &[0, 1, 2]);
        let (alone, alone_target) = load(3, &[2]);
        assert_eq!(pixels[2 * SizeInputs::PIXELS..], alone);
        assert_eq!(targets[2], alone_target[0]);
        assert_ne!(load(4, &[2]).0, alone);
    }

    #[test]
    fn the_size_that_is_to_be_said_is_that_of_the_box_that_is_shown() {
        let still = recipe(|_| {});
        let moved = recipe(|config| config.size.box_jitter = 0.1);
        let truth = |recipe: &SizeRecipe, epoch| {
            let loaded = recipe.views(&recipe.train, &[0], epoch).unwrap();
            (loaded.inputs.views[0].clone(), loaded.targets[0])
        };
        let (view, target) = truth(&still, None);
        let (moved_view, moved_target) = truth(&moved, Some(0));
        assert_ne!(view.angles, moved_view.angles);
        // Both say the same depth.
        let depth_m = |view: &SizeView, target: &Target| {
            target.log_size.exp() / (view.angles[0] * view.angles[1]).sqrt()
        };
        let difference = depth_m(&view, &target) - depth_m(&moved_view, &moved_target);
        assert!(difference.abs() < 1e-9, "{difference}");
    }

    #[test]
    fn mirroring_a_crop_twice_changes_nothing() {
        let recipe = recipe(|_| {});
        let loaded = recipe.views(&recipe.val, &[0], None).unwrap();
        let mut pixels = loaded.inputs.pixels.clone();
        mirror(&mut pixels);
        assert_ne!(pixels, loaded.inputs.pixels);
        mirror(&mut pixels);
        assert_eq!(pixels, loaded.inputs.pixels);
    }
}
