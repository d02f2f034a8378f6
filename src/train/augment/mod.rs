//! Random changes of training images, drawn from a generator that the caller seeds per image.

#![allow(
    clippy::inline_always,
    reason = "code compiled for a vector width must be inlined into the function that enables it"
)]

mod color;
mod tile;

use image::RgbImage;
use rand::RngExt as _;
use rand_pcg::Pcg64;

use self::color::Recolor;
use self::tile::{Columns, Row, Tile};
use crate::detector::assign::Target;
use crate::detector::loss::ImageTargets;
use crate::error::Result;
use crate::geometry::PixelBox;
use crate::geometry::letterbox::{PADDING_GREY, Size};

/// Boxes that shrink below this in either direction are dropped, pixels.
const LEAST_SIDE_PX: f64 = 2.0;
/// Boxes of which less than this part stays in view are dropped.
const LEAST_AREA: f64 = 0.1;
/// Boxes that are longer than so many times their other side are dropped.
const LARGEST_ASPECT: f64 = 100.0;

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

/// An image with its boxes, pixels of that image.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// The picture.
    pub image: &'a RgbImage,
    /// What is to be found: class and box.
    pub boxes: &'a [(u32, PixelBox)],
    /// What may be found or not.
    pub ignored: &'a [PixelBox],
}

/// The random change of an image: canvas to input is zoom about the centre, shift, mirror.
struct Change {
    sides: [f64; 2],
    zoom: f64,
    shift: [f64; 2],
    flipped: bool,
    gains: [f64; 3],
}

impl Change {
    fn draw(augment: &DetectionAugment, input: Size, random: &mut Pcg64) -> Self {
        let sides = [f64::from(input.width), f64::from(input.height)];
        Self {
            zoom: 1.0 + augment.zoom * signed(random),
            shift: sides.map(|side| augment.shift * signed(random) * side),
            flipped: random.random_bool(augment.flip),
            gains: augment.hsv.map(|strength| strength * signed(random)),
            sides,
        }
    }

    fn canvas_from_input(&self, value: f64, axis: usize) -> f64 {
        let side = self.sides[axis];
        let value = if axis == 0 && self.flipped {
            side - value
        } else {
            value
        };
        (value - self.shift[axis] - side / 2.0) / self.zoom + side / 2.0
    }

    fn input_from_canvas(&self, area: &PixelBox) -> PixelBox {
        let [width, height] = self.sides;
        let at = |value: f64, side: f64, shift: f64| {
            (value - side / 2.0) * self.zoom + side / 2.0 + shift
        };
        let mut moved = PixelBox::new(
            at(area.x_min, width, self.shift[0]),
            at(area.y_min, height, self.shift[1]),
            at(area.x_max, width, self.shift[0]),
            at(area.y_max, height, self.shift[1]),
        );
        if self.flipped {
            (moved.x_min, moved.x_max) = (width - moved.x_max, width - moved.x_min);
        }
        moved
    }
}

/// Letterboxes an image with a random zoom, shift, flip and colour into the planes of the
/// detector's input, `[3, height, width]` in 0..1, and returns there what is to be found and what
/// to be ignored.
///
/// # Errors
/// An image of impossible size.
pub fn augmented_letterbox(
    scene: Scene,
    input: Size,
    augment: &DetectionAugment,
    random: &mut Pcg64,
    planes: &mut [f32],
) -> Result<ImageTargets> {
    let tile = Tile::letterboxed(scene, input)?;
    let change = Change::draw(augment, input, random);
    Ok(draw(&[tile], input, &change, planes))
}

/// Like [`augmented_letterbox`] for a mosaic of four scenes that meet at a random point.
pub fn augmented_mosaic(
    scenes: [Scene; 4],
    input: Size,
    augment: &DetectionAugment,
    random: &mut Pcg64,
    planes: &mut [f32],
) -> ImageTargets {
    // The middle half of the canvas, in whole pixels: all of the input.
    let center = [
        f64::from(random.random_range(0..input.width)),
        f64::from(random.random_range(0..input.height)),
    ];
    let parts = [[false, false], [true, false], [false, true], [true, true]];
    let tiles: Vec<Tile> = scenes
        .into_iter()
        .zip(parts)
        .map(|(scene, part)| Tile::of_mosaic(scene, input, center, part))
        .collect();
    let change = Change::draw(augment, input, random);
    draw(&tiles, input, &change, planes)
}

