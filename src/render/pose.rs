//! Where the rig is and where it looks.

use glam::Vec3A;

use crate::geometry::{Camera, StereoRig};

/// One of the two cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Eye {
    /// The left camera.
    Left,
    /// The right camera.
    Right,
}

impl Eye {
    /// Both, left first.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// The camera of this eye.
    pub const fn camera(self, rig: &StereoRig) -> &Camera {
        match self {
            Self::Left => &rig.left,
            Self::Right => &rig.right,
        }
    }

    /// The camera's place along the rig's x axis, metres.
    pub fn offset_m(self, rig: &StereoRig) -> f64 {
        match self {
            Self::Left => -rig.baseline_m / 2.0,
            Self::Right => rig.baseline_m / 2.0,
        }
    }
}

/// The rig in the world: its midpoint and its axes, unit vectors. It never rolls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigPose {
    /// Midpoint between the cameras, metres.
    pub position_world: [f64; 3],
    /// To the right, level.
    pub right_world: [f64; 3],
    /// Down in the image.
    pub down_world: [f64; 3],
    /// Along the optical axes.
    pub forward_world: [f64; 3],
}

impl RigPose {
    /// The pose at a position in which a target appears at the tangents `aim` from the optical axis
    /// (right and down positive).
    ///
    /// None where no level camera can do that: close to straight above the target, only positions
    /// near the middle column of the image can be had without roll.
    pub fn aimed(position_world: [f64; 3], target_world: [f64; 3], aim: [f64; 2]) -> Option<Self> {
        let [x, y, z] = [0, 1, 2].map(|i| target_world[i] - position_world[i]);
        let level = (x * x + y * y).sqrt();
        let length = (level * level + z * z).sqrt();
        let [u, v] = aim;
        // The target's height against the camera fixes the pitch: with the pitch p (down positive),
        // sin p + v cos p = sqrt(1 + u^2 + v^2) * sin(angle below the horizon).
        let below = -z / length;
        let reach = (1.0 + v * v).sqrt();
        let sine = below * (1.0 + u * u + v * v).sqrt() / reach;
        if sine.is_nan() || sine.abs() > 0.9999 {
            return None;
        }
        let pitch = libm::asin(sine) - libm::atan2(v, 1.0);
        let [pitch_sin, pitch_cos] = [libm::sin(pitch), libm::cos(pitch)];
        // Seen from above, the target lies to the right of the axis by this angle.
        let yaw = libm::atan2(y, x) + libm::atan2(u, pitch_cos - v * pitch_sin);
        let [yaw_sin, yaw_cos] = [libm::sin(yaw), libm::cos(yaw)];
        Some(Self {
            position_world,
            right_world: [yaw_sin, -yaw_cos, 0.0],
            down_world: [-pitch_sin * yaw_cos, -pitch_sin * yaw_sin, -pitch_cos],
            forward_world: [pitch_cos * yaw_cos, pitch_cos * yaw_sin, -pitch_sin],
        })
    }

    /// A point of the world in rig axes.
    pub fn rig_from_world(&self, point_world: [f64; 3]) -> [f64; 3] {
        self.rig_direction_from_world([0, 1, 2].map(|i| point_world[i] - self.position_world[i]))
    }

    /// A direction of the world in rig axes.
    pub fn rig_direction_from_world(&self, direction_world: [f64; 3]) -> [f64; 3] {
        [self.right_world, self.down_world, self.forward_world]
            .map(|axis| dot(axis, direction_world))
    }

    /// Where an eye is in the world.
    pub(crate) fn eye_world(&self, rig: &StereoRig, eye: Eye) -> Vec3A {
        let offset = eye.offset_m(rig);
        let place =
            [0, 1, 2].map(|i| (self.position_world[i] + offset * self.right_world[i]) as f32);
        Vec3A::from_array(place)
    }

    /// The direction (unit length, world) that lands on a pixel.
    pub(crate) fn world_from_pixel(&self, camera: &Camera, pixel: [f64; 2]) -> Vec3A {
        let [x, y, _] = camera.camera_from_pixel(pixel);
        let scale = 1.0 / (x * x + y * y + 1.0).sqrt();
        let direction = [0, 1, 2].map(|i| {
            ((self.right_world[i] * x + self.down_world[i] * y + self.forward_world[i]) * scale)
                as f32
        });
        Vec3A::from_array(direction)
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_target_appears_where_it_was_aimed_and_the_axes_are_orthonormal_without_roll() {
        for aim in [[0.0, 0.0], [0.5, -0.3], [-0.4, 0.45]] {
            for position in [[20.0, 5.0, 9.0], [-11.0, 30.0, 14.0], [3.0, -8.0, 2.0]] {
                let target = [1.0, 2.0, 0.7];
                let pose = RigPose::aimed(position, target, aim).unwrap();
                let [x, y, z] = pose.rig_from_world(target);
                assert!((x / z - aim[0]).abs() < 1e-9 && (y / z - aim[1]).abs() < 1e-9);
                assert!(z > 0.0);
                let [r, d, f] = [pose.right_world, pose.down_world, pose.forward_world];
                for (a, b, wanted) in [
                    (r, r, 1.0),
                    (d, d, 1.0),
                    (f, f, 1.0),
                    (r, d, 0.0),
                    (d, f, 0.0),
                    (f, r, 0.0),
                ] {
                    assert!((dot(a, b) - wanted).abs() < 1e-12);
                }
                // Right-handed: x cross y is z.
                let z_axis = [
                    r[1] * d[2] - r[2] * d[1],
                    r[2] * d[0] - r[0] * d[2],
                    r[0] * d[1] - r[1] * d[0],
                ];
                assert!((dot(z_axis, f) - 1.0).abs() < 1e-12);
                assert!(r[2].abs() < 1e-15 && d[2] < 0.0);
            }
        }
    }

    #[test]
    fn straight_above_the_target_only_the_middle_column_can_be_aimed_at() {
        assert!(RigPose::aimed([0.0, 0.5, 10.0], [0.0, 0.0, 0.0], [0.5, 0.0]).is_none());
        assert!(RigPose::aimed([0.0, 0.5, 10.0], [0.0, 0.0, 0.0], [0.0, 0.1]).is_some());
    }
}
