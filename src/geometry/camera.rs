//! Pinhole cameras and the rectified stereo rig made of two of them.

use serde::{Deserialize, Serialize};

use super::PixelBox;
use crate::error::{Error, Result};

/// Boxes nearer to a side of the image are cut off by it, pixels.
const BORDER_PX: f64 = 2.0;

/// Boxes' disparities may differ by this from their vehicle's, pixels, and in addition by
/// [`BOX_SLACK_PART`].
const BOX_SLACK_PX: f64 = 1.5;

/// Part of the box's width: the near side of a car at 9 m moves its box by a tenth.
const BOX_SLACK_PART: f64 = 0.15;

/// A pinhole camera without distortion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Focal length along x, pixels.
    pub focal_x_px: f64,
    /// Focal length along y, pixels.
    pub focal_y_px: f64,
    /// Principal point x, pixels.
    pub center_x_px: f64,
    /// Principal point y, pixels.
    pub center_y_px: f64,
}

impl Camera {
    /// A camera with square pixels and its principal point at the image centre:
    /// `focal_px = width / (2 tan(hfov / 2))`.
    pub fn from_hfov(width: u32, height: u32, hfov_deg: f64) -> Self {
        let focal_px = f64::from(width) / (2.0 * libm::tan(hfov_deg.to_radians() / 2.0));
        Self {
            width,
            height,
            focal_x_px: focal_px,
            focal_y_px: focal_px,
            center_x_px: f64::from(width) / 2.0,
            center_y_px: f64::from(height) / 2.0,
        }
    }

    /// Focal lengths and principal point.
    pub fn intrinsics(&self) -> Intrinsics {
        Intrinsics {
            focal_x_px: self.focal_x_px,
            focal_y_px: self.focal_y_px,
            center_x_px: self.center_x_px,
            center_y_px: self.center_y_px,
        }
    }

    /// Projects a point (metres, camera axes) to pixels. None when it is not in front of the camera.
    pub fn pixel_from_camera(&self, point_camera: [f64; 3]) -> Option<[f64; 2]> {
        let [x, y, z] = point_camera;
        (z > 0.0).then(|| {
            [
                self.center_x_px + self.focal_x_px * x / z,
                self.center_y_px + self.focal_y_px * y / z,
            ]
        })
    }

    /// The direction (not normalised, z = 1) in camera axes that lands on a pixel.
    pub fn camera_from_pixel(&self, pixel: [f64; 2]) -> [f64; 3] {
        [
            (pixel[0] - self.center_x_px) / self.focal_x_px,
            (pixel[1] - self.center_y_px) / self.focal_y_px,
            1.0,
        ]
    }
}

/// Two cameras with parallel axes, the right one `baseline_m` to the right of the left one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RigSettings", into = "RigSettings")]
pub struct StereoRig {
    /// Left camera.
    pub left: Camera,
    /// Right camera.
    pub right: Camera,
    /// Distance between the cameras' centres, metres.
    pub baseline_m: f64,
}

/// A rig as people write it: a field of view for both cameras, or intrinsics for each.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigSettings {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Distance between the cameras, metres.
    pub baseline_m: f64,
    /// Horizontal field of view of both cameras, degrees; the alternative to `left` and `right`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hfov_deg: Option<f64>,
    /// Left camera's intrinsics.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left: Option<Intrinsics>,
    /// Right camera's intrinsics.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub right: Option<Intrinsics>,
}

/// Focal lengths and principal point of one camera, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Intrinsics {
    /// Focal length along x.
    pub focal_x_px: f64,
    /// Focal length along y.
    pub focal_y_px: f64,
    /// Principal point x.
    pub center_x_px: f64,
    /// Principal point y.
    pub center_y_px: f64,
}

impl Intrinsics {
    /// A camera with images of this size.
    pub fn camera(&self, width: u32, height: u32) -> Camera {
        Camera {
            width,
            height,
            focal_x_px: self.focal_x_px,
            focal_y_px: self.focal_y_px,
            center_x_px: self.center_x_px,
            center_y_px: self.center_y_px,
        }
    }
}

impl StereoRig {
    /// Two equal cameras with their principal points at the image centre.
    ///
    /// # Errors
    /// A size, field of view or baseline that no camera can have.
    pub fn from_hfov(width: u32, height: u32, hfov_deg: f64, baseline_m: f64) -> Result<Self> {
        RigSettings {
            width,
            height,
            baseline_m,
            hfov_deg: Some(hfov_deg),
            left: None,
            right: None,
        }
        .try_into()
    }

    /// The left camera's focal length along x, pixels: the one of the disparity law.
    pub fn focal_px(&self) -> f64 {
        self.left.focal_x_px
    }

