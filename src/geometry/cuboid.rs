//! A vehicle's bounding box in space, as datasets of driving scenes label it.

use super::{Camera, PixelBox, SphereTarget};

/// What lies nearer to the camera than this is cut off before it is projected, metres.
const NEAR_M: f64 = 0.1;

/// A box that stands upright on the ground, in camera axes (x right, y down, z forward).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cuboid {
    /// Its centre, metres.
    pub center_camera: [f64; 3],
    /// Along the vehicle, metres.
    pub length_m: f64,
    /// Across the vehicle, metres.
    pub width_m: f64,
    /// Upwards, metres.
    pub height_m: f64,
    /// Turn about the camera's y axis, radians: 0 is a vehicle that drives along x, and a quarter
    /// turn one that drives towards the camera (KITTI's `rotation_y`).
    pub yaw_rad: f64,
}

impl Cuboid {
    /// The same box seen from a camera that stands elsewhere, axes alike: `offset_m` is added to
    /// its centre.
    pub fn moved(&self, offset_m: [f64; 3]) -> Self {
        let [x, y, z] = self.center_camera;
        Self {
            center_camera: [x + offset_m[0], y + offset_m[1], z + offset_m[2]],
            ..*self
        }
    }

    /// Unit vector from the vehicle's centre to its front, camera axes.
    pub fn forward_camera(&self) -> [f64; 3] {
        [libm::cos(self.yaw_rad), 0.0, -libm::sin(self.yaw_rad)]
    }

    /// From the camera's centre to the box's, metres.
    pub fn distance_m(&self) -> f64 {
        let [x, y, z] = self.center_camera;
        libm::sqrt(x * x + y * y + z * z)
    }

    /// Angle of the camera around the vehicle, degrees from -180 to 180: 0 in front, 90 at its
    /// right.
    pub fn azimuth_deg(&self) -> f64 {
        let [x, _, z] = self.center_camera;
        let [forward_x, _, forward_z] = self.forward_camera();
        // From the vehicle to the camera, along its forward and its left direction; y points down.
        let ahead = -x * forward_x - z * forward_z;
        let leftwards = x * forward_z - z * forward_x;
        libm::atan2(-leftwards, ahead).to_degrees()
    }

    /// Angle of the camera above the horizon as seen from the vehicle, degrees.
    pub fn elevation_deg(&self) -> f64 {
        libm::asin(self.center_camera[1] / self.distance_m()).to_degrees()
    }

    /// What the sphere box needs to know: the sphere through the corners, and as the least radius
    /// half the diagonal of the cross-section.
    pub fn sphere_target(&self) -> SphereTarget {
        let across = self.width_m * self.width_m + self.height_m * self.height_m;
        SphereTarget {
            center_camera: self.center_camera,
            forward_camera: self.forward_camera(),
            radius_min_m: 0.5 * libm::sqrt(across),
            radius_sphere_m: 0.5 * libm::sqrt(across + self.length_m * self.length_m),
        }
    }

    /// The smallest box around the projection, not clipped to the image. None where no part of it
    /// is in front of the camera.
    pub fn projected(&self, camera: &Camera) -> Option<PixelBox> {
        let corners = self.corners();
        let mut bounds: Option<PixelBox> = None;
        let mut add = |point: [f64; 3]| {
            if let Some([x, y]) = camera.pixel_from_camera(point) {
                let old = bounds.unwrap_or(PixelBox::new(x, y, x, y));
                bounds = Some(PixelBox::new(
                    old.x_min.min(x),
                    old.y_min.min(y),
                    old.x_max.max(x),
                    old.y_max.max(y),
                ));
            }
        };
        for (i, a) in corners.iter().enumerate() {
            if a[2] >= NEAR_M {
                add(*a);
            }
            // Edges join corners whose numbers differ in one bit.
            for bit in [1, 2, 4] {
                let b = corners[i ^ bit];
                if i & bit == 0 && (a[2] < NEAR_M) != (b[2] < NEAR_M) {
                    let part = (NEAR_M - a[2]) / (b[2] - a[2]);
                    add([
                        a[0] + part * (b[0] - a[0]),
                        a[1] + part * (b[1] - a[1]),
                        NEAR_M,
                    ]);
                }
            }
        }
        bounds.filter(PixelBox::is_valid)
    }

