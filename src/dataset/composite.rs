//! What stage two sees: the two crops of a vehicle on top of each other, and its box's size.

use std::fmt;
use std::str::FromStr;

use image::RgbImage;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::geometry::PixelBox;
use crate::imaging::{ChannelStatistics, PlaneWindow, crop_into_planes, crop_resized};

/// Size of a composite in pixels: two square crops on top of each other, so twice as high as wide.
///
/// As text it is height x width, the paper's order: `828x414`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct CompositeSize {
    /// Height of both crops together.
    pub height: u32,
    /// Width, and the height of one crop.
    pub width: u32,
}

impl TryFrom<String> for CompositeSize {
    type Error = Error;

    fn try_from(text: String) -> Result<Self> {
        text.parse()
    }
}

impl From<CompositeSize> for String {
    fn from(size: CompositeSize) -> Self {
        size.to_string()
    }
}

impl CompositeSize {
    /// The paper's size.
    pub const FULL: Self = Self {
        height: 828,
        width: 414,
    };

    /// Small enough to train on a CPU; leaves 60 features.
    pub const QUICK: Self = Self {
        height: 340,
        width: 170,
    };

    /// The smallest of which the network's five blocks leave anything.
    pub const SMALLEST: Self = Self {
        height: 324,
        width: 162,
    };

    /// Above this width a size is a slip of the keyboard, not a wish: ten times the paper's.
    const WIDEST: u32 = 4140;

    /// A checked size.
    ///
    /// # Errors
    /// [`Error::Value`] for a size that is not twice as high as wide or that no network can use.
    pub fn new(height: u32, width: u32) -> Result<Self> {
        let size = Self { height, width };
        let refuse = |problem: String| {
            Err(Error::value(
                format!("composite size {size}"),
                problem,
                format!(
                    "choose {}, {} or another height x width",
                    Self::FULL,
                    Self::QUICK
                ),
            ))
        };
        if u64::from(height) != 2 * u64::from(width) {
            return refuse("must be twice as high as wide, two square crops".to_owned());
        }
        if width < Self::SMALLEST.width {
            return refuse(format!(
                "the network's blocks leave nothing below {}",
                Self::SMALLEST
            ));
        }
        if width > Self::WIDEST {
            return refuse(format!("is wider than {} pixels", Self::WIDEST));
        }
        Ok(size)
    }

    /// Values of a composite as three planes.
    pub const fn plane_values(self) -> usize {
        3 * self.height as usize * self.width as usize
    }
}

impl fmt::Display for CompositeSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.height, self.width)
    }
}

impl FromStr for CompositeSize {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let numbers = text.split_once('x').and_then(|(height, width)| {
            Some((height.trim().parse().ok()?, width.trim().parse().ok()?))
        });
        match numbers {
            Some((height, width)) => Self::new(height, width),
            None => Err(Error::value(
                format!("composite size '{text}'"),
                "is not height x width",
                format!("write it like {}", Self::FULL),
            )),
        }
    }
}

/// The geometry vector (`norm_w`, `norm_h`): the mean of the two boxes' widths over the image's width,
/// and of their heights over its height. The boxes are taken as they are, not squared or clipped.
pub fn geometry_vector(
    left_box: &PixelBox,
    right_box: &PixelBox,
    image_width: u32,
    image_height: u32,
) -> [f32; 2] {
    [
        (f64::midpoint(left_box.width(), right_box.width()) / f64::from(image_width)) as f32,
        (f64::midpoint(left_box.height(), right_box.height()) / f64::from(image_height)) as f32,
    ]
}

/// The composite of a vehicle: the crop of the RIGHT image on top, that of the LEFT one below.
///
/// Each box is first grown to a square around its centre; what reaches outside an image is black.
pub fn composite(
    left_image: &RgbImage,
    right_image: &RgbImage,
    left_box: &PixelBox,
    right_box: &PixelBox,
    size: CompositeSize,
) -> RgbImage {
    let side = size.width;
    let mut bytes = crop_resized(right_image, &right_box.squared(), side, side).into_raw();
    bytes.extend_from_slice(&crop_resized(left_image, &left_box.squared(), side, side));
    // Two squares of this side are exactly the image's size, so the empty image is never made.
    RgbImage::from_raw(side, 2 * side, bytes).unwrap_or_default()
}

/// The composite of [`composite()`] as normalised planes `[3, height, width]`, without the image
/// in between: the input of stage two at work. The values are exactly those of the detour.
///
/// # Panics
/// When `planes` is not [`CompositeSize::plane_values`] long.
pub fn composite_into_planes(
    images: [&RgbImage; 2],
    boxes: [&PixelBox; 2],
    size: CompositeSize,
    statistics: &ChannelStatistics,
    planes: &mut [f32],
) {
    let [left_image, right_image] = images;
    let [left_box, right_box] = boxes;
    half_into_planes(
        right_image,
        right_box,
        Half::Upper,
        size,
        statistics,
        planes,
    );
    half_into_planes(left_image, left_box, Half::Lower, size, statistics, planes);
}

