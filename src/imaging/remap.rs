//! Images resampled by a map that says where each pixel comes from.

use image::RgbImage;
use rayon::prelude::*;

/// Bits of a pixel's fraction: a map is exact to a quarter of a thousandth of a pixel.
const FRACTION_BITS: u32 = 11;

/// One pixel in fractions.
const ONE: u32 = 1 << FRACTION_BITS;

/// Half of a colour level after both axes were weighted.
const HALF: u32 = 1 << (2 * FRACTION_BITS - 1);

/// Places that lie outside the image by no more than this are on its border, pixels: rounding.
const BORDER_PX: f64 = 1e-6;

/// The index of a tap that sees nothing.
const NOTHING: u32 = u32::MAX;

/// Where one pixel comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Tap {
    /// The upper left one of the four pixels, row by row; [`NOTHING`] for black.
    index: u32,
    /// The way to the right and the lower ones, of [`ONE`].
    fraction: [u16; 2],
}

/// Where each pixel of an image comes from in another, computed once for many images.
///
/// Bilinear between pixel centres; in the outer half of border pixels their colour; black where
/// nothing comes from. Whole-number arithmetic: the same bytes on every machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PixelMap {
    source: [u32; 2],
    target: [u32; 2],
    taps: Vec<Tap>,
}

impl PixelMap {
    /// A map from images of size `source` to images of size `target`. `place` says where the centre
    /// of a target pixel lies in the source, pixels (the first one's centre is at (0.5, 0.5)); None
    /// or a place outside is black.
    ///
    /// Sides must be between 2 and 32768, as those of every rig are; other maps are empty.
    pub fn new(
        source: [u32; 2],
        target: [u32; 2],
        place: impl Fn([f64; 2]) -> Option<[f64; 2]> + Sync,
    ) -> Self {
        let usable = |size: [u32; 2]| size.iter().all(|side| (2..=32_768).contains(side));
        let (width, height) = (target[0] as usize, target[1] as usize);
        let mut taps = Vec::new();
        if usable(source) && usable(target) {
            let empty = Tap {
                index: NOTHING,
                fraction: [0; 2],
            };
            taps = vec![empty; width * height];
            taps.par_chunks_exact_mut(width)
                .zip(0..target[1])
                .for_each(|(row, y)| {
                    for (tap, x) in row.iter_mut().zip(0_u32..) {
                        let center = [f64::from(x) + 0.5, f64::from(y) + 0.5];
                        *tap = place(center)
                            .and_then(|pixel| tap_at(pixel, source))
                            .unwrap_or(empty);
                    }
                });
        }
        Self {
            source,
            target,
            taps,
        }
    }

    /// Size of the images that it takes, pixels.
    pub fn source(&self) -> [u32; 2] {
        self.source
    }

    /// Share of the pixels that are black because nothing comes from there.
    pub fn black_share(&self) -> f64 {
        let black = self.taps.iter().filter(|tap| tap.index == NOTHING).count();
        black as f64 / self.taps.len().max(1) as f64
    }

    /// The mapped image; None for an image of another size than the map's source.
    pub fn apply(&self, image: &RgbImage) -> Option<RgbImage> {
        let [width, height] = self.target;
        if <[u32; 2]>::from(image.dimensions()) != self.source || self.taps.is_empty() {
            return None;
        }
        let stride = 3 * self.source[0] as usize;
        let bytes = image.as_raw();
        let mut out = RgbImage::new(width, height);
        let row = 3 * width as usize;
        out.par_chunks_exact_mut(row)
            .zip(self.taps.par_chunks_exact(width as usize))
            .for_each(|(out, taps)| {
                for (out, tap) in out.chunks_exact_mut(3).zip(taps) {
                    if tap.index == NOTHING {
                        continue;
                    }
                    let start = 3 * tap.index as usize;
                    let upper = &bytes[start..start + 6];
                    let lower = &bytes[start + stride..start + stride + 6];
                    let [fx, fy] = tap.fraction.map(u32::from);
                    for channel in 0..3 {
                        let along = |pair: &[u8]| {
                            u32::from(pair[channel]) * (ONE - fx)
                                + u32::from(pair[channel + 3]) * fx
                        };
                        let value = along(upper) * (ONE - fy) + along(lower) * fy + HALF;
                        out[channel] = (value >> (2 * FRACTION_BITS)) as u8;
                    }
                }
            });
        Some(out)
    }
}

