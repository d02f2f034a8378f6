//! Blur of the lens and traces of lossy compression.

use std::io::Cursor;

use glam::Vec3A;
use image::RgbImage;
use image::codecs::jpeg::{JpegDecoder, JpegEncoder};

/// Blurs an image by a Gaussian of this standard deviation in pixels; edges repeat.
pub(crate) fn blur(light: &mut [Vec3A], width: usize, height: usize, deviation: f32) {
    // Less than this leaves nine tenths of the light where it was.
    if deviation < 0.2 || width == 0 {
        return;
    }
    let reach = (deviation * 2.6).ceil() as usize;
    let weight = |i: usize| {
        let x = i as f32 / deviation;
        libm::expf(-0.5 * x * x)
    };
    let whole: f32 = weight(0) + 2.0 * (1..=reach).map(weight).sum::<f32>();
    let kernel: Vec<f32> = (0..=reach).map(|i| weight(i) / whole).collect();
    let mut rows = vec![Vec3A::ZERO; light.len()];
    for (from, to) in light.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        for (x, out) in to.iter_mut().enumerate() {
            let mut sum = from[x] * kernel[0];
            for (i, &part) in kernel.iter().enumerate().skip(1) {
                sum += (from[x.saturating_sub(i)] + from[(x + i).min(width - 1)]) * part;
            }
            *out = sum;
        }
    }
    for y in 0..height {
        let row = |y: usize| &rows[y * width..(y + 1) * width];
        let out = &mut light[y * width..(y + 1) * width];
        for (to, from) in out.iter_mut().zip(row(y)) {
            *to = *from * kernel[0];
        }
        for (i, &part) in kernel.iter().enumerate().skip(1) {
            let [above, below] = [row(y.saturating_sub(i)), row((y + i).min(height - 1))];
            for (to, (a, b)) in out.iter_mut().zip(above.iter().zip(below)) {
                *to += (*a + *b) * part;
            }
        }
    }
}

/// The image after JPEG of this quality; unchanged in the case that it cannot be encoded.
pub(crate) fn compress(image: RgbImage, quality: u8) -> RgbImage {
    let mut bytes = Vec::new();
    let packed = JpegEncoder::new_with_quality(&mut bytes, quality).encode_image(&image);
    let unpacked = packed
        .and_then(|()| image::DynamicImage::from_decoder(JpegDecoder::new(Cursor::new(&bytes))?));
    match unpacked {
        Ok(unpacked)
            if unpacked.width() == image.width() && unpacked.height() == image.height() =>
        {
            unpacked.into_rgb8()
        }
        _ => image,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blur_keeps_the_light_and_spreads_it_by_its_deviation() {
        let (width, height) = (41, 31);
        let mut light = vec![Vec3A::ZERO; width * height];
        light[15 * width + 20] = Vec3A::ONE;
        blur(&mut light, width, height, 1.5);
        let (mut sum, mut spread) = (0.0, 0.0);
        for (i, value) in light.iter().enumerate() {
            let dx = (i % width) as f32 - 20.0;
            sum += value.x;
            spread += value.x * dx * dx;
        }
        assert!((sum - 1.0).abs() < 1e-4, "{sum}");
        // The tails beyond 2.6 deviations are missing.
        assert!((spread.sqrt() - 1.5).abs() < 0.1, "{spread}");
    }

    #[test]
    fn a_flat_picture_survives_blur_and_compression() {
        let mut light = vec![Vec3A::splat(0.4); 20 * 10];
        blur(&mut light, 20, 10, 2.0);
        assert!(light.iter().all(|v| (v.x - 0.4).abs() < 1e-5));
        let image = RgbImage::from_pixel(40, 24, image::Rgb([90, 120, 60]));
        let after = compress(image.clone(), 80);
        let apart = image.pixels().zip(after.pixels());
        for (a, b) in apart {
            for i in 0..3 {
                assert!(a.0[i].abs_diff(b.0[i]) <= 4);
            }
        }
    }
}
