//! Stereo evidence: how likely the pixels of a box make each disparity of its vehicle.
//!
//! Overlapping windows in the box vote. Each is compared with the right image at every disparity that
//! the size of vehicles allows, on the same row and its neighbours, by weighted zero-mean normalised
//! cross-correlation. A window's vote is a likelihood normalised over the disparities, so that one
//! without texture says little, and votes are added, not multiplied, so that a window on the
//! background cannot veto.

use image::RgbImage;

use super::spline::Spline;
use crate::geometry::{PixelBox, StereoRig};
use crate::pairing::correlation::{GreyPlane, Grid, Template};
use crate::pairing::search::RightFromLeft;

/// Windows along the width and the height of a box.
const WINDOWS: [usize; 2] = [7, 4];

/// Side of a window as a part of the box's.
const WINDOW_PART: f64 = 0.3;

/// Part of the box's width and height that the windows span: its rim shows background.
const SPAN: [f64; 2] = [0.9, 0.8];

/// Least side of a window, points: smaller ones are like too much else.
const LEAST_WINDOW: f64 = 9.0;

/// Boxes higher than this are matched in halved images, points: cost stays the same, and large cars
/// have texture enough.
const LARGEST_HEIGHT: f64 = 64.0;

/// Standard deviation of the bell-shaped weights over half the width and height of a window.
const BELL: f64 = 0.8;

/// Standard deviations of the windows' say over half the width and height of the box: windows near
/// its rim see background.
const CENTRAL: [f64; 2] = [0.6, 0.5];

/// Rows above and below the epipolar line that are tried, points.
const ROW_SLACK: usize = 1;

/// Noise of grey values in 8-bit counts: with less texture than that no correlation is evidence.
const GREY_NOISE: f64 = 4.0;

/// Effective number of independent points of a window: how fast its likelihood falls with the
/// correlation.
const INDEPENDENT_POINTS: i32 = 40;

/// Correlations are interpolated to this step, points.
const STEP: f64 = 0.05;

/// What is matched is something else than the vehicle at least this often, and then has any
/// disparity.
const LEAST_WRONG: f64 = 0.03;

/// And so often where no windows agree.
const WRONG_PART: f64 = 0.5;

/// The larger side of a box stands for at least and at most this length, metres: limits of the
/// disparity.
const SIDE_M: [f64; 2] = [1.0, 14.0];

/// What is seen of a vehicle that the image's border cuts off can be this much smaller.
const CUT_PART: f64 = 0.5;

/// Disparities tried beyond those limits at both ends, pixels.
const MARGIN_PX: f64 = 2.0;

/// Least disparity that is tried, pixels: cameras that are slightly turned towards each other give
/// far vehicles less than 0.
const LEAST_DISPARITY_PX: f64 = -2.0;

/// Boxes of nearer vehicles hide what is behind them, but for this part of their sides at their left,
/// right and upper rim.
const RIM: f64 = 0.06;

/// A window that is hidden more has no say.
const LEAST_VISIBLE: f64 = 0.3;

/// A box that is hidden more is matched as if nothing hid it.
const LEAST_BOX_VISIBLE: f64 = 0.12;

/// Least share of a window, by weight, that must lie inside the right image.
const LEAST_INSIDE: f64 = 0.5;

/// More disparities than this come from a rig that nobody can build.
const MOST_PLACES: f64 = 8192.0;

/// Windows that vote within this of the best disparity agree with it, pixels of the matched image.
const AGREEMENT: f64 = 1.0;

/// Likelihood of each disparity of a vehicle's visible surface.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StereoEvidence {
    /// First disparity, counted from the principal points, pixels of the left camera.
    first_px: f64,
    step_px: f64,
    /// Relative to an even one over the range.
    likelihood: Vec<f64>,
    /// Sums of the likelihoods before each step, and of all.
    sums: Vec<f64>,
    /// Likelihood of what was not tried.
    floor: f64,
    /// Share of the windows' say that agrees with the best disparity, 0 to 1.
    pub support: f64,
}

