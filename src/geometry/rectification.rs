//! Two cameras turned into a rig whose images have every point on the same row.
//!
//! The rectified cameras stand where the real ones stand. Both look the same way: x along the line
//! from the left to the right camera, z the mean of both optical axes, made perpendicular to x, y
//! completing them (Fusiello, Trucco, Verri: "A compact algorithm for rectification of stereo pairs",
//! 2000). They have no lens, square pixels and one principal point.

use glam::{DMat3, DVec3};

use super::calibration::StereoCalibration;
use super::{Camera, Distortion, Intrinsics, RigSettings, StereoRig};
use crate::error::{Error, Result};

/// Points along each side of an image that say how far it reaches.
const BORDER_POINTS: u32 = 64;

/// Directions flatter than this to a rectified image plane are not part of it, cosine.
const LEAST_COSINE: f64 = 0.1;

/// How one camera's unrectified image becomes its rectified one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RectifiedView {
    /// The real camera, without its lens; its size is that of the unrectified image.
    pub camera: Camera,
    /// Its lens.
    pub distortion: Distortion,
    /// Takes directions from the rectified camera's axes to the real one's.
    pub camera_from_rectified: DMat3,
    /// The rectified camera.
    pub rectified: Camera,
}

impl RectifiedView {
    /// Where in the unrectified image a pixel of the rectified one is seen. None where the lens shows
    /// nothing of it; the pixel may lie outside the image.
    pub fn pixel_from_rectified(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        self.pixel_within(pixel, self.distortion.widest())
    }

    /// [`RectifiedView::pixel_from_rectified`], given [`Distortion::widest`].
    pub(crate) fn pixel_within(&self, pixel: [f64; 2], widest: f64) -> Option<[f64; 2]> {
        let ray = DVec3::from_array(self.rectified.camera_from_pixel(pixel));
        let [x, y, z] = (self.camera_from_rectified * ray).to_array();
        if z <= 0.0 {
            return None;
        }
        let direction = [x / z, y / z];
        let r2 = direction[0] * direction[0] + direction[1] * direction[1];
        if r2 > widest * widest {
            return None;
        }
        let [x, y] = self.distortion.distorted(direction);
        self.camera.pixel_from_camera([x, y, 1.0])
    }

    /// Where a pixel of the unrectified image is in the rectified one: the inverse of
    /// [`RectifiedView::pixel_from_rectified`].
    pub fn rectified_from_pixel(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let direction = self.direction(pixel)?;
        self.rectified
            .pixel_from_camera([direction[0], direction[1], 1.0])
    }

    /// The direction of a pixel of the unrectified image in rectified axes, z = 1.
    fn direction(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let [x, y, _] = self.camera.camera_from_pixel(pixel);
        let [x, y] = self.distortion.undistorted([x, y])?;
        let ray = self.camera_from_rectified.transpose() * DVec3::new(x, y, 1.0);
        (ray.z > LEAST_COSINE * ray.length()).then(|| [ray.x / ray.z, ray.y / ray.z])
    }
}

/// What rectification makes of a calibrated rig.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectification {
    /// Left and right camera.
    pub views: [RectifiedView; 2],
    /// The rig of the rectified images.
    pub rig: StereoRig,
}

impl Rectification {
    /// Rectification of images of this size.
    ///
    /// `alpha` says how much of the images is kept: with 0 the rectified ones hold nothing but
    /// pixels that both cameras saw, with 1 everything that either camera saw, with black borders;
    /// between them sizes and places are interpolated. Without it the projections of the calibration
    /// are used where it has them (OpenCV's `P1` and `P2`), and 0 where not. The rotations of the
    /// calibration are used in any case. The images keep their size unless the calibration says
    /// otherwise.
    ///
    /// # Errors
    /// Images that do not belong to the calibration, an `alpha` that is not from 0 to 1, cameras
    /// that see nothing in common.
    pub fn new(
        calibration: &StereoCalibration,
        size: [u32; 2],
        alpha: Option<f64>,
    ) -> Result<Self> {
        let calibration = calibration.for_size(size)?;
        let given = calibration.given().copied();
        let rotations = match &given {
            Some(given) => given.rotations,
            None => rotations(&calibration),
        };
        let new_size = given.and_then(|given| given.size).unwrap_or(size);
        let baseline_m = calibration.baseline_m();
        let view = |side: usize, rectified: Camera| RectifiedView {
            camera: calibration.camera(side, size),
            distortion: calibration.cameras()[side].distortion,
            camera_from_rectified: rotations[side].transpose(),
            rectified,
        };
        let cameras = match (&given, alpha) {
            (Some(given), None) => given
                .intrinsics
                .map(|intrinsics| intrinsics.camera(new_size[0], new_size[1])),
            (_, alpha) => {
                let unit = Intrinsics {
                    focal_x_px: 1.0,
                    focal_y_px: 1.0,
                    center_x_px: 0.0,
                    center_y_px: 0.0,
                };
                let unit = unit.camera(new_size[0], new_size[1]);
                let reaches = [0, 1].map(|side| Reach::of(&view(side, unit)));
                [common_camera(reaches, new_size, alpha.unwrap_or(0.0))?; 2]
            }
        };
        let rig = RigSettings {
            width: new_size[0],
            height: new_size[1],
            baseline_m: given.map_or(baseline_m, |given| given.baseline_m),
            hfov_deg: None,
            left: Some(cameras[0].intrinsics()),
            right: Some(cameras[1].intrinsics()),
        };
        Ok(Self {
            views: [view(0, cameras[0]), view(1, cameras[1])],
            rig: rig.try_into()?,
        })
    }
}

