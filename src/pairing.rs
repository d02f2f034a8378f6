//! Which box of the right image is the same vehicle as a detection of the left image.
//!
//! In a rectified rig the two boxes of a vehicle lie on the same rows, are of about the same size,
//! and the left one lies further right by the disparity `focal_px * baseline_m / z`. That is above
//! zero; as boxes and cameras are inexact, that of a vehicle near the horizon may come out slightly
//! below. There are two ways to the right box, see [`PairingMode`]:
//!
//! * [`pair`] chooses among the detections of the right image. Of all one-to-one assignments that
//!   obey the geometry, the one with the largest sum of affinities is taken, so that an early choice
//!   never takes away a better partner.
//! * [`search`](search::search) finds it in the pixels of the right image, where no detector needs
//!   to run.

pub(crate) mod correlation;
pub mod search;

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use pathfinding::kuhn_munkres::kuhn_munkres;
use pathfinding::matrix::Matrix;
use serde::{Deserialize, Serialize};

use crate::detector::detection::Detection;
use crate::geometry::{Camera, StereoRig};

/// Affinities are compared in whole steps of this size, because the assignment wants integers.
const AFFINITY_STEPS: f64 = 1e6;

/// How the box of a vehicle in the right image is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PairingMode {
    /// The detector runs on both images, and its boxes are assigned to each other: both images are
    /// witnesses.
    Detect,
    /// The detector runs on the left image alone, and its boxes are looked for in the right one:
    /// half the detector's cost, and a disparity from pixels instead of two boxes. The default: at
    /// equal recall it makes up as many vehicles as the other way.
    #[default]
    Search,
}

impl PairingMode {
    /// All modes.
    pub const ALL: [Self; 2] = [Self::Detect, Self::Search];

    /// The word that people write for it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Detect => "detect",
            Self::Search => "search",
        }
    }
}

impl fmt::Display for PairingMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}

impl FromStr for PairingMode {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|mode| mode.word() == word)
            .ok_or_else(|| {
                let words = Self::ALL.map(Self::word).join(", ");
                format!("'{word}' is none of {words}")
            })
    }
}

/// What two boxes of one vehicle have in common.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PairingConfig {
    /// Detectors place boxes this inexactly whatever their size, pixels.
    pub slack_px: f64,
    /// And in addition by this fraction of the box's side.
    pub slack_fraction: f64,
    /// The smaller width over the larger, and likewise the heights, must reach this.
    pub least_size_ratio: f64,
    /// Vehicles are never nearer than this, metres: it limits the disparity.
    pub least_depth_m: f64,
    /// The larger side of a box must stand for at least this length, metres.
    pub least_side_m: f64,
    /// And at most for this length, metres.
    pub largest_side_m: f64,
}

impl Default for PairingConfig {
    fn default() -> Self {
        Self {
            slack_px: 3.0,
            slack_fraction: 0.15,
            least_size_ratio: 0.6,
            least_depth_m: 2.0,
            least_side_m: 0.5,
            largest_side_m: 40.0,
        }
    }
}

impl PairingConfig {
    /// How far boxes may lie from where they should, given their side along that axis; pixels.
    fn slack(&self, side: f64) -> f64 {
        self.slack_px + self.slack_fraction * side
    }
}

/// The detections of both images, sorted out.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Pairing {
    /// Index into the left list, index into the right list, affinity from 0 to 1; in the order of
    /// the left list.
    pub pairs: Vec<(usize, usize, f64)>,
    /// Detections of the left image without a partner.
    pub left_only: Vec<usize>,
    /// Detections of the right image without a partner.
    pub right_only: Vec<usize>,
}

/// Finds the best overall one-to-one assignment of left to right detections.
///
/// Pairs that contradict the rig's geometry are never made, however few partners there are.
pub fn pair(
    left: &[Detection],
    right: &[Detection],
    rig: &StereoRig,
    config: &PairingConfig,
) -> Pairing {
    let affinities = Affinities::new(left, right, rig, config);
    let mut pairs = affinities.best_assignment();
    pairs.sort_by_key(|&(l, r, _)| (l, r));
    let unpaired = |count: usize, is_paired: &dyn Fn(usize) -> bool| -> Vec<usize> {
        (0..count).filter(|&i| !is_paired(i)).collect()
    };
    Pairing {
        left_only: unpaired(left.len(), &|i| pairs.iter().any(|p| p.0 == i)),
        right_only: unpaired(right.len(), &|i| pairs.iter().any(|p| p.1 == i)),
        pairs,
    }
}

/// A box as the left camera would measure it, with the origin at the principal point.
///
/// Cameras with different intrinsics become comparable, and the difference of two centres is the
/// disparity.
#[derive(Debug, Clone, Copy)]
struct Measured {
    x: f64,
    y: f64,
    width: f64,
    height: f64,
    class: usize,
}

