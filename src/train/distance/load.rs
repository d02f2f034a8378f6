//! Training vehicles as the network sees them, changed at random.

use std::sync::{Arc, OnceLock};

use image::RgbImage;
use image::imageops::{crop_imm, flip_horizontal_in_place};
use rand::RngExt as _;
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::DistanceRecipe;
use crate::dataset::{Frame, StereoLabel};
use crate::error::Result;
use crate::geometry::{PixelBox, StereoRig};
use crate::imaging::ChannelStatistics;
use crate::ranging::{Crops, Reading, Sighting, surface_m};
use crate::train::augment::mirror_composite;

/// Rows above and below a vehicle's boxes that the search for its surface may look at, pixels.
const ROWS_AROUND: f64 = 32.0;

/// A labelled vehicle in its frame.
#[derive(Debug, Clone)]
pub(super) struct Vehicle {
    pub frame: Arc<Frame>,
    pub label: StereoLabel,
    /// Left and right box of the detector, which then stand for the labelled ones.
    pub detected: Option<[PixelBox; 2]>,
    /// Distances of the surface in its boxes, as they are and mirrored, once measured.
    surfaces_m: Arc<[OnceLock<Option<f64>>; 2]>,
}

impl Vehicle {
    pub fn new(frame: Arc<Frame>, label: StereoLabel) -> Self {
        Self {
            frame,
            label,
            detected: None,
            surfaces_m: Arc::default(),
        }
    }

    /// Its boxes, left and right.
    pub fn boxes(&self) -> [PixelBox; 2] {
        self.detected
            .unwrap_or([self.label.left.box_pixel, self.label.right.box_pixel])
    }
}

/// Composites before they go to a device.
pub struct LoadedComposites {
    pub(super) planes: Vec<f32>,
    pub(super) readings: Vec<Reading>,
    pub(super) distances_m: Vec<f32>,
}

impl DistanceRecipe {
    /// Loads composites; with an epoch they are changed at random.
    pub(super) fn composites(
        &self,
        vehicles: &[Vehicle],
        epoch: Option<(u32, &[usize])>,
    ) -> Result<LoadedComposites> {
        let size = self.settings.composite;
        let mut planes = vec![0.0; vehicles.len() * size.plane_values()];
        let readings = planes
            .par_chunks_exact_mut(size.plane_values())
            .zip(vehicles)
            .enumerate()
            .map(|(position, (planes, vehicle))| {
                let random = epoch.map(|(epoch, items)| {
                    let stream = (u128::from(epoch) << 64) | items[position] as u128;
                    Pcg64::new(u128::from(self.seed) + 1, stream)
                });
                self.see(vehicle, random, planes)
            })
            .collect::<Result<_>>()?;
        Ok(LoadedComposites {
            planes,
            readings,
            distances_m: vehicles
                .iter()
                .map(|vehicle| vehicle.label.distance_m as f32)
                .collect(),
        })
    }

    /// One composite and the numbers beside it.
    fn see(
        &self,
        vehicle: &Vehicle,
        mut random: Option<Pcg64>,
        planes: &mut [f32],
    ) -> Result<Reading> {
        let frame = &vehicle.frame;
        let images = self.frames.get(frame.row.stamp, || frame.load(&self.rig))?;
        let mut boxes = vehicle.boxes();
        // The detector's boxes have its errors already.
        if let Some(random) = &mut random
            && vehicle.detected.is_none()
        {
            boxes = boxes.map(|area| self.jitter(area, random));
        }
        let sighting = Sighting {
            images: [&images[0], &images[1]],
            boxes,
        };
        self.header.compose(&sighting, planes);
        let is_mirrored = random.is_some_and(|mut random| self.change(planes, &mut random));
        // Of the changes only the mirror and the boxes matter: correlation is blind to brightness
        // and contrast.
        let measured_m = self.header.sizes.and_then(|_| {
            let measure = || measured_m(&sighting, &self.rig, is_mirrored);
            if boxes == vehicle.boxes() {
                *vehicle.surfaces_m[usize::from(is_mirrored)].get_or_init(measure)
            } else {
                measure()
            }
        });
        Ok(self.header.reading_with(&sighting, &self.rig, measured_m))
    }

