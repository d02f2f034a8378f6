//! Draws the image of one camera.

use glam::Vec3A;
use image::RgbImage;
use rayon::prelude::*;

use super::appearance::Conditions;
use super::film::{Film, Noise};
use super::lens;
use super::material::{GROUND_FACE, VEHICLE_FACES};
use super::pose::{Eye, RigPose};
use super::shade::{Lit, Sample, Shader};
use super::trace::Stage;
use crate::geometry::StereoRig;
use crate::world::noise::derive_seed;
use crate::world::sky::{LUMA, Light};

/// Neighbours that differ by more than this part of their brightness are worth more samples.
const CONTRAST: f32 = 0.22;
/// The same across the edge of a face or a shadow.
const EDGE_CONTRAST: f32 = 0.05;
/// Brightest light that one sample may bring into an average, after exposure, so that a glint is
/// not a blot.
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
    /// Sun, weather, camera and sensor, the same for both cameras.
    pub conditions: Conditions,
}

/// What one camera of the rig sees.
pub fn render(
    stage: &Stage,
    rig: &StereoRig,
    pose: &RigPose,
    eye: Eye,
    settings: &RenderSettings,
) -> RgbImage {
    let conditions = &settings.conditions;
    let light = Light::new(conditions.sun, conditions.air, stage.scene().compass_deg);
    let shader = Shader {
        stage,
        light: &light,
        wetness: conditions.wetness,
    };
    let view = View {
        shader,
        rig,
        pose,
        eye,
        brightest: f32::INFINITY,
    };
    let exposure = view.exposure();
    let view = View {
        brightest: BRIGHTEST / exposure,
        ..view
    };
    let camera = eye.camera(rig);
    let (width, height) = (camera.width, camera.height);
    let noise = Noise {
        counts: settings.noise_counts,
        seed: derive_seed(settings.noise_seed, NOISE_STREAM, eye as u64) as u32,
    };
    let film = Film::new(
        conditions,
        exposure,
        balance(&light),
        [width, height],
        noise,
    );
    let mut image = view.image(settings.samples_per_pixel.isqrt().max(1), exposure);
    lens::blur(
        &mut image,
        width as usize,
        height as usize,
        conditions.blur_pixel,
    );
    let image = develop(&film, &image, width, height);
    match conditions.jpeg_quality {
        Some(quality) => lens::compress(image, quality),
        None => image,
    }
}

fn develop(film: &Film, light: &[Vec3A], width: u32, height: u32) -> RgbImage {
    let mut image = RgbImage::new(width, height);
    let rows = image.par_chunks_exact_mut(3 * width as usize);
    let light = light.par_chunks_exact(width as usize);
    (0..height)
        .into_par_iter()
        .zip(rows.zip(light))
        .for_each(|(y, (row, light))| {
            for (x, (pixel, &light)) in (0..).zip(row.chunks_exact_mut(3).zip(light)) {
                pixel.copy_from_slice(&film.develop(light, x, y));
            }
        });
    image
}

/// The camera's white balance: it takes out a good half of the light's colour, as cameras do, so
/// that an evening stays warm.
fn balance(light: &Light) -> Vec3A {
    let white = light.sun * light.direction.z.max(0.15) + light.skylight(Vec3A::Z);
    let scaled = white / white.dot(LUMA);
    Vec3A::from_array(scaled.to_array().map(|v| libm::powf(v, -0.55)))
}

/// A value for each pixel, row by row; rows are shared by the threads.
fn by_rows<T: Send + Clone + Default>(
    width: u32,
    height: u32,
    pixel: impl Fn(u32, u32) -> T + Sync,
) -> Vec<T> {
    let mut values = vec![T::default(); width as usize * height as usize];
    let rows = values.par_chunks_exact_mut(width as usize);
    (0..height).into_par_iter().zip(rows).for_each(|(y, row)| {
        for (x, value) in (0..).zip(row) {
            *value = pixel(x, y);
        }
    });
    values
}

/// One camera's rays.
struct View<'a> {
    shader: Shader<'a>,
    rig: &'a StereoRig,
    pose: &'a RigPose,
    eye: Eye,
    /// Brightest light that one sample may bring into an average.
    brightest: f32,
}