/// Fills the planes from the tiles, and moves their boxes.
fn draw(tiles: &[Tile], input: Size, change: &Change, planes: &mut [f32]) -> ImageTargets {
    let canvas_x: Vec<f64> = (0..input.width)
        .map(|x| change.canvas_from_input(f64::from(x) + 0.5, 0))
        .collect();
    let columns: Vec<Columns> = tiles.iter().map(|tile| tile.columns(&canvas_x)).collect();
    let recolor = Recolor::new(change.gains);
    let (red, rest) = planes.split_at_mut(input.area());
    let (green, blue) = rest.split_at_mut(input.area());
    let width = input.width as usize;
    let rows = red
        .chunks_exact_mut(width)
        .zip(green.chunks_exact_mut(width))
        .zip(blue.chunks_exact_mut(width));
    for (y, ((red, green), blue)) in rows.enumerate() {
        let canvas_y = change.canvas_from_input(y as f64 + 0.5, 1);
        let images: Vec<_> = columns
            .iter()
            .zip(tiles)
            .filter_map(|(columns, tile)| Some((columns, tile.rows(canvas_y)?)))
            .collect();
        let row = Row {
            channels: [red, green, blue],
            images: &images,
            recolor,
            grey: f32::from(PADDING_GREY),
        };
        row.draw();
    }

    let [width, height] = change.sides;
    let mut targets = ImageTargets::default();
    for tile in tiles {
        let moved = |area: &PixelBox| {
            let on_canvas = tile.canvas_from_image(area);
            (on_canvas.width() > 0.0 && on_canvas.height() > 0.0)
                .then(|| change.input_from_canvas(&on_canvas))
        };
        for (class, area) in tile.scene.boxes {
            let Some(moved) = moved(area) else { continue };
            let seen = moved.clipped(width, height);
            if is_worth_finding(&seen, &moved) {
                targets.targets.push(target(*class, &seen));
            }
        }
        for area in tile.scene.ignored {
            let Some(moved) = moved(area) else { continue };
            let seen = moved.clipped(width, height);
            targets
                .ignored
                .push([seen.x_min, seen.y_min, seen.x_max, seen.y_max]);
        }
    }
    targets
}

/// Whether enough of a box is in view.
fn is_worth_finding(seen: &PixelBox, whole: &PixelBox) -> bool {
    let (width, height) = (seen.width(), seen.height());
    width > LEAST_SIDE_PX
        && height > LEAST_SIDE_PX
        && seen.area() > LEAST_AREA * whole.area()
        && (width / height).max(height / width) < LARGEST_ASPECT
}

/// A box as a target.
pub fn target(class: u32, b: &PixelBox) -> Target {
    Target {
        class: class as usize,
        box_letterbox: [b.x_min, b.y_min, b.x_max, b.y_max],
    }
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
    use crate::geometry::letterbox::{Enlarging, Frame, Letterbox};

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
        let scene = Scene {
            image: &image,
            boxes: &boxes,
            ignored: &[],
        };
        let targets =
            augmented_letterbox(scene, input, &still(), &mut random(), &mut planes).unwrap();
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
            let scene = Scene {
                image: &image,
                boxes: &boxes,
                ignored: &[boxes[0].1],
            };
            let targets =
                augmented_letterbox(scene, input, &augment, &mut random(), &mut planes).unwrap();
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
    fn a_mosaic_shows_four_scenes_and_their_boxes_where_they_are_drawn() {
        // Each scene is of one colour but for a bright box in its middle.
        let input = Size::new(64, 36);
        let area = PixelBox::new(24.0, 12.0, 40.0, 24.0);
        let images: Vec<RgbImage> = (0..4_u8)
            .map(|tone| {
                RgbImage::from_fn(64, 36, |x, y| {
                    let inside = (24..40).contains(&x) && (12..24).contains(&y);
                    image::Rgb([if inside { 255 } else { 20 * tone }; 3])
                })
            })
            .collect();
        let boxes: Vec<[(u32, PixelBox); 1]> = (0..4).map(|class| [(class, area)]).collect();
        let mut seen = 0;
        for seed in 0..20 {
            let mut planes = vec![0.0; 3 * input.area()];
            let scenes = [0, 1, 2, 3].map(|index| Scene {
                image: &images[index],
                boxes: &boxes[index],
                ignored: &[],
            });
            let mut random = Pcg64::new(seed, 3);
            let targets = augmented_mosaic(scenes, input, &still(), &mut random, &mut planes);
            for target in &targets.targets {
                let [x_min, y_min, x_max, y_max] = target.box_letterbox;
                let middle = |a: f64, b: f64| f64::midpoint(a, b) as usize;
                let at = middle(y_min, y_max) * 64 + middle(x_min, x_max);
                assert!(
                    planes[at] > 0.9,
                    "{target:?} of seed {seed}: {}",
                    planes[at]
                );
                assert!(x_min >= 0.0 && x_max <= 64.0 && y_min >= 0.0 && y_max <= 36.0);
                seen += 1;
            }
        }
        assert!(seen > 20, "{seen}");
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
