//! The input of the size network: a square crop around a box, a mask of the box, and numbers beside
//! it. One way for training and prediction.

use image::RgbImage;

use crate::geometry::{Camera, PixelBox};
use crate::imaging::crop_resized;

/// Side of the crop that the network sees, pixels.
pub const SIDE_PX: u32 = 64;

/// Channels of the crop: red, green, blue, and 1 inside the box.
pub const VIEW_CHANNELS: usize = 4;

/// Numbers beside the crop; see [`SizeView::numbers`].
pub const VIEW_NUMBERS: usize = 7;

/// Side of the crop's area over the longer side of the box.
const CONTEXT: f64 = 1.25;

/// A box edge nearer to the image's border than this is cut off by it, pixels.
const BORDER_PX: f64 = 1.5;

/// Least spread of grey values that is scaled up to one, in parts of white: below is noise.
const LEAST_SPREAD: f32 = 0.02;

/// Numbers of [`SizeView::picture`].
const PICTURE_NUMBERS: usize = 12;

/// Least mean of a magnitude whose logarithm is taken.
const LEAST_MAGNITUDE: f64 = 1e-3;

/// Box sides below this count as this, pixels.
const SMALLEST_SIDE_PX: f64 = 0.1;

/// The area of the image that the network is shown of a box: a square around its centre, larger than
/// the box by what lies around it.
pub fn crop_area(area: &PixelBox) -> PixelBox {
    let side = CONTEXT * area.width().max(area.height());
    PixelBox::from_center(area.center(), side, side)
}

/// What the network is given of one vehicle in one image.
#[derive(Debug, Clone, PartialEq)]
pub struct SizeView {
    /// Logarithm of the box's angular width over its height; direction to its centre, x and y at
    /// depth 1; 1 for an edge that the border of the image cuts off: left, right, top, bottom.
    pub numbers: [f32; VIEW_NUMBERS],
    /// Angular width and height of the box at depth 1. The network does not see them; the guard does.
    pub angles: [f64; 2],
    /// What the guard is told of the picture; see `picture_numbers`.
    pub picture: [f64; PICTURE_NUMBERS],
}

impl SizeView {
    /// The numbers of a box.
    pub fn of_box(area: &PixelBox, camera: &Camera) -> Self {
        let angles = [
            area.width().max(SMALLEST_SIDE_PX) / camera.focal_x_px,
            area.height().max(SMALLEST_SIDE_PX) / camera.focal_y_px,
        ];
        let [x, y, _] = camera.camera_from_pixel(area.center());
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        let cuts = [
            area.x_min,
            width - area.x_max,
            area.y_min,
            height - area.y_max,
        ]
        .map(|to_border| f32::from(u8::from(to_border < BORDER_PX)));
        let aspect = (angles[0] / angles[1]).ln();
        Self {
            numbers: [
                aspect as f32,
                x as f32,
                y as f32,
                cuts[0],
                cuts[1],
                cuts[2],
                cuts[3],
            ],
            angles,
            picture: [0.0; PICTURE_NUMBERS],
        }
    }

    /// The view with the numbers of its crop.
    pub fn with_picture(mut self, crop: &[f32], tone: [f32; 2]) -> Self {
        self.picture = picture_numbers(crop, tone);
        self
    }

    /// The numbers of the box in the mirrored image.
    pub fn mirrored(mut self) -> Self {
        self.numbers[1] = -self.numbers[1];
        self.numbers.swap(3, 4);
        self
    }

    /// Logarithm of the box's metric size, `sqrt(width height)`, at a depth in metres.
    pub fn log_size(&self, z_m: f64) -> f64 {
        (z_m * (self.angles[0] * self.angles[1]).sqrt()).ln()
    }
}

/// Writes the crop of a box, cut out of an image, as `[SIDE_PX, SIDE_PX, VIEW_CHANNELS]`, and gives what
/// [`write_pixels`] does.
///
/// # Panics
/// When `out` has another length.
pub fn write_crop(image: &RgbImage, area: &PixelBox, out: &mut [f32]) -> [f32; 2] {
    let window = crop_area(area);
    let crop = crop_resized(image, &window, SIDE_PX, SIDE_PX);
    write_pixels(&crop, area, &window, out)
}

