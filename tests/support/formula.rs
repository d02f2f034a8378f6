//! The number formula: every weight and image of the fixtures, computed from a text and an index.
//!
//! No weight file is needed to check a network: FNV-1a turns a text key into a seed, `SplitMix64`
//! turns seed and index into 64 bits, and a few single-precision operations turn those into a
//! parameter or a pixel. Every step rounds as written (no fused multiply-add), so all numbers are
//! the same on every machine.

use super::fixture::Fixture;

/// FNV-1a, 64 bit, of a text's UTF-8 bytes.
pub fn hash(key: &str) -> u64 {
    key.bytes().fold(0xcbf2_9ce4_8422_2325, |h: u64, byte| {
        (h ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

/// Output number `index + 1` of `SplitMix64` seeded with `seed`.
pub fn mix(seed: u64, index: u64) -> u64 {
    let mut z = seed.wrapping_add((index + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// A number in [-1, 1) from 64 bits, exact in single precision.
pub fn unit_from_bits(z: u64) -> f32 {
    ((z >> 40) as f32 - 8_388_608.0) / 8_388_608.0
}

/// The first `count` numbers in [-1, 1) of a key.
pub fn units(key: &str, count: usize) -> Vec<f32> {
    let seed = hash(key);
    (0..count as u64)
        .map(|index| unit_from_bits(mix(seed, index)))
        .collect()
}

/// The first `count` bytes of a key.
pub fn bytes(key: &str, count: usize) -> Vec<u8> {
    let seed = hash(key);
    (0..count as u64)
        .map(|index| (mix(seed, index) >> 56) as u8)
        .collect()
}

/// The four constants that fill a whole network.
#[derive(Debug, Clone, PartialEq)]
pub struct Fill {
    /// Start of every parameter's key.
    pub tag: String,
    /// Scale of the ordinary weights.
    pub gain: f64,
    /// Scale of the detection head's last convolutions.
    pub head_gain: f64,
    /// Factor of the attention's query and key rows, a power of two.
    pub qk_boost: f64,
}

impl Fill {
    /// These four constants.
    pub fn new(tag: &str, gain: f64, head_gain: f64, qk_boost: f64) -> Self {
        Self {
            tag: tag.to_owned(),
            gain,
            head_gain,
            qk_boost,
        }
    }

    /// A filling without a detection head or attention: single blocks, the distance network.
    pub fn plain(tag: &str, gain: f64) -> Self {
        Self::new(tag, gain, 1.0, 1.0)
    }

    /// The constants that stand in a fixture file; a missing `head_gain` or `qk_boost` is 1.
    pub fn from_fixture(fixture: &Fixture) -> Self {
        let number = |key| fixture.meta_number(key);
        Self::new(
            &fixture.meta_text("tag"),
            number("gain").expect("the fixture states its gain"),
            number("head_gain").unwrap_or(1.0),
            number("qk_boost").unwrap_or(1.0),
        )
    }

    /// `sqrt(gain / fan_in)`, rounded to single precision once.
    pub fn scale(gain: f64, shape: &[usize]) -> f32 {
        (gain / fan_in(shape) as f64).sqrt() as f32
    }

    /// All elements of the parameter or buffer with this state-dict name, row-major.
    ///
    /// `shape` is the `PyTorch` shape: a linear layer's weight is (outputs, inputs).
    pub fn parameter(&self, name: &str, shape: &[usize]) -> Vec<f32> {
        let count = shape.iter().product::<usize>();
        if name.ends_with("num_batches_tracked") {
            return vec![0.0; count];
        }
        if name.ends_with("dfl.conv.weight") {
            return (0..count).map(|i| i as f32).collect();
        }
        let u = units(&format!("{}/{name}", self.tag), count);
        let each = |f: &dyn Fn(usize, f32) -> f32| -> Vec<f32> {
            u.iter().enumerate().map(|(i, &u)| f(i, u)).collect()
        };
        if name.ends_with("running_mean") {
            each(&|_, u| 0.1 * u)
        } else if name.ends_with("running_var") {
            each(&|_, u| 1.0 + 0.5 * u.abs())
        } else if name.ends_with(".bn.weight") {
            each(&|_, u| 1.0 + 0.1 * u)
        } else if name.ends_with(".bn.bias") {
            each(&|_, u| 0.1 * u)
        } else if name.starts_with("model.23.cv") && name.ends_with(".2.weight") {
            let scale = Self::scale(self.head_gain, shape);
            each(&|_, u| u * scale)
        } else if name.starts_with("model.23.cv2") && name.ends_with(".2.bias") {
            // Boxes lean to short distances, so that they have a useful size.
            each(&|i, u| 0.1 * u + 0.25 * (8.0 - (i % 16) as f32))
        } else if name.ends_with(".qkv.conv.weight") {
            let scale = Self::scale(self.gain, shape);
            let boost = self.qk_boost as f32;
            let row_elements = fan_in(shape);
            each(&|i, u| {
                let is_query_or_key = (i / row_elements) % 128 < 64;
                u * scale * if is_query_or_key { boost } else { 1.0 }
            })
        } else if shape.len() >= 2 {
            let scale = Self::scale(self.gain, shape);
            each(&|_, u| u * scale)
        } else {
            each(&|_, u| 0.1 * u)
        }
    }
}

/// Inputs of one output: all dimensions but the first.
fn fan_in(shape: &[usize]) -> usize {
    shape[1..].iter().product()
}

/// An 8-bit picture, channel by channel (CHW): coarse 8x8 blocks and some noise.
pub fn image(key: &str, channels: usize, height: usize, width: usize) -> Vec<u8> {
    let (block_rows, block_columns) = (height.div_ceil(8), width.div_ceil(8));
    let blocks = bytes(
        &format!("{key}#block"),
        channels * block_rows * block_columns,
    );
    let noise = bytes(&format!("{key}#noise"), channels * height * width);
    let mut pixels = Vec::with_capacity(noise.len());
    for c in 0..channels {
        for y in 0..height {
            for x in 0..width {
                let block = blocks[(c * block_rows + y / 8) * block_columns + x / 8];
                let noise = noise[(c * height + y) * width + x];
                pixels.push(((3 * u32::from(block) + u32::from(noise)) >> 2) as u8);
            }
        }
    }
    pixels
}

/// The same picture with interleaved channels (HWC).
pub fn image_interleaved(key: &str, channels: usize, height: usize, width: usize) -> Vec<u8> {
    let planes = image(key, channels, height, width);
    let plane = height * width;
    (0..plane)
        .flat_map(|pixel| (0..channels).map(move |c| c * plane + pixel))
        .map(|index| planes[index])
        .collect()
}

/// A network's input of shape (batch, 3, height, width): sample b is `image(key.b)` over 255.
pub fn image_batch(key: &str, batch: usize, height: usize, width: usize) -> Vec<f32> {
    (0..batch)
        .flat_map(|b| image(&format!("{key}.{b}"), 3, height, width))
        .map(|byte| f32::from(byte) / 255.0)
        .collect()
}

/// The distance network's input of shape (batch, 3, height, width): the right crop
/// `image(key.b.right)` above the left crop `image(key.b.left)`, over 255.
pub fn composite_batch(key: &str, batch: usize, height: usize, width: usize) -> Vec<f32> {
    let half = height / 2 * width;
    let mut values = Vec::with_capacity(batch * 3 * 2 * half);
    for b in 0..batch {
        let right = image(&format!("{key}.{b}.right"), 3, height / 2, width);
        let left = image(&format!("{key}.{b}.left"), 3, height / 2, width);
        for c in 0..3 {
            for crop in [&right, &left] {
                values.extend(
                    crop[c * half..(c + 1) * half]
                        .iter()
                        .map(|&v| f32::from(v) / 255.0),
                );
            }
        }
    }
    values
}

/// 26 numbers that stand for a whole tensor: mean, standard deviation (divisor n), the first
/// eight elements (zeros where there are fewer), and sixteen elements spread evenly over it.
pub fn summary(values: &[f32]) -> Vec<f64> {
    let n = values.len();
    let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / n as f64;
    let variance = values
        .iter()
        .map(|&v| (f64::from(v) - mean).powi(2))
        .sum::<f64>()
        / n as f64;
    let first = (0..8).map(|i| values.get(i).map_or(0.0, |&v| f64::from(v)));
    let spread = (0..16).map(|j| f64::from(values[j * n / 16]));
    [mean, variance.sqrt()]
        .into_iter()
        .chain(first)
        .chain(spread)
        .collect()
}