    /// Moves the edges of a box as a detector's errors do.
    fn jitter(&self, area: PixelBox, random: &mut Pcg64) -> PixelBox {
        let mut moved = |edge: f64, side: f64| {
            // The sum of three uniform numbers is close to normal, and bounded.
            let error: f64 = (0..3).map(|_| random.random_range(-1.0..1.0)).sum();
            edge + self.settings.box_jitter * side * error
        };
        let (width, height) = (area.width(), area.height());
        PixelBox::new(
            moved(area.x_min, width),
            moved(area.y_min, height),
            moved(area.x_max, width),
            moved(area.y_max, height),
        )
    }

    /// Changes brightness and contrast, and mirrors; says whether it did mirror.
    fn change(&self, planes: &mut [f32], random: &mut Pcg64) -> bool {
        let size = self.settings.composite;
        let strength = self.settings.photometric;
        let contrast = 1.0 + strength * random.random_range(-1.0..1.0);
        let brightness = 0.5 * strength * random.random_range(-1.0..1.0);
        let ChannelStatistics { mean, std } = self.header.normalization;
        let [height, width] = [size.height as usize, size.width as usize];
        let filled = self.header.crops.filled_rows(size) as usize * width;
        for (channel, plane) in planes.chunks_exact_mut(height * width).enumerate() {
            // In pixel values: contrast * value + brightness; here the values are normalised.
            let shift = (mean[channel] * (contrast - 1.0) + brightness) / std[channel].max(1e-6);
            for value in &mut plane[..filled] {
                *value = *value * contrast as f32 + shift as f32;
            }
        }
        let is_mirrored = random.random_bool(self.settings.flip);
        if is_mirrored {
            match self.header.crops {
                Crops::RightLeft => mirror_composite(planes, height, width),
                // Nothing to exchange.
                Crops::RightRight | Crops::Mono => {
                    planes.chunks_exact_mut(width).for_each(<[f32]>::reverse);
                }
            }
        }
        is_mirrored
    }
}

/// Distance of the visible surface, metres, as the pair or its mirror image shows it. The mirrored
/// pair's left image is the right one, so other pixels are looked for and the answer is another one.
fn measured_m(sighting: &Sighting, rig: &StereoRig, is_mirrored: bool) -> Option<f64> {
    if !is_mirrored {
        return surface_m(sighting, rig);
    }
    let (sighting, first_row, rows) = around(sighting);
    let mirror = |image: &RgbImage| {
        let mut part = crop_imm(image, 0, first_row, image.width(), rows).to_image();
        flip_horizontal_in_place(&mut part);
        part
    };
    let [left, right] = sighting.images.map(mirror);
    let width = f64::from(rig.left.width);
    let [left_box, right_box] = sighting.boxes.map(|area| area.mirrored(width));
    let mirrored = Sighting {
        images: [&right, &left],
        boxes: [right_box, left_box],
    };
    surface_m(&mirrored, &rig.mirrored().of_rows(first_row, rows))
}

/// A sighting whose boxes count from the first of the rows around them, that row, and how many there
/// are: mirroring whole frames for each vehicle would take longer than the search.
fn around<'a>(sighting: &Sighting<'a>) -> (Sighting<'a>, u32, u32) {
    let [left, right] = &sighting.boxes;
    let height = f64::from(sighting.images[0].height());
    let both = left.around(right);
    let first = (both.y_min - ROWS_AROUND).floor().clamp(0.0, height - 1.0);
    let end = (both.y_max + ROWS_AROUND).ceil().clamp(first + 1.0, height);
    let boxes = sighting.boxes.map(|area| PixelBox {
        y_min: area.y_min - first,
        y_max: area.y_max - first,
        ..area
    });
    let images = sighting.images;
    (
        Sighting { images, boxes },
        first as u32,
        (end - first) as u32,
    )
}

#[cfg(test)]
mod tests;
