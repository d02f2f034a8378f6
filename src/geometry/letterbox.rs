//! The letterbox: an image of any size shrunk or grown into the detector's input, its shape kept
//! and the rest filled with grey, and the way back for boxes.
//!
//! Follows YOLO11's conventions: sizes round half to even, an odd pixel of padding goes to the
//! right or bottom, pixels are interpolated by the common integer bilinear rule without
//! antialiasing. Knows nothing of tensors; planes are written into plain slices.

mod resize;

use image::RgbImage;
use serde::{Deserialize, Serialize};

use super::PixelBox;
use crate::error::{Error, Result};

pub use resize::resize_bilinear;

/// The detector's coarsest stride: every side of its input is a multiple of it.
pub const STRIDE: u32 = 32;

/// Grey level of the padding in all channels.
pub const PADDING_GREY: u8 = 114;

/// Longest side that is accepted, pixels: beyond it the integer arithmetic has no room.
const LARGEST_SIDE: u32 = 1 << 16;

/// Width and height in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Size {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
}

impl Size {
    /// This width and height.
    pub const fn new(width: u32, height: u32) -> Self {
        Self { width, height }
    }

    /// A square.
    pub const fn square(side: u32) -> Self {
        Self::new(side, side)
    }

    /// Number of pixels.
    pub const fn area(self) -> usize {
        self.width as usize * self.height as usize
    }

    fn of(image: &RgbImage) -> Self {
        Self::new(image.width(), image.height())
    }

    fn check(self, name: &str) -> Result<()> {
        let sides = 1..=LARGEST_SIDE;
        if sides.contains(&self.width) && sides.contains(&self.height) {
            return Ok(());
        }
        Err(Error::value(
            format!("{name} size {self}"),
            "not a usable image size",
            format!("give width and height between 1 and {LARGEST_SIDE} pixels"),
        ))
    }
}

impl std::fmt::Display for Size {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

/// How large the padded image becomes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Frame {
    /// Exactly the target: images of different shapes share a batch.
    #[default]
    Exact,
    /// As small as the stride allows, within the target: less grey to compute on. The sides of
    /// the target should be multiples of the stride.
    MinimumRectangle {
        /// What the padding is counted modulo, pixels; [`STRIDE`] for the detector.
        stride: u32,
    },
}

/// Whether an image smaller than the target grows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Enlarging {
    /// It grows until one side fits: prediction.
    #[default]
    Allowed,
    /// It keeps its size and gets more padding: validation.
    Forbidden,
}

/// Where an image of one size lies inside its letterboxed version.
///
/// ```
/// use twinsight::geometry::letterbox::{Enlarging, Frame, Letterbox, STRIDE, Size};
///
/// let frame = Frame::MinimumRectangle { stride: STRIDE };
/// let letterbox = Letterbox::new(Size::new(2048, 1080), Size::square(640), frame, Enlarging::Allowed)?;
/// assert_eq!(letterbox.resized, Size::new(640, 338));
/// assert_eq!(letterbox.size(), Size::new(640, 352));
/// # Ok::<(), twinsight::error::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Letterbox {
    /// Size of the original image.
    pub original: Size,
    /// Size after resizing, before padding.
    pub resized: Size,
    /// Padding above, pixels.
    pub top: u32,
    /// Padding below, pixels.
    pub bottom: u32,
    /// Padding on the left, pixels.
    pub left: u32,
    /// Padding on the right, pixels.
    pub right: u32,
    /// Factor from original to letterboxed lengths, the same for both axes.
    pub ratio: f64,
}