/// What the guard is told of a crop as the network sees it: its brightness and the logarithm of its
/// contrast before they were taken out; logarithms of the mean steps across, down and around a pixel
/// and of the mean difference of colours; skewness and kurtosis of grey; grey at the top and at the
/// bottom; grey, and logarithm of the contrast, inside of the box less outside.
///
/// Cameras, renderers and places differ in these before vehicles do.
fn picture_numbers(crop: &[f32], [brightness, contrast]: [f32; 2]) -> [f64; PICTURE_NUMBERS] {
    const EDGE_ROWS: usize = 6;
    let side = SIDE_PX as usize;
    let at = |x: usize, y: usize| &crop[(y * side + x) * VIEW_CHANNELS..][..VIEW_CHANNELS];
    let grey = |x: usize, y: usize| {
        let pixel = at(x, y);
        f64::from(pixel[0] + pixel[1] + pixel[2]) / 3.0
    };
    let count = (side * side) as f64;
    let (mut steps, mut colors, mut powers) = ([0.0; 3], 0.0, [0.0; 2]);
    let mut ends = [0.0; 2];
    // Count, sum and sum of squares, outside and inside of the box.
    let mut parts = [[1e-6, 0.0, 0.0]; 2];
    for y in 0..side {
        for x in 0..side {
            let (value, pixel) = (grey(x, y), at(x, y));
            let (right, below) = (
                grey((x + 1).min(side - 1), y),
                grey(x, (y + 1).min(side - 1)),
            );
            let (left, above) = (grey(x.saturating_sub(1), y), grey(x, y.saturating_sub(1)));
            steps[0] += (right - value).abs();
            steps[1] += (below - value).abs();
            steps[2] += (4.0 * value - left - right - above - below).abs();
            colors += f64::from((pixel[0] - pixel[1]).abs() + (pixel[1] - pixel[2]).abs());
            powers[0] += value.powi(3);
            powers[1] += value.powi(4);
            if y < EDGE_ROWS {
                ends[0] += value;
            } else if y >= side - EDGE_ROWS {
                ends[1] += value;
            }
            let part = &mut parts[usize::from(pixel[3] > 0.5)];
            part[0] += 1.0;
            part[1] += value;
            part[2] += value * value;
        }
    }
    let log = |sum: f64| (sum / count).max(LEAST_MAGNITUDE).ln();
    let [(outside, outside_spread), (inside, inside_spread)] =
        parts.map(|[count, sum, squares]| {
            let mean: f64 = sum / count;
            let variance = (squares / count - mean * mean).max(0.0);
            (mean, variance.sqrt().max(LEAST_MAGNITUDE).ln())
        });
    let edge = (side * EDGE_ROWS) as f64;
    [
        f64::from(brightness),
        f64::from(contrast.max(LEAST_SPREAD)).ln(),
        log(steps[0]),
        log(steps[1]),
        log(steps[2]),
        log(colors),
        (powers[0] / count).cbrt(),
        (powers[1] / count).sqrt().sqrt(),
        ends[0] / edge,
        ends[1] / edge,
        inside - outside,
        inside_spread - outside_spread,
    ]
}