fn tap_at(pixel: [f64; 2], [width, height]: [u32; 2]) -> Option<Tap> {
    let axis = |position: f64, side: u32| {
        let side = f64::from(side);
        if !(-BORDER_PX..=side + BORDER_PX).contains(&position) {
            return None;
        }
        let position = (position - 0.5).clamp(0.0, side - 1.0);
        let first = position.floor().min(side - 2.0);
        let fraction = ((position - first) * f64::from(ONE)).round();
        Some((first as u32, fraction as u16))
    };
    let (x, fraction_x) = axis(pixel[0], width)?;
    let (y, fraction_y) = axis(pixel[1], height)?;
    Some(Tap {
        index: y * width + x,
        fraction: [fraction_x, fraction_y],
    })
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

    #[test]
    fn a_map_to_the_same_places_leaves_every_byte() {
        let image = noise(61, 37);
        let map = PixelMap::new([61, 37], [61, 37], |[x, y]| Some([x + 1e-9, y - 1e-9]));
        assert_eq!(map.apply(&image), Some(image));
        assert_eq!(map.black_share(), 0.0);
    }

    #[test]
    fn places_between_pixels_are_their_weighted_mean() {
        let image = RgbImage::from_fn(4, 4, |x, y| Rgb([(x * 40) as u8, (y * 60) as u8, 7]));
        let map = PixelMap::new([4, 4], [2, 2], |[x, y]| Some([x + 0.75, y + 0.5]));
        let mapped = map.apply(&image).unwrap();
        assert_eq!(mapped.get_pixel(0, 0).0, [30, 30, 7]);
        assert_eq!(mapped.get_pixel(1, 1).0, [70, 90, 7]);
    }

    #[test]
    fn outside_is_black_and_the_outer_half_of_border_pixels_is_theirs() {
        let image = noise(8, 8);
        let map = PixelMap::new([8, 8], [4, 2], |[x, y]| match (x as u32, y as u32) {
            (0, 0) => Some([0.0, 0.0]),
            (1, 0) => Some([8.0, 8.0]),
            (2, 0) => Some([-0.01, 4.0]),
            (3, 0) => Some([4.0, 8.01]),
            (0, 1) => Some([f64::NAN, 4.0]),
            (1, 1) => Some([f64::INFINITY, 4.0]),
            _ => None,
        });
        let mapped = map.apply(&image).unwrap();
        assert_eq!(mapped.get_pixel(0, 0), image.get_pixel(0, 0));
        assert_eq!(mapped.get_pixel(1, 0), image.get_pixel(7, 7));
        for (x, y) in [(2, 0), (3, 0), (0, 1), (1, 1), (2, 1)] {
            assert_eq!(mapped.get_pixel(x, y).0, [0; 3]);
        }
        assert_eq!(map.black_share(), 0.75);
    }

    #[test]
    fn images_and_maps_of_impossible_sizes_give_none() {
        let map = PixelMap::new([8, 8], [8, 8], Some);
        assert_eq!(map.apply(&noise(8, 7)), None);
        for size in [[0, 5], [1, 5], [40_000, 4]] {
            assert_eq!(PixelMap::new(size, [4, 4], Some).apply(&noise(4, 4)), None);
            assert_eq!(PixelMap::new([4, 4], size, Some).apply(&noise(4, 4)), None);
        }
    }

    #[test]
    fn the_bytes_do_not_depend_on_the_number_of_threads() {
        let image = noise(97, 61);
        let make = || {
            let place = |[x, y]: [f64; 2]| Some([x * 0.97 + 0.01 * y, y * 1.02 - 0.3]);
            PixelMap::new([97, 61], [97, 61], place).apply(&image)
        };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        assert_eq!(pool.unwrap().install(make), make());
    }
}