impl Letterbox {
    /// Fits an image of size `original` into `target` (YOLO11's letterbox).
    ///
    /// # Errors
    /// A size without pixels or beyond 65,536, or a stride of 0.
    pub fn new(original: Size, target: Size, frame: Frame, enlarging: Enlarging) -> Result<Self> {
        original.check("image")?;
        target.check("letterbox")?;
        let [w, h] = [f64::from(original.width), f64::from(original.height)];
        let mut ratio = (f64::from(target.height) / h).min(f64::from(target.width) / w);
        if enlarging == Enlarging::Forbidden {
            ratio = ratio.min(1.0);
        }
        let scaled = |side: f64| ((side * ratio).round_ties_even() as u32).max(1);
        let resized = Size::new(scaled(w), scaled(h));
        let mut padding_x = target.width.saturating_sub(resized.width);
        let mut padding_y = target.height.saturating_sub(resized.height);
        if let Frame::MinimumRectangle { stride } = frame {
            if stride == 0 {
                return Err(Error::value(
                    "letterbox stride 0",
                    "padding cannot be counted modulo 0",
                    format!("use the detector's stride, {STRIDE}"),
                ));
            }
            padding_x %= stride;
            padding_y %= stride;
        }
        // round(padding / 2 - 0.1) and round(padding / 2 + 0.1) in whole numbers.
        Ok(Self {
            original,
            resized,
            top: padding_y / 2,
            bottom: padding_y.div_ceil(2),
            left: padding_x / 2,
            right: padding_x.div_ceil(2),
            ratio,
        })
    }

    /// Size of the letterboxed image.
    pub fn size(&self) -> Size {
        Size::new(
            self.left + self.resized.width + self.right,
            self.top + self.resized.height + self.bottom,
        )
    }

    /// A box of the original image in the letterboxed one: `x * ratio + left`, `y * ratio + top`.
    pub fn letterbox_from_pixel(&self, box_pixel: &PixelBox) -> PixelBox {
        let x = |x: f64| x * self.ratio + f64::from(self.left);
        let y = |y: f64| y * self.ratio + f64::from(self.top);
        let b = box_pixel;
        PixelBox::new(x(b.x_min), y(b.y_min), x(b.x_max), y(b.y_max))
    }

    /// A box of the letterboxed image in the original one, clipped to it.
    ///
    /// Uses the rounded sizes, so that the image's border maps exactly to the image's border; the
    /// way there and back can therefore move an edge by a fraction of a pixel.
    pub fn pixel_from_letterbox(&self, box_letterbox: &PixelBox) -> PixelBox {
        let [w, h] = [
            f64::from(self.original.width),
            f64::from(self.original.height),
        ];
        let gain_x = f64::from(self.resized.width) / w;
        let gain_y = f64::from(self.resized.height) / h;
        let x = |x: f64| (x - f64::from(self.left)) / gain_x;
        let y = |y: f64| (y - f64::from(self.top)) / gain_y;
        let b = box_letterbox;
        PixelBox::new(x(b.x_min), y(b.y_min), x(b.x_max), y(b.y_max)).clipped(w, h)
    }

    /// The letterboxed image.
    ///
    /// # Errors
    /// An image of another size than this letterbox was made for.
    pub fn apply(&self, image: &RgbImage) -> Result<RgbImage> {
        self.check_image(image)?;
        let size = self.size();
        let mut pixels = vec![PADDING_GREY; 3 * size.area()];
        let row_bytes = 3 * size.width as usize;
        let (start, inner) = (3 * self.left as usize, 3 * self.resized.width as usize);
        resize::for_each_row(image.as_raw(), self.original, self.resized, |y, row| {
            let begin = (self.top as usize + y) * row_bytes + start;
            pixels[begin..begin + inner].copy_from_slice(row);
        });
        RgbImage::from_raw(size.width, size.height, pixels).ok_or_else(|| {
            Error::value(
                format!("letterboxed size {size}"),
                "too large for an image",
                "use a smaller detector input",
            )
        })
    }