impl Measured {
    /// None for a box that is empty or not finite.
    fn new(detection: &Detection, camera: &Camera, reference: &Camera) -> Option<Self> {
        let b = detection.box_pixel;
        let [x, y] = b.center();
        let (scale_x, scale_y) = (
            reference.focal_x_px / camera.focal_x_px,
            reference.focal_y_px / camera.focal_y_px,
        );
        b.is_valid().then_some(Self {
            x: (x - camera.center_x_px) * scale_x,
            y: (y - camera.center_y_px) * scale_y,
            width: b.width() * scale_x,
            height: b.height() * scale_y,
            class: detection.class,
        })
    }
}

/// How well every left detection fits every right one; None where the two cannot be one vehicle.
struct Affinities {
    rows: Vec<Vec<Option<f64>>>,
    right_count: usize,
}

impl Affinities {
    fn new(
        left: &[Detection],
        right: &[Detection],
        rig: &StereoRig,
        config: &PairingConfig,
    ) -> Self {
        let measured = |detections: &[Detection], camera: &Camera| -> Vec<Option<Measured>> {
            let measure = |detection| Measured::new(detection, camera, &rig.left);
            detections.iter().map(measure).collect()
        };
        let right_boxes = measured(right, &rig.right);
        let rows = measured(left, &rig.left)
            .iter()
            .map(|left| {
                right_boxes
                    .iter()
                    .map(|right| affinity(left.as_ref()?, right.as_ref()?, rig, config))
                    .collect()
            })
            .collect();
        Self {
            rows,
            right_count: right.len(),
        }
    }

    /// The pairs whose affinities have the largest sum.
    fn best_assignment(&self) -> Vec<(usize, usize, f64)> {
        let left_count = self.rows.len();
        let is_transposed = left_count > self.right_count;
        // The shorter list must be the rows; a weight of 0 means "stays alone", which costs
        // nothing, so a pair that cannot be never takes a place.
        let (rows, columns) = if is_transposed {
            (self.right_count, left_count)
        } else {
            (left_count, self.right_count)
        };
        if rows == 0 {
            return Vec::new();
        }
        let in_order = |row: usize, column: usize| {
            if is_transposed {
                (column, row)
            } else {
                (row, column)
            }
        };
        let weights = Matrix::from_fn(rows, columns, |(row, column)| {
            let (l, r) = in_order(row, column);
            self.rows[l][r].map_or(0, |affinity| (affinity * AFFINITY_STEPS).round() as i64)
        });
        let (_, assignment) = kuhn_munkres(&weights);
        assignment
            .into_iter()
            .enumerate()
            .filter_map(|(row, column)| {
                let (l, r) = in_order(row, column);
                self.rows[l][r].map(|affinity| (l, r, affinity))
            })
            .collect()
    }
}

/// Agreement of two boxes in rows and size, above 0 and at most 1; None where they cannot be one
/// vehicle.
fn affinity(
    left: &Measured,
    right: &Measured,
    rig: &StereoRig,
    config: &PairingConfig,
) -> Option<f64> {
    let ratio = |a: f64, b: f64| a.min(b) / a.max(b);
    let width_ratio = ratio(left.width, right.width);
    let height_ratio = ratio(left.height, right.height);
    let row_slack = config.slack(f64::midpoint(left.height, right.height));
    let row_difference = (left.y - right.y).abs();
    let is_alike = left.class == right.class
        && width_ratio >= config.least_size_ratio
        && height_ratio >= config.least_size_ratio
        && row_difference <= row_slack;
    if !is_alike {
        return None;
    }

    let disparity = left.x - right.x;
    let width = f64::midpoint(left.width, right.width);
    let height = f64::midpoint(left.height, right.height);
    let slack = config.slack(width);
    let possible = disparity_range(width, height, rig, config);
    let is_possible = (possible.start() - slack..=possible.end() + slack).contains(&disparity);
    // The row term halves at the edge of what is allowed and so never reaches 0.
    let row_term = if row_slack > 0.0 {
        1.0 - 0.5 * row_difference / row_slack
    } else {
        1.0
    };
    is_possible.then(|| row_term * (width_ratio * height_ratio).sqrt())
}

