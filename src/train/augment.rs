//! Random changes of training images, drawn from a generator that the caller seeds per image.

use image::RgbImage;
use rand::RngExt as _;
use rand_pcg::Pcg64;

use crate::detector::assign::Target;
use crate::detector::loss::ImageTargets;
use crate::error::Result;
use crate::geometry::PixelBox;
use crate::geometry::letterbox::{Enlarging, Frame, Letterbox, PADDING_GREY, Size};

/// Boxes that shrink below this in either direction are dropped, pixels.
const LEAST_SIDE_PX: f64 = 2.0;
/// Boxes of which less than this part stays in view are dropped.
const LEAST_AREA: f64 = 0.1;

/// Strengths of the detector's augmentation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectionAugment {
    /// Largest change of hue, saturation and value, as shares.
    pub hsv: [f64; 3],
    /// Largest change of size, as a share.
    pub zoom: f64,
    /// Largest shift, as a share of the input's sides.
    pub shift: f64,
    /// Probability of a horizontal flip.
    pub flip: f64,
}

/// A number in -1..1.
fn signed(random: &mut Pcg64) -> f64 {
    random.random_range(-1.0..1.0)
}

/// Letterboxes an image with a random zoom, shift, flip and colour into the planes of the
/// detector's input, `[3, height, width]` in 0..1, and returns there what is to be found and what
/// to be ignored.
///
/// # Errors
/// An image of impossible size.
pub fn augmented_letterbox(
    image: &RgbImage,
    boxes: &[(u32, PixelBox)],
    ignored: &[PixelBox],
    input: Size,
    augment: &DetectionAugment,
    random: &mut Pcg64,
    planes: &mut [f32],
) -> Result<ImageTargets> {
    let original = Size::new(image.width(), image.height());
    let letterbox = Letterbox::new(original, input, Frame::Exact, Enlarging::Allowed)?;
    let zoom = 1.0 + augment.zoom * signed(random);
    let (width, height) = (f64::from(input.width), f64::from(input.height));
    let shift = [
        augment.shift * signed(random) * width,
        augment.shift * signed(random) * height,
    ];
    let flipped = random.random_bool(augment.flip);
    let gains = augment.hsv.map(|strength| strength * signed(random));

    // Letterbox coordinates after the change: (x - centre) zoom + centre + shift, then mirrored.
    let forward =
        |value: f64, side: f64, shift: f64| (value - side / 2.0) * zoom + side / 2.0 + shift;
    let back = |value: f64, side: f64, shift: f64| (value - shift - side / 2.0) / zoom + side / 2.0;
    let scale_x = f64::from(letterbox.resized.width) / f64::from(original.width);
    let scale_y = f64::from(letterbox.resized.height) / f64::from(original.height);
    let source_x: Vec<f64> = (0..input.width)
        .map(|x| {
            let x = f64::from(x) + 0.5;
            let x = if flipped { width - x } else { x };
            (back(x, width, shift[0]) - f64::from(letterbox.left)) / scale_x
        })
        .collect();
    let area = input.area();
    for y in 0..input.height {
        let source_y =
            (back(f64::from(y) + 0.5, height, shift[1]) - f64::from(letterbox.top)) / scale_y;
        let row = y as usize * input.width as usize;
        for (x, &source_x) in source_x.iter().enumerate() {
            let color = change_color(sample(image, source_x, source_y), gains);
            for (channel, value) in color.into_iter().enumerate() {
                planes[channel * area + row + x] = value;
            }
        }
    }

    let moved = |box_pixel: &PixelBox| {
        let b = letterbox.letterbox_from_pixel(box_pixel);
        let mut moved = PixelBox::new(
            forward(b.x_min, width, shift[0]),
            forward(b.y_min, height, shift[1]),
            forward(b.x_max, width, shift[0]),
            forward(b.y_max, height, shift[1]),
        );
        if flipped {
            (moved.x_min, moved.x_max) = (width - moved.x_max, width - moved.x_min);
        }
        moved
    };
    let targets = boxes.iter().filter_map(|(class, box_pixel)| {
        let moved = moved(box_pixel);
        let seen = moved.clipped(width, height);
        (seen.width() > LEAST_SIDE_PX
            && seen.height() > LEAST_SIDE_PX
            && seen.area() > LEAST_AREA * moved.area())
        .then(|| target(*class, &seen))
    });
    let ignored = ignored.iter().map(|box_pixel| {
        let seen = moved(box_pixel).clipped(width, height);
        [seen.x_min, seen.y_min, seen.x_max, seen.y_max]
    });
    Ok(ImageTargets {
        targets: targets.collect(),
        ignored: ignored.collect(),
    })
}

/// A box as a target.
pub fn target(class: u32, b: &PixelBox) -> Target {
    Target {
        class: class as usize,
        box_letterbox: [b.x_min, b.y_min, b.x_max, b.y_max],
    }
}

/// The colour (0..1) at a point of the image, bilinear; grey outside.
fn sample(image: &RgbImage, x: f64, y: f64) -> [f32; 3] {
    let (width, height) = (image.width() as usize, image.height() as usize);
    if !(x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64) {
        return [f32::from(PADDING_GREY) / 255.0; 3];
    }
    let (x, y) = ((x - 0.5).max(0.0) as f32, (y - 0.5).max(0.0) as f32);
    let (column, row) = (x as usize, y as usize);
    let (fx, fy) = (x - column as f32, y - row as f32);
    let right = (column + 1).min(width - 1);
    let below = (row + 1).min(height - 1);
    let raw = image.as_raw();
    let at = |column: usize, row: usize| &raw[3 * (row * width + column)..][..3];
    let (a, b, c, d) = (
        at(column, row),
        at(right, row),
        at(column, below),
        at(right, below),
    );
    std::array::from_fn(|channel| {
        let value = |pixel: &[u8]| f32::from(pixel[channel]);
        let upper = value(a) + fx * (value(b) - value(a));
        let lower = value(c) + fx * (value(d) - value(c));
        (upper + fy * (lower - upper)) / 255.0
    })
}

