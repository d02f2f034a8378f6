//! Weights in the order in which the products read them.

use rayon::prelude::*;

use super::shape::ConvShape;
use super::simd::{self, TILE_VECTORS};
use super::winograd;

/// How a convolution is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Algorithm {
    /// One small kernel per channel.
    Depthwise,
    /// As a product over all taps and input channels.
    Direct,
    /// Through Winograd's minimal filtering, F(4x4, 3x3).
    Winograd,
}

/// Least channels on either side for which Winograd's transforms pay.
const WINOGRAD_CHANNELS: usize = 8;
/// Most weights (input times output channels): beyond, the transformed weights, four times as
/// large, no longer come from memory as fast as they are used.
const WINOGRAD_WEIGHTS: usize = 256 * 256;

/// Least pixels of an output for which weights are transformed on the spot.
const WINOGRAD_AREA: usize = 64;

impl Algorithm {
    /// What a convolution's weights are packed for; the size of the images plays no part.
    pub fn of(shape: &ConvShape) -> Self {
        if shape.depthwise {
            return Self::Depthwise;
        }
        let least = shape.channels_in.min(shape.channels_out);
        let weights = shape.channels_in * shape.channels_out;
        if shape.kernel == [3, 3]
            && shape.stride == 1
            && least >= WINOGRAD_CHANNELS
            && weights <= WINOGRAD_WEIGHTS
        {
            Self::Winograd
        } else {
            Self::Direct
        }
    }
}

impl Algorithm {
    /// What a convolution is best computed with when its weights are packed for it alone: images of
    /// a few tiles do not pay for Winograd's transforms.
    pub fn for_images(shape: &ConvShape) -> Self {
        match Self::of(shape) {
            Self::Winograd if shape.height_out() * shape.width_out() < WINOGRAD_AREA => {
                Self::Direct
            }
            algorithm => algorithm,
        }
    }
}

/// Packed weights of one convolution.
///
/// Output channels are cut into panels of two vectors (the last one may have one); a panel holds
/// `depth` rows, and a row the weights of all its channels, zeros beyond the last channel.
#[derive(Debug, Clone, Copy)]
pub struct Packed<'a> {
    /// The panels, one behind the other.
    pub data: &'a [f32],
    /// Output channels.
    pub channels: usize,
    /// Rows of a panel.
    pub depth: usize,
}

/// One panel.
#[derive(Debug, Clone, Copy)]
pub struct Panel<'a> {
    /// `depth` rows.
    pub weights: &'a [f32],
    /// First output channel.
    pub first: usize,
    /// Output channels that exist.
    pub channels: usize,
    /// Vectors of a row.
    pub vectors: usize,
}

/// Channels of a full panel.
fn panel_channels() -> usize {
    TILE_VECTORS * simd::vector_lanes()
}

/// Vectors of a panel with so many channels.
fn panel_vectors(channels: usize) -> usize {
    channels.div_ceil(simd::vector_lanes())
}

/// Length of the packed weights of so many output channels.
pub fn packed_len(channels: usize, depth: usize) -> usize {
    channels.next_multiple_of(simd::vector_lanes()) * depth
}

/// Packs weights given by `weight(channel, k)`.
pub fn pack(
    channels: usize,
    depth: usize,
    weight: impl Fn(usize, usize) -> f32 + Sync,
) -> Vec<f32> {
    let full = panel_channels();
    let mut data = vec![0.0; packed_len(channels, depth)];
    data.par_chunks_mut(full * depth)
        .enumerate()
        .for_each(|(panel, data)| {
            let first = panel * full;
            let used = full.min(channels - first);
            let width = data.len() / depth;
            for (k, row) in data.chunks_exact_mut(width).enumerate() {
                for (channel, value) in row[..used].iter_mut().enumerate() {
                    *value = weight(first + channel, k);
                }
            }
        });
    data
}

/// Packs a convolution's weights `[channels_out, channels_in, kernel_h, kernel_w]` (depthwise:
/// `[channels, 1, ..]`) for the algorithm that its shape calls for.
pub fn pack_weights(shape: &ConvShape, algorithm: Algorithm, weight: &[f32]) -> Vec<f32> {
    let ConvShape {
        channels_in,
        channels_out,
        kernel: [kernel_h, kernel_w],
        ..
    } = *shape;
    let taps = kernel_h * kernel_w;
    match algorithm {
        Algorithm::Depthwise => {
            let width = channels_out.next_multiple_of(simd::MAX_LANES);
            let mut data = vec![0.0; taps * width];
            for (tap, row) in data.chunks_exact_mut(width).enumerate() {
                for (channel, value) in row[..channels_out].iter_mut().enumerate() {
                    *value = weight[channel * taps + tap];
                }
            }
            data
        }
        Algorithm::Direct => pack(channels_out, taps * channels_in, |channel, k| {
            weight[(channel * channels_in + k % channels_in) * taps + k / channels_in]
        }),
        Algorithm::Winograd => winograd::pack(channels_out, channels_in, |channel, c, tap| {
            weight[(channel * channels_in + c) * taps + tap]
        }),
    }
}

impl<'a> Packed<'a> {
    /// The panels in order.
    pub fn panels(&self) -> impl Iterator<Item = Panel<'a>> {
        let (channels, full) = (self.channels, panel_channels());
        self.data
            .chunks(full * self.depth)
            .enumerate()
            .map(move |(index, weights)| {
                let first = index * full;
                let channels = full.min(channels - first);
                Panel {
                    weights,
                    first,
                    channels,
                    vectors: panel_vectors(channels),
                }
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panels_cover_every_channel_once_and_pad_with_zeros() {
        for channels in [1, 8, 16, 17, 33, 65] {
            let data = pack(channels, 3, |channel, k| (channel * 10 + k + 1) as f32);
            let packed = Packed {
                data: &data,
                channels,
                depth: 3,
            };
            let mut next = 0;
            for panel in packed.panels() {
                assert_eq!(panel.first, next);
                let width = panel.vectors * simd::vector_lanes();
                for (k, row) in panel.weights.chunks_exact(width).enumerate() {
                    for (i, &value) in row.iter().enumerate() {
                        let expected = if i < panel.channels {
                            ((panel.first + i) * 10 + k + 1) as f32
                        } else {
                            0.0
                        };
                        assert_eq!(value, expected);
                    }
                }
                next += panel.channels;
            }
            assert_eq!(next, channels);
        }
    }
}