/// Writes a crop of this window as the network takes it: colours less their mean over the crop and
/// over their common spread, so that exposure and contrast do not matter, and the mask of the box.
/// Gives that mean, over all colours, and spread.
///
/// # Panics
/// When `out` has another length than crop and mask.
pub fn write_pixels(
    crop: &RgbImage,
    area: &PixelBox,
    window: &PixelBox,
    out: &mut [f32],
) -> [f32; 2] {
    let count = (SIDE_PX * SIDE_PX) as f32;
    assert_eq!(out.len(), VIEW_CHANNELS * count as usize, "a crop's pixels");
    let mut sums = [0.0_f32; 3];
    let mut squares = [0.0_f32; 3];
    for pixel in crop.pixels() {
        for channel in 0..3 {
            let value = f32::from(pixel.0[channel]) / 255.0;
            sums[channel] += value;
            squares[channel] += value * value;
        }
    }
    let means = sums.map(|sum| sum / count);
    let variance = (0..3)
        .map(|channel| (squares[channel] / count - means[channel] * means[channel]).max(0.0))
        .sum::<f32>()
        / 3.0;
    let spread = variance.sqrt();
    let scale = 1.0 / spread.max(LEAST_SPREAD);
    let inside = |start: f64, length: f64, index: u32, low: f64, high: f64| {
        let at = start + (f64::from(index) + 0.5) * length / f64::from(SIDE_PX);
        (low..=high).contains(&at)
    };
    for ((x, y, pixel), values) in crop
        .enumerate_pixels()
        .zip(out.chunks_exact_mut(VIEW_CHANNELS))
    {
        for channel in 0..3 {
            values[channel] = (f32::from(pixel.0[channel]) / 255.0 - means[channel]) * scale;
        }
        let is_inside = inside(window.x_min, window.width(), x, area.x_min, area.x_max)
            && inside(window.y_min, window.height(), y, area.y_min, area.y_max);
        values[3] = f32::from(u8::from(is_inside));
    }
    [means.iter().sum::<f32>() / 3.0, spread]
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;
    use crate::geometry::StereoRig;

    #[test]
    fn the_logarithm_of_the_size_is_that_of_the_box_at_its_depth() {
        let rig = StereoRig::from_hfov(640, 360, 90.0, 0.8).unwrap();
        let area = PixelBox::new(100.0, 100.0, 180.0, 120.0);
        let view = SizeView::of_box(&area, &rig.left);
        // 80 and 20 pixels at 320 pixels of focal length and 16 m: 4 m by 1 m.
        assert!((view.log_size(16.0) - 2.0_f64.ln()).abs() < 1e-12);
        assert!((view.numbers[0] - 4.0_f32.ln()).abs() < 1e-6);
        assert_eq!(view.numbers[3..], [0.0; 4]);
    }

    #[test]
    fn an_edge_at_the_border_is_marked_and_changes_sides_in_the_mirror() {
        let rig = StereoRig::from_hfov(640, 360, 90.0, 0.8).unwrap();
        let area = PixelBox::new(0.0, 100.0, 80.0, 360.0);
        let view = SizeView::of_box(&area, &rig.left);
        assert_eq!(view.numbers[3..], [1.0, 0.0, 0.0, 1.0]);
        let mirrored = view.clone().mirrored();
        let truly = SizeView::of_box(&area.mirrored(640.0), &rig.left);
        assert_eq!(mirrored.numbers, truly.numbers);
        assert_eq!(mirrored.angles, view.angles);
    }

    #[test]
    fn brightness_and_contrast_leave_the_crop_as_it_is_and_the_mask_marks_the_box() {
        let picture = |gain: u32, offset: u32| {
            RgbImage::from_fn(200, 140, |x, y| {
                let value = (x % 16) * 2 + y % 8;
                Rgb([(value * gain + offset) as u8; 3])
            })
        };
        let area = PixelBox::new(60.0, 40.0, 140.0, 80.0);
        let mut crops = [vec![0.0; 64 * 64 * 4], vec![0.0; 64 * 64 * 4]];
        write_crop(&picture(2, 10), &area, &mut crops[0]);
        write_crop(&picture(4, 60), &area, &mut crops[1]);
        for (a, b) in crops[0].iter().zip(&crops[1]) {
            assert!((a - b).abs() < 0.08, "{a} {b}");
        }
        // 80 of 100 pixels across and 40 of 100 down are inside.
        let inside: f32 = crops[0].iter().skip(3).step_by(4).sum();
        assert!((inside / (64.0 * 64.0) - 0.32).abs() < 0.02, "{inside}");
    }
}
