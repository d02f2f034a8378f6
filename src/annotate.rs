//! Draws a stereo pair side by side with the vehicles' boxes and what is known of them.
//!
//! Letters come from a bitmap font in the program, enlarged with the image: no font files.

use font8x8::{BASIC_FONTS, LATIN_FONTS, UnicodeFonts};
use image::{Rgb, RgbImage, imageops};

use crate::geometry::PixelBox;

/// Side of a letter in the bitmap font, pixels.
const LETTER: i64 = 8;

/// One vehicle in a picture of both images.
#[derive(Debug, Clone, PartialEq)]
pub struct Annotation {
    /// Its box in the left image, if it was seen there.
    pub left: Option<PixelBox>,
    /// Its box in the right image, if it was seen there.
    pub right: Option<PixelBox>,
    /// What to write above its boxes, such as `23.4 m 0.91`; may be empty.
    pub text: String,
}

/// Both images side by side, left on the left, with every vehicle's boxes in one colour.
///
/// Boxes and labels are cut off at the border of their image. Lines and letters grow with the
/// image. Images of different heights are aligned at the top on black.
pub fn annotate_pair(left: &RgbImage, right: &RgbImage, annotations: &[Annotation]) -> RgbImage {
    let height = left.height().max(right.height());
    let mut canvas = RgbImage::new(left.width() + right.width(), height);
    let mut offset = 0;
    for (image, side) in [(left, Side::Left), (right, Side::Right)] {
        imageops::replace(&mut canvas, image, i64::from(offset), 0);
        let mut pen = Pen::new(&mut canvas, offset, image.width(), image.height());
        let boxes = |side| {
            annotations
                .iter()
                .enumerate()
                .filter_map(move |(i, annotation)| {
                    let box_pixel = match side {
                        Side::Left => annotation.left,
                        Side::Right => annotation.right,
                    };
                    box_pixel.map(|b| (b, annotation.text.as_str(), color(i)))
                })
        };
        // All boxes first, so that no line crosses a label.
        for (box_pixel, _, color) in boxes(side) {
            pen.outline(&box_pixel, color);
        }
        for (box_pixel, text, color) in boxes(side) {
            pen.label(&box_pixel, text, color);
        }
        offset += image.width();
    }
    canvas
}

/// Writes a line of text, its upper left corner at a pixel; letters are `8 * scale` pixels high.
/// What reaches out of the image is cut off.
pub(crate) fn write_text(
    canvas: &mut RgbImage,
    [x, y]: [i64; 2],
    text: &str,
    scale: u32,
    ink: Rgb<u8>,
) {
    let (width, height) = canvas.dimensions();
    let scale = i64::from(scale);
    let mut pen = Pen {
        letter_scale: scale,
        ..Pen::new(canvas, 0, width, height)
    };
    for (i, letter) in (0i64..).zip(text.chars()) {
        pen.letter(letter, [x + i * LETTER * scale, y], ink);
    }
}

/// Which of the two images is being drawn on.
#[derive(Clone, Copy)]
enum Side {
    Left,
    Right,
}

/// A rectangle in whole pixels of one image, the ends excluded.
#[derive(Clone, Copy)]
struct Area {
    x: (i64, i64),
    y: (i64, i64),
}

/// Draws into one of the two images.
struct Pen<'a> {
    canvas: &'a mut RgbImage,
    offset: i64,
    width: i64,
    height: i64,
    line: i64,
    letter_scale: i64,
}

impl<'a> Pen<'a> {
    fn new(canvas: &'a mut RgbImage, offset: u32, width: u32, height: u32) -> Self {
        let side = i64::from(width.max(height));
        Self {
            canvas,
            offset: i64::from(offset),
            width: i64::from(width),
            height: i64::from(height),
            // 1 pixel in small images, 3 at 2048 pixels.
            line: ((side + 320) / 640).max(1),
            // Letters of 8 pixels in small images, of 32 at 2048 pixels.
            letter_scale: (side / 512).max(1),
        }
    }

    /// Fills what lies inside the image.
    fn fill(&mut self, area: Area, color: Rgb<u8>) {
        for y in area.y.0.max(0)..area.y.1.min(self.height) {
            for x in area.x.0.max(0)..area.x.1.min(self.width) {
                // Inside the canvas, because the image is.
                self.canvas
                    .put_pixel((self.offset + x) as u32, y as u32, color);
            }
        }
    }