/// Turns the hue by a share of the circle and scales saturation and value.
fn change_color([r, g, b]: [f32; 3], gains: [f64; 3]) -> [f32; 3] {
    let [hue, saturation, value] = gains.map(|gain| gain as f32);
    let largest = r.max(g).max(b);
    let chroma = largest - r.min(g).min(b);
    let brightness = (largest * (1.0 + value)).clamp(0.0, 1.0);
    if chroma <= 0.0 || largest <= 0.0 {
        return [brightness; 3];
    }
    let sector = if largest == r {
        ((g - b) / chroma).rem_euclid(6.0)
    } else if largest == g {
        (b - r) / chroma + 2.0
    } else {
        (r - g) / chroma + 4.0
    };
    let sector = (sector + 6.0 * hue).rem_euclid(6.0);
    let strength = (chroma / largest * (1.0 + saturation)).clamp(0.0, 1.0);
    // The usual closed form: each channel is a clipped triangle wave of the hue.
    [5.0, 3.0, 1.0].map(|phase: f32| {
        let k = (phase + sector).rem_euclid(6.0);
        brightness * (1.0 - strength * k.min(4.0 - k).clamp(0.0, 1.0))
    })
}

/// Mirrors a composite in the form that keeps stereo true: both crops mirrored, left and right
/// exchanged. Planes are `[3, height, width]` with one crop above the other.
pub fn mirror_composite(planes: &mut [f32], height: usize, width: usize) {
    for plane in planes.chunks_exact_mut(height * width) {
        plane.chunks_exact_mut(width).for_each(<[f32]>::reverse);
        let (right, left) = plane.split_at_mut(height / 2 * width);
        right.swap_with_slice(&mut left[..height / 2 * width]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn still() -> DetectionAugment {
        DetectionAugment {
            hsv: [0.0; 3],
            zoom: 0.0,
            shift: 0.0,
            flip: 0.0,
        }
    }

    fn random() -> Pcg64 {
        Pcg64::new(1, 2)
    }

    fn picture() -> RgbImage {
        RgbImage::from_fn(64, 36, |x, y| {
            image::Rgb([(x * 4) as u8, (y * 7) as u8, 90])
        })
    }

    #[test]
    fn without_strength_the_picture_is_the_plain_letterbox() {
        let (image, input) = (picture(), Size::new(32, 32));
        let mut planes = vec![0.0; 3 * input.area()];
        let boxes = [(0, PixelBox::new(10.0, 4.0, 30.0, 20.0))];
        let targets = augmented_letterbox(
            &image,
            &boxes,
            &[],
            input,
            &still(),
            &mut random(),
            &mut planes,
        )
        .unwrap();
        let original = Size::new(64, 36);
        let letterbox = Letterbox::new(original, input, Frame::Exact, Enlarging::Allowed).unwrap();
        let mut plain = vec![0.0; 3 * input.area()];
        letterbox.write_planes(&image, &mut plain).unwrap();
        let largest = planes
            .iter()
            .zip(&plain)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        assert!(largest <= 1.01 / 255.0, "{largest}");
        assert_eq!(
            targets.targets,
            vec![target(0, &letterbox.letterbox_from_pixel(&boxes[0].1))]
        );
    }

    #[test]
    fn a_flip_mirrors_picture_and_boxes() {
        let (image, input) = (picture(), Size::new(64, 64));
        let run = |flip: f64| {
            let mut planes = vec![0.0; 3 * input.area()];
            let boxes = [(0, PixelBox::new(10.0, 4.0, 30.0, 20.0))];
            let augment = DetectionAugment { flip, ..still() };
            let targets = augmented_letterbox(
                &image,
                &boxes,
                &[boxes[0].1],
                input,
                &augment,
                &mut random(),
                &mut planes,
            )
            .unwrap();
            assert_eq!(targets.ignored, [targets.targets[0].box_letterbox]);
            (planes, targets.targets[0].box_letterbox)
        };
        let (plain, [x_min, y_min, x_max, y_max]) = run(0.0);
        let (mirrored, edges) = run(1.0);
        assert_eq!(edges, [64.0 - x_max, y_min, 64.0 - x_min, y_max]);
        for (a, b) in plain.chunks_exact(64).zip(mirrored.chunks_exact(64)) {
            assert!(
                a.iter()
                    .zip(b.iter().rev())
                    .all(|(a, b)| (a - b).abs() < 1e-5)
            );
        }
    }

    #[test]
    fn colours_survive_a_change_of_nothing_and_a_full_turn_of_the_hue() {
        for color in [
            [0.1, 0.5, 0.9],
            [0.9, 0.2, 0.2],
            [0.3, 0.3, 0.3],
            [0.0, 0.8, 0.1],
        ] {
            for hue in [0.0, 1.0] {
                let changed = change_color(color, [hue, 0.0, 0.0]);
                for (a, b) in changed.iter().zip(color) {
                    assert!((a - b).abs() < 1e-5, "{changed:?} {color:?}");
                }
            }
        }
    }

    #[test]
    fn mirroring_a_composite_twice_changes_nothing() {
        let planes: Vec<f32> = (0..3 * 4 * 5).map(|value| value as f32).collect();
        let mut mirrored = planes.clone();
        mirror_composite(&mut mirrored, 4, 5);
        assert_eq!(mirrored[..5], [14.0, 13.0, 12.0, 11.0, 10.0]);
        mirror_composite(&mut mirrored, 4, 5);
        assert_eq!(mirrored, planes);
    }
}
