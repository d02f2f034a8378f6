//! The sphere box: the paper's square label around a vehicle's bounding sphere.

use super::{Camera, PixelBox};

/// What the sphere box needs to know of a vehicle (paper, section 3.3).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SphereTarget {
    /// Centre of the bounding sphere, metres, camera axes.
    pub center_camera: [f64; 3],
    /// Unit vector of the vehicle's forward direction, camera axes.
    pub forward_camera: [f64; 3],
    /// Radius when seen along its length, metres.
    pub radius_min_m: f64,
    /// Radius of the bounding sphere, metres.
    pub radius_sphere_m: f64,
}

/// The sphere box of a vehicle in one camera (paper, appendix A).
///
/// `d = F . V` of the vehicle's and the camera's forward directions, `factor = 1 - |d|`,
/// `r_eff = r_min + factor (r_sphere - r_min)`; the centre and the centre moved by `r_eff` to the
/// camera's right are projected, and their distance is half the square's side. None when the
/// vehicle is not in front of the camera. The box is not clipped to the image.
pub fn sphere_box(camera: &Camera, target: &SphereTarget) -> Option<PixelBox> {
    // The camera looks along +z, so the dot product with its forward vector is the z component.
    let facing = target.forward_camera[2].abs();
    let radius_m =
        target.radius_min_m + (1.0 - facing) * (target.radius_sphere_m - target.radius_min_m);
    let [x, y, z] = target.center_camera;
    let center = camera.pixel_from_camera([x, y, z])?;
    let side = camera.pixel_from_camera([x + radius_m, y, z])?;
    let radius_px = libm::hypot(side[0] - center[0], side[1] - center[1]);
    Some(PixelBox::from_center(
        center,
        2.0 * radius_px,
        2.0 * radius_px,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn target(forward_camera: [f64; 3]) -> SphereTarget {
        SphereTarget {
            center_camera: [2.0, 1.0, 20.0],
            forward_camera,
            radius_min_m: 1.0,
            radius_sphere_m: 2.5,
        }
    }

    #[test]
    fn a_vehicle_seen_from_the_side_has_the_whole_sphere_and_from_behind_the_least_radius() {
        let camera = Camera::from_hfov(2048, 1152, 90.0);
        let side = sphere_box(&camera, &target([1.0, 0.0, 0.0])).unwrap();
        let rear = sphere_box(&camera, &target([0.0, 0.0, -1.0])).unwrap();
        assert!((side.width() - 2.0 * 1024.0 * 2.5 / 20.0).abs() < 1e-9);
        assert!((rear.width() - 2.0 * 1024.0 * 1.0 / 20.0).abs() < 1e-9);
        assert_eq!(side.center(), rear.center());
        assert!((side.width() - side.height()).abs() < 1e-9);
    }

    #[test]
    fn a_vehicle_behind_the_camera_has_no_box() {
        let camera = Camera::from_hfov(2048, 1152, 90.0);
        let behind = SphereTarget {
            center_camera: [0.0, 0.0, -3.0],
            ..target([1.0, 0.0, 0.0])
        };
        assert!(sphere_box(&camera, &behind).is_none());
    }
}