    /// The corners; bit 0 of a corner's number says front, bit 1 right, bit 2 bottom.
    fn corners(&self) -> [[f64; 3]; 8] {
        let (sin, cos) = (libm::sin(self.yaw_rad), libm::cos(self.yaw_rad));
        let [x, y, z] = self.center_camera;
        std::array::from_fn(|i| {
            let end = |bit: usize, size: f64| {
                if i & bit == 0 {
                    -size / 2.0
                } else {
                    size / 2.0
                }
            };
            let (along, across) = (end(1, self.length_m), end(2, self.width_m));
            [
                x + along * cos + across * sin,
                y + end(4, self.height_m),
                z - along * sin + across * cos,
            ]
        })
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    fn car(center_camera: [f64; 3], yaw_rad: f64) -> Cuboid {
        Cuboid {
            center_camera,
            length_m: 4.0,
            width_m: 1.6,
            height_m: 1.5,
            yaw_rad,
        }
    }

    fn camera() -> Camera {
        Camera::from_hfov(1000, 600, 90.0)
    }

    #[test]
    fn a_box_straight_ahead_projects_to_its_nearest_face() {
        let bounds = car([0.0, 0.0, 20.0], FRAC_PI_2)
            .projected(&camera())
            .unwrap();
        let side_px = 500.0 * 1.6 / 18.0;
        assert!((bounds.width() - side_px).abs() < 1e-9);
        assert!((bounds.height() - 500.0 * 1.5 / 18.0).abs() < 1e-9);
        assert_eq!(bounds.center().map(f64::round), [500.0, 300.0]);
    }

    #[test]
    fn a_box_that_reaches_behind_the_camera_is_cut_off_and_one_behind_it_has_no_projection() {
        let beside = car([2.0, 0.0, 0.5], FRAC_PI_2)
            .projected(&camera())
            .unwrap();
        assert!(beside.x_max > 1000.0 && beside.x_min.is_finite());
        assert!(car([0.0, 0.0, -9.0], 0.3).projected(&camera()).is_none());
    }

    #[test]
    fn the_camera_is_in_front_of_a_vehicle_that_drives_towards_it_and_behind_one_that_leaves() {
        assert!(car([0.0, 1.0, 20.0], FRAC_PI_2).azimuth_deg().abs() < 1e-9);
        assert!((car([0.0, 1.0, 20.0], -FRAC_PI_2).azimuth_deg().abs() - 180.0).abs() < 1e-9);
        // It drives to the right of the image: the camera is on its right.
        assert!((car([0.0, 1.0, 20.0], 0.0).azimuth_deg() - 90.0).abs() < 1e-9);
    }

    #[test]
    fn a_camera_above_the_vehicle_has_a_positive_elevation() {
        let vehicle = car([0.0, 10.0, 10.0], 0.0);
        assert!((vehicle.elevation_deg() - 45.0).abs() < 1e-9);
        assert!((vehicle.distance_m() - 200.0_f64.sqrt()).abs() < 1e-9);
    }

    #[test]
    fn the_sphere_goes_through_the_corners() {
        let vehicle = car([3.0, 1.0, 12.0], 0.7);
        let radius_m = vehicle.sphere_target().radius_sphere_m;
        for corner in vehicle.corners() {
            let apart = (0..3)
                .map(|i| (corner[i] - vehicle.center_camera[i]).powi(2))
                .sum::<f64>();
            assert!((apart.sqrt() - radius_m).abs() < 1e-12);
        }
    }
}
