//! The partner of a detection of the left image, found in the right image without a detector.
//!
//! In a rectified rig a vehicle appears in the right image on the same rows, moved by its
//! disparity. The middle of the left box is compared with every place that the rig and the size of
//! vehicles allow, first coarsely, then pixel by pixel, and the most alike place is the partner:
//! unless nothing there is alike enough, or another place is as alike.
//!
//! The disparity is the one of the visible surface. That of the vehicle's centre, a little further
//! away, is smaller: by one part in 20 for a surface 1 m before a centre at 20 m.

use std::cmp::Ordering;
use std::ops::RangeInclusive;

use image::{RgbImage, imageops};
use rayon::prelude::*;

use super::correlation::{GreyPlane, Grid, Template};
use super::{PairingConfig, disparity_range};
use crate::detector::detection::Detection;
use crate::geometry::{PixelBox, StereoRig};

/// Part of a box's width and height that is compared. Boxes hold background around the vehicle,
/// which moves by another disparity: above and below more than beside it, because vehicles are
/// longer than high. Of whole boxes in rendered 1920-pixel frames, 6 % were found on the background,
/// of these parts 0.2 %; still smaller parts gained nothing.
const COMPARED: [f64; 2] = [0.8, 0.6];

/// Standard deviations of the bell-shaped weights over half the width and height of the compared
/// part, for the same reason: with equal weights 2 % were found on the background.
const BELL: [f64; 2] = [0.7, 0.4];

/// The compared part has at least this many pixels a side, even if the box has fewer: smaller
/// patches are too often like something else. With 8, one in a hundred boxes of less than 24 pixels
/// was refused, with 12 none.
const LEAST_PATCH_PX: f64 = 12.0;

/// The first, coarse comparison averages pixels until a patch has at most this many points a side:
/// its cost is then the same for all sizes. From 16 to 48 the results hardly differ.
const COARSE_POINTS: f64 = 32.0;

/// Coarse peaks that are followed to full resolution, where the first may prove lower than another,
/// or no better. More than two made no difference.
const CANDIDATES: usize = 3;

/// Rows above and below the epipolar line that are tried, pixels: what a usual calibration leaves.
const ROW_SLACK_PX: usize = 2;

/// A disparity that is measured may lie below the least one of the box's size by this, pixels: what a
/// calibration leaves along the rows. The slack of boxes that a detector placed is many times larger,
/// and with it exchanged images gave plausible distances.
const DISPARITY_SLACK_PX: f64 = 1.0;

/// Least correlation of a partner. On rendered frames 19 of 20 true partners reach 0.73, and in the
/// image of another scene one in ten boxes of up to 48 pixels, and one in a hundred larger ones,
/// finds a place that reaches 0.6.
const LEAST_CORRELATION: f64 = 0.6;

/// Two places whose correlations differ by less than this cannot be told apart. From 0.02 to 0.05
/// nothing changes; below, more wrong places come through.
const LEAST_LEAD: f64 = 0.02;

/// Least share of a patch, by weight, that must lie inside the right image: half a vehicle can be
/// recognised, and less of it would be measured by its rim.
const LEAST_VISIBLE: f64 = 0.5;

/// Places beyond each end of the range, so that a best place at its end has neighbours.
const MARGIN: usize = 2;

/// More places than the two widest images have columns come from a rig that nobody can build.
const MOST_PLACES: f64 = 65_536.0;

/// Boxes of one class that overlap by more than this intersection over union are one vehicle:
/// what suppression of detections takes for one.
pub(crate) const SAME_VEHICLE_IOU: f64 = 0.7;

/// The partner of a detection of the left image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Partner {
    /// Index into the list of left detections.
    pub left: usize,
    /// Its box in the right image, pixels: the left box moved by the disparity, and clipped to the
    /// image as detected boxes are.
    pub box_pixel: PixelBox,
    /// Disparity of the visible surface, counted from the principal points, pixels of the left
    /// camera.
    pub disparity_px: f64,
    /// How alike both patches are, at most 1.
    pub correlation: f64,
}

