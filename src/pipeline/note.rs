//! What is strange about the two images of a pair.

use std::fmt;

use image::RgbImage;

use super::vehicle::Pair;
use crate::detector::Detection;
use crate::geometry::StereoRig;
use crate::pairing::PairingConfig;
use crate::pairing::search::search_from_right;

/// Less disparity is no evidence of exchanged images, pixels: that of a vehicle near the horizon fits
/// either order.
const LEAST_DISPARITY_PX: f64 = 2.0;

/// Nor is a less alike place: 19 of 20 true partners reach about this correlation.
const LEAST_CORRELATION: f64 = 0.75;

/// What makes it likely that the two images are not the left and the right one of a capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PairNote {
    /// Both are the same to the last pixel.
    Identical,
    /// Most vehicles have their place in the other image where they would be if left and right were
    /// exchanged.
    Exchanged {
        /// Vehicles that the detector saw in the left image.
        detected: usize,
        /// Of these, found in the right image where the rig allows it.
        found: usize,
        /// Of these, found where exchanged images would show them.
        exchanged: usize,
    },
}

impl PairNote {
    /// Whether both images are the same; a pair of one colour, such as the black ones that begin a
    /// video, says nothing.
    pub fn of_images([left, right]: [&RgbImage; 2]) -> Option<Self> {
        let is_plain = || left.pixels().all(|pixel| pixel == left.get_pixel(0, 0));
        (left == right && !is_plain()).then_some(Self::Identical)
    }

    /// What the detections of the left image and the pairs that were made of them tell.
    pub(super) fn of_pairs(
        images: [&RgbImage; 2],
        detected: &[Detection],
        pairs: &[Pair],
        rig: &StereoRig,
        config: &PairingConfig,
    ) -> Option<Self> {
        let identical = Self::of_images(images);
        let is_possible = |pair: &&Pair| {
            let [left, right] = [&pair.left.box_pixel, &pair.right].map(|b| b.center()[0]);
            let of_boxes = || rig.disparity_of_pixels(left, right);
            pair.disparity_px.unwrap_or_else(of_boxes) > 0.0
        };
        let found = pairs.iter().filter(is_possible).count();
        if identical.is_some() || 2 * found >= detected.len() {
            return identical;
        }
        let [left, right] = images;
        let searched = search_from_right([right, left], detected, rig, config);
        let is_evident = |disparity_px: f64, correlation: f64| {
            disparity_px >= LEAST_DISPARITY_PX && correlation >= LEAST_CORRELATION
        };
        let exchanged = searched
            .partners
            .iter()
            .filter(|partner| is_evident(partner.disparity_px, partner.correlation))
            .count();
        (2 * exchanged > detected.len()).then_some(Self::Exchanged {
            detected: detected.len(),
            found,
            exchanged,
        })
    }
}

impl fmt::Display for PairNote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Identical => write!(
                f,
                "the left and the right image are the same, and without a disparity no distance \
                 can be measured; give the two images of one capture"
            ),
            Self::Exchanged {
                detected,
                found,
                exchanged,
            } => write!(
                f,
                "left and right may be exchanged: of {detected} vehicles {found} appear in the \
                 right image where they can, and {exchanged} where exchanged images would show \
                 them; if they are, give the other one first"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PixelBox;
    use crate::pairing::search::search;
    use crate::pipeline::vehicle::DetectedIn;

    const SIZE: [u32; 2] = [320, 180];

    fn rig() -> StereoRig {
        StereoRig::from_hfov(SIZE[0], SIZE[1], 90.0, 0.8).unwrap()
    }

    /// Waves in directions of their own, moved to the left.
    fn street(shift: f64, seed: f64) -> RgbImage {
        RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| {
            let (x, y) = (f64::from(x) + shift, f64::from(y));
            let waves = (0..12u32).map(|wave| {
                let [a, b, c] = [1.7, 2.9, 4.3].map(|k| libm::sin(k * (f64::from(wave) + seed)));
                let along = x * libm::cos(3.0 * b) + y * libm::sin(3.0 * b);
                libm::sin(along / (4.0 + 3.0 * a) + 9.0 * c)
            });
            let level = 128.0 + 20.0 * waves.sum::<f64>();
            image::Rgb([level.clamp(0.0, 255.0) as u8; 3])
        })
    }

    fn detections() -> Vec<Detection> {
        [[90.0, 60.0], [160.0, 90.0], [230.0, 120.0]]
            .into_iter()
            .map(|center| Detection {
                box_pixel: PixelBox::from_center(center, 40.0, 30.0),
                score: 0.9,
                class: 0,
            })
            .collect()
    }

    fn note(left: &RgbImage, right: &RgbImage) -> Option<PairNote> {
        let (detected, config) = (detections(), PairingConfig::default());
        let found = search([left, right], &detected, &rig(), &config);
        let pairs: Vec<Pair> = found
            .partners
            .iter()
            .map(|partner| Pair {
                left: detected[partner.left],
                right: partner.box_pixel,
                score: 0.9,
                detected_in: DetectedIn::Left,
                disparity_px: Some(partner.disparity_px),
                surface_distance_m: None,
            })
            .collect();
        PairNote::of_pairs([left, right], &detected, &pairs, &rig(), &config)
    }

    #[test]
    fn exchanged_images_are_told_and_others_are_not() {
        let [left, right] = [0.0, 14.0].map(|shift| street(shift, 0.0));
        assert_eq!(note(&left, &right), None);
        let told = note(&right, &left).unwrap();
        let PairNote::Exchanged {
            detected: 3,
            found,
            exchanged: 3,
        } = told
        else {
            panic!("{told:?}");
        };
        // Something else may be alike by chance.
        assert!(found <= 1);
        let text = told.to_string();
        assert!(
            text.contains("exchanged") && text.contains("of 3 vehicles"),
            "{text}"
        );
        // A right image of another place fits neither way, and a far one both.
        assert_eq!(note(&left, &street(0.0, 50.0)), None);
        assert_eq!(note(&left, &street(-0.7, 0.0)), None);
    }

    #[test]
    fn the_same_image_twice_is_told_unless_it_shows_nothing() {
        let image = street(0.0, 0.0);
        assert_eq!(note(&image, &image.clone()), Some(PairNote::Identical));
        let mut other = image.clone();
        other.get_pixel_mut(319, 179).0[2] ^= 1;
        assert_eq!(PairNote::of_images([&image, &other]), None);
        let black = RgbImage::new(64, 36);
        assert_eq!(PairNote::of_images([&black, &black]), None);
        assert!(PairNote::Identical.to_string().contains("the same"));
    }
}