/// A half of a composite: one crop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Half {
    Upper,
    Lower,
}

/// One crop of [`composite_into_planes`].
pub(crate) fn half_into_planes(
    image: &RgbImage,
    area: &PixelBox,
    half: Half,
    size: CompositeSize,
    statistics: &ChannelStatistics,
    planes: &mut [f32],
) {
    let window = PlaneWindow {
        width: size.width,
        height: size.width,
        plane_height: size.height,
        first_row: match half {
            Half::Upper => 0,
            Half::Lower => size.width,
        },
    };
    crop_into_planes(image, &area.squared(), statistics, window, planes);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::planes_from_image;
    use image::Rgb;

    #[test]
    fn the_right_crop_is_on_top_and_the_left_one_below() {
        let left = RgbImage::from_pixel(300, 200, Rgb([10, 0, 0]));
        let right = RgbImage::from_pixel(300, 200, Rgb([0, 20, 0]));
        let area = PixelBox::new(50.0, 50.0, 90.0, 90.0);
        let stacked = composite(&left, &right, &area, &area, CompositeSize::QUICK);
        assert_eq!(stacked.dimensions(), (170, 340));
        for (_, y, pixel) in stacked.enumerate_pixels() {
            assert_eq!(
                pixel.0,
                if y < 170 { [0, 20, 0] } else { [10, 0, 0] },
                "row {y}"
            );
        }
    }

    #[test]
    fn a_tight_box_is_squared_around_its_centre_and_black_outside() {
        let white = RgbImage::from_pixel(200, 100, Rgb([255; 3]));
        // 200 x 100 grows to 200 x 200: a quarter above and below the image is black.
        let area = PixelBox::new(0.0, 0.0, 200.0, 100.0);
        let size = CompositeSize::new(400, 200).unwrap();
        let stacked = composite(&white, &white, &area, &area, size);
        for (y, value) in [
            (0, 0),
            (49, 0),
            (50, 255),
            (149, 255),
            (150, 0),
            (199, 0),
            (250, 255),
        ] {
            assert_eq!(stacked.get_pixel(100, y).0, [value; 3], "row {y}");
        }
    }

    #[test]
    fn planes_are_those_of_the_composite_image() {
        let left = RgbImage::from_fn(240, 180, |x, y| Rgb([x as u8, y as u8, (x * y) as u8]));
        let right = RgbImage::from_fn(240, 180, |x, y| Rgb([y as u8, (x + y) as u8, x as u8]));
        let boxes = [
            PixelBox::new(20.5, 30.0, 70.1, 99.9),
            PixelBox::new(-9.0, 31.0, 60.0, 98.0),
        ];
        let statistics = ChannelStatistics {
            mean: [0.4, 0.5, 0.6],
            std: [0.1, 0.2, 0.3],
        };
        let size = CompositeSize::SMALLEST;
        let mut direct = vec![f32::NAN; size.plane_values()];
        composite_into_planes(
            [&left, &right],
            [&boxes[0], &boxes[1]],
            size,
            &statistics,
            &mut direct,
        );
        let mut detour = vec![f32::NAN; size.plane_values()];
        let stacked = composite(&left, &right, &boxes[0], &boxes[1], size);
        planes_from_image(&stacked, &statistics, &mut detour);
        assert_eq!(direct, detour);
    }

    #[test]
    fn the_geometry_vector_is_the_mean_box_over_the_image() {
        let left = PixelBox::new(0.0, 0.0, 100.0, 40.0);
        let right = PixelBox::new(-20.0, 10.0, 100.0, 70.0);
        let [width, height] = geometry_vector(&left, &right, 1100, 500);
        assert!((width - 0.1).abs() < 1e-7 && (height - 0.1).abs() < 1e-7);
    }

    #[test]
    fn unusable_sizes_are_refused_and_the_smallest_is_named() {
        for (text, word) in [
            ("322x161", "below 324x162"),
            ("828x828", "twice as high as wide"),
            ("90000x45000", "wider than"),
            ("828", "is not height x width"),
        ] {
            let message = text.parse::<CompositeSize>().unwrap_err().to_string();
            assert!(message.contains(word), "{message} should contain {word}");
        }
        for size in [
            CompositeSize::FULL,
            CompositeSize::QUICK,
            CompositeSize::SMALLEST,
        ] {
            assert_eq!(size.to_string().parse::<CompositeSize>().unwrap(), size);
        }
    }
}