/// From each camera's axes to those of the rectified cameras.
fn rotations(calibration: &StereoCalibration) -> [DMat3; 2] {
    let right_from_left = calibration.right_from_left();
    let x = calibration.right_camera_m().normalize();
    let right_axis = right_from_left.transpose() * DVec3::Z;
    let forward = DVec3::Z + right_axis;
    let z = (forward - x * x.dot(forward)).normalize();
    let rectified_from_left = DMat3::from_cols(x, z.cross(x), z).transpose();
    [
        rectified_from_left,
        rectified_from_left * right_from_left.transpose(),
    ]
}

/// How far an image reaches in rectified axes: x and y of directions at z = 1.
#[derive(Debug, Clone, Copy)]
struct Reach {
    /// The rectangle that lies inside the image: `x_min y_min x_max y_max`.
    inner: [f64; 4],
    /// The rectangle that the image lies in.
    outer: [f64; 4],
}

impl Reach {
    /// None for an image whose border cannot be followed.
    fn of(view: &RectifiedView) -> Option<Self> {
        let (width, height) = (f64::from(view.camera.width), f64::from(view.camera.height));
        let mut inner = [
            f64::NEG_INFINITY,
            f64::NEG_INFINITY,
            f64::INFINITY,
            f64::INFINITY,
        ];
        let mut outer = inner.map(|limit| -limit);
        let mut count = 0;
        for i in 0..=BORDER_POINTS {
            let part = f64::from(i) / f64::from(BORDER_POINTS);
            let along = [
                [0.0, part * height],
                [part * width, 0.0],
                [width, part * height],
                [part * width, height],
            ];
            for (side, pixel) in along.into_iter().enumerate() {
                let Some(direction) = view.direction(pixel) else {
                    continue;
                };
                count += 1;
                let value = direction[side % 2];
                if side < 2 {
                    inner[side] = inner[side].max(value);
                    outer[side] = outer[side].min(value);
                } else {
                    inner[side] = inner[side].min(value);
                    outer[side] = outer[side].max(value);
                }
            }
        }
        let is_whole = inner.iter().chain(&outer).all(|v| v.is_finite());
        (is_whole && count > 2 * BORDER_POINTS).then_some(Self { inner, outer })
    }
}

/// The camera of both rectified images.
fn common_camera(
    reaches: [Option<Reach>; 2],
    [width, height]: [u32; 2],
    alpha: f64,
) -> Result<Camera> {
    if !(0.0..=1.0).contains(&alpha) {
        return Err(Error::value(
            format!("alpha = {alpha}"),
            "is no number from 0 to 1",
            "give 0 for images without black borders, 1 for everything that the cameras saw",
        ));
    }
    let nothing = || {
        Error::value(
            "rectification",
            "the two cameras see too little in common, or their lenses cannot be undone at the border \
             of the image",
            "calibrate again with the board near the borders, or give rectified images and their \
             calibration",
        )
    };
    let [Some(left), Some(right)] = reaches else {
        return Err(nothing());
    };
    let within = |a: [f64; 4], b: [f64; 4]| {
        [
            a[0].max(b[0]),
            a[1].max(b[1]),
            a[2].min(b[2]),
            a[3].min(b[3]),
        ]
    };
    let around = |a: [f64; 4], b: [f64; 4]| {
        [
            a[0].min(b[0]),
            a[1].min(b[1]),
            a[2].max(b[2]),
            a[3].max(b[3]),
        ]
    };
    let (inner, outer) = (
        within(left.inner, right.inner),
        around(left.outer, right.outer),
    );
    let (width_px, height_px) = (f64::from(width), f64::from(height));
    let sides = |area: [f64; 4]| [area[2] - area[0], area[3] - area[1]];
    if !sides(inner).iter().all(|side| *side > 0.0) {
        return Err(nothing());
    }
    let [inner_sides, outer_sides] = [sides(inner), sides(outer)];
    let full = (width_px / inner_sides[0]).max(height_px / inner_sides[1]);
    let whole = (width_px / outer_sides[0]).min(height_px / outer_sides[1]);
    let mixed = |a: f64, b: f64| if a == b { a } else { a + alpha * (b - a) };
    let focal_px = mixed(full, whole);
    let middle = |area: [f64; 4], i: usize| f64::midpoint(area[i], area[i + 2]);
    let center = |i: usize, side_px: f64| {
        side_px / 2.0 - focal_px * mixed(middle(inner, i), middle(outer, i))
    };
    Ok(Camera {
        width,
        height,
        focal_x_px: focal_px,
        focal_y_px: focal_px,
        center_x_px: center(0, width_px),
        center_y_px: center(1, height_px),
    })
}

#[cfg(test)]
mod tests;