impl View<'_> {
    /// The light of every pixel, row by row.
    fn image(&self, side: u32, exposure: f32) -> Vec<Vec3A> {
        let camera = self.eye.camera(self.rig);
        let (width, height) = (camera.width, camera.height);
        let coarse: Vec<Sample> = by_rows(width, height, |x, y| {
            self.sample(f64::from(x) + 0.5, f64::from(y) + 0.5, 1.0, None)
        });
        let around = Around {
            samples: &coarse,
            width,
            height,
            dark: 0.01 / exposure,
        };
        by_rows(width, height, |x, y| {
            if side > 1 && around.is_edge(x, y) {
                self.average(x, y, side, around.lit(x, y))
            } else {
                around.at(x, y).light
            }
        })
    }

    /// The factor that the camera's automatic exposure chooses: the scene's middle brightness,
    /// seen from between the two cameras so that both use the same, becomes mid grey, unless its
    /// bright parts would then be lost.
    fn exposure(&self) -> f32 {
        const COLUMNS: u32 = 32;
        const ROWS: u32 = 18;
        const GREY: f32 = 0.23;
        /// Light that a tenth of the picture may exceed.
        const BRIGHT: f32 = 1.15;
        let camera = self.eye.camera(self.rig);
        let origin = Vec3A::from_array(self.pose.position_world.map(|v| v as f32));
        let step = [
            f64::from(camera.width) / f64::from(COLUMNS),
            f64::from(camera.height) / f64::from(ROWS),
        ];
        let angle = (step[0] / camera.focal_x_px) as f32;
        let mut seen: Vec<f32> = (0..ROWS)
            .flat_map(|row| (0..COLUMNS).map(move |column| (column, row)))
            .map(|(column, row)| {
                let pixel = [
                    (f64::from(column) + 0.5) * step[0],
                    (f64::from(row) + 0.5) * step[1],
                ];
                let direction = self.pose.world_from_pixel(camera, pixel);
                let light = self
                    .shader
                    .sample(origin, direction, angle * 0.3, None)
                    .light;
                light.dot(LUMA).max(1e-4)
            })
            .collect();
        seen.sort_by(f32::total_cmp);
        let mean = seen.iter().map(|v| v.sqrt()).sum::<f32>() / seen.len() as f32;
        let bright = seen[seen.len() * 9 / 10];
        (GREY / (mean * mean)).min(BRIGHT / bright)
    }

    /// Traces a point of the image; `share` is the sample's width in pixels.
    fn sample(&self, x: f64, y: f64, share: f32, known: Option<Lit>) -> Sample {
        let camera = self.eye.camera(self.rig);
        let direction = self.pose.world_from_pixel(camera, [x, y]);
        let origin = self.pose.eye_world(self.rig, self.eye);
        self.shader
            .sample(origin, direction, share / camera.focal_x_px as f32, known)
    }

    /// The mean of `side` x `side` samples in a pixel.
    fn average(&self, x: u32, y: u32, side: u32, known: Option<Lit>) -> Vec3A {
        let step = 1.0 / f64::from(side);
        let mut sum = Vec3A::ZERO;
        for row in 0..side {
            for column in 0..side {
                let [at_x, at_y] = [(x, column), (y, row)]
                    .map(|(p, i)| f64::from(p) + (f64::from(i) + 0.5) * step);
                sum += self
                    .sample(at_x, at_y, step as f32, known)
                    .light
                    .min(Vec3A::splat(self.brightest));
            }
        }
        sum / (side * side) as f32
    }
}

/// A pixel's neighbourhood in the first, coarse pass.
struct Around<'a> {
    samples: &'a [Sample],
    width: u32,
    height: u32,
    /// Differences of light below this are dark on dark.
    dark: f32,
}

