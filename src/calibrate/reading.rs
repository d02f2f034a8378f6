//! The disparity of a place whose distance is known.

use std::f64::consts::FRAC_PI_2;

use serde::Serialize;

use super::known::{KnownDistance, Target};
use super::matching::{Matchable, place_in_right};
use crate::geometry::{PixelBox, StereoRig};

/// Disparities are looked for up to this factor below and above the expected one, and
/// [`SLACK_PX`] more: what is farther off is something else than the place.
const FACTOR: f64 = 1.1;

/// Pixels that even a far place's disparity may be off: what a calibration leaves.
const SLACK_PX: f64 = 3.0;

/// Standard deviation of a measured disparity, pixels.
const MATCH_STD_PX: f64 = 0.15;

/// Points across and down a vehicle's box that are measured.
const POINTS: [u32; 2] = [11, 8];

/// Part of the box, along x and y, that the points span.
const SPAN: [f64; 2] = [0.8, 0.7];

/// Fewest points that make a vehicle's surface.
const LEAST_POINTS: usize = 4;

/// Width and length of a car, metres; vans differ by less than the visible extent is uncertain.
const BODY_M: [f64; 2] = [1.7, 4.2];

/// What matching meets lies before the centre by this part of the extent: bodies are round, and the
/// ranger found it so.
const SURFACE: f64 = 0.65;

/// Standard deviation of the width of a box, relative.
const WIDTH_STD: f64 = 0.12;

/// A known distance and the disparity that was measured there.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reading {
    /// Line of the known distance in its file.
    pub line: u64,
    /// Frame that it is of.
    pub frame: String,
    /// Its pixel in the left image.
    pub pixel: [f64; 2],
    /// Disparity that its distance has with a perfect rig, pixels.
    pub expected_px: f64,
    /// Disparity that was measured, pixels.
    pub measured_px: f64,
    /// Standard deviation of their difference, pixels.
    pub std_px: f64,
    /// How far the surface at the pixel is from the middle between the cameras, metres.
    #[serde(skip)]
    surface_distance_m: f64,
}

impl Reading {
    /// The pixels of both images that the measured disparity belongs to.
    pub(super) fn pixels(&self, rig: &StereoRig) -> [[f64; 2]; 2] {
        let [x, y] = self.pixel;
        let aside = (x - rig.left.center_x_px - self.measured_px) / rig.left.focal_x_px;
        let right = rig.right.center_x_px + aside * rig.right.focal_x_px;
        [self.pixel, [right, y]]
    }

    /// The same reading in images of another rectification, where its pixels are these.
    pub(super) fn moved(&self, [left, right]: [[f64; 2]; 2], rig: &StereoRig) -> Option<Self> {
        let depth_m = depth_m(left, self.surface_distance_m, rig)?;
        let expected_px = rig.disparity_px(depth_m);
        Some(Self {
            pixel: left,
            expected_px,
            measured_px: rig.disparity_of_pixels(left[0], right[0]),
            std_px: self.std_px * expected_px / self.expected_px,
            ..self.clone()
        })
    }
}

/// Measures the disparity of a known distance; the reason where that cannot be done.
pub(super) fn read(
    known: &KnownDistance,
    frame: &str,
    pair: [&Matchable; 2],
    rig: &StereoRig,
) -> Result<Reading, String> {
    let pixel = known.target.pixel();
    let size = [rig.left.width, rig.left.height].map(f64::from);
    let is_inside = |[x, y]: [f64; 2]| (0.0..=size[0]).contains(&x) && (0.0..=size[1]).contains(&y);
    let corners = match known.target {
        Target::Point(pixel) => vec![pixel],
        Target::Vehicle(area) => vec![[area.x_min, area.y_min], [area.x_max, area.y_max]],
    };
    if !corners.into_iter().all(is_inside) {
        return Err(format!(
            "its place lies outside the image of {}x{} pixels",
            size[0], size[1]
        ));
    }
    let depth_m = depth_m(pixel, known.distance_m, rig)
        .ok_or("no point in front of the cameras is as near as that there")?;
    let (surface_m, extent_std_m) = match known.target {
        Target::Point(_) => (depth_m, 0.0),
        Target::Vehicle(area) => {
            let [extent_m, std_m] = extent_m(&area, depth_m, rig);
            let surface_m = depth_m - SURFACE * extent_m;
            if surface_m <= 0.0 {
                return Err("its vehicle would reach behind the cameras".to_owned());
            }
            (surface_m, SURFACE * std_m)
        }
    };
    let expected_px = rig.disparity_px(surface_m);
    let offset_px = rig.left.center_x_px - rig.right.center_x_px;
    let range = [
        expected_px / FACTOR - SLACK_PX + offset_px,
        expected_px * FACTOR + SLACK_PX + offset_px,
    ];
    let at = |pixel: [f64; 2]| {
        let place = place_in_right(pair, pixel.map(|v| v - 0.5), range)?;
        Some(rig.disparity_of_pixels(pixel[0], place[0] + 0.5))
    };
    let measured_px = match known.target {
        Target::Point(pixel) => at(pixel),
        Target::Vehicle(area) => surface_px(&area, at),
    };
    let measured_px = measured_px.ok_or_else(|| {
        format!(
            "nothing in the right image is certain to be the same between {:.1} and {:.1} px of \
             disparity; at {} m it would be {expected_px:.1} px",
            expected_px / FACTOR - SLACK_PX,
            expected_px * FACTOR + SLACK_PX,
            known.distance_m
        )
    })?;
    let surface_distance_m = rig
        .triangulated_m(pixel, expected_px)
        .ok_or("its surface would lie behind the cameras")?;
    let relative = (known.distance_std_m / known.distance_m).hypot(extent_std_m / surface_m);
    Ok(Reading {
        line: known.line,
        frame: frame.to_owned(),
        pixel,
        expected_px,
        measured_px,
        std_px: MATCH_STD_PX.hypot(expected_px * relative),
        surface_distance_m,
    })
}

