//! What is where in an image: depth and instance maps.

use glam::Vec3A;

use super::pose::{Eye, RigPose};
use super::screen::Screens;
use super::silhouette::Silhouette;
use super::trace::Stage;
use crate::geometry::StereoRig;

/// Depth along the optical axis of the surface that each pixel's centre shows, metres, row by row;
/// infinite for the sky.
pub fn depth(stage: &Stage, rig: &StereoRig, pose: &RigPose, eye: Eye) -> Vec<f64> {
    let camera = eye.camera(rig);
    let origin = pose.eye_world(rig, eye);
    let forward = Vec3A::from_array(pose.forward_world.map(|v| v as f32));
    (0..camera.height)
        .flat_map(|y| (0..camera.width).map(move |x| [x, y]))
        .map(|pixel| {
            let direction = pose.world_from_pixel(camera, pixel.map(|v| f64::from(v) + 0.5));
            stage
                .nearest(origin, direction)
                .map_or(f64::INFINITY, |hit| {
                    f64::from(hit.t * direction.dot(forward))
                })
        })
        .collect()
}

/// Every vehicle of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct Instances {
    /// The silhouettes, by the vehicles' order in the scene.
    pub silhouettes: Vec<Silhouette>,
    /// The vehicle in each pixel, row by row: its index plus 1, and 0 where none is seen. A pixel
    /// of which samples show several vehicles belongs to the one that most of them show, and a
    /// pixel of which any sample shows a vehicle belongs to a vehicle.
    pub map: Vec<u8>,
}

impl Instances {
    /// Measures every vehicle's silhouette.
    pub fn measure(stage: &Stage, rig: &StereoRig, pose: &RigPose, eye: Eye) -> Self {
        let camera = eye.camera(rig);
        let pixels = camera.width as usize * camera.height as usize;
        let mut map = vec![0_u8; pixels];
        // How much of its pixel the vehicle in the map covers, sixteenths.
        let mut most = vec![0_u8; pixels];
        let mut counts = vec![0_u8; pixels];
        let screens = Screens::new(stage, rig, pose, eye);
        let silhouettes = (0..stage.scene().vehicles.len())
            .map(|vehicle| {
                let mut touched = Vec::new();
                let silhouette = Silhouette::measure_samples(
                    &screens,
                    stage,
                    vehicle,
                    rig,
                    pose,
                    eye,
                    &mut |[x, y], sixteenths| {
                        let pixel = y as usize * camera.width as usize + x as usize;
                        if counts[pixel] == 0 {
                            touched.push(pixel);
                        }
                        counts[pixel] += sixteenths;
                    },
                );
                for pixel in touched {
                    if counts[pixel] > most[pixel] {
                        most[pixel] = counts[pixel];
                        // No scene has as many vehicles as 8 bits can count.
                        map[pixel] = (vehicle + 1) as u8;
                    }
                    counts[pixel] = 0;
                }
                silhouette
            })
            .collect();
        Self { silhouettes, map }
    }
}