/// The detections of the left image, sorted out.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Searched {
    /// Partners, in the order of the left list.
    pub partners: Vec<Partner>,
    /// Detections of the left image without a partner.
    pub left_only: Vec<usize>,
}

/// Looks in the right image for the partner of every detection of the left image.
///
/// The rig must be the one of images of this size. Detections are followed in parallel, each at a
/// cost that grows with its box's area; the result does not depend on the number of threads.
pub fn search(
    images: [&RgbImage; 2],
    left: &[Detection],
    rig: &StereoRig,
    config: &PairingConfig,
) -> Searched {
    let found: Vec<Option<Partner>> = left
        .par_iter()
        .enumerate()
        .map(|(left, detection)| {
            let (box_pixel, disparity_px, correlation) =
                Search::new(images, &detection.box_pixel, rig, config)?.partner()?;
            Some(Partner {
                left,
                box_pixel,
                disparity_px,
                correlation,
            })
        })
        .collect();
    let partners = distinct(found.into_iter().flatten().collect(), left);
    let is_alone = |i: &usize| partners.binary_search_by_key(i, |p| p.left).is_err();
    Searched {
        left_only: (0..left.len()).filter(is_alone).collect(),
        partners,
    }
}

/// [`search`] the other way: partners in the left image of detections of the right one. In what
/// comes back, left and right have changed places.
///
/// In a mirror the right camera is the left one, so it is the same search in mirrored images.
pub fn search_from_right(
    images: [&RgbImage; 2],
    right: &[Detection],
    rig: &StereoRig,
    config: &PairingConfig,
) -> Searched {
    let mirrored_box = |b: &PixelBox, image: &RgbImage| {
        let width = f64::from(image.width());
        PixelBox::new(width - b.x_max, b.y_min, width - b.x_min, b.y_max)
    };
    let mirrored: Vec<Detection> = right
        .iter()
        .map(|detection| Detection {
            box_pixel: mirrored_box(&detection.box_pixel, images[1]),
            ..*detection
        })
        .collect();
    let [left_image, right_image] = images.map(imageops::flip_horizontal);
    let mut searched = search(
        [&right_image, &left_image],
        &mirrored,
        &rig.mirrored(),
        config,
    );
    // Measured in pixels of the right camera, which was the left one.
    let scale = rig.left.focal_x_px / rig.right.focal_x_px;
    for partner in &mut searched.partners {
        partner.box_pixel = mirrored_box(&partner.box_pixel, images[0]);
        partner.disparity_px *= scale;
    }
    searched
}

/// Disparity of what one box of the left image shows, as [`search`] finds it: of the visible surface,
/// counted from the principal points, pixels of the left camera. None where the right image shows it
/// nowhere, or in more than one place.
pub fn disparity_px(
    images: [&RgbImage; 2],
    left_box: &PixelBox,
    rig: &StereoRig,
    config: &PairingConfig,
) -> Option<f64> {
    let (_, disparity_px, _) = Search::new(images, left_box, rig, config)?.partner()?;
    Some(disparity_px)
}

/// Where several detections found the same vehicle, the one that is most like it keeps it. The
/// others are hidden in the right image, and alike.
fn distinct(mut partners: Vec<Partner>, left: &[Detection]) -> Vec<Partner> {
    partners.sort_by(|a, b| b.correlation.total_cmp(&a.correlation));
    let mut kept: Vec<Partner> = Vec::with_capacity(partners.len());
    for partner in partners {
        let is_same = |other: &Partner| {
            left[other.left].class == left[partner.left].class
                && other.box_pixel.iou(&partner.box_pixel) > SAME_VEHICLE_IOU
        };
        if !kept.iter().any(is_same) {
            kept.push(partner);
        }
    }
    kept.sort_by_key(|partner| partner.left);
    kept
}

/// The way from pixels of the left image to pixels of the right one, given the disparity.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RightFromLeft<'a> {
    pub rig: &'a StereoRig,
}