    /// Writes the letterboxed image as a detector's input: red, green and blue plane after
    /// another (CHW), each value over 255.
    ///
    /// # Errors
    /// An image of another size than this letterbox was made for, or `planes` that does not have
    /// `3 * width * height` elements of [`Letterbox::size`].
    pub fn write_planes(&self, image: &RgbImage, planes: &mut [f32]) -> Result<()> {
        self.check_image(image)?;
        let size = self.size();
        if planes.len() != 3 * size.area() {
            return Err(Error::value(
                format!("{} elements of letterbox planes", planes.len()),
                format!("a letterbox of {size} has {}", 3 * size.area()),
                "give room for three planes of the letterboxed size",
            ));
        }
        // A table: exact, and cheaper than a division for every pixel.
        let unit: [f32; 256] = std::array::from_fn(|level| level as f32 / 255.0);
        planes.fill(unit[usize::from(PADDING_GREY)]);
        let (width, inner) = (size.width as usize, self.resized.width as usize);
        let (red, rest) = planes.split_at_mut(size.area());
        let (green, blue) = rest.split_at_mut(size.area());
        resize::for_each_row(image.as_raw(), self.original, self.resized, |y, row| {
            let begin = (self.top as usize + y) * width + self.left as usize;
            let range = begin..begin + inner;
            let outputs = red[range.clone()]
                .iter_mut()
                .zip(&mut green[range.clone()])
                .zip(&mut blue[range]);
            let (pixels, _) = row.as_chunks::<3>();
            for (((r, g), b), pixel) in outputs.zip(pixels) {
                *r = unit[usize::from(pixel[0])];
                *g = unit[usize::from(pixel[1])];
                *b = unit[usize::from(pixel[2])];
            }
        });
        Ok(())
    }

    fn check_image(&self, image: &RgbImage) -> Result<()> {
        let size = Size::of(image);
        if size == self.original {
            return Ok(());
        }
        Err(Error::value(
            format!("image of {size}"),
            format!("this letterbox was made for {}", self.original),
            "make one for every image size",
        ))
    }
}