/// Depth of the point on a pixel's ray that is this far from the middle between the cameras.
fn depth_m(pixel: [f64; 2], distance_m: f64, rig: &StereoRig) -> Option<f64> {
    let [x, y, _] = rig.left.camera_from_pixel(pixel);
    let half_m = rig.baseline_m / 2.0;
    let square = x * x + y * y + 1.0;
    let along = x * half_m;
    let root = along * along - square * (half_m * half_m - distance_m * distance_m);
    let depth_m = (along + root.sqrt()) / square;
    (depth_m.is_finite() && depth_m > 0.0).then_some(depth_m)
}

/// Half of a car's extent along the line of sight, mean and standard deviation: its heading is as
/// likely as the box's width at this depth makes it.
fn extent_m(area: &PixelBox, depth_m: f64, rig: &StereoRig) -> [f64; 2] {
    const HEADINGS: u32 = 31;
    let seen_m = area.width() * depth_m / rig.left.focal_x_px;
    let [width_m, length_m] = BODY_M;
    let mut sums = [0.0; 3];
    for i in 0..HEADINGS {
        let heading = FRAC_PI_2 * f64::from(i) / f64::from(HEADINGS - 1);
        let (sin, cos) = (libm::sin(heading), libm::cos(heading));
        let across_m = length_m * cos + width_m * sin;
        let off = (seen_m / across_m - 1.0) / WIDTH_STD;
        // A floor, so that boxes of no car at all have an extent too.
        let weight = libm::exp(-0.5 * off * off) + 1e-6;
        let extent_m = f64::midpoint(length_m * sin, width_m * cos);
        for (sum, part) in sums.iter_mut().zip([1.0, extent_m, extent_m * extent_m]) {
            *sum += weight * part;
        }
    }
    let mean_m = sums[1] / sums[0];
    // Bodies differ by a tenth.
    let std_m = (sums[2] / sums[0] - mean_m * mean_m).max(0.0).sqrt();
    [mean_m, std_m.hypot(0.1 * mean_m)]
}

/// The disparity that most points of a box share.
fn surface_px(area: &PixelBox, at: impl Fn([f64; 2]) -> Option<f64>) -> Option<f64> {
    let [across, down] = POINTS;
    let part =
        |i: u32, count: u32, span: f64| 0.5 + span * (f64::from(i) / f64::from(count - 1) - 0.5);
    let mut found: Vec<f64> = (0..across * down)
        .filter_map(|i| {
            at([
                area.x_min + area.width() * part(i % across, across, SPAN[0]),
                area.y_min + area.height() * part(i / across, down, SPAN[1]),
            ])
        })
        .collect();
    found.sort_unstable_by(f64::total_cmp);
    // The interval that holds most: a pixel, or as deep as a body near by.
    let best = (0..found.len())
        .map(|first| {
            let end = found[first] + 1.0_f64.max(0.05 * found[first]);
            let last = found.partition_point(|value| *value <= end);
            first..last
        })
        .max_by_key(ExactSizeIterator::len)?;
    let surface = found.get(best)?;
    (surface.len() >= LEAST_POINTS).then(|| surface.iter().sum::<f64>() / surface.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig() -> StereoRig {
        StereoRig::from_hfov(1280, 720, 90.0, 0.5).unwrap()
    }

    #[test]
    fn a_depth_is_that_of_the_point_at_this_distance() {
        for pixel in [[640.0, 360.0], [10.0, 700.0], [1270.0, 30.0]] {
            let depth_m = depth_m(pixel, 20.0, &rig()).unwrap();
            let disparity_px = rig().disparity_px(depth_m);
            let distance_m = rig().triangulated_m(pixel, disparity_px).unwrap();
            assert!((distance_m - 20.0).abs() < 1e-9, "{distance_m}");
        }
        assert_eq!(depth_m([640.0, 360.0], 0.1, &rig()), None);
    }

    #[test]
    fn a_narrow_box_is_a_car_from_behind_and_a_wide_one_from_the_side() {
        let boxed = |width_m: f64| {
            let width_px = width_m * rig().focal_px() / 20.0;
            PixelBox::from_center([640.0, 360.0], width_px, 45.0)
        };
        let [behind_m, _] = extent_m(&boxed(1.75), 20.0, &rig());
        let [side_m, _] = extent_m(&boxed(4.2), 20.0, &rig());
        assert!((1.9..2.15).contains(&behind_m), "{behind_m}");
        assert!((1.2..1.8).contains(&side_m), "{side_m}");
        assert!(extent_m(&boxed(40.0), 20.0, &rig())[0].is_finite());
    }

    #[test]
    fn the_surface_of_a_box_is_what_most_of_its_points_share() {
        let area = PixelBox::new(0.0, 0.0, 100.0, 80.0);
        let body = |[x, y]: [f64; 2]| {
            if x < 30.0 {
                Some(4.0 + y / 9.0)
            } else {
                Some(20.0 + x / 500.0)
            }
        };
        let surface_px = surface_px(&area, body).unwrap();
        assert!((surface_px - 20.12).abs() < 0.05, "{surface_px}");
        let nothing = |[x, _]: [f64; 2]| (x < 11.0).then_some(3.0).filter(|_| false);
        assert_eq!(super::surface_px(&area, nothing), None);
    }
}
