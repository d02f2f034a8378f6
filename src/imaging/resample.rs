//! Crops resampled from images, and images as normalised planes.
//!
//! Bilinear with half-pixel centres, no antialiasing, black outside the image. The same arithmetic
//! makes training composites and network inputs, so that a network sees at work what it was
//! trained on.

use image::RgbImage;
use serde::{Deserialize, Serialize};

use crate::geometry::PixelBox;

/// Mean and standard deviation of each colour channel, for values in 0 to 1 (paper, equations 1
/// and 2).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelStatistics {
    /// Mean of red, green and blue.
    pub mean: [f64; 3],
    /// Standard deviation of red, green and blue.
    pub std: [f64; 3],
}

impl ChannelStatistics {
    /// Leaves values in 0 to 1 as they are.
    pub const IDENTITY: Self = Self {
        mean: [0.0; 3],
        std: [1.0; 3],
    };

    /// The normalised value of each of the 256 levels of each channel.
    ///
    /// A channel without any spread carries nothing and cannot be divided by its deviation: it is
    /// only shifted.
    fn levels(&self) -> [[f32; 256]; 3] {
        std::array::from_fn(|channel| {
            let (mean, std) = (self.mean[channel], self.std[channel]);
            let scale = if std > 0.0 { 1.0 / std } else { 1.0 };
            std::array::from_fn(|level| ((level as f64 / 255.0 - mean) * scale) as f32)
        })
    }
}

/// Normalises an 8-bit RGB image into three planes, red, green, blue, each row by row: the memory
/// order of a `[channels, height, width]` tensor.
///
/// # Panics
/// When `planes` is not three times the number of pixels long.
pub fn planes_from_image(image: &RgbImage, statistics: &ChannelStatistics, planes: &mut [f32]) {
    let pixels = image.width() as usize * image.height() as usize;
    assert_eq!(planes.len(), 3 * pixels, "three planes of {pixels} pixels");
    let levels = statistics.levels();
    for (channel, plane) in planes.chunks_exact_mut(pixels.max(1)).enumerate() {
        for (value, rgb) in plane.iter_mut().zip(image.as_raw().chunks_exact(3)) {
            *value = levels[channel][usize::from(rgb[channel])];
        }
    }
}

/// Cuts a box out of an image and resizes it to `out_width` x `out_height`.
///
/// Bilinear with half-pixel centres and without antialiasing: output pixel `i` samples the image
/// at `x_min + (i + 0.5) * width / out_width - 0.5`, counted in pixel indices. The box may be
/// fractional and may reach outside the image, where everything is black.
pub fn crop_resized(
    image: &RgbImage,
    box_pixel: &PixelBox,
    out_width: u32,
    out_height: u32,
) -> RgbImage {
    let mut out = RgbImage::new(out_width, out_height);
    crop_rows(image, box_pixel, out_width, out_height, |row, rgb| {
        let start = row * rgb.len();
        out.as_mut()[start..start + rgb.len()].copy_from_slice(rgb);
    });
    out
}

/// Where a crop goes in a set of three planes that may hold more than the crop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PlaneWindow {
    /// Width of the crop and of the planes, pixels.
    pub width: u32,
    /// Height of the crop, pixels.
    pub height: u32,
    /// Height of the planes, pixels.
    pub plane_height: u32,
    /// The plane's row where the crop begins.
    pub first_row: u32,
}

/// [`crop_resized`] and [`planes_from_image`] in one go, without the image in between: writes the
/// normalised crop into three planes `[3, plane_height, width]`, from row `first_row` on.
///
/// The values are exactly those of the detour over an 8-bit image.
///
/// # Panics
/// When the crop does not fit into the planes, or `planes` has another length.
pub fn crop_into_planes(
    image: &RgbImage,
    box_pixel: &PixelBox,
    statistics: &ChannelStatistics,
    window: PlaneWindow,
    planes: &mut [f32],
) {
    let PlaneWindow {
        width,
        height,
        plane_height,
        first_row,
    } = window;
    let plane_len = width as usize * plane_height as usize;
    assert_eq!(
        planes.len(),
        3 * plane_len,
        "three planes of {width}x{plane_height} pixels"
    );
    assert!(
        u64::from(first_row) + u64::from(height) <= u64::from(plane_height),
        "{height} rows from row {first_row} on must fit into {plane_height}"
    );
    let levels = statistics.levels();
    crop_rows(image, box_pixel, width, height, |row, rgb| {
        let start = (first_row as usize + row) * width as usize;
        for (channel, levels) in levels.iter().enumerate() {
            let out = &mut planes[channel * plane_len + start..][..width as usize];
            for (value, rgb) in out.iter_mut().zip(rgb.chunks_exact(3)) {
                *value = levels[usize::from(rgb[channel])];
            }
        }
    });
}

/// The two neighbours of a sample along one axis; a neighbour outside the image has weight 0.
#[derive(Debug, Clone, Copy)]
struct Taps {
    indices: [usize; 2],
    weights: [f32; 2],
}

