//! From light to 8-bit pixels: exposure, white balance, tone curve, sRGB and the sensor's noise.

use glam::Vec3A;

use super::appearance::Conditions;
use crate::world::noise::hash;
use crate::world::sky::LUMA;

/// Entries of the tone curve's table.
const STEPS: u16 = 4096;
/// Brightest light that the table knows; white is 1 before the curve's shoulder.
const BRIGHTEST: f32 = 16.0;

/// Encodes linear light.
#[derive(Debug, Clone)]
pub(crate) struct Film {
    /// Factor from light to the curve's input.
    gain: Vec3A,
    saturation: f32,
    vignetting: f32,
    /// Tone curve and sRGB over the square root of light, which spreads the dark end out.
    table: Vec<f32>,
    noise_counts: f32,
    noise_seed: u32,
    /// Middle of the image and one over the square of its half diagonal.
    middle: [f32; 2],
    inverse_reach: f32,
}

/// The sensor's noise.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Noise {
    /// Standard deviation in 8-bit counts where the pixel is white; darker pixels have less.
    pub counts: f32,
    /// Differs from image to image.
    pub seed: u32,
}

impl Film {
    /// The film for an image size; `exposure` and `balance` are what the camera's automatics chose.
    pub fn new(
        conditions: &Conditions,
        exposure: f32,
        balance: Vec3A,
        size: [u32; 2],
        noise: Noise,
    ) -> Self {
        let warm = conditions.white_balance;
        let tint = Vec3A::new(1.0 + warm, 1.0, 1.0 - warm);
        let gain = balance * tint * (exposure * libm::exp2f(conditions.exposure_ev));
        let table = (0..=STEPS)
            .map(|step| {
                let root = f32::from(step) / f32::from(STEPS);
                srgb(curve(root * root * BRIGHTEST, conditions.contrast))
            })
            .collect();
        let middle = size.map(|v| v as f32 * 0.5);
        Self {
            gain,
            saturation: conditions.saturation,
            vignetting: conditions.vignetting,
            table,
            noise_counts: noise.counts,
            noise_seed: noise.seed,
            middle,
            inverse_reach: 1.0 / (middle[0] * middle[0] + middle[1] * middle[1]),
        }
    }

    /// The pixel at (x, y) of the image.
    pub fn develop(&self, light: Vec3A, x: u32, y: u32) -> [u8; 3] {
        let [dx, dy] = [
            x as f32 + 0.5 - self.middle[0],
            y as f32 + 0.5 - self.middle[1],
        ];
        let fall = 1.0 - self.vignetting * (dx * dx + dy * dy) * self.inverse_reach;
        let exposed = light * self.gain * fall;
        let grey = exposed.dot(LUMA);
        let colored =
            (Vec3A::splat(grey) + (exposed - grey) * (1.08 * self.saturation)).max(Vec3A::ZERO);
        let seed = hash(x.cast_signed(), y.cast_signed(), self.noise_seed);
        let mut channel: u32 = 0;
        colored.to_array().map(|value| {
            channel += 1;
            let encoded = self.encode(value);
            // Photon noise grows with the square root of the light, read noise is constant.
            let noisy = if self.noise_counts > 0.0 {
                let deviation = self.noise_counts * (0.25 + 0.75 * encoded).sqrt();
                encoded * 255.0
                    + deviation * normal(seed.wrapping_add(channel.wrapping_mul(0x9e37_79b9)))
            } else {
                encoded * 255.0
            };
            (noisy + 0.5).clamp(0.0, 255.0) as u8
        })
    }

    fn encode(&self, light: f32) -> f32 {
        let place = (light * (1.0 / BRIGHTEST)).min(1.0).sqrt() * f32::from(STEPS);
        let index = (place as usize).min(usize::from(STEPS) - 1);
        let [low, high] = [self.table[index], self.table[index + 1]];
        low + (high - low) * (place - index as f32)
    }
}

/// A film-like curve: a soft toe, a straight middle and a long shoulder that reaches white at 16
/// times the light of a white wall's grey. Mid grey (0.18) stays where it is for contrast 1.
fn curve(light: f32, contrast: f32) -> f32 {
    const GREY: f32 = 0.18;
    const WHITE: f32 = 9.0;
    let x = GREY * libm::powf(light / GREY, contrast * 1.2);
    // Reinhard's curve with a white point, scaled so that grey maps to grey, after a toe that
    // deepens the last two stops.
    let toe = x / (x + 0.012);
    let x = x * 1.22 * toe;
    (x * (1.0 + x / (WHITE * WHITE)) / (1.0 + 0.82 * x)).min(1.0)
}

/// The sRGB transfer function.
fn srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * libm::powf(linear, 1.0 / 2.4) - 0.055
    }
}

/// Nearly normal noise of mean 0 and deviation 1: the sum of four uniform bytes.
fn normal(seed: u32) -> f32 {
    let bytes = hash(seed.cast_signed(), 0, 0x6e6f).to_le_bytes();
    let sum: u16 = bytes.iter().map(|&b| u16::from(b)).sum();
    // A uniform byte has mean 127.5 and variance (256^2 - 1) / 12.
    (f32::from(sum) - 510.0) / 147.8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::Sun;

    fn film(counts: f32) -> Film {
        Film::new(
            &Conditions::fair(Sun::Noon),
            1.0,
            Vec3A::ONE,
            [64, 36],
            Noise { counts, seed: 1 },
        )
    }

    #[test]
    fn noise_has_mean_zero_and_the_stated_deviation() {
        let draws: Vec<f32> = (0..20_000).map(normal).collect();
        let mean = draws.iter().sum::<f32>() / 20_000.0;
        let deviation =
            (draws.iter().map(|d| (d - mean) * (d - mean)).sum::<f32>() / 20_000.0).sqrt();
        // Four standard errors of 20,000 draws.
        assert!(
            mean.abs() < 0.03 && (deviation - 1.0).abs() < 0.03,
            "{mean} {deviation}"
        );
    }

    #[test]
    fn the_curve_rises_from_black_over_grey_to_white() {
        for contrast in [0.7, 1.0, 1.3] {
            let values: Vec<f32> = (0..2000)
                .map(|i| curve(i as f32 * 0.01, contrast))
                .collect();
            assert_eq!(values[0], 0.0);
            assert!(values.windows(2).all(|pair| pair[0] <= pair[1]));
            assert!((0.14..0.24).contains(&curve(0.18, contrast)));
        }
        assert!(curve(BRIGHTEST, 1.0) > 0.99);
    }

    #[test]
    fn the_table_agrees_with_the_curve() {
        let film = film(0.0);
        for light in [0.0_f32, 0.001, 0.02, 0.18, 0.9, 3.0, 15.0, 200.0] {
            let exact = srgb(curve(light.min(BRIGHTEST), 1.0));
            assert!((film.encode(light) - exact).abs() < 2e-3, "{light}");
        }
    }

    #[test]
    fn grey_stays_grey_and_corners_are_darker_with_vignetting() {
        let [red, green, blue] = film(0.0).develop(Vec3A::splat(0.2), 5, 5);
        assert!(red == green && green == blue);
        let conditions = Conditions {
            vignetting: 0.5,
            ..Conditions::fair(Sun::Noon)
        };
        let noise = Noise {
            counts: 0.0,
            seed: 1,
        };
        let film = Film::new(&conditions, 1.0, Vec3A::ONE, [64, 36], noise);
        let [corner, middle] =
            [(0, 0), (32, 18)].map(|(x, y)| film.develop(Vec3A::splat(0.2), x, y));
        assert!(f32::from(corner[0]) < 0.8 * f32::from(middle[0]));
    }
}
