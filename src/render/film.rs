//! From light to 8-bit pixels: exposure, tone curve, sRGB and the sensor's noise.

use std::sync::OnceLock;

use glam::Vec3A;

use crate::world::noise::hash;

const STEPS: u16 = 2048;

/// Encodes linear light.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Film {
    /// Factor from light to the curve's input.
    pub exposure: f32,
    /// Standard deviation of the noise in 8-bit counts where the pixel is white; darker pixels have
    /// less.
    pub noise_counts: f32,
    /// Differs from image to image.
    pub noise_seed: u32,
}

impl Film {
    /// The pixel at (x, y) of the image.
    pub fn develop(&self, light: Vec3A, x: u32, y: u32) -> [u8; 3] {
        let mapped = (light * self.exposure).to_array().map(curve);
        let seed = hash(x.cast_signed(), y.cast_signed(), self.noise_seed);
        let mut channel: u32 = 0;
        mapped.map(|value| {
            channel += 1;
            let encoded = encode(value);
            // Photon noise grows with the square root of the light, read noise is constant.
            let deviation = self.noise_counts * (0.25 + 0.75 * encoded).sqrt();
            let noisy = encoded * 255.0
                + deviation * normal(seed.wrapping_add(channel.wrapping_mul(0x9e37_79b9)));
            (noisy + 0.5).clamp(0.0, 255.0) as u8
        })
    }
}

/// A film-like shoulder for bright light (Narkowicz's rational fit of the ACES curve).
fn curve(x: f32) -> f32 {
    let x = x.max(0.0);
    ((x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14)).min(1.0)
}

/// The sRGB transfer function from a table: powers are slow.
fn encode(linear: f32) -> f32 {
    static TABLE: OnceLock<Vec<f32>> = OnceLock::new();
    let table = TABLE.get_or_init(|| {
        (0..=STEPS + 1)
            .map(|step| {
                // The table runs over the square root, which spreads the dark end out.
                let root = f32::from(step) / f32::from(STEPS);
                let linear = root * root;
                if linear <= 0.003_130_8 {
                    12.92 * linear
                } else {
                    1.055 * libm::powf(linear, 1.0 / 2.4) - 0.055
                }
            })
            .collect()
    });
    let place = linear.sqrt() * f32::from(STEPS);
    let index = place as usize;
    table[index] + (table[index + 1] - table[index]) * place.fract()
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
    fn encoding_follows_the_srgb_curve_and_ends_at_one() {
        assert!((encode(1.0) - 1.0).abs() < 1e-5);
        assert!((encode(0.214_041) - 0.5).abs() < 1e-3);
        assert_eq!(encode(0.0), 0.0);
        assert!(encode(curve(100.0)) <= 1.0001);
    }
}