/// The taps of all output positions along one axis.
fn taps(start: f64, length: f64, out: u32, size: u32) -> Vec<Taps> {
    (0..out)
        .map(|i| {
            let source = start + (f64::from(i) + 0.5) * length / f64::from(out) - 0.5;
            let floor = source.floor();
            let fraction = (source - floor) as f32;
            let tap = |offset: f64, weight: f32| {
                let index = floor + offset;
                let inside = index >= 0.0 && index < f64::from(size);
                if inside {
                    (index as usize, weight)
                } else {
                    (0, 0.0)
                }
            };
            let (first, weight_first) = tap(0.0, 1.0 - fraction);
            let (second, weight_second) = tap(1.0, fraction);
            Taps {
                indices: [first, second],
                weights: [weight_first, weight_second],
            }
        })
        .collect()
}

/// Resamples a box row by row and hands each row's RGB bytes to `emit` with the row's number.
///
/// Rows are resampled along x once and kept for the following output rows: when a small box is
/// enlarged, which is the common case, most output rows lie between the same two image rows.
fn crop_rows(
    image: &RgbImage,
    area: &PixelBox,
    width: u32,
    height: u32,
    mut emit: impl FnMut(usize, &[u8]),
) {
    let row_len = 3 * width as usize;
    let columns = taps(area.x_min, area.width(), width, image.width());
    let rows = taps(area.y_min, area.height(), height, image.height());
    let stride = 3 * image.width() as usize;
    let source_row = |y: usize| &image.as_raw()[y * stride..(y + 1) * stride];
    // Two resampled rows and the image rows that they hold.
    let mut kept = [vec![0.0_f32; row_len], vec![0.0_f32; row_len]];
    let mut kept_rows = [usize::MAX; 2];
    let mut bytes = vec![0_u8; row_len];
    for (row, Taps { indices, weights }) in rows.iter().enumerate() {
        for tap in 0..2 {
            if weights[tap] == 0.0 || stride == 0 || kept_rows[tap] == indices[tap] {
                continue;
            }
            if kept_rows[1 - tap] == indices[tap] {
                kept.swap(0, 1);
                kept_rows.swap(0, 1);
                continue;
            }
            resample_row(source_row(indices[tap]), &columns, &mut kept[tap]);
            kept_rows[tap] = indices[tap];
        }
        let [above, below] = &kept;
        for ((byte, above), below) in bytes.iter_mut().zip(above).zip(below) {
            // Values are never negative, so adding a half and cutting off rounds to nearest.
            *byte = (above * weights[0] + below * weights[1] + 0.5) as u8;
        }
        emit(row, &bytes);
    }
}

