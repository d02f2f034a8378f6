//! Features of the left image found again in the right one.

use image::RgbImage;
use rayon::prelude::*;

use super::corners::corners;
use super::grey::Grey;
use super::search::{Found, Plane, Range};
use super::subpixel::{self, Surface};

/// Images are halved for the search until they are no wider than this, pixels.
const SEARCHED_WIDTH: usize = 700;

/// The largest disparity that is looked for, part of the image's width.
const WIDEST: f64 = 0.25;

/// Rows that the search goes up and down, of the halved images.
const ROWS: i64 = 4;

/// Least correlation of a match.
const LEAST_CORRELATION: f32 = 0.85;

/// The best place must differ from the patch by no more than this part of what the next best one
/// differs by.
const UNIQUE: f32 = 0.7;

/// The way back from the right image must end this near to where it began, pixels of the halved
/// images.
const BACK: usize = 1;

/// A place must be known as well as this, standard deviation in pixels.
const EXACT_PX: f64 = 0.15;

/// Both ways, left to right and back, must lead to places no further apart than this, pixels.
const AGREEMENT_PX: f64 = 0.2;

/// Part of a window that is exactly black where something was cut off by rectification.
const BLACK: f64 = 0.1;

/// A point seen in both images of a pair; pixels, the first one's centre at (0.5, 0.5).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeatureMatch {
    /// The number of its pair.
    pub frame: u32,
    /// Where the left image shows it.
    pub left: [f64; 2],
    /// Where the right image shows it.
    pub right: [f64; 2],
}

/// An image with all that matching needs of it.
pub(super) struct Matchable {
    /// From the halved images to the whole one.
    planes: Vec<Plane>,
    surface: Surface,
}

impl Matchable {
    pub fn new(image: &RgbImage) -> Self {
        let grey = Grey::of(image);
        let surface = Surface::new(&grey);
        let mut levels = vec![grey];
        while let Some(last) = levels.last()
            && last.width > SEARCHED_WIDTH
        {
            levels.push(last.halved());
        }
        let planes = levels.into_par_iter().rev().map(Plane::new).collect();
        Self { planes, surface }
    }

    fn grey(&self) -> &Grey {
        &self.surface.grey
    }
}

/// Finds up to `most` corners of the left image in the right one. `offset_px` is by how much the
/// principal point of the left camera lies further right than that of the right one.
///
/// Disparities below 0 are found as well: they tell exchanged images.
pub(super) fn matches(
    [left, right]: [&Matchable; 2],
    frame: u32,
    offset_px: f64,
    most: usize,
) -> Vec<FeatureMatch> {
    let margin = subpixel::RADIUS + 2;
    let places = corners(&left.surface.gradients, most, margin);
    places
        .into_par_iter()
        .filter(|place| !is_cut(left.grey(), *place))
        .filter_map(|place| {
            let widest = WIDEST * left.grey().width as f64;
            let found = find(left, right, place, [offset_px - widest, offset_px + widest])?;
            let place = place.map(|v| v as f64);
            let found = exact(left, right, place, found)?;
            Some(FeatureMatch {
                frame,
                left: place.map(|v| v + 0.5),
                right: found.map(|v| v + 0.5),
            })
        })
        .collect()
}

/// Where a place of the left image lies in the right one, to a fraction of a pixel, for shifts
/// `x_left - x_right` within a range; None where that is not certain. Places are counted from the
/// centre of the first pixel.
pub(super) fn place_in_right(
    [left, right]: [&Matchable; 2],
    place: [f64; 2],
    shifts_px: [f64; 2],
) -> Option<[f64; 2]> {
    let nearest = whole(place)?;
    let found = find(left, right, nearest, shifts_px)?;
    // The window is centred on the place itself.
    let moved = [0, 1].map(|i| found[i] + place[i] - nearest[i] as f64);
    exact(left, right, place, moved)
}

fn whole(place: [f64; 2]) -> Option<[usize; 2]> {
    let is_inside = place.iter().all(|v| (0.0..1e6).contains(v));
    is_inside.then(|| place.map(|v| v.round() as usize))
}

/// Whether the surroundings of a place are partly black: the border of a rectified image, not of a
/// thing.
fn is_cut(grey: &Grey, [x, y]: [usize; 2]) -> bool {
    let radius = subpixel::RADIUS;
    let side = 2 * radius + 1;
    let black: usize = (y.saturating_sub(radius)..(y + radius + 1).min(grey.height))
        .map(|row| {
            let row = &grey.row(row)[x.saturating_sub(radius)..(x + radius + 1).min(grey.width)];
            row.iter().filter(|value| **value == 0.0).count()
        })
        .sum();
    black as f64 > BLACK * (side * side) as f64
}

/// The whole pixel of the right image that shows a place of the left one: searched in the halved
/// images, there and back, then followed into the whole ones.
fn find(
    left: &Matchable,
    right: &Matchable,
    place: [usize; 2],
    [least, most]: [f64; 2],
) -> Option<[f64; 2]> {
    let halvings = left.planes.len() - 1;
    let scale = f64::from(1_u32 << halvings.min(16));
    let at = |level: usize| {
        let halved = f64::from(1_u32 << (halvings - level).min(16));
        place.map(|v| (((v as f64 + 0.5) / halved - 0.5).round().max(0.0)) as usize)
    };
    let [low, high] = [(least / scale).floor() as i64, (most / scale).ceil() as i64];
    let [x, y] = at(0);
    let ranges = |[x, y]: [usize; 2], columns: [i64; 2]| Range {
        columns: columns.map(|column| x as i64 + column),
        rows: [y as i64 - ROWS, y as i64 + ROWS],
    };
    let (here, there) = (left.planes.first()?, right.planes.first()?);
    let found = there.find(&here.patch([x, y])?, ranges([x, y], [-high, -low]))?;
    if !is_certain(&found) {
        return None;
    }
    let back = here.find(&there.patch(found.place)?, ranges(found.place, [low, high]))?;
    if back.place[0].abs_diff(x) > BACK || back.place[1].abs_diff(y) > BACK {
        return None;
    }
    let mut found = found.place;
    for level in 1..=halvings {
        let patch = left.planes[level].patch(at(level))?;
        // The halved pixel's middle, and as far as its neighbours'.
        let around = Range::around(found.map(|v| 2 * v), 2);
        let around = Range {
            columns: [around.columns[0], around.columns[1] + 1],
            rows: [around.rows[0], around.rows[1] + 1],
        };
        found = right.planes[level].find(&patch, around)?.place;
    }
    Some(found.map(|v| v as f64))
}

fn is_certain(found: &Found) -> bool {
    found.correlation >= LEAST_CORRELATION
        && 1.0 - found.correlation <= UNIQUE * (1.0 - found.rival)
}

/// Where the right image shows a place of the left one, refined there and back. Both ways have their
/// say by half.
fn exact(
    left: &Matchable,
    right: &Matchable,
    place: [f64; 2],
    guess: [f64; 2],
) -> Option<[f64; 2]> {
    let there = subpixel::refine(&left.surface, place, &right.surface, guess)?;
    let back = subpixel::refine(&right.surface, there.place, &left.surface, place)?;
    let is_exact = there.std.iter().chain(&back.std).all(|std| *std < EXACT_PX);
    let apart = [0, 1].map(|i| back.place[i] - place[i]);
    if !is_exact || apart.iter().any(|apart| apart.abs() > AGREEMENT_PX) {
        return None;
    }
    Some([0, 1].map(|i| there.place[i] - apart[i] / 2.0))
}
