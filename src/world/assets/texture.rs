//! Pictures on the surfaces of models, averaged over what a pixel covers.

use std::sync::OnceLock;

use image::RgbaImage;

/// Pictures are shrunk until no side is longer than this: more is never seen of a vehicle.
const LARGEST_SIDE: u32 = 1024;

/// How a picture goes on beyond its edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Wrap {
    Repeat,
    Mirror,
    Clamp,
}

/// A picture and its halvings down to one pixel.
#[derive(Debug, Clone)]
pub(super) struct Texture {
    levels: Vec<Level>,
    wrap: [Wrap; 2],
    is_color: bool,
}

#[derive(Debug, Clone)]
struct Level {
    size: [usize; 2],
    pixels: Vec<[u8; 4]>,
}

impl Texture {
    /// Prepares a picture; colours are stored as sRGB, other values as they are.
    pub fn new(image: &RgbaImage, wrap: [Wrap; 2], is_color: bool) -> Self {
        let mut level = Level {
            size: [image.width() as usize, image.height() as usize],
            pixels: image.pixels().map(|pixel| pixel.0).collect(),
        };
        let longest = |level: &Level| level.size[0].max(level.size[1]);
        while longest(&level) > LARGEST_SIDE as usize {
            level = level.halved(is_color);
        }
        let mut levels = vec![level];
        while let Some(last) = levels.last()
            && longest(last) > 1
        {
            levels.push(last.halved(is_color));
        }
        Self {
            levels,
            wrap,
            is_color,
        }
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> usize {
        self.levels.iter().map(|level| level.pixels.len() * 4).sum()
    }

    /// Pixels along the sides of the full picture.
    pub fn size(&self) -> [f32; 2] {
        self.levels[0].size.map(|side| side as f32)
    }

    /// Linear red, green, blue and alpha at a place of the picture, 0 to 1 over it, averaged over
    /// `width_px` of its pixels.
    pub fn at(&self, place: [f32; 2], width_px: f32) -> [f32; 4] {
        let last = self.levels.len() - 1;
        let level = libm::log2f(width_px.max(1.0)).min(last as f32);
        let (lower, part) = (level as usize, level - level.floor());
        let fine = self.bilinear(&self.levels[lower], place);
        if part <= 0.0 || lower == last {
            return fine;
        }
        let coarse = self.bilinear(&self.levels[lower + 1], place);
        std::array::from_fn(|i| fine[i] + (coarse[i] - fine[i]) * part)
    }

    fn bilinear(&self, level: &Level, place: [f32; 2]) -> [f32; 4] {
        // Far from the picture single precision has no fractions left.
        let at = [0, 1].map(|i| place[i].clamp(-1e4, 1e4) * level.size[i] as f32 - 0.5);
        let first = at.map(|v| v.floor() as i64);
        let part = [0, 1].map(|i| at[i] - first[i] as f32);
        let pixel = |dx: i64, dy: i64| {
            let [x, y] =
                [0, 1].map(|i| wrapped(first[i] + [dx, dy][i], level.size[i] as i64, self.wrap[i]));
            let [r, g, b, a] = level.pixels[y * level.size[0] + x];
            let value = |v: u8| {
                if self.is_color {
                    linear_from_srgb(v)
                } else {
                    f32::from(v) / 255.0
                }
            };
            [value(r), value(g), value(b), f32::from(a) / 255.0]
        };
        let [a, b, c, d] = [pixel(0, 0), pixel(1, 0), pixel(0, 1), pixel(1, 1)];
        std::array::from_fn(|i| {
            let [top, bottom] = [
                a[i] + (b[i] - a[i]) * part[0],
                c[i] + (d[i] - c[i]) * part[0],
            ];
            top + (bottom - top) * part[1]
        })
    }
}

impl Level {
    fn halved(&self, is_color: bool) -> Self {
        let size = self.size.map(|side| (side / 2).max(1));
        let mut pixels = Vec::with_capacity(size[0] * size[1]);
        for y in 0..size[1] {
            for x in 0..size[0] {
                let four = [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[dx, dy]| {
                    let column = (2 * x + dx).min(self.size[0] - 1);
                    let row = (2 * y + dy).min(self.size[1] - 1);
                    self.pixels[row * self.size[0] + column]
                });
                pixels.push(std::array::from_fn(|i| {
                    if is_color && i < 3 {
                        let sum: f32 = four.iter().map(|pixel| linear_from_srgb(pixel[i])).sum();
                        srgb_from_linear(sum * 0.25)
                    } else {
                        let sum: u16 = four.iter().map(|pixel| u16::from(pixel[i])).sum();
                        ((sum + 2) / 4) as u8
                    }
                }));
            }
        }
        Self { size, pixels }
    }
}

/// The pixel that stands for one beyond the edge.
fn wrapped(index: i64, side: i64, wrap: Wrap) -> usize {
    let inside = match wrap {
        Wrap::Repeat => index.rem_euclid(side),
        Wrap::Clamp => index.clamp(0, side - 1),
        Wrap::Mirror => {
            let turn = index.rem_euclid(2 * side);
            turn.min(2 * side - 1 - turn)
        }
    };
    inside as usize
}

fn linear_from_srgb(value: u8) -> f32 {
    static TABLE: OnceLock<[f32; 256]> = OnceLock::new();
    TABLE.get_or_init(|| std::array::from_fn(|i| decoded(i as f32 / 255.0)))[usize::from(value)]
}

fn decoded(value: f32) -> f32 {
    if value <= 0.040_45 {
        value / 12.92
    } else {
        libm::powf((value + 0.055) / 1.055, 2.4)
    }
}

fn srgb_from_linear(value: f32) -> u8 {
    let encoded = if value <= 0.003_130_8 {
        value * 12.92
    } else {
        1.055 * libm::powf(value, 1.0 / 2.4) - 0.055
    };
    (encoded * 255.0 + 0.5).clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use image::Rgba;

    use super::*;

    fn checks(wrap: Wrap) -> Texture {
        let image = RgbaImage::from_fn(8, 8, |x, y| {
            let level = if (x + y) % 2 == 0 { 255 } else { 0 };
            Rgba([level, level, level, level])
        });
        Texture::new(&image, [wrap; 2], true)
    }

    #[test]
    fn from_afar_a_picture_is_its_mean_light_and_near_its_pixels() {
        let texture = checks(Wrap::Repeat);
        let far = texture.at([0.3, 0.7], 100.0);
        assert!((far[0] - 0.5).abs() < 0.01, "{far:?}");
        assert!((far[3] - 0.5).abs() < 0.01, "{far:?}");
        let near = |x: f32| texture.at([(x + 0.5) / 8.0, 0.5 / 8.0], 0.1)[0];
        assert_eq!(
            [near(0.0), near(1.0), near(8.0), near(-1.0)],
            [1.0, 0.0, 1.0, 0.0]
        );
    }

    #[test]
    fn beyond_the_edge_a_picture_goes_on_as_its_file_says() {
        let pick = |index, wrap| wrapped(index, 4, wrap);
        assert_eq!([-1, 4, 9].map(|i| pick(i, Wrap::Repeat)), [3, 0, 1]);
        assert_eq!([-1, 4, 9].map(|i| pick(i, Wrap::Mirror)), [0, 3, 1]);
        assert_eq!([-1, 4, 9].map(|i| pick(i, Wrap::Clamp)), [0, 3, 3]);
    }

    #[test]
    fn large_pictures_are_shrunk_and_odd_sizes_end_at_one_pixel() {
        let large = RgbaImage::from_pixel(2500, 3, Rgba([10, 200, 30, 255]));
        let texture = Texture::new(&large, [Wrap::Clamp; 2], true);
        assert_eq!(texture.size(), [625.0, 1.0]);
        assert_eq!(texture.levels.last().unwrap().size, [1, 1]);
        let [_, green, ..] = texture.at([0.5, 0.5], 1e6);
        assert!((green - decoded(200.0 / 255.0)).abs() < 0.01);
    }
}