/// Input size of a validation batch with a rectangular shape (YOLO11's rectangular batches).
///
/// Each ratio is height over width. When all images are wider than high the batch is as high as
/// the highest needs, when all are higher than wide as wide as the widest needs, otherwise
/// square; both sides are `ceil(relative * long_side / 32 + 0.5) * 32`.
pub fn rectangular_batch_size(images: &[Size], long_side: u32) -> Size {
    let ratios = images
        .iter()
        .map(|s| f64::from(s.height) / f64::from(s.width.max(1)));
    let (least, largest) = ratios.fold((f64::INFINITY, 0.0f64), |(least, largest), ratio| {
        (least.min(ratio), largest.max(ratio))
    });
    let (relative_height, relative_width) = if images.is_empty() {
        (1.0, 1.0)
    } else if largest < 1.0 {
        (largest, 1.0)
    } else if least > 1.0 {
        (1.0, 1.0 / least)
    } else {
        (1.0, 1.0)
    };
    let stride = f64::from(STRIDE);
    let side = |relative: f64| {
        let strides = (relative * f64::from(long_side) / stride + 0.5).ceil();
        strides as u32 * STRIDE
    };
    Size::new(side(relative_width), side(relative_height))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MINIMUM: Frame = Frame::MinimumRectangle { stride: STRIDE };

    fn letterbox(original: Size, target: Size, frame: Frame) -> Letterbox {
        Letterbox::new(original, target, frame, Enlarging::Allowed).unwrap()
    }

    #[test]
    fn an_odd_pixel_of_padding_goes_to_the_right_and_bottom() {
        let wide = letterbox(Size::new(100, 51), Size::new(100, 60), Frame::Exact);
        assert_eq!((wide.top, wide.bottom, wide.left, wide.right), (4, 5, 0, 0));
        let high = letterbox(Size::new(51, 100), Size::new(60, 100), Frame::Exact);
        assert_eq!((high.top, high.bottom, high.left, high.right), (0, 0, 4, 5));
    }

    #[test]
    fn the_minimum_rectangle_pads_to_the_next_stride_only() {
        let frame = letterbox(Size::new(1920, 1080), Size::square(640), MINIMUM);
        assert_eq!(frame.resized, Size::new(640, 360));
        assert_eq!(frame.size(), Size::new(640, 384));
        assert_eq!((frame.top, frame.bottom), (12, 12));
    }

    #[test]
    fn boxes_come_back_to_where_they_were() {
        let frame = letterbox(Size::new(2048, 1024), Size::square(640), Frame::Exact);
        let there = PixelBox::new(17.5, 20.25, 900.0, 1000.0);
        let back = frame.pixel_from_letterbox(&frame.letterbox_from_pixel(&there));
        for (a, b) in [
            (back.x_min, there.x_min),
            (back.y_min, there.y_min),
            (back.x_max, there.x_max),
            (back.y_max, there.y_max),
        ] {
            assert!((a - b).abs() < 1e-9);
        }
    }

    #[test]
    fn boxes_in_the_padding_are_clipped_to_the_image() {
        let frame = letterbox(Size::new(1920, 1080), Size::square(640), Frame::Exact);
        let back = frame.pixel_from_letterbox(&PixelBox::new(-5.0, 0.0, 700.0, 640.0));
        assert_eq!(back, PixelBox::new(0.0, 0.0, 1920.0, 1080.0));
    }

    #[test]
    fn planes_hold_the_letterboxed_image_over_255() {
        let image = RgbImage::from_fn(37, 21, |x, y| {
            image::Rgb([(x * 6) as u8, (y * 11) as u8, (x * y % 251) as u8])
        });
        let frame = letterbox(Size::new(37, 21), Size::square(64), MINIMUM);
        let picture = frame.apply(&image).unwrap();
        let area = frame.size().area();
        let mut planes = vec![f32::NAN; 3 * area];
        frame.write_planes(&image, &mut planes).unwrap();
        for (i, pixel) in picture.pixels().enumerate() {
            for c in 0..3 {
                assert_eq!(planes[c * area + i], f32::from(pixel[c]) / 255.0);
            }
        }
    }

    #[test]
    fn an_image_as_large_as_the_target_is_unchanged() {
        let image = RgbImage::from_fn(64, 32, |x, y| image::Rgb([x as u8, y as u8, 7]));
        let frame = letterbox(Size::new(64, 32), Size::new(64, 32), Frame::Exact);
        assert_eq!(frame.apply(&image).unwrap(), image);
    }

    #[test]
    fn unusable_sizes_are_refused_with_the_value_named() {
        let fit = |original, target, frame| {
            Letterbox::new(original, target, frame, Enlarging::Allowed).map(|_| ())
        };
        let square = Size::square(64);
        let no_stride = Frame::MinimumRectangle { stride: 0 };
        let small = RgbImage::new(3, 4);
        for (result, word) in [
            (fit(Size::new(0, 9), square, Frame::Exact), "0x9"),
            (fit(square, Size::new(64, 99_999), Frame::Exact), "64x99999"),
            (fit(square, square, no_stride), "stride 0"),
            (
                letterbox(square, square, MINIMUM).apply(&small).map(|_| ()),
                "3x4",
            ),
            (
                letterbox(Size::new(3, 4), square, MINIMUM).write_planes(&small, &mut [0.0; 5]),
                "5 elements",
            ),
        ] {
            let message = result.unwrap_err().to_string();
            assert!(message.contains(word), "{message} should contain {word}");
        }
    }

    #[test]
    fn a_batch_of_wide_images_is_wide_and_a_mixed_one_square() {
        let wide = Size::new(1920, 1080);
        let high = Size::new(1080, 1920);
        assert_eq!(rectangular_batch_size(&[wide], 640), Size::new(672, 384));
        assert_eq!(rectangular_batch_size(&[high], 640), Size::new(384, 672));
        assert_eq!(
            rectangular_batch_size(&[wide, high], 640),
            Size::square(672)
        );
        assert_eq!(rectangular_batch_size(&[], 640), Size::square(672));
    }
}