impl RightFromLeft<'_> {
    /// Pixels of the right image for one of the left, along x and y.
    pub fn scale(self) -> [f64; 2] {
        let (left, right) = (&self.rig.left, &self.rig.right);
        [
            right.focal_x_px / left.focal_x_px,
            right.focal_y_px / left.focal_y_px,
        ]
    }

    /// The column of the right image that shows with this disparity what `left_x` shows.
    pub fn x(self, left_x: f64, disparity_px: f64) -> f64 {
        let (left, right) = (&self.rig.left, &self.rig.right);
        right.center_x_px + (left_x - left.center_x_px - disparity_px) * self.scale()[0]
    }

    /// The row of the right image that shows what `left_y` shows.
    pub fn y(self, left_y: f64) -> f64 {
        let (left, right) = (&self.rig.left, &self.rig.right);
        right.center_y_px + (left_y - left.center_y_px) * self.scale()[1]
    }

    /// The disparity that brings `left_x` to `right_x`.
    pub fn disparity_px(self, left_x: f64, right_x: f64) -> f64 {
        let (left, right) = (&self.rig.left, &self.rig.right);
        left_x - left.center_x_px - (right_x - right.center_x_px) / self.scale()[0]
    }

    /// Where a box of the left image lies with this disparity.
    pub fn moved(self, b: &PixelBox, disparity_px: f64) -> PixelBox {
        PixelBox::new(
            self.x(b.x_min, disparity_px),
            self.y(b.y_min),
            self.x(b.x_max, disparity_px),
            self.y(b.y_max),
        )
    }
}

/// The part of a left box that is compared, in whole pixels of the left image.
#[derive(Debug, Clone, Copy)]
struct Patch {
    grid: Grid,
    /// How often it can be halved until it is coarse enough; its sides are multiples of
    /// `2^halvings`.
    halvings: usize,
}

impl Patch {
    /// None for a box outside the image.
    fn new(b: &PixelBox, [image_width, image_height]: [u32; 2]) -> Option<Self> {
        let whole = [f64::from(image_width), f64::from(image_height)];
        let seen = b.clipped(whole[0], whole[1]);
        if !(b.is_valid() && seen.is_valid()) {
            return None;
        }
        let seen_sides = [seen.width(), seen.height()];
        let sides: [f64; 2] =
            std::array::from_fn(|i| (COMPARED[i] * seen_sides[i]).max(LEAST_PATCH_PX));
        let mut halvings = 0;
        let mut points = sides[0].max(sides[1]);
        while points > COARSE_POINTS {
            halvings += 1;
            points /= 2.0;
        }
        let unit = f64::from(1_u32 << halvings);
        let sides: [f64; 2] = std::array::from_fn(|i| {
            let largest = (whole[i] / unit).floor();
            (sides[i] / unit).round().clamp(1.0, largest.max(1.0)) * unit
        });
        let center = seen.center();
        let first: [f64; 2] = std::array::from_fn(|i| {
            let last = (whole[i] - sides[i]).max(0.0);
            (center[i] - sides[i] / 2.0).round().clamp(0.0, last)
        });
        let fits = (0..2).all(|i| first[i] + sides[i] <= whole[i]);
        fits.then_some(Self {
            grid: Grid {
                first: first.map(|pixel| pixel + 0.5),
                step: [1.0, 1.0],
                width: sides[0] as usize,
                height: sides[1] as usize,
            },
            halvings,
        })
    }
}

/// A place in a strip, in points of one of its resolutions, and how alike it is there.
#[derive(Debug, Clone, Copy)]
struct Place {
    x: usize,
    y: usize,
    correlation: f64,
}

impl Place {
    /// The order "most alike first".
    fn higher(a: &Self, b: &Self) -> Ordering {
        b.correlation.total_cmp(&a.correlation)
    }
}

/// The patch and the strip at one resolution.
#[derive(Debug)]
struct Level {
    template: Template,
    strip: GreyPlane,
    /// The row of the epipolar line.
    line: usize,
    /// Rows above and below it that are tried.
    row_slack: usize,
}

impl Level {
    fn place(&self, x: usize, y: usize) -> Option<Place> {
        let correlation = self
            .template
            .correlation(&self.strip, x, y, LEAST_VISIBLE)?;
        Some(Place { x, y, correlation })
    }