impl StereoEvidence {
    fn new(first_px: f64, step_px: f64, likelihood: Vec<f64>, floor: f64, support: f64) -> Self {
        let mut sums = Vec::with_capacity(likelihood.len() + 1);
        let mut sum = 0.0;
        sums.push(sum);
        for value in &likelihood {
            sum += value;
            sums.push(sum);
        }
        Self {
            first_px,
            step_px,
            likelihood,
            sums,
            floor,
            support,
        }
    }

    /// The same with disparities that are uncertain by this standard deviation, pixels.
    pub fn blurred(&self, std_px: f64) -> Self {
        let deviation = std_px / self.step_px;
        let radius = libm::ceil(3.5 * deviation) as usize;
        let kernel: Vec<f64> = (0..=2 * radius)
            .map(|i| libm::exp(-0.5 * ((i as f64 - radius as f64) / deviation).powi(2)))
            .collect();
        self.averaged(&kernel)
    }

    /// The same with disparities that are off by one of these amounts, each with its weight: amounts
    /// are `step_px` apart, with 0 in the middle.
    pub fn averaged(&self, kernel: &[f64]) -> Self {
        let radius = kernel.len() / 2;
        let total: f64 = kernel.iter().sum();
        let last = self.likelihood.len() - 1;
        let at = |i: usize| self.likelihood[i.saturating_sub(radius).min(last)];
        let padded: Vec<f64> = (0..self.likelihood.len() + 2 * radius).map(at).collect();
        let likelihood = padded.windows(kernel.len()).map(|values| {
            let sum: f64 = values.iter().zip(kernel).map(|(v, k)| v * k).sum();
            sum / total
        });
        Self::new(
            self.first_px,
            self.step_px,
            likelihood.collect(),
            self.floor,
            self.support,
        )
    }

    /// The same with all disparities larger by this, pixels.
    pub fn moved(self, by_px: f64) -> Self {
        Self {
            first_px: self.first_px + by_px,
            ..self
        }
    }

    /// The step of its grid, pixels.
    pub fn step_px(&self) -> f64 {
        self.step_px
    }

    /// Likelihood of a disparity, relative to that of any.
    pub fn at(&self, disparity_px: f64) -> f64 {
        let place = (disparity_px - self.first_px) / self.step_px;
        if !(place >= 0.0 && place < (self.likelihood.len() - 1) as f64) {
            return self.floor;
        }
        let (i, part) = (place as usize, place.fract());
        self.likelihood[i] + part * (self.likelihood[i + 1] - self.likelihood[i])
    }

    /// Disparities above 0 that are at least this likely, pixels, `stride` steps apart.
    pub fn likely(&self, least: f64, stride: f64) -> impl Iterator<Item = f64> {
        let stride = stride as usize;
        let places = (0..self.likelihood.len()).step_by(stride.max(1));
        places
            .filter(move |&i| self.likelihood[i] >= least)
            .map(|i| self.first_px + self.step_px * i as f64)
            .filter(|disparity_px| *disparity_px > 0.0)
    }

    /// Mean likelihood between two disparities, pixels.
    pub fn mean(&self, least_px: f64, most_px: f64) -> f64 {
        let width = (most_px - least_px) / self.step_px;
        if width < 1.0 {
            return self.at(f64::midpoint(least_px, most_px));
        }
        (self.sum_to(most_px) - self.sum_to(least_px)) / width
    }

    /// Sum of the likelihoods of all disparities that were tried up to this one, and of those beyond.
    fn sum_to(&self, disparity_px: f64) -> f64 {
        let place = (disparity_px - self.first_px) / self.step_px;
        let last = self.sums.len() - 1;
        if place <= 0.0 {
            return self.floor * place;
        }
        if place >= last as f64 {
            return self.sums[last] + self.floor * (place - last as f64);
        }
        let i = place as usize;
        self.sums[i] + place.fract() * (self.sums[i + 1] - self.sums[i])
    }

    /// The most likely disparity, pixels.
    pub fn best_px(&self) -> f64 {
        let best = (0..self.likelihood.len())
            .max_by(|&a, &b| self.likelihood[a].total_cmp(&self.likelihood[b]));
        self.first_px + self.step_px * best.unwrap_or(0) as f64
    }
}

