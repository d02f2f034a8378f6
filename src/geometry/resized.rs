//! Cameras whose images are resized.

use super::{Camera, Intrinsics, StereoRig};

/// Sizes that differ by less than this part in aspect are the same image, shrunk or enlarged.
const ASPECT_TOLERANCE: f64 = 0.005;

/// Scale along x and y of images of the same view; None for another shape.
pub(super) fn scale_to(own: [u32; 2], size: [u32; 2]) -> Option<[f64; 2]> {
    let scale = [0, 1].map(|i| f64::from(size[i]) / f64::from(own[i]));
    // Sides are whole pixels: half a pixel of the smaller side is no other shape.
    let smallest = f64::from(size[0].min(size[1]));
    let tolerance = ASPECT_TOLERANCE.max(0.6 / smallest);
    ((scale[0] / scale[1] - 1.0).abs() <= tolerance).then_some(scale)
}

/// Whether images of both sizes can be the same view, resized.
pub fn is_same_shape(size: [u32; 2], other: [u32; 2]) -> bool {
    scale_to(size, other).is_some()
}

impl Intrinsics {
    /// Those of the same camera when its images are resized by these factors along x and y.
    #[must_use]
    pub fn scaled(&self, [x, y]: [f64; 2]) -> Self {
        Self {
            focal_x_px: self.focal_x_px * x,
            focal_y_px: self.focal_y_px * y,
            center_x_px: self.center_x_px * x,
            center_y_px: self.center_y_px * y,
        }
    }
}

impl Camera {
    fn scaled(&self, scale: [f64; 2], [width, height]: [u32; 2]) -> Self {
        self.intrinsics().scaled(scale).camera(width, height)
    }
}

impl StereoRig {
    /// The rig of the same cameras when their images are resized; None for a size of another shape.
    pub fn resized(&self, size: [u32; 2]) -> Option<Self> {
        let scale = scale_to([self.left.width, self.left.height], size)?;
        Some(Self {
            left: self.left.scaled(scale, size),
            right: self.right.scaled(scale, size),
            baseline_m: self.baseline_m,
        })
    }

    /// A rig of the same horizontal field of view and square pixels for images of any size: rows are
    /// cut off above and below, or added.
    pub fn cropped(&self, [width, height]: [u32; 2]) -> Self {
        let camera = |camera: &Camera| {
            let scale = f64::from(width) / f64::from(camera.width);
            let mut scaled = camera.scaled([scale; 2], [width, height]);
            scaled.center_y_px += (f64::from(height) - scale * f64::from(camera.height)) / 2.0;
            scaled
        };
        Self {
            left: camera(&self.left),
            right: camera(&self.right),
            baseline_m: self.baseline_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_resized_rig_sees_every_point_at_the_same_part_of_the_image() {
        let rig = StereoRig::from_hfov(2048, 1152, 90.0, 0.80).unwrap();
        let half = rig.resized([1024, 576]).unwrap();
        let point = [3.0, -2.0, 42.0];
        let [whole, halved] = [rig, half].map(|rig| rig.pixels_from_rig(point).unwrap());
        for (a, b) in whole
            .into_iter()
            .flatten()
            .zip(halved.into_iter().flatten())
        {
            assert!((a / 2.0 - b).abs() < 1e-9);
        }
        assert_eq!(rig.resized([1024, 600]), None);
        let flat = rig.cropped([1024, 400]);
        let [cut, _] = flat.pixels_from_rig(point).unwrap();
        assert_eq!(flat.left.focal_x_px, flat.left.focal_y_px);
        assert!((cut[0] - halved[0][0]).abs() < 1e-9);
        assert!((cut[1] - (halved[0][1] - 88.0)).abs() < 1e-9);
    }
}
