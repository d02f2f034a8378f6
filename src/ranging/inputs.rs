//! What the network is shown of a vehicle, and how its output becomes metres: one way for training,
//! evaluation and prediction.

use serde::{Deserialize, Serialize};

use super::{RangingHeader, Readout, Sighting, sizes_as_trained, surface_m};
use crate::dataset::{CompositeSize, Half, half_into_planes};
use crate::geometry::{PixelBox, StereoRig};
use crate::imaging::ChannelStatistics;

/// Numbers of the geometry vector that follow from the boxes: normalised width and height.
const BOX_NUMBERS: usize = 2;

/// Further numbers where the disparity is measured.
const DISPARITY_NUMBERS: usize = 3;

/// Distances are given to the network in this unit, metres, so that all its inputs are of about
/// one size.
const DISTANCE_UNIT_M: f64 = 10.0;

/// Detected boxes, and with them the sizes that they imply, may be wrong by this factor.
const SIZE_SLACK: f64 = 1.1;

/// Which crops the composite holds: the inputs that the paper compares in its section 7.
///
/// The composite's size, and with it the network, is the same for all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Crops {
    /// The right crop above the left one: the paper's network.
    #[default]
    RightLeft,
    /// The right crop twice: a pair of the same shape without anything stereo in it.
    RightRight,
    /// The right crop alone; the lower half is grey, the mean of the training composites.
    Mono,
}

impl Crops {
    /// The word that people write for it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::RightLeft => "right-left",
            Self::RightRight => "right-right",
            Self::Mono => "mono",
        }
    }

    /// Of something left and something right that which the composite is made of.
    fn seen<T: Copy>(self, [left, right]: [T; 2]) -> [T; 2] {
        match self {
            Self::RightLeft => [left, right],
            Self::RightRight | Self::Mono => [right, right],
        }
    }

    /// Rows of a composite that show anything.
    pub(crate) const fn filled_rows(self, size: CompositeSize) -> u32 {
        match self {
            Self::RightLeft | Self::RightRight => size.height,
            Self::Mono => size.width,
        }
    }
}

/// How large the vehicles of the training split are across the line of sight, metres: what
/// [`Readout::Size`] gives for their labels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleSizes {
    /// The smallest one.
    pub least_m: f64,
    /// The median.
    pub typical_m: f64,
    /// The largest one.
    pub largest_m: f64,
}

impl VehicleSizes {
    /// Of labelled vehicles; None where there are none.
    pub fn of(sizes_m: impl Iterator<Item = f64>) -> Option<Self> {
        let mut sizes_m: Vec<f64> = sizes_m
            .filter(|size_m| size_m.is_finite() && *size_m > 0.0)
            .collect();
        sizes_m.sort_by(f64::total_cmp);
        Some(Self {
            least_m: *sizes_m.first()?,
            typical_m: sizes_m[sizes_m.len() / 2],
            largest_m: *sizes_m.last()?,
        })
    }

    /// Whether a vehicle can have this size: a disparity that says otherwise is something else's,
    /// such as the street's beside it.
    fn allow(&self, size_m: f64) -> bool {
        (self.least_m / SIZE_SLACK..=self.largest_m * SIZE_SLACK).contains(&size_m)
    }
}

/// The numbers beside a composite.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// The geometry vector.
    pub geometry: Vec<f32>,
    /// Metres of distance for each unit of the network's output.
    pub distance_per_output: f64,
    /// The distance that an output of 0 stands for, metres.
    pub distance_at_zero_m: f64,
}

impl Reading {
    /// The distance that an output stands for, metres.
    pub fn distance_m(&self, output: f64) -> f64 {
        output * self.distance_per_output + self.distance_at_zero_m
    }

    /// Whether the surface was found; None where it was not looked for.
    pub fn surface_found(&self) -> Option<bool> {
        self.geometry.get(BOX_NUMBERS).map(|found| *found > 0.0)
    }
}

impl RangingHeader {
    /// Numbers in the geometry vector.
    pub const fn geometry_numbers(&self) -> usize {
        match self.sizes {
            None => BOX_NUMBERS,
            Some(_) => BOX_NUMBERS + DISPARITY_NUMBERS,
        }
    }