/// Compares what a box of the left image shows with the right image. `nearer` are boxes of vehicles
/// before it. None for a box outside the image, and where no window has texture.
pub(crate) fn stereo_evidence(
    images: [&RgbImage; 2],
    area: &PixelBox,
    nearer: &[PixelBox],
    rig: &StereoRig,
) -> Option<StereoEvidence> {
    let matched = Matched::new(images, area, rig)?;
    let mask = Mask::new(&matched, nearer);
    let windows = matched.windows();
    let step = STEP * matched.unit;
    let first_px = matched.disparity_px(matched.places - 2);
    let count = libm::floor((matched.disparity_px(1) - first_px) / step) as usize + 1;
    let mut votes = Vec::with_capacity(windows.len());
    for window in &windows {
        let Some(vote) = matched.vote(window, &mask, count) else {
            continue;
        };
        votes.push(vote);
    }
    let mut likelihood = vec![0.0; count];
    for (say, vote) in &votes {
        for (sum, value) in likelihood.iter_mut().zip(vote) {
            *sum += say * value;
        }
    }
    let (best, most) = likelihood
        .iter()
        .copied()
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    if !(most.is_finite() && most > 0.0) {
        return None;
    }
    let reach = (AGREEMENT / STEP) as usize;
    let near = best.saturating_sub(reach)..(best + reach + 1).min(count);
    let agreeing: f64 = votes
        .iter()
        .map(|(say, vote)| say * vote[near.clone()].iter().sum::<f64>() * STEP)
        .sum();
    let total: f64 = votes.iter().map(|(say, _)| say).sum();
    let support = agreeing / total;
    let floor = (WRONG_PART * (1.0 - support)).max(LEAST_WRONG);
    let sum: f64 = likelihood.iter().sum();
    for value in &mut likelihood {
        *value = (1.0 - floor) * *value / sum * count as f64 + floor;
    }
    Some(StereoEvidence::new(
        first_px, step, likelihood, floor, support,
    ))
}

/// A window: its first point in the left plane, its size, and its say by place.
#[derive(Debug, Clone, Copy)]
struct Window {
    first: [usize; 2],
    size: [usize; 2],
    say: f64,
}

/// A box and its surroundings in both images, at a resolution at which the box is not too high.
struct Matched {
    left: GreyPlane,
    right: GreyPlane,
    /// Pixels of the left image a point stands for.
    unit: f64,
    /// The left image's pixel coordinates of the planes' first corner.
    corner: [f64; 2],
    /// The box in points of the left plane, clipped to the image.
    area: PixelBox,
    /// Disparity of the first column of the right plane for the first column of the left one, points.
    largest: usize,
    /// Disparities tried.
    places: usize,
    /// Rows of the right plane before the first one of the left plane, and after its last.
    rows: usize,
}