    /// The best of these columns, over all rows within `row_slack` of the epipolar line that are
    /// among `rows`.
    fn best(&self, columns: RangeInclusive<usize>, rows: RangeInclusive<usize>) -> Option<Place> {
        let first = *rows.start().max(&(self.line - self.row_slack));
        let last = *rows.end().min(&(self.line + self.row_slack));
        (first..=last)
            .flat_map(|y| columns.clone().filter_map(move |x| self.place(x, y)))
            .min_by(Place::higher)
    }

    /// The highest peaks of the correlation over all columns, highest first.
    fn peaks(&self) -> Vec<Place> {
        let count = (self.strip.width + 1).saturating_sub(self.template.width);
        let profile: Vec<Option<Place>> = (0..count)
            .map(|x| self.best(x..=x, 0..=usize::MAX))
            .collect();
        let height = |x: Option<usize>| {
            let place = x.and_then(|x| *profile.get(x)?);
            place.map_or(f64::NEG_INFINITY, |place| place.correlation)
        };
        let mut peaks: Vec<Place> = profile
            .iter()
            .flatten()
            .filter(|place| {
                height(place.x.checked_sub(1)) < place.correlation
                    && height(Some(place.x + 1)) <= place.correlation
            })
            .copied()
            .collect();
        peaks.sort_by(Place::higher);
        peaks.truncate(CANDIDATES);
        peaks
    }

    /// The best place near one of the next coarser level.
    fn refined(&self, coarse: Place) -> Option<Place> {
        let (x, y) = (2 * coarse.x, 2 * coarse.y);
        self.best(x.saturating_sub(2)..=x + 2, y.saturating_sub(1)..=y + 1)
    }

    /// The neighbours of a place in its row.
    fn beside(&self, place: &Place) -> [Option<Place>; 2] {
        let left = place.x.checked_sub(1).and_then(|x| self.place(x, place.y));
        [left, self.place(place.x + 1, place.y)]
    }

    /// The peak that is reached from a place by going uphill along its row.
    fn uphill(&self, mut place: Place) -> Place {
        loop {
            let beside = self.beside(&place).into_iter().flatten();
            let higher = beside
                .filter(|next| next.correlation > place.correlation)
                .min_by(Place::higher);
            match higher {
                Some(higher) => place = higher,
                None => return place,
            }
        }
    }
}

/// A patch of the left image and the strip of the right image where it may be.
#[derive(Debug)]
struct Search<'a> {
    left_box: PixelBox,
    right_from_left: RightFromLeft<'a>,
    right_size: [f64; 2],
    /// Finest first, each half as fine as the one before.
    levels: Vec<Level>,
    /// Disparity of the first place of the finest strip; every next one has 1 less.
    first_disparity_px: f64,
    /// Lower ones no vehicle has.
    least_disparity_px: f64,
}

