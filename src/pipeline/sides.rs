//! From detections of one or both images to pairs of boxes, and what one image alone shows.

use image::RgbImage;

use super::PredictOptions;
use super::vehicle::{DetectedIn, Pair, SingleSided};
use crate::detector::Detection;
use crate::geometry::{PixelBox, StereoRig};
use crate::pairing::search::{SAME_VEHICLE_IOU, search, search_from_right};
use crate::pairing::{PairingMode, pair};

/// The detections of a pair, sorted out.
#[derive(Debug, Clone, Default)]
pub(super) struct Sides {
    /// Vehicles with a box in both images.
    pub pairs: Vec<Pair>,
    /// Detections of the left and of the right image that have no box in the other one.
    pub alone: [Vec<Detection>; 2],
}

impl Sides {
    /// Vehicles of the left image, before anything is known of the right one.
    pub fn of_left(detections: Vec<Detection>) -> Self {
        Self {
            pairs: detections.into_iter().map(Pair::of_left).collect(),
            alone: [Vec::new(), Vec::new()],
        }
    }

    /// Given what the detector found in the images that it ran on, left first.
    pub fn new(
        images: [&RgbImage; 2],
        found: Vec<Vec<Detection>>,
        rig: &StereoRig,
        options: &PredictOptions,
    ) -> Self {
        let mut found = found.into_iter();
        let left = found.next().unwrap_or_default();
        let config = &options.pairing;
        let (mut pairs, left_only, right_only) = match options.pairing_mode {
            PairingMode::Detect => {
                let right = found.next().unwrap_or_default();
                let paired = pair(&left, &right, rig, config);
                let joined = |(l, r, _): (usize, usize, f64)| Pair {
                    left: left[l],
                    right: right[r].box_pixel,
                    score: f32::midpoint(left[l].score, right[r].score),
                    detected_in: DetectedIn::Both,
                    disparity_px: None,
                    ranged: None,
                };
                let only = |of: &[Detection], which: &[usize]| -> Vec<Detection> {
                    which.iter().map(|&i| of[i]).collect()
                };
                let left_only = only(&left, &paired.left_only);
                let right_only = only(&right, &paired.right_only);
                (
                    paired.pairs.into_iter().map(joined).collect(),
                    left_only,
                    right_only,
                )
            }
            PairingMode::Search => (Vec::new(), left, Vec::new()),
        };
        let is_searched = options.pairing_mode == PairingMode::Search
            || options.single_sided != SingleSided::Drop;
        if !is_searched {
            return Self {
                pairs,
                ..Self::default()
            };
        }

        let searched = search(images, &left_only, rig, config);
        let found_right = searched.partners.iter().map(|partner| {
            let left = left_only[partner.left];
            let boxes = [left, at(partner.box_pixel, left)];
            Pair::searched(boxes, DetectedIn::Left, partner.disparity_px)
        });
        add_new(&mut pairs, found_right.collect());
        let left_alone = searched.left_only.iter().map(|&i| left_only[i]).collect();

        // What the search brought to a left detection has a place in the right image already.
        let is_new = |detection: &Detection| {
            let is_same = |pair: &Pair| {
                pair.left.class == detection.class
                    && pair.right.iou(&detection.box_pixel) > SAME_VEHICLE_IOU
            };
            !pairs.iter().any(is_same)
        };
        let right_only: Vec<Detection> = right_only.into_iter().filter(is_new).collect();
        let mut right_alone = Vec::new();
        if !right_only.is_empty() {
            let searched = search_from_right(images, &right_only, rig, config);
            let found_left = searched.partners.iter().map(|partner| {
                let right = right_only[partner.left];
                let boxes = [at(partner.box_pixel, right), right];
                Pair::searched(boxes, DetectedIn::Right, partner.disparity_px)
            });
            add_new(&mut pairs, found_left.collect());
            right_alone = searched.left_only.iter().map(|&i| right_only[i]).collect();
        }
        Self {
            pairs,
            alone: [left_alone, right_alone],
        }
    }
}

/// A detection as it appears in the other image.
fn at(box_pixel: PixelBox, detection: Detection) -> Detection {
    Detection {
        box_pixel,
        ..detection
    }
}