    /// Disparity `x_left - x_right = focal_px * baseline_m / z` of a point at depth `z`, both
    /// coordinates taken from their camera's principal point.
    pub fn disparity_px(&self, z_m: f64) -> f64 {
        self.focal_px() * self.baseline_m / z_m
    }

    /// Depth of a point with this disparity: the inverse of [`StereoRig::disparity_px`].
    pub fn depth_m(&self, disparity_px: f64) -> f64 {
        self.focal_px() * self.baseline_m / disparity_px
    }

    /// Disparity of two pixels, each counted from its camera's principal point, pixels of the left
    /// camera.
    pub fn disparity_of_pixels(&self, left_x: f64, right_x: f64) -> f64 {
        let scale = self.left.focal_x_px / self.right.focal_x_px;
        left_x - self.left.center_x_px - (right_x - self.right.center_x_px) * scale
    }

    /// How far the point is, from the midpoint between the cameras, that a pixel of the left image
    /// shows with this disparity; metres. None for a disparity that no point in front of the rig has.
    pub fn triangulated_m(&self, left_pixel: [f64; 2], disparity_px: f64) -> Option<f64> {
        let z = self.depth_m(disparity_px);
        if !(z.is_finite() && z > 0.0) {
            return None;
        }
        let [x, y, _] = self.left.camera_from_pixel(left_pixel).map(|v| v * z);
        let x = x - self.baseline_m / 2.0;
        Some((x * x + y * y + z * z).sqrt())
    }

    /// Whether a vehicle's visible boxes lie as far apart as its depth says.
    ///
    /// Loosely: the vehicle's near side has more disparity than its centre, and hidden parts move
    /// edges: `hidden_px` is how far what hides the vehicle may have moved the centres apart. Boxes
    /// that touch a side of their image say nothing and pass.
    pub fn boxes_agree(&self, left: &PixelBox, right: &PixelBox, z_m: f64, hidden_px: f64) -> bool {
        let cut_off = |area: &PixelBox, camera: &Camera| {
            area.x_min < BORDER_PX || area.x_max > f64::from(camera.width) - BORDER_PX
        };
        if cut_off(left, &self.left) || cut_off(right, &self.right) || z_m <= 0.0 {
            return true;
        }
        let [left_x, right_x] = [(left, &self.left), (right, &self.right)]
            .map(|(area, camera)| (area.center()[0] - camera.center_x_px) / camera.focal_x_px);
        let disparity_px = (left_x - right_x) * self.focal_px();
        let slack_px = BOX_SLACK_PX + BOX_SLACK_PART * left.width().max(right.width()) + hidden_px;
        (disparity_px - self.disparity_px(z_m)).abs() <= slack_px
    }

    /// The rig that takes the same pictures of the mirrored world: cameras exchanged, their images
    /// mirrored.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        let mirrored = |camera: Camera| Camera {
            center_x_px: f64::from(camera.width) - camera.center_x_px,
            ..camera
        };
        Self {
            left: mirrored(self.right),
            right: mirrored(self.left),
            baseline_m: self.baseline_m,
        }
    }

    /// The rig of a part of the images: some rows from the first of them on.
    #[must_use]
    pub fn of_rows(&self, first: u32, rows: u32) -> Self {
        let part = |camera: Camera| Camera {
            height: rows,
            center_y_px: camera.center_y_px - f64::from(first),
            ..camera
        };
        Self {
            left: part(self.left),
            right: part(self.right),
            baseline_m: self.baseline_m,
        }
    }

    /// Projects a point (metres, rig axes) into the left and the right image.
    pub fn pixels_from_rig(&self, point_rig: [f64; 3]) -> Option<[[f64; 2]; 2]> {
        let [x, y, z] = point_rig;
        let half = self.baseline_m / 2.0;
        Some([
            self.left.pixel_from_camera([x + half, y, z])?,
            self.right.pixel_from_camera([x - half, y, z])?,
        ])
    }
}

impl From<StereoRig> for RigSettings {
    fn from(rig: StereoRig) -> Self {
        Self {
            width: rig.left.width,
            height: rig.left.height,
            baseline_m: rig.baseline_m,
            hfov_deg: None,
            left: Some(rig.left.intrinsics()),
            right: Some(rig.right.intrinsics()),
        }
    }
}

impl TryFrom<RigSettings> for StereoRig {
    type Error = Error;