    /// The box in whole pixels; None where nothing of it can be seen.
    fn visible(&self, b: &PixelBox) -> Option<Area> {
        let clipped = b.clipped(self.width as f64, self.height as f64);
        (b.is_valid() && clipped.area() > 0.0).then(|| Area {
            x: (b.x_min.round() as i64, b.x_max.round() as i64),
            y: (b.y_min.round() as i64, b.y_max.round() as i64),
        })
    }

    /// The box's outline, inside its edges.
    fn outline(&mut self, box_pixel: &PixelBox, color: Rgb<u8>) {
        let Some(Area { x, y }) = self.visible(box_pixel) else {
            return;
        };
        let line = self.line;
        // Saturating: a box may lie anywhere.
        let (left, right) = (x.0.saturating_add(line), x.1.saturating_sub(line));
        let (upper, lower) = (y.0.saturating_add(line), y.1.saturating_sub(line));
        for area in [
            Area { x, y: (y.0, upper) },
            Area { x, y: (lower, y.1) },
            Area { x: (x.0, left), y },
            Area { x: (right, x.1), y },
        ] {
            self.fill(area, color);
        }
    }

    /// The text on a filled background above the box, or in its upper part at the image's top.
    fn label(&mut self, box_pixel: &PixelBox, text: &str, color: Rgb<u8>) {
        let Some(Area { x, y }) = self.visible(box_pixel) else {
            return;
        };
        if text.is_empty() {
            return;
        }
        let scale = self.letter_scale;
        let letters = text.chars().map(|_| LETTER).sum::<i64>();
        let width = (letters + 2) * scale;
        let height = (LETTER + 2) * scale;
        let left = x.0.min(self.width - width).max(0);
        let top = if y.0 >= height {
            y.0 - height
        } else {
            y.0.max(0)
        };
        let top = top.min(self.height - height).max(0);
        let background = Area {
            x: (left, left + width),
            y: (top, top + height),
        };
        self.fill(background, color);
        let ink = ink_on(color);
        for (i, letter) in (0i64..).zip(text.chars()) {
            let x = left + scale + i * LETTER * scale;
            self.letter(letter, [x, top + scale], ink);
        }
    }

    /// One letter with its upper left corner at a pixel; unknown ones become question marks.
    fn letter(&mut self, letter: char, [x, y]: [i64; 2], ink: Rgb<u8>) {
        let known = BASIC_FONTS.get(letter).or_else(|| LATIN_FONTS.get(letter));
        let Some(rows) = known.or_else(|| BASIC_FONTS.get('?')) else {
            return;
        };
        let scale = self.letter_scale;
        for (row, bits) in (0i64..).zip(rows) {
            for column in 0..LETTER {
                if bits >> column & 1 == 1 {
                    let (x, y) = (x + column * scale, y + row * scale);
                    let dot = Area {
                        x: (x, x + scale),
                        y: (y, y + scale),
                    };
                    self.fill(dot, ink);
                }
            }
        }
    }
}

/// A colour for the vehicle with this number; neighbours in number differ strongly.
fn color(index: usize) -> Rgb<u8> {
    // Steps of the golden ratio spread any number of hues evenly.
    let hue = (index as f64 * 0.618_033_988_749_895 + 0.33).fract() * 6.0;
    let channel = |shift: f64| {
        let distance = (hue + shift) % 6.0;
        let level = (distance.min(6.0 - distance) - 1.0).clamp(0.0, 1.0);
        (40.0 + 215.0 * level).round() as u8
    };
    Rgb([channel(3.0), channel(1.0), channel(5.0)])
}

/// Black on light colours, white on dark ones.
fn ink_on(Rgb([red, green, blue]): Rgb<u8>) -> Rgb<u8> {
    // Integer luminance weights of ITU-R BT.601, thousandths.
    let luminance = 299 * u32::from(red) + 587 * u32::from(green) + 114 * u32::from(blue);
    Rgb([if luminance > 128_000 { 0 } else { 255 }; 3])
}

#[cfg(test)]
mod tests {
    use super::*;

    const GREY: Rgb<u8> = Rgb([90, 90, 90]);

    fn grey(width: u32, height: u32) -> RgbImage {
        RgbImage::from_pixel(width, height, GREY)
    }

    fn annotation(left: Option<PixelBox>, right: Option<PixelBox>, text: &str) -> Annotation {
        Annotation {
            left,
            right,
            text: text.to_owned(),
        }
    }

