//! What the network's output stands for: metres to the vehicle, metres of vehicle, or metres behind
//! its surface.

use serde::{Deserialize, Serialize};

use crate::geometry::{Camera, PixelBox, StereoRig};

/// Box sides below this count as this, pixels, so that no distance is infinite.
const SMALLEST_SIDE_PX: f64 = 0.1;

/// What the last layer's sum is.
///
/// The layer adds up features and box size. Distance, however, is a quotient: the vehicle's size
/// over the angle that it fills. A network that is to give the distance itself must learn that
/// quotient from how blurred the enlarged crop is; one that gives the size is left with what a crop
/// shows well, which vehicle it is and from where it is seen, and the cameras' own law does the
/// rest. It also carries over to cameras of another focal length.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Readout {
    /// The distance, metres, as in the paper.
    #[default]
    Distance,
    /// The extent across the line of sight that the boxes enclose, metres.
    Size,
    /// How far the vehicle's centre, which is labelled, lies behind its visible surface, which
    /// matching measures; metres. Only where the disparity is measured.
    ///
    /// That depends on which vehicle it is and from where it is seen, which a crop shows, and hardly on
    /// the distance: on rendered streets (640 pixels wide, 90 degrees) its median is 0.5 m near 10 m
    /// as near 40 m, with a spread of 0.35 m and 0.4 to 0.65 m. As a ratio that spread halves on the
    /// way, and in pixels of disparity it falls to a sixth: the last layer, which can only add, need
    /// not learn either.
    Surface,
}

impl Readout {
    /// Metres of distance for each unit of the network's output, given a vehicle's left and right
    /// box.
    ///
    /// For [`Readout::Size`], with `side = sqrt(width / focal_x * height / focal_y)` and `ray` the
    /// direction to the box's centre at depth 1: `|ray| / side`, the mean of both images. Depth is
    /// `size / side`, and the distance lies along the ray.
    pub fn distance_per_output(self, boxes: [&PixelBox; 2], rig: &StereoRig) -> f64 {
        match self {
            Self::Distance | Self::Surface => 1.0,
            Self::Size => {
                let [left, right] = boxes;
                f64::midpoint(
                    distance_per_size(left, &rig.left),
                    distance_per_size(right, &rig.right),
                )
            }
        }
    }
}

fn distance_per_size(area: &PixelBox, camera: &Camera) -> f64 {
    let width = area.width().max(SMALLEST_SIDE_PX) / camera.focal_x_px;
    let height = area.height().max(SMALLEST_SIDE_PX) / camera.focal_y_px;
    let [x, y, z] = camera.camera_from_pixel(area.center());
    (x * x + y * y + z * z).sqrt() / (width * height).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig() -> StereoRig {
        StereoRig::from_hfov(640, 360, 90.0, 0.8).unwrap()
    }

    /// Boxes of a sphere-like square of `size_m` around a point, as both cameras see it.
    fn boxes(rig: &StereoRig, point_rig: [f64; 3], size_m: f64) -> [PixelBox; 2] {
        let centers = rig.pixels_from_rig(point_rig).unwrap();
        [(centers[0], rig.left), (centers[1], rig.right)].map(|([x, y], camera)| {
            let half = size_m / 2.0 * camera.focal_x_px / point_rig[2];
            PixelBox::new(x - half, y - half, x + half, y + half)
        })
    }

    #[test]
    fn a_known_size_gives_the_distance_anywhere_in_the_image() {
        let rig = rig();
        for point in [[0.0, 0.0, 20.0], [12.0, 3.0, 20.0], [-20.0, -6.0, 35.0]] {
            let [left, right] = boxes(&rig, point, 4.0);
            let distance_m = point.iter().map(|value| value * value).sum::<f64>().sqrt();
            let per_size = Readout::Size.distance_per_output([&left, &right], &rig);
            // The two cameras are 0.4 m from the midpoint that the distance is measured from.
            assert!(
                (4.0 * per_size / distance_m - 1.0).abs() < 1e-3,
                "{point:?}"
            );
            assert_eq!(
                Readout::Distance.distance_per_output([&left, &right], &rig),
                1.0
            );
        }
    }

    #[test]
    fn a_box_without_extent_stays_finite() {
        let area = PixelBox::new(5.0, 5.0, 5.0, 4.0);
        let per_size = Readout::Size.distance_per_output([&area, &area], &rig());
        assert!(per_size.is_finite() && per_size > 0.0, "{per_size}");
    }
}