    fn try_from(settings: RigSettings) -> Result<Self> {
        let RigSettings {
            width,
            height,
            baseline_m,
            hfov_deg,
            left,
            right,
        } = settings;
        if width < 2 || height < 2 || width > 32_768 || height > 32_768 {
            return Err(Error::value(
                format!("rig size {width}x{height}"),
                "not a usable image size",
                "give width and height between 2 and 32768 pixels",
            ));
        }
        if !(baseline_m.is_finite() && baseline_m > 0.0) {
            return Err(Error::value(
                format!("rig baseline_m = {baseline_m}"),
                "the cameras must stand apart, the right one to the right",
                "give the distance between the cameras in metres, above 0",
            ));
        }
        let camera = |i: Intrinsics| -> Result<Camera> {
            let values = [i.focal_x_px, i.focal_y_px, i.center_x_px, i.center_y_px];
            if values.iter().any(|v| !v.is_finite()) || i.focal_x_px <= 0.0 || i.focal_y_px <= 0.0 {
                return Err(Error::value(
                    format!("rig focal lengths {} and {} px", i.focal_x_px, i.focal_y_px),
                    "a focal length must be a positive number",
                    "give the calibrated intrinsics in pixels",
                ));
            }
            Ok(i.camera(width, height))
        };
        match (hfov_deg, left, right) {
            (Some(hfov), None, None) if hfov > 0.0 && hfov < 180.0 => {
                let camera = Camera::from_hfov(width, height, hfov);
                Ok(Self {
                    left: camera,
                    right: camera,
                    baseline_m,
                })
            }
            (Some(hfov), None, None) => Err(Error::value(
                format!("rig hfov_deg = {hfov}"),
                "not a field of view of a pinhole camera",
                "give degrees between 0 and 180",
            )),
            (None, Some(left), Some(right)) => Ok(Self {
                left: camera(left)?,
                right: camera(right)?,
                baseline_m,
            }),
            _ => Err(Error::value(
                "rig",
                "needs either hfov_deg or both [rig.left] and [rig.right]",
                "give exactly one of the two forms",
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paper_rig() -> StereoRig {
        StereoRig::from_hfov(2048, 1152, 90.0, 0.80).unwrap()
    }

    #[test]
    fn ninety_degrees_at_2048_pixels_is_1024_pixels_of_focal_length() {
        assert!((paper_rig().focal_px() - 1024.0).abs() < 1e-9);
    }

    #[test]
    fn the_disparity_of_a_projected_point_is_focal_times_baseline_over_depth() {
        let rig = paper_rig();
        for point in [[0.0, 0.0, 10.0], [3.0, -2.0, 42.0], [-60.0, 11.0, 200.0]] {
            let [left, right] = rig.pixels_from_rig(point).unwrap();
            assert!((left[0] - right[0] - rig.disparity_px(point[2])).abs() < 1e-9);
            assert!((left[1] - right[1]).abs() < 1e-12);
            assert!((rig.depth_m(left[0] - right[0]) - point[2]).abs() < 1e-6);
        }
    }

    #[test]
    fn the_paper_rig_sees_82_pixels_at_10_m_and_4_at_200_m() {
        let rig = paper_rig();
        assert!((rig.disparity_px(10.0) - 81.92).abs() < 1e-9);
        assert!((rig.disparity_px(200.0) - 4.096).abs() < 1e-9);
    }

    #[test]
    fn the_two_pixels_of_a_point_triangulate_to_its_distance_from_the_midpoint() {
        let rig = paper_rig();
        for point in [[0.0, 0.0, 10.0], [3.0, -2.0, 42.0], [-60.0, 11.0, 200.0]] {
            let [left, right] = rig.pixels_from_rig(point).unwrap();
            let disparity_px = rig.disparity_of_pixels(left[0], right[0]);
            let distance_m = point.iter().map(|v| v * v).sum::<f64>().sqrt();
            assert!((rig.triangulated_m(left, disparity_px).unwrap() - distance_m).abs() < 1e-6);
        }
        for disparity_px in [0.0, -1.0, f64::NAN] {
            assert_eq!(rig.triangulated_m([1000.0, 500.0], disparity_px), None);
        }
    }

    #[test]
    fn a_pixel_and_its_direction_invert_each_other() {
        let camera = paper_rig().left;
        let [x, y, z] = camera.camera_from_pixel([17.25, 903.5]);
        let pixel = camera
            .pixel_from_camera([x * 7.0, y * 7.0, z * 7.0])
            .unwrap();
        assert!((pixel[0] - 17.25).abs() < 1e-9 && (pixel[1] - 903.5).abs() < 1e-9);
    }

    #[test]
    fn impossible_rigs_are_refused_with_the_value_named() {
        for (rig, word) in [
            (StereoRig::from_hfov(640, 360, 90.0, 0.0), "baseline_m = 0"),
            (StereoRig::from_hfov(640, 360, 180.0, 0.8), "hfov_deg = 180"),
            (StereoRig::from_hfov(0, 360, 90.0, 0.8), "0x360"),
            (
                StereoRig::from_hfov(640, 360, f64::NAN, 0.8),
                "hfov_deg = NaN",
            ),
        ] {
            let message = rig.unwrap_err().to_string();
            assert!(message.contains(word), "{message} should contain {word}");
        }
    }
}
