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
/// Boxes that are longer than so many times their other side are dropped.
const LARGEST_ASPECT: f64 = 100.0;
/// What lies outside all images.
const GREY: [f32; 3] = [PADDING_GREY as f32 / 255.0; 3];

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

/// A scene laid on a canvas that is then zoomed, shifted and mirrored into the network's input.
struct Tile<'a> {
    scene: Scene<'a>,
    /// Canvas pixels per image pixel.
    scale: [f64; 2],
    /// Where the image's first corner lies on the canvas.
    corner: [f64; 2],
    /// The part of the canvas that it may fill.
    area: PixelBox,
}

impl<'a> Tile<'a> {
    /// The plain letterbox: the canvas is the network's input.
    fn letterboxed(scene: Scene<'a>, input: Size) -> Result<Self> {
        let original = Size::new(scene.image.width(), scene.image.height());
        let letterbox = Letterbox::new(original, input, Frame::Exact, Enlarging::Allowed)?;
        Ok(Self {
            scene,
            scale: [
                f64::from(letterbox.resized.width) / f64::from(original.width),
                f64::from(letterbox.resized.height) / f64::from(original.height),
            ],
            corner: [f64::from(letterbox.left), f64::from(letterbox.top)],
            area: PixelBox::new(
                f64::NEG_INFINITY,
                f64::NEG_INFINITY,
                f64::INFINITY,
                f64::INFINITY,
            ),
        })
    }

    /// One of the four parts of a mosaic: column and row 0 or 1, touching the centre with its
    /// nearest corner. The canvas is twice the input and has its middle where the input's is.
    fn of_mosaic(scene: Scene<'a>, input: Size, center: [f64; 2], part: [bool; 2]) -> Self {
        let sides = [f64::from(input.width), f64::from(input.height)];
        let original = [
            f64::from(scene.image.width()),
            f64::from(scene.image.height()),
        ];
        let scale = (sides[0] / original[0]).min(sides[1] / original[1]);
        let mut corner = center;
        let mut area = [[0.0; 2]; 2];
        for axis in 0..2 {
            let (start, end) = (-sides[axis] / 2.0, 1.5 * sides[axis]);
            area[axis] = if part[axis] {
                [center[axis], end]
            } else {
                corner[axis] -= scale * original[axis];
                [start, center[axis]]
            };
        }
        let [x, y] = area;
        Self {
            scene,
            scale: [scale, scale],
            corner,
            area: PixelBox::new(x[0], y[0], x[1], y[1]),
        }
    }

    fn image_from_canvas(&self, value: f64, axis: usize) -> f64 {
        (value - self.corner[axis]) / self.scale[axis]
    }

    /// A box on the canvas, cut at the edges of the part that the scene may fill.
    fn canvas_from_image(&self, area: &PixelBox) -> PixelBox {
        let at = |value: f64, axis: usize| value * self.scale[axis] + self.corner[axis];
        let limit = &self.area;
        PixelBox::new(
            at(area.x_min, 0).max(limit.x_min),
            at(area.y_min, 1).max(limit.y_min),
            at(area.x_max, 0).min(limit.x_max),
            at(area.y_max, 1).min(limit.y_max),
        )
    }

    fn is_at(&self, x: f64, y: f64) -> bool {
        let area = &self.area;
        x >= area.x_min && x < area.x_max && y >= area.y_min && y < area.y_max
    }
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
    let area = input.area();
    let canvas_x: Vec<f64> = (0..input.width)
        .map(|x| change.canvas_from_input(f64::from(x) + 0.5, 0))
        .collect();
    for y in 0..input.height {
        let canvas_y = change.canvas_from_input(f64::from(y) + 0.5, 1);
        let row = y as usize * input.width as usize;
        for (x, &canvas_x) in canvas_x.iter().enumerate() {
            let tile = tiles.iter().find(|tile| tile.is_at(canvas_x, canvas_y));
            let color = tile.map_or(GREY, |tile| {
                let x = tile.image_from_canvas(canvas_x, 0);
                let y = tile.image_from_canvas(canvas_y, 1);
                sample(tile.scene.image, x, y)
            });
            for (channel, value) in change_color(color, change.gains).into_iter().enumerate() {
                planes[channel * area + row + x] = value;
            }
        }
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

/// The colour (0..1) at a point of the image, bilinear; grey outside.
fn sample(image: &RgbImage, x: f64, y: f64) -> [f32; 3] {
    let (width, height) = (image.width() as usize, image.height() as usize);
    if !(x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64) {
        return GREY;
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