/// Adds pairs of which one box was searched, but for those that found a vehicle that is there
/// already: a second detection of it, without a partner of its own.
fn add_new(pairs: &mut Vec<Pair>, searched: Vec<Pair>) {
    let known = pairs.len();
    for new in searched {
        let is_same = |old: &Pair| {
            old.left.class == new.left.class
                && (old.left.box_pixel.iou(&new.left.box_pixel) > SAME_VEHICLE_IOU
                    || old.right.iou(&new.right) > SAME_VEHICLE_IOU)
        };
        if !pairs[..known].iter().any(is_same) {
            pairs.push(new);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    const SIZE: [u32; 2] = [320, 180];

    fn rig() -> StereoRig {
        StereoRig::from_hfov(SIZE[0], SIZE[1], 90.0, 0.8).unwrap()
    }

    /// A number from 0 to 1 that looks random.
    fn noise(x: i64, y: i64) -> f64 {
        let mixed = (x as u64)
            .wrapping_mul(0x9E37_79B9_7F4A_7C15)
            .wrapping_add((y as u64).wrapping_mul(0xBF58_476D_1CE4_E5B9));
        let mixed = (mixed ^ mixed >> 29).wrapping_mul(0x94D0_49BB_1331_11EB);
        f64::from((mixed ^ mixed >> 32) as u32) / f64::from(u32::MAX)
    }

    /// Both images of a textured wall, which the right camera sees `disparity` pixels further left.
    fn wall(disparity: i64) -> [RgbImage; 2] {
        [0, disparity].map(|shift| {
            RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| {
                let (x, y) = (i64::from(x) + shift, i64::from(y));
                let smooth = (0..3).map(|i| noise((x + i) / 3, y / 3)).sum::<f64>() / 3.0;
                Rgb([(smooth * 255.0) as u8; 3])
            })
        })
    }

    fn detection(x: f64, score: f32) -> Detection {
        Detection {
            box_pixel: PixelBox::from_center([x, 90.0], 40.0, 30.0),
            score,
            class: 0,
        }
    }

    fn options(pairing_mode: PairingMode, single_sided: SingleSided) -> PredictOptions {
        PredictOptions {
            pairing_mode,
            single_sided,
            ..PredictOptions::default()
        }
    }

    fn sides(found: &[Vec<Detection>; 2], single_sided: SingleSided) -> Sides {
        let [left, right] = wall(16);
        let options = options(PairingMode::Detect, single_sided);
        Sides::new([&left, &right], found.to_vec(), &rig(), &options)
    }

    #[test]
    fn what_one_image_shows_is_found_in_the_other_one_and_flagged() {
        for (found, flag) in [
            ([vec![detection(160.0, 0.8)], vec![]], DetectedIn::Left),
            ([vec![], vec![detection(144.0, 0.8)]], DetectedIn::Right),
        ] {
            let Sides { pairs, alone } = sides(&found, SingleSided::Search);
            assert_eq!(pairs.len(), 1, "{flag:?}");
            let Pair { left, right, .. } = pairs[0];
            assert_eq!((pairs[0].detected_in, pairs[0].score), (flag, 0.8));
            assert!((left.box_pixel.center()[0] - 160.0).abs() < 0.2, "{left:?}");
            assert!((right.center()[0] - 144.0).abs() < 0.2, "{right:?}");
            let disparity_px = pairs[0].disparity_px.unwrap();
            assert!((disparity_px - 16.0).abs() < 0.2, "{disparity_px}");
            assert!(alone.iter().all(Vec::is_empty));
            assert!(sides(&found, SingleSided::Drop).pairs.is_empty());
        }
    }

    #[test]
    fn detections_of_both_images_are_one_vehicle_and_no_third() {
        // A second box of the same vehicle in each image finds the pair that is there already.
        let found = [
            vec![detection(160.0, 0.8), detection(163.0, 0.4)],
            vec![detection(144.0, 0.6)],
        ];
        let pairs = sides(&found, SingleSided::Search).pairs;
        assert_eq!(pairs.len(), 1, "{pairs:?}");
        assert_eq!(pairs[0].detected_in, DetectedIn::Both);
        assert_eq!(pairs[0].disparity_px, None);
        assert!((pairs[0].score - 0.7).abs() < 1e-6);
    }

    #[test]
    fn without_a_place_in_the_other_image_a_detection_stays_alone() {
        let [left, _] = wall(16);
        let blank = RgbImage::new(SIZE[0], SIZE[1]);
        let found = vec![vec![detection(160.0, 0.8)], vec![detection(20.0, 0.5)]];
        let options = options(PairingMode::Detect, SingleSided::Keep);
        let Sides { pairs, alone } = Sides::new([&left, &blank], found, &rig(), &options);
        assert!(pairs.is_empty());
        assert_eq!(alone.map(|side| side.len()), [1, 1]);
    }

    #[test]
    fn a_detector_on_the_left_image_alone_flags_everything_as_left() {
        let [left, right] = wall(16);
        let options = options(PairingMode::Search, SingleSided::Drop);
        let found = vec![vec![detection(160.0, 0.8)]];
        let pairs = Sides::new([&left, &right], found, &rig(), &options).pairs;
        assert_eq!(pairs.len(), 1);
        assert_eq!(pairs[0].detected_in, DetectedIn::Left);
    }
}