impl Matched {
    fn new(images: [&RgbImage; 2], area: &PixelBox, rig: &StereoRig) -> Option<Self> {
        let [left_image, right_image] = images;
        let (width, height) = left_image.dimensions();
        let whole = [f64::from(width), f64::from(height)];
        let seen = area.clipped(whole[0], whole[1]);
        if !(area.is_valid() && seen.is_valid()) {
            return None;
        }
        let mut halvings = 0_u32;
        while seen.height() / f64::from(1_u32 << halvings) > LARGEST_HEIGHT {
            halvings += 1;
        }
        let block = 1_usize << halvings;
        let unit = block as f64;
        // Room for the least window around a small box, in whole blocks of pixels.
        let room = |side: f64| 0.5 * (LEAST_WINDOW * unit - side).max(0.0) + unit;
        let edges = |low: f64, high: f64, most: f64| {
            let room = room(high - low);
            let first = libm::floor(((low - room) / unit).max(0.0)) as usize;
            let end = libm::ceil((high + room).min(most) / unit) as usize;
            // A block that the border cuts off cannot be averaged.
            (first, end.min((most / unit) as usize))
        };
        let (x_first, x_end) = edges(seen.x_min, seen.x_max, whole[0]);
        let (y_first, y_end) = edges(seen.y_min, seen.y_max, whole[1]);
        let least = LEAST_WINDOW as usize;
        if x_end < x_first + least || y_end < y_first + least {
            return None;
        }
        let side = area.width().max(area.height()) * rig.baseline_m;
        let cut = if seen == *area { 1.0 } else { CUT_PART };
        let least_px = (side / SIDE_M[1] - MARGIN_PX).max(LEAST_DISPARITY_PX);
        let largest_px = side / (SIDE_M[0] * cut) + MARGIN_PX;
        let (smallest, largest) = (
            libm::floor(least_px / unit) - 1.0,
            libm::ceil(largest_px / unit) + 1.0,
        );
        let places = largest - smallest + 1.0;
        if !(places >= 4.0 && places <= MOST_PLACES.min(whole[0] + 16.0)) {
            return None;
        }
        let way = RightFromLeft { rig };
        let corner = [x_first as f64 * unit, y_first as f64 * unit];
        let rows = ROW_SLACK * block;
        let columns = (x_end - x_first) * block;
        let left = GreyPlane::sample(
            left_image,
            &Grid {
                first: [corner[0] + 0.5, corner[1] + 0.5],
                step: [1.0, 1.0],
                width: columns,
                height: (y_end - y_first) * block,
            },
        );
        let right = GreyPlane::sample(
            right_image,
            &Grid {
                first: [
                    way.x(corner[0] + 0.5, largest * unit),
                    way.y(corner[1] + 0.5 - rows as f64),
                ],
                step: way.scale(),
                width: columns + (places as usize - 1) * block,
                height: (y_end - y_first) * block + 2 * rows,
            },
        );
        let [left, right] = [left, right].map(|plane| {
            let mut plane = plane;
            for _ in 0..halvings {
                plane = plane.halved();
            }
            plane
        });
        let point = |pixel: f64, axis: usize| (pixel - corner[axis]) / unit;
        Some(Self {
            area: PixelBox::new(
                point(seen.x_min, 0),
                point(seen.y_min, 1),
                point(seen.x_max, 0),
                point(seen.y_max, 1),
            ),
            left,
            right,
            unit,
            corner,
            largest: largest as usize,
            places: places as usize,
            rows: ROW_SLACK,
        })
    }

    /// The disparity of a place: places are columns of the right plane for the first column of the
    /// left one. Pixels.
    fn disparity_px(&self, place: usize) -> f64 {
        (self.largest as f64 - place as f64) * self.unit
    }

    /// Windows that span the box.
    fn windows(&self) -> Vec<Window> {
        let plane = [self.left.width, self.left.height];
        let sides = [self.area.width(), self.area.height()];
        let center = self.area.center();
        let size: [usize; 2] = std::array::from_fn(|i| {
            let side = libm::round(WINDOW_PART * sides[i]).max(LEAST_WINDOW);
            (side as usize).min(plane[i])
        });
        let offset = |i: usize, which: usize| {
            let part = 2.0 * which as f64 / (WINDOWS[i] - 1) as f64 - 1.0;
            // Windows larger than what they are to span stay in its middle.
            part * 0.5 * (SPAN[i] * sides[i] - size[i] as f64).max(0.0)
        };
        let mut windows: Vec<Window> = Vec::with_capacity(WINDOWS[0] * WINDOWS[1]);
        for row in 0..WINDOWS[1] {
            for column in 0..WINDOWS[0] {
                let offsets = [offset(0, column), offset(1, row)];
                let first: [usize; 2] = std::array::from_fn(|i| {
                    let first = libm::round(center[i] + offsets[i] - 0.5 * size[i] as f64);
                    (first.max(0.0) as usize).min(plane[i] - size[i])
                });
                let from_middle: f64 = (0..2)
                    .map(|i| (2.0 * offsets[i] / sides[i] / CENTRAL[i]).powi(2))
                    .sum();
                let say = libm::exp(-0.5 * from_middle);
                // In a small box several windows are the same: one of them is compared for all.
                match windows.iter_mut().find(|window| window.first == first) {
                    Some(window) => window.say += say,
                    None => windows.push(Window { first, size, say }),
                }
            }
        }
        windows
    }

