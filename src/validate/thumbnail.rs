//! Pictures that look alike, found by their thumbnails.

use image::RgbImage;
use image::imageops::thumbnail;

/// Width and height of a thumbnail; a bit of the hash compares neighbours in a row.
const WIDTH: u32 = 17;
/// See [`WIDTH`].
const HEIGHT: u32 = 16;

/// Hashes of pictures that are alike differ in at most this many of 256 bits. Sensor noise and
/// compression flip a few where neighbours are equally bright.
const MOST_BITS: u32 = 14;

/// And their thumbnails by at most this many grey levels on average.
const MOST_LEVELS: u32 = 4;

/// A small grey picture and its difference hash: which of two neighbours is brighter.
#[derive(Debug, Clone)]
pub(super) struct Thumbnail {
    grey: Vec<u8>,
    hash: [u64; 4],
}

impl Thumbnail {
    pub fn new(image: &RgbImage) -> Self {
        let small = thumbnail(image, WIDTH, HEIGHT);
        let grey: Vec<u8> = small
            .pixels()
            .map(|pixel| {
                let [red, green, blue] = pixel.0.map(u32::from);
                // Rec. 601 luma in 256ths.
                ((77 * red + 150 * green + 29 * blue) >> 8) as u8
            })
            .collect();
        let mut hash = [0_u64; 4];
        let rows = grey.chunks_exact(WIDTH as usize);
        let brighter = rows.flat_map(|row| row.windows(2).map(|pair| pair[0] < pair[1]));
        for (i, _) in brighter.enumerate().filter(|(_, brighter)| *brighter) {
            hash[i / 64] |= 1 << (i % 64);
        }
        Self { grey, hash }
    }

    /// Whether the two pictures are almost the same.
    pub fn is_like(&self, other: &Self) -> bool {
        let pairs = self.hash.iter().zip(other.hash);
        let bits: u32 = pairs.map(|(a, b)| (a ^ b).count_ones()).sum();
        if bits > MOST_BITS {
            return false;
        }
        let levels: u32 = self
            .grey
            .iter()
            .zip(&other.grey)
            .map(|(a, b)| u32::from(a.abs_diff(*b)))
            .sum();
        levels <= MOST_LEVELS * WIDTH * HEIGHT
    }
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    fn picture(shift: u32, noise: u32) -> RgbImage {
        RgbImage::from_fn(320, 180, |x, y| {
            let wave = (x + shift) * 2 % 128 + (y * y / 64 + x * y / 99) % 127;
            let grain = (x * 31 + y * 17) % (noise + 1);
            Rgb([(wave + grain).min(255) as u8; 3])
        })
    }

    #[test]
    fn noise_keeps_pictures_alike_and_another_place_does_not() {
        let original = Thumbnail::new(&picture(0, 0));
        assert!(original.is_like(&original));
        assert!(original.is_like(&Thumbnail::new(&picture(0, 4))));
        assert!(!original.is_like(&Thumbnail::new(&picture(90, 0))));
    }

    #[test]
    fn plain_pictures_are_alike_only_when_equally_bright() {
        let plain = |level| Thumbnail::new(&RgbImage::from_pixel(64, 64, Rgb([level; 3])));
        assert!(plain(100).is_like(&plain(102)));
        assert!(!plain(100).is_like(&plain(120)));
    }
}