impl Around<'_> {
    fn at(&self, x: u32, y: u32) -> Sample {
        self.samples[(y * self.width + x) as usize]
    }

    /// The pixels beside, above and below; at the image's edge the pixel itself.
    fn neighbors(&self, x: u32, y: u32) -> [Sample; 4] {
        [
            self.at(x.saturating_sub(1), y),
            self.at((x + 1).min(self.width - 1), y),
            self.at(x, y.saturating_sub(1)),
            self.at(x, (y + 1).min(self.height - 1)),
        ]
    }

    /// Whether a neighbour has a clearly different brightness; across the edge of a face and on
    /// vehicles, little is enough.
    fn is_edge(&self, x: u32, y: u32) -> bool {
        let here = self.at(x, y);
        let brightness = |s: Sample| s.light.x + s.light.y + s.light.z;
        self.neighbors(x, y).into_iter().any(|other| {
            let (a, b) = (brightness(here), brightness(other));
            let vehicle = (here.face | other.face) & VEHICLE_FACES != 0;
            let least = if here.face == other.face && here.lit == other.lit && !vehicle {
                if here.face == GROUND_FACE {
                    // Its textures are averaged over the pixel as they are.
                    return false;
                }
                CONTRAST
            } else {
                EDGE_CONTRAST
            };
            (a - b).abs() > least * (a + b) + self.dark
        })
    }

    /// How the pixel and its neighbours are lit, where they agree.
    fn lit(&self, x: u32, y: u32) -> Option<Lit> {
        let here = self.at(x, y);
        // A vehicle is small and has shadows of its own.
        let alike = here.face & VEHICLE_FACES == 0
            && self.neighbors(x, y).into_iter().all(|other| {
                other.face & VEHICLE_FACES == 0 && (other.lit == here.lit || other.lit == Lit::Dark)
            });
        (alike && here.lit != Lit::Dark).then_some(here.lit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::Appearance;
    use crate::world::{Scene, Sun};

    const SIZE: [u32; 2] = [128, 72];

    fn view(number: u32) -> (Stage, StereoRig, RigPose) {
        let stage = Stage::new(Scene::draw_with_traffic(21, number, 60.0, 4, 25.0));
        let rig = StereoRig::from_hfov(SIZE[0], SIZE[1], 90.0, 0.8).unwrap();
        let [x, y, z] = stage.scene().target().center_world;
        let pose = RigPose::aimed([x + 9.0, y - 7.0, z + 9.0], [x, y, z], [0.1, 0.1]).unwrap();
        (stage, rig, pose)
    }

    fn settings(conditions: Conditions) -> RenderSettings {
        RenderSettings {
            samples_per_pixel: 4,
            noise_counts: 1.0,
            noise_seed: 3,
            conditions,
        }
    }

    #[test]
    fn under_every_sun_and_sky_few_pixels_are_lost_in_white_or_black() {
        let murky = Appearance {
            overcast: 1.0,
            wet: 0.5,
            ..Appearance::default()
        };
        for number in 0..2 {
            let (stage, rig, pose) = view(number);
            let mut skies: Vec<Conditions> = Sun::ALL.map(Conditions::fair).to_vec();
            skies.extend((0..3).map(|seed| Conditions::draw(&murky, Sun::Random, seed)));
            for conditions in skies {
                let image = render(&stage, &rig, &pose, Eye::Left, &settings(conditions));
                let share = |test: fn(&image::Rgb<u8>) -> bool| {
                    image.pixels().filter(|p| test(p)).count() as f64 / f64::from(SIZE[0] * SIZE[1])
                };
                assert!(share(|p| p.0.contains(&255)) < 0.06, "{conditions:?}");
                assert!(
                    share(|p| p.0.iter().all(|&v| v < 5)) < 0.03,
                    "{conditions:?}"
                );
                let mean = image.pixels().map(|p| f64::from(p.0[1])).sum::<f64>()
                    / f64::from(SIZE[0] * SIZE[1]);
                assert!((70.0..190.0).contains(&mean), "{mean} {conditions:?}");
            }
        }
    }

    #[test]
    fn both_eyes_see_a_place_on_the_ground_in_the_same_light() {
        let (stage, rig, pose) = view(1);
        let conditions = Conditions::fair(Sun::Morning);
        let light = Light::new(conditions.sun, conditions.air, stage.scene().compass_deg);
        let shader = Shader {
            stage: &stage,
            light: &light,
            wetness: 0.0,
        };
        let [left, right] = Eye::BOTH.map(|eye| pose.eye_world(&rig, eye));
        let (mut seen, mut alike) = (0, 0);
        for row in 0..36 {
            for column in 0..64 {
                let pixel = [f64::from(column) * 2.0 + 1.0, f64::from(row) * 2.0 + 1.0];
                let direction = pose.world_from_pixel(&rig.left, pixel);
                let first = shader.sample(left, direction, 0.004, None);
                if first.face != GROUND_FACE {
                    continue;
                }
                let place = left + direction * (-left.z / direction.z);
                let second = shader.sample(right, (place - right).normalize(), 0.004, None);
                if second.face != GROUND_FACE {
                    continue;
                }
                seen += 1;
                let [a, b] = [first, second].map(|sample| sample.light.dot(LUMA));
                alike += u32::from((a - b).abs() < 0.08 * (a + b));
            }
        }
        assert!(seen > 300, "{seen}");
        // The rest is where a blade of grass or the edge of a shadow falls between.
        assert!(
            f64::from(alike) > 0.96 * f64::from(seen),
            "{alike} of {seen}"
        );
    }

    #[test]
    fn the_same_settings_give_the_same_bytes_and_weather_gives_others() {
        let (stage, rig, pose) = view(0);
        let wet = Conditions {
            wetness: 0.8,
            blur_pixel: 0.5,
            jpeg_quality: Some(80),
            ..Conditions::fair(Sun::Sunset)
        };
        let image = || render(&stage, &rig, &pose, Eye::Right, &settings(wet));
        assert_eq!(image(), image());
        let dry = Conditions {
            wetness: 0.0,
            ..wet
        };
        assert_ne!(
            image(),
            render(&stage, &rig, &pose, Eye::Right, &settings(dry))
        );
    }
}