    /// Writes the composite of a vehicle as normalised planes `[3, height, width]`.
    ///
    /// # Panics
    /// When `planes` is not [`CompositeSize::plane_values`] long.
    pub fn compose(&self, sighting: &Sighting, planes: &mut [f32]) {
        compose(
            self.crops,
            sighting,
            self.composite,
            &self.normalization,
            planes,
        );
    }

    /// The numbers beside the composite of a vehicle, given the rig that took the images; where it is
    /// another than the trained one, box sizes are what they would have been with that one. Measures
    /// the disparity where the network was trained with it.
    pub fn reading(&self, sighting: &Sighting, rig: &StereoRig) -> Reading {
        let surface_m = self.sizes.and_then(|_| surface_m(sighting, rig));
        self.reading_with(sighting, rig, surface_m)
    }

    /// [`RangingHeader::reading`] with the distance of the visible surface already measured.
    pub(crate) fn reading_with(
        &self,
        sighting: &Sighting,
        rig: &StereoRig,
        surface_m: Option<f64>,
    ) -> Reading {
        let [left, right] = self.crops.seen(sighting.boxes);
        let [left_camera, right_camera] = self.crops.seen([rig.left, rig.right]);
        let seen_rig = StereoRig {
            left: left_camera,
            right: right_camera,
            ..*rig
        };
        let [left_trained, right_trained] = self.crops.seen([self.rig.left, self.rig.right]);
        let trained_rig = StereoRig {
            left: left_trained,
            right: right_trained,
            ..self.rig
        };
        let per_size = |boxes: [&PixelBox; 2], rig| Readout::Size.distance_per_output(boxes, rig);
        let mut reading = Reading {
            geometry: sizes_as_trained([&left, &right], &seen_rig, &trained_rig).to_vec(),
            distance_per_output: match self.readout {
                Readout::Distance | Readout::Surface => 1.0,
                Readout::Size => per_size([&left, &right], &seen_rig),
            },
            distance_at_zero_m: 0.0,
        };
        if let Some(sizes) = &self.sizes {
            let [left, right] = &sighting.boxes;
            let surface = Surface::new(sizes, surface_m, per_size([left, right], rig));
            reading.geometry.extend(surface.numbers());
            if self.readout == Readout::Surface {
                reading.distance_at_zero_m = surface.distance_m;
            }
        }
        reading
    }
}

fn compose(
    crops: Crops,
    sighting: &Sighting,
    size: CompositeSize,
    statistics: &ChannelStatistics,
    planes: &mut [f32],
) {
    let images = crops.seen(sighting.images);
    let boxes = crops.seen(sighting.boxes);
    half_into_planes(images[1], &boxes[1], Half::Upper, size, statistics, planes);
    match crops {
        Crops::RightLeft | Crops::RightRight => {
            half_into_planes(images[0], &boxes[0], Half::Lower, size, statistics, planes);
        }
        Crops::Mono => {
            let width = size.width as usize;
            for plane in planes.chunks_exact_mut(2 * width * width) {
                plane[width * width..].fill(0.0);
            }
        }
    }
}

/// Where the visible surface of a vehicle is.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Surface {
    /// Whether it was measured.
    found: bool,
    /// Its distance, metres: where it was not measured, that of a vehicle of the typical size.
    distance_m: f64,
    /// What the boxes enclose at that distance, metres.
    size_m: f64,
}

impl Surface {
    /// Refuses a measurement with which the vehicle would be smaller or larger than any.
    fn new(sizes: &VehicleSizes, measured_m: Option<f64>, distance_per_size: f64) -> Self {
        let size_m = |distance_m: f64| distance_m / distance_per_size;
        let measured_m = measured_m.filter(|&distance_m| sizes.allow(size_m(distance_m)));
        let distance_m = measured_m.unwrap_or(sizes.typical_m * distance_per_size);
        Self {
            found: measured_m.is_some(),
            distance_m,
            size_m: size_m(distance_m),
        }
    }

    /// What the last layer, which can only add, needs of it for any readout: the distance for
    /// [`Readout::Distance`], the size for [`Readout::Size`]. Whether it was found comes first.
    fn numbers(&self) -> [f32; DISPARITY_NUMBERS] {
        [
            f32::from(u8::from(self.found)),
            (self.distance_m / DISTANCE_UNIT_M) as f32,
            self.size_m as f32,
        ]
    }
}

#[cfg(test)]
mod tests;