impl<'a> Search<'a> {
    /// None where there is nothing to compare: no box, no texture, no place in the right image.
    fn new(
        images: [&RgbImage; 2],
        left_box: &PixelBox,
        rig: &'a StereoRig,
        config: &PairingConfig,
    ) -> Option<Self> {
        let [left, right] = images;
        let right_from_left = RightFromLeft { rig };
        let right_size = [f64::from(right.width()), f64::from(right.height())];
        let patch = Patch::new(left_box, [left.width(), left.height()])?;
        let [patch_x, patch_y] = patch.grid.first;
        let scale = right_from_left.scale();

        // The strip has the scale of the left image, whatever the right camera's.
        let (width, height) = (left_box.width(), left_box.height());
        let possible = disparity_range(width, height, rig, config);
        let least_disparity_px = possible.start() - DISPARITY_SLACK_PX;
        let disparity_at = |right_x: f64| right_from_left.disparity_px(patch_x, right_x);
        let beyond_left = -(patch.grid.width as f64) * scale[0];
        let largest = (possible.end() + config.slack(width)).min(disparity_at(beyond_left));
        let least = least_disparity_px.max(disparity_at(right_size[0]));
        let places = (largest - least).ceil();
        if !(0.0..MOST_PLACES).contains(&places) {
            return None;
        }
        let places = places as usize + 1 + 2 * MARGIN;
        // On the centres of pixels: with equal focal lengths no columns are interpolated.
        let on_pixel = |x: f64| (x - 0.5).round() + 0.5;
        let first_x = on_pixel(right_from_left.x(patch_x, largest)) - MARGIN as f64 * scale[0];
        let line = ROW_SLACK_PX.next_multiple_of(1 << patch.halvings);
        let first_y = right_from_left.y(patch_y) - line as f64 * scale[1];
        let strip_grid = Grid {
            first: [first_x, first_y],
            step: scale,
            width: places + patch.grid.width - 1,
            height: patch.grid.height + 2 * line,
        };

        let mut planes = [
            GreyPlane::sample(left, &patch.grid),
            GreyPlane::sample(right, &strip_grid),
        ];
        let mut levels = Vec::with_capacity(patch.halvings + 1);
        for halving in 0..=patch.halvings {
            let finer_by_half =
                (halving < patch.halvings).then(|| planes.each_ref().map(GreyPlane::halved));
            let [patch, strip] = planes;
            let weights = [bell(patch.width, BELL[0]), bell(patch.height, BELL[1])];
            levels.push(Level {
                template: Template::new(&patch, [&weights[0], &weights[1]])?,
                strip,
                line: line >> halving,
                row_slack: ROW_SLACK_PX >> halving,
            });
            match finer_by_half {
                Some(next) => planes = next,
                None => break,
            }
        }
        Some(Self {
            left_box: *left_box,
            right_from_left,
            right_size,
            levels,
            first_disparity_px: disparity_at(first_x),
            least_disparity_px,
        })
    }

    /// The peaks of the coarsest level, followed to the finest one; highest first.
    fn peaks(&self) -> Vec<Place> {
        let mut levels = self.levels.iter().rev();
        let mut peaks = levels.next().map_or_else(Vec::new, Level::peaks);
        for finer in levels {
            peaks = peaks
                .into_iter()
                .filter_map(|peak| finer.refined(peak))
                .collect();
        }
        if let Some(finest) = self.levels.first() {
            for peak in &mut peaks {
                *peak = finest.uphill(*peak);
            }
        }
        peaks.sort_by(Place::higher);
        peaks
    }

    /// Box in the right image, disparity and correlation; None where no place is alike enough, or
    /// more than one is.
    fn partner(&self) -> Option<(PixelBox, f64, f64)> {
        let peaks = self.peaks();
        let best = *peaks.first()?;
        // Neighbours are the same peak, reached on another row.
        let is_rival = |place: &&Place| place.x.abs_diff(best.x) > 1;
        let rival = peaks.iter().find(is_rival);
        let is_clear = rival.is_none_or(|rival| best.correlation - rival.correlation >= LEAST_LEAD);
        if best.correlation < LEAST_CORRELATION || !is_clear {
            return None;
        }
        // A place without neighbours is the end of the range: the peak is beyond it.
        let [Some(before), Some(after)] = self.levels.first()?.beside(&best) else {
            return None;
        };
        let position =
            best.x as f64 + vertex(before.correlation, best.correlation, after.correlation);
        let disparity_px = self.first_disparity_px - position;
        // The strip has places beyond the range, so that its last one has neighbours.
        if disparity_px < self.least_disparity_px {
            return None;
        }
        let [width, height] = self.right_size;
        let moved = self.right_from_left.moved(&self.left_box, disparity_px);
        let box_pixel = moved.clipped(width, height);
        box_pixel
            .is_valid()
            .then_some((box_pixel, disparity_px, best.correlation))
    }
}

/// Weights of points along one side: a bell around the middle, `deviation` half sides wide.
fn bell(points: usize, deviation: f64) -> Vec<f32> {
    (0..points)
        .map(|i| {
            let from_middle = 2.0 * (i as f64 + 0.5) / points as f64 - 1.0;
            libm::exp(-0.5 * (from_middle / deviation).powi(2)) as f32
        })
        .collect()
}

/// Where the parabola through a peak and its neighbours has its vertex, from -0.5 to 0.5.
fn vertex(before: f64, peak: f64, after: f64) -> f64 {
    let curvature = before - 2.0 * peak + after;
    if curvature < 0.0 {
        0.5 * (before - after) / curvature
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests;