    fn drawn_pixels(picture: &RgbImage, columns: std::ops::Range<u32>) -> usize {
        picture
            .enumerate_pixels()
            .filter(|(x, _, pixel)| columns.contains(x) && **pixel != GREY)
            .count()
    }

    #[test]
    fn without_vehicles_the_images_stand_side_by_side_unchanged() {
        let left = RgbImage::from_pixel(20, 10, Rgb([1, 2, 3]));
        let right = RgbImage::from_pixel(30, 8, Rgb([4, 5, 6]));
        let picture = annotate_pair(&left, &right, &[]);
        assert_eq!(picture.dimensions(), (50, 10));
        assert_eq!(picture.get_pixel(19, 9).0, [1, 2, 3]);
        assert_eq!(picture.get_pixel(20, 7).0, [4, 5, 6]);
        assert_eq!(picture.get_pixel(20, 9).0, [0, 0, 0]);
    }

    #[test]
    fn a_vehicle_has_the_same_colour_in_both_images() {
        let boxes = [
            PixelBox::new(10.0, 20.0, 30.0, 40.0),
            PixelBox::new(5.0, 20.0, 25.0, 40.0),
        ];
        let both = annotation(Some(boxes[0]), Some(boxes[1]), "");
        let picture = annotate_pair(&grey(100, 60), &grey(100, 60), &[both]);
        assert_eq!(*picture.get_pixel(10, 20), color(0));
        assert_eq!(*picture.get_pixel(29, 39), color(0));
        assert_eq!(*picture.get_pixel(105, 20), color(0));
        assert_eq!(*picture.get_pixel(20, 30), GREY);
        // An outline of one pixel around 20 x 20 pixels, twice.
        assert_eq!(drawn_pixels(&picture, 0..200), 2 * 76);
    }

    #[test]
    fn boxes_and_labels_never_reach_into_the_other_image() {
        let left = annotation(
            Some(PixelBox::new(90.0, 1.0, 150.0, 40.0)),
            None,
            "123.4 m 0.91",
        );
        let right = annotation(None, Some(PixelBox::new(-50.0, 1.0, 5.0, 40.0)), "1.0 m");
        let [left_only, right_only] =
            [left, right].map(|a| annotate_pair(&grey(100, 60), &grey(100, 60), &[a]));
        assert!(drawn_pixels(&left_only, 0..100) > 0);
        assert_eq!(drawn_pixels(&left_only, 100..200), 0);
        assert_eq!(drawn_pixels(&right_only, 0..100), 0);
        assert!(drawn_pixels(&right_only, 100..200) > 0);
    }

    #[test]
    fn boxes_that_cannot_be_seen_draw_nothing() {
        for invisible in [
            PixelBox::new(200.0, 10.0, 300.0, 20.0),
            PixelBox::new(f64::NAN, 10.0, 30.0, 20.0),
            PixelBox::new(30.0, 10.0, 20.0, 20.0),
        ] {
            let vehicle = annotation(Some(invisible), None, "10 m");
            let picture = annotate_pair(&grey(100, 60), &grey(100, 60), &[vehicle]);
            assert_eq!(drawn_pixels(&picture, 0..200), 0, "{invisible:?}");
        }
    }

    #[test]
    fn endless_boxes_and_images_smaller_than_a_letter_do_no_harm() {
        let endless = PixelBox::new(-1e300, -1e300, 1e300, 1e300);
        let vehicle = annotation(Some(endless), Some(endless), "a very long text ∞");
        let picture = annotate_pair(&grey(3, 2), &grey(1, 1), &[vehicle]);
        assert_eq!(picture.dimensions(), (4, 2));
    }

    #[test]
    fn a_label_shows_its_letters_in_readable_ink() {
        let vehicle = annotation(Some(PixelBox::new(10.0, 30.0, 60.0, 50.0)), None, "1");
        let picture = annotate_pair(&grey(100, 60), &grey(100, 60), &[vehicle]);
        let ink = picture
            .pixels()
            .filter(|pixel| **pixel == ink_on(color(0)))
            .count();
        let dots: u32 = BASIC_FONTS
            .get('1')
            .unwrap()
            .iter()
            .map(|row| row.count_ones())
            .sum();
        assert_eq!(ink as u32, dots);
    }

    #[test]
    fn the_first_colours_differ_from_each_other() {
        for i in 0..12 {
            for j in 0..i {
                let (a, b) = (color(i).0, color(j).0);
                let difference: u32 = a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(b))).sum();
                assert!(difference > 20, "colours {i} and {j}");
            }
        }
    }
}