/// The disparities that a vehicle whose box has this size may have, pixels of the left camera; above
/// zero as long as the rig's baseline is, and without slack for boxes or cameras that are inexact.
///
/// A side of `side` pixels and a disparity of d pixels make `side / d * baseline_m` metres, so the
/// size of vehicles limits the disparity as the least depth does.
fn disparity_range(
    width: f64,
    height: f64,
    rig: &StereoRig,
    config: &PairingConfig,
) -> RangeInclusive<f64> {
    let side = width.max(height);
    let from_size = |side_m: f64| side * rig.baseline_m / side_m;
    let nearest = rig.disparity_px(config.least_depth_m);
    from_size(config.largest_side_m).max(0.0)..=from_size(config.least_side_m).min(nearest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Intrinsics, PixelBox, RigSettings};

    fn rig() -> StereoRig {
        StereoRig::from_hfov(2048, 1152, 90.0, 0.80).unwrap()
    }

    fn detection(center: [f64; 2], width: f64, height: f64) -> Detection {
        Detection {
            box_pixel: PixelBox::from_center(center, width, height),
            score: 0.9,
            class: 0,
        }
    }

    /// Both boxes of a vehicle of this size at a point in rig axes.
    fn vehicle(rig: &StereoRig, point: [f64; 3], width_m: f64, height_m: f64) -> [Detection; 2] {
        let [left, right] = rig.pixels_from_rig(point).unwrap();
        [(left, rig.left), (right, rig.right)].map(|(center, camera)| {
            let width = camera.focal_x_px * width_m / point[2];
            detection(center, width, camera.focal_y_px * height_m / point[2])
        })
    }

    /// A street of vehicles, seen by both cameras.
    fn street(rig: &StereoRig) -> Vec<[Detection; 2]> {
        (0..12u32)
            .map(|i| {
                let i = f64::from(i);
                let z = 12.0 + 14.0 * i;
                let x = 0.5 * z * libm::sin(2.4 * i);
                vehicle(rig, [x, 0.02 * z, z], 2.0 + 0.2 * (i % 4.0), 1.6)
            })
            .collect()
    }

    /// Pairs that `pair` finds after the right list was shuffled, as indices before shuffling.
    fn shuffled_pairs(rig: &StereoRig, vehicles: &[[Detection; 2]]) -> Vec<(usize, usize)> {
        let count = vehicles.len();
        let order: Vec<usize> = (0..count).map(|i| (i * 7 + 3) % count).collect();
        let left: Vec<Detection> = vehicles.iter().map(|v| v[0]).collect();
        let right: Vec<Detection> = order.iter().map(|&i| vehicles[i][1]).collect();
        let pairing = pair(&left, &right, rig, &PairingConfig::default());
        pairing
            .pairs
            .iter()
            .map(|&(l, r, _)| (l, order[r]))
            .collect()
    }

    #[test]
    fn shuffled_vehicles_find_their_partners() {
        let rig = rig();
        let vehicles = street(&rig);
        let expected: Vec<_> = (0..vehicles.len()).map(|i| (i, i)).collect();
        assert_eq!(shuffled_pairs(&rig, &vehicles), expected);
    }

    #[test]
    fn cameras_with_different_principal_points_and_focal_lengths_pair_as_well() {
        let intrinsics = |focal_px: f64, center: [f64; 2]| Intrinsics {
            focal_x_px: focal_px,
            focal_y_px: focal_px,
            center_x_px: center[0],
            center_y_px: center[1],
        };
        let rig: StereoRig = RigSettings {
            width: 2048,
            height: 1152,
            baseline_m: 0.80,
            hfov_deg: None,
            left: Some(intrinsics(1024.0, [960.0, 560.0])),
            // Uncorrected, every disparity would be about 200 pixels too small.
            right: Some(intrinsics(1100.0, [1160.0, 610.0])),
        }
        .try_into()
        .unwrap();
        let vehicles = street(&rig);
        let expected: Vec<_> = (0..vehicles.len()).map(|i| (i, i)).collect();
        assert_eq!(shuffled_pairs(&rig, &vehicles), expected);
    }

    #[test]
    fn modes_are_known_by_their_words_to_people_and_to_files() {
        for mode in PairingMode::ALL {
            assert_eq!(mode.to_string().parse(), Ok(mode));
            let json = serde_json::to_string(&mode).unwrap();
            assert_eq!(json, format!("\"{mode}\""));
        }
        assert!("both".parse::<PairingMode>().is_err());
        assert_eq!(PairingMode::default(), PairingMode::Search);
    }

    #[test]
    fn the_best_sum_wins_where_the_best_single_pair_would_leave_one_alone() {
        // Left 0 fits right 0 perfectly; but left 1 fits only right 0, and right 1 only left 0.
        let left = [
            detection([1000.0, 500.0], 60.0, 60.0),
            detection([1000.0, 493.0], 60.0, 60.0),
        ];
        let right = [
            detection([980.0, 500.0], 60.0, 60.0),
            detection([980.0, 507.0], 60.0, 60.0),
        ];
        let pairing = pair(&left, &right, &rig(), &PairingConfig::default());
        let indices: Vec<_> = pairing.pairs.iter().map(|&(l, r, _)| (l, r)).collect();
        assert_eq!(indices, [(0, 1), (1, 0)]);
        let alone = pair(&left[..1], &right, &rig(), &PairingConfig::default());
        assert_eq!(alone.pairs, [(0, 0, 1.0)]);
        assert_eq!(alone.right_only, [1]);
    }

    #[test]
    fn boxes_that_cannot_be_one_vehicle_stay_alone() {
        let left = detection([1000.0, 500.0], 60.0, 60.0);
        let impossible = [
            ("other rows", detection([980.0, 540.0], 60.0, 60.0)),
            ("negative disparity", detection([1030.0, 500.0], 60.0, 60.0)),
            (
                "nearer than the least depth",
                detection([500.0, 500.0], 60.0, 60.0),
            ),
            ("too wide", detection([980.0, 500.0], 120.0, 60.0)),
            ("too high", detection([980.0, 500.0], 60.0, 30.0)),
            ("a toy of 0.2 m", detection([760.0, 500.0], 60.0, 60.0)),
            ("not a number", detection([f64::NAN, 500.0], 60.0, 60.0)),
            ("no area", detection([980.0, 500.0], 0.0, 60.0)),
            (
                "another class",
                Detection {
                    class: 1,
                    ..detection([980.0, 500.0], 60.0, 60.0)
                },
            ),
        ];
        for (reason, right) in impossible {
            let pairing = pair(&[left], &[right], &rig(), &PairingConfig::default());
            assert!(pairing.pairs.is_empty(), "{reason}");
            assert_eq!(
                (pairing.left_only, pairing.right_only),
                (vec![0], vec![0]),
                "{reason}"
            );
        }
    }

    #[test]
    fn a_hall_of_hundreds_of_metres_at_the_horizon_is_no_vehicle() {
        let left = detection([1000.0, 500.0], 400.0, 400.0);
        let right = detection([1060.0, 500.0], 400.0, 400.0);
        let config = PairingConfig {
            slack_fraction: 0.0,
            ..PairingConfig::default()
        };
        assert!(pair(&[left], &[right], &rig(), &config).pairs.is_empty());
    }

    #[test]
    fn a_distant_vehicle_may_have_a_slightly_negative_disparity() {
        let left = detection([1000.0, 500.0], 12.0, 10.0);
        let right = detection([1002.0, 501.0], 13.0, 10.0);
        let pairing = pair(&[left], &[right], &rig(), &PairingConfig::default());
        assert_eq!(pairing.pairs.len(), 1);
    }

    #[test]
    fn empty_lists_leave_everything_alone() {
        let found = [detection([1000.0, 500.0], 60.0, 60.0)];
        let config = PairingConfig::default();
        assert_eq!(pair(&[], &[], &rig(), &config), Pairing::default());
        assert_eq!(pair(&found, &[], &rig(), &config).left_only, [0]);
        assert_eq!(pair(&[], &found, &rig(), &config).right_only, [0]);
    }

    #[test]
    fn unequal_lists_keep_their_indices_in_order() {
        let rig = rig();
        let vehicles = street(&rig);
        let left: Vec<Detection> = vehicles.iter().map(|v| v[0]).collect();
        let right: Vec<Detection> = vehicles.iter().skip(5).map(|v| v[1]).collect();
        let config = PairingConfig::default();
        let more_left = pair(&left, &right, &rig, &config);
        let indices: Vec<_> = more_left.pairs.iter().map(|&(l, r, _)| (l, r)).collect();
        assert_eq!(indices, (5..12).map(|i| (i, i - 5)).collect::<Vec<_>>());
        assert_eq!(more_left.left_only, [0, 1, 2, 3, 4]);
        assert!(more_left.right_only.is_empty());

        let right: Vec<Detection> = vehicles.iter().map(|v| v[1]).collect();
        let more_right = pair(&left[5..], &right, &rig, &config);
        let indices: Vec<_> = more_right.pairs.iter().map(|&(l, r, _)| (l, r)).collect();
        assert_eq!(indices, (5..12).map(|i| (i - 5, i)).collect::<Vec<_>>());
        assert_eq!(more_right.right_only, [0, 1, 2, 3, 4]);
    }

    #[test]
    fn a_hundred_alike_vehicles_in_each_image_are_assigned_one_to_one() {
        let many = |disparity: f64| -> Vec<Detection> {
            (0..100u32)
                .map(|i| detection([600.0 + 2.0 * f64::from(i) - disparity, 500.0], 90.0, 60.0))
                .collect()
        };
        let start = std::time::Instant::now();
        let pairing = pair(&many(20.0), &many(60.0), &rig(), &PairingConfig::default());
        // Generous: it takes milliseconds, and a search over all assignments would never end.
        assert!(start.elapsed().as_secs() < 5);
        let mut partners: Vec<usize> = pairing.pairs.iter().map(|p| p.1).collect();
        partners.sort_unstable();
        partners.dedup();
        assert_eq!(partners.len(), pairing.pairs.len());
        assert_eq!(pairing.pairs.len(), 100);
    }
}