/// Resamples one row along x.
fn resample_row(source: &[u8], columns: &[Taps], out: &mut [f32]) {
    for (out, Taps { indices, weights }) in out.chunks_exact_mut(3).zip(columns) {
        let first = &source[3 * indices[0]..][..3];
        let second = &source[3 * indices[1]..][..3];
        for channel in 0..3 {
            out[channel] =
                f32::from(first[channel]) * weights[0] + f32::from(second[channel]) * weights[1];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    fn noise(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            let value = x * 37 + y * 101 + x * y;
            Rgb([value as u8, (value / 3) as u8, (value / 7) as u8])
        })
    }

    fn whole(image: &RgbImage) -> PixelBox {
        PixelBox::new(
            0.0,
            0.0,
            f64::from(image.width()),
            f64::from(image.height()),
        )
    }

    #[test]
    fn cropping_the_whole_image_at_its_own_size_changes_nothing() {
        let image = noise(37, 23);
        assert_eq!(crop_resized(&image, &whole(&image), 37, 23), image);
    }

    #[test]
    fn an_integer_crop_at_its_own_size_is_a_copy_with_black_outside() {
        let image = noise(20, 16);
        let crop = crop_resized(&image, &PixelBox::new(-4.0, 10.0, 8.0, 20.0), 12, 10);
        for (x, y, pixel) in crop.enumerate_pixels() {
            let expected = match (x.checked_sub(4), y + 10) {
                (Some(x), y) if y < 16 => *image.get_pixel(x, y),
                _ => Rgb([0; 3]),
            };
            assert_eq!(*pixel, expected, "at {x}, {y}");
        }
    }

    #[test]
    fn boxes_outside_the_image_or_without_sense_are_black() {
        let image = RgbImage::from_pixel(9, 9, Rgb([255; 3]));
        for area in [
            PixelBox::new(100.0, 0.0, 120.0, 9.0),
            PixelBox::new(0.0, -50.0, 9.0, -20.0),
            PixelBox::new(f64::NAN, 0.0, 9.0, 9.0),
            PixelBox::new(1e300, 0.0, f64::INFINITY, 9.0),
        ] {
            assert!(
                crop_resized(&image, &area, 7, 5)
                    .iter()
                    .all(|value| *value == 0),
                "{area:?}"
            );
        }
        assert!(
            crop_resized(&RgbImage::new(0, 4), &whole(&image), 3, 3)
                .iter()
                .all(|value| *value == 0)
        );
    }

    #[test]
    fn half_a_pixel_over_the_border_fades_to_black_by_half() {
        let image = RgbImage::from_pixel(8, 8, Rgb([200; 3]));
        let crop = crop_resized(&image, &PixelBox::new(-0.5, 0.0, 7.5, 8.0), 8, 8);
        assert_eq!(crop.get_pixel(0, 3).0, [100; 3]);
        assert_eq!(crop.get_pixel(1, 3).0, [200; 3]);
    }

    #[test]
    fn a_linear_ramp_stays_linear_under_any_crop_and_scale() {
        let image = RgbImage::from_fn(101, 61, |x, y| {
            Rgb([(2 * x) as u8, (4 * y) as u8, (x + y) as u8])
        });
        let area = PixelBox::new(7.3, 5.1, 90.8, 55.9);
        for (width, height) in [(300, 200), (41, 17), (84, 51)] {
            let crop = crop_resized(&image, &area, width, height);
            for (x, y, Rgb([red, green, blue])) in crop.enumerate_pixels() {
                let x = area.x_min + (f64::from(x) + 0.5) * area.width() / f64::from(width) - 0.5;
                let y = area.y_min + (f64::from(y) + 0.5) * area.height() / f64::from(height) - 0.5;
                for (value, expected) in [(red, 2.0 * x), (green, 4.0 * y), (blue, x + y)] {
                    // Rounding to a level, and a little for single precision.
                    assert!(
                        (f64::from(*value) - expected).abs() <= 0.5001,
                        "{value} for {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn kept_rows_give_what_a_direct_computation_gives() {
        let image = noise(33, 29);
        let at = |x: i64, y: i64, channel: usize| {
            let inside = (0..33).contains(&x) && (0..29).contains(&y);
            if inside {
                f64::from(image.get_pixel(x as u32, y as u32).0[channel])
            } else {
                0.0
            }
        };
        for (area, width, height) in [
            (PixelBox::new(3.2, -6.7, 12.9, 35.5), 50, 90),
            (PixelBox::new(-8.0, -8.0, 45.0, 41.0), 13, 11),
        ] {
            let crop = crop_resized(&image, &area, width, height);
            for (out_x, out_y, pixel) in crop.enumerate_pixels() {
                let x =
                    area.x_min + (f64::from(out_x) + 0.5) * area.width() / f64::from(width) - 0.5;
                let y =
                    area.y_min + (f64::from(out_y) + 0.5) * area.height() / f64::from(height) - 0.5;
                let (u, v) = (x - x.floor(), y - y.floor());
                let (x, y) = (x.floor() as i64, y.floor() as i64);
                for channel in 0..3 {
                    let expected = (1.0 - v)
                        * ((1.0 - u) * at(x, y, channel) + u * at(x + 1, y, channel))
                        + v * ((1.0 - u) * at(x, y + 1, channel) + u * at(x + 1, y + 1, channel));
                    let value = f64::from(pixel.0[channel]);
                    assert!((value - expected).abs() <= 0.5001, "{value} for {expected}");
                }
            }
        }
    }

    #[test]
    fn planes_are_the_normalised_crop_at_their_rows_and_nothing_else_is_touched() {
        let image = noise(40, 30);
        let area = PixelBox::new(-3.0, 4.4, 25.0, 33.0);
        let statistics = ChannelStatistics {
            mean: [0.3641, 0.3769, 0.3985],
            std: [0.1710, 0.1630, 0.1481],
        };
        let (width, height) = (14, 12);
        let mut alone = vec![0.0; 3 * 14 * 12];
        planes_from_image(
            &crop_resized(&image, &area, width, height),
            &statistics,
            &mut alone,
        );
        let mut planes = vec![f32::NAN; 3 * 14 * 24];
        let window = PlaneWindow {
            width,
            height,
            plane_height: 24,
            first_row: 12,
        };
        crop_into_planes(&image, &area, &statistics, window, &mut planes);
        for channel in 0..3 {
            let plane = &planes[channel * 14 * 24..][..14 * 24];
            assert!(plane[..14 * 12].iter().all(|value| value.is_nan()));
            assert_eq!(plane[14 * 12..], alone[channel * 14 * 12..][..14 * 12]);
        }
        // Black normalises to minus the mean over the deviation.
        assert!((f64::from(planes[14 * 12]) - -0.3641 / 0.1710).abs() < 1e-6);
    }

    #[test]
    fn a_channel_without_spread_stays_finite() {
        let image = RgbImage::from_pixel(2, 2, Rgb([51; 3]));
        let mut planes = [f32::NAN; 12];
        planes_from_image(
            &image,
            &ChannelStatistics {
                mean: [0.2; 3],
                std: [0.0; 3],
            },
            &mut planes,
        );
        assert!(planes.iter().all(|value| value.abs() < 1e-6));
    }
}