    /// A window's say and its likelihood of each disparity, from the smallest one on.
    fn vote(&self, window: &Window, mask: &Mask, count: usize) -> Option<(f64, Vec<f64>)> {
        let [width, height] = window.size;
        let bell = |i: usize, of: usize| {
            let from_middle = 2.0 * (i as f64 + 0.5) / of as f64 - 1.0;
            libm::exp(-0.5 * (from_middle / BELL).powi(2)) as f32
        };
        let columns: Vec<f32> = (0..width).map(|x| bell(x, width)).collect();
        let rows: Vec<f32> = (0..height).map(|y| bell(y, height)).collect();
        let [left, top] = window.first;
        let shows = |x: usize, y: usize| mask.shows(left + x, top + y);
        let visible = if mask.is_clear() {
            1.0
        } else {
            let (mut seen, mut all) = (0.0, 0.0);
            for (y, row) in rows.iter().enumerate() {
                for (x, column) in columns.iter().enumerate() {
                    all += row * column;
                    seen += if shows(x, y) { row * column } else { 0.0 };
                }
            }
            f64::from(seen / all)
        };
        if visible < LEAST_VISIBLE {
            return None;
        }
        let template = Template::window(&self.left, window.first, window.size, |x, y| {
            if shows(x, y) {
                columns[x] * rows[y]
            } else {
                0.0
            }
        })?;
        // From the smallest disparity on: the last place first. Places without enough of the window
        // inside the right image, or without texture there, are unlike it.
        let correlations: Vec<f64> = (0..self.places)
            .rev()
            .map(|place| {
                (0..=2 * self.rows)
                    .filter_map(|row| {
                        template.correlation(&self.right, left + place, top + row, LEAST_INSIDE)
                    })
                    .fold(0.0, f64::max)
            })
            .collect();
        let spline = Spline::new(&correlations)?;
        let noise = (GREY_NOISE / template.deviation()).powi(2);
        let mut best = 0.0_f64;
        let mut vote: Vec<f64> = (0..count)
            .map(|i| {
                let correlation = spline.at(1.0 + STEP * i as f64).clamp(0.0, 0.9995);
                best = best.max(correlation);
                let unlike = 1.0 - correlation * correlation + noise;
                unlike.powi(-INDEPENDENT_POINTS / 2)
            })
            .collect();
        let total: f64 = vote.iter().sum::<f64>() * STEP;
        if !(total.is_finite() && total > 0.0) {
            return None;
        }
        for value in &mut vote {
            *value /= total;
        }
        Some((window.say * visible * best * best, vote))
    }
}

/// Which points of the left plane no nearer vehicle hides.
struct Mask {
    /// In points: half-open ranges of columns and rows.
    hidden: Vec<[std::ops::Range<usize>; 2]>,
}

impl Mask {
    fn new(matched: &Matched, nearer: &[PixelBox]) -> Self {
        let plane = [matched.left.width, matched.left.height];
        let hidden = nearer.iter().filter_map(|other| {
            let rim = [RIM * other.width(), RIM * other.height()];
            let point = |pixel: f64, axis: usize| {
                let at = (pixel - matched.corner[axis]) / matched.unit;
                libm::round(at.clamp(0.0, plane[axis] as f64)) as usize
            };
            let columns = point(other.x_min + rim[0], 0)..point(other.x_max - rim[0], 0);
            let rows = point(other.y_min + rim[1], 1)..point(other.y_max, 1);
            (!columns.is_empty() && !rows.is_empty()).then_some([columns, rows])
        });
        let mut mask = Self {
            hidden: hidden.collect(),
        };
        if !mask.is_clear() && mask.visible_part(&matched.area) < LEAST_BOX_VISIBLE {
            mask.hidden.clear();
        }
        mask
    }

    fn is_clear(&self) -> bool {
        self.hidden.is_empty()
    }

    fn shows(&self, x: usize, y: usize) -> bool {
        !self
            .hidden
            .iter()
            .any(|[columns, rows]| columns.contains(&x) && rows.contains(&y))
    }

    fn visible_part(&self, area: &PixelBox) -> f64 {
        let (mut seen, mut all) = (0_usize, 0_usize);
        for y in area.y_min as usize..libm::ceil(area.y_max) as usize {
            for x in area.x_min as usize..libm::ceil(area.x_max) as usize {
                all += 1;
                seen += usize::from(self.shows(x, y));
            }
        }
        seen as f64 / all.max(1) as f64
    }
}
