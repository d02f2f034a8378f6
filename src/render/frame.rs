//! Draws the image of one camera.

use glam::Vec3A;
use image::RgbImage;

use super::film::Film;
use super::pose::{Eye, RigPose};
use super::shade::{Sample, Shader};
use super::silhouette::vehicle_rectangle;
use super::trace::Stage;
use crate::geometry::{PixelBox, StereoRig};
use crate::world::Sun;
use crate::world::noise::derive_seed;
use crate::world::sun::Light;

/// Neighbours that differ by more than this part of their brightness are worth more samples.
const CONTRAST: f32 = 0.16;
/// Brightest light that one sample may bring into an average, so that a glint is not a blot.
const BRIGHTEST: f32 = 6.0;
const NOISE_STREAM: u64 = 3;

/// How a frame is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RenderSettings {
    /// Samples a pixel where there are edges: a square number; elsewhere one is enough, because
    /// textures are averaged over the pixel.
    pub samples_per_pixel: u32,
    /// Standard deviation of the sensor's noise on white, 8-bit counts.
    pub noise_counts: f32,
    /// Seed of the sensor's noise; the two cameras and any two frames differ.
    pub noise_seed: u64,
}

/// What one camera of the rig sees.
pub fn render(
    stage: &Stage,
    rig: &StereoRig,
    pose: &RigPose,
    eye: Eye,
    sun: Sun,
    settings: &RenderSettings,
) -> RgbImage {
    let light = Light::of(sun, stage.scene().compass_deg);
    let view = View {
        shader: Shader { stage, light },
        rig,
        pose,
        eye,
    };
    let camera = eye.camera(rig);
    let (width, height) = (camera.width, camera.height);
    let side = settings.samples_per_pixel.isqrt().max(1);
    let coarse: Vec<Sample> = (0..height)
        .flat_map(|y| (0..width).map(move |x| (x, y)))
        .map(|(x, y)| view.sample(f64::from(x) + 0.5, f64::from(y) + 0.5, 1.0))
        .collect();
    let film = Film {
        exposure: light.exposure,
        noise_counts: settings.noise_counts,
        noise_seed: derive_seed(settings.noise_seed, NOISE_STREAM, eye as u64) as u32,
    };
    let detail: Vec<PixelBox> = (0..stage.scene().vehicles.len())
        .filter_map(|vehicle| vehicle_rectangle(stage, vehicle, rig, pose, eye))
        .collect();
    RgbImage::from_fn(width, height, |x, y| {
        let here = coarse[(y * width + x) as usize];

        let refine = side > 1
            && (detail.iter().any(|area| in_box(area, x, y))
                || is_edge(&coarse, width, height, x, y));
        let light = if refine {
            view.average(x, y, side)
        } else {
            here.light
        };
        image::Rgb(film.develop(light, x, y))
    })
}

/// One camera's rays.
struct View<'a> {
    shader: Shader<'a>,
    rig: &'a StereoRig,
    pose: &'a RigPose,
    eye: Eye,
}

impl View<'_> {
    /// Traces a point of the image; `share` is the sample's width in pixels.
    fn sample(&self, x: f64, y: f64, share: f32) -> Sample {
        let camera = self.eye.camera(self.rig);
        let direction = self.pose.world_from_pixel(camera, [x, y]);
        let origin = self.pose.eye_world(self.rig, self.eye);
        self.shader
            .sample(origin, direction, share / camera.focal_x_px as f32)
    }

    /// The mean of `side` x `side` samples in a pixel.
    fn average(&self, x: u32, y: u32, side: u32) -> Vec3A {
        let step = 1.0 / f64::from(side);
        let mut sum = Vec3A::ZERO;
        for row in 0..side {
            for column in 0..side {
                let [at_x, at_y] = [(x, column), (y, row)]
                    .map(|(p, i)| f64::from(p) + (f64::from(i) + 0.5) * step);
                sum += self
                    .sample(at_x, at_y, step as f32)
                    .light
                    .min(Vec3A::splat(BRIGHTEST));
            }
        }
        sum / (side * side) as f32
    }
}

fn in_box(area: &PixelBox, x: u32, y: u32) -> bool {
    let (x, y) = (f64::from(x), f64::from(y));
    x + 1.0 > area.x_min && x < area.x_max && y + 1.0 > area.y_min && y < area.y_max
}

/// Whether a neighbour shows another face or a clearly different brightness.
fn is_edge(samples: &[Sample], width: u32, height: u32, x: u32, y: u32) -> bool {
    let at = |x: u32, y: u32| samples[(y * width + x) as usize];
    let here = at(x, y);
    let brightness = |s: Sample| s.light.x + s.light.y + s.light.z;
    let differs = |other: Sample| {
        let (a, b) = (brightness(here), brightness(other));
        here.face != other.face || (a - b).abs() > CONTRAST * (a + b) + 0.01
    };
    (x > 0 && differs(at(x - 1, y)))
        || (x + 1 < width && differs(at(x + 1, y)))
        || (y > 0 && differs(at(x, y - 1)))
        || (y + 1 < height && differs(at(x, y + 1)))
}
