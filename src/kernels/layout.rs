//! How images lie in memory for the kernels: channels innermost.
//!
//! Tensors stay `[batch, channels, height, width]` for everyone; only their strides tell that the
//! channels of a pixel are neighbours in memory. The kernels return such tensors and read them
//! where they lie; anything else is rearranged first. With channels innermost a vector holds
//! the channels of one pixel, so no kernel ever has to rearrange across a vector, and the inputs of
//! a convolution at one kernel row are one contiguous run.

use rayon::prelude::*;

/// A stack of images whose pixels hold their channels side by side.
#[derive(Debug, Clone, Copy)]
pub struct Pixels<'a> {
    /// The values, from the first channel of the first pixel on.
    pub data: &'a [f32],
    /// Number of images.
    pub images: usize,
    /// Rows of an image.
    pub height: usize,
    /// Pixels of a row.
    pub width: usize,
    /// Channels of a pixel.
    pub channels: usize,
    /// Distance of neighbouring pixels; more than the channels when these are part of a wider
    /// stack.
    pub pixel_stride: usize,
    /// Distance of two images.
    pub image_stride: usize,
}

impl<'a> Pixels<'a> {
    /// Images that lie densely one behind the other.
    pub fn dense(data: &'a [f32], [images, height, width, channels]: [usize; 4]) -> Self {
        debug_assert!(data.len() >= images * height * width * channels);
        Self {
            data,
            images,
            height,
            width,
            channels,
            pixel_stride: channels,
            image_stride: height * width * channels,
        }
    }

    /// Where a pixel starts in [`Pixels::data`].
    pub fn offset(&self, image: usize, y: usize, x: usize) -> usize {
        image * self.image_stride + (y * self.width + x) * self.pixel_stride
    }

    /// The values of a pixel.
    pub fn pixel(&self, image: usize, y: usize, x: usize) -> &'a [f32] {
        &self.data[self.offset(image, y, x)..][..self.channels]
    }

    /// Copies rows of an image into `target`, zeros where they lie outside: `rows x columns`
    /// pixels from pixel (`top`, `left`) on, which may be outside.
    pub fn copy_window(
        &self,
        image: usize,
        [top, left]: [isize; 2],
        [rows, columns]: [usize; 2],
        target: &mut [f32],
    ) {
        let channels = self.channels;
        // Columns that lie inside.
        let first = (-left).clamp(0, columns as isize).unsigned_abs();
        let last = (self.width as isize - left)
            .clamp(first as isize, columns as isize)
            .unsigned_abs();
        for (row, target) in target
            .chunks_exact_mut(columns * channels)
            .take(rows)
            .enumerate()
        {
            let y = top + row as isize;
            if y < 0 || y >= self.height as isize || first == last {
                target.fill(0.0);
                continue;
            }
            target[..first * channels].fill(0.0);
            target[last * channels..].fill(0.0);
            let x = (left + first as isize).unsigned_abs();
            let source = self.offset(image, y.unsigned_abs(), x);
            let target = &mut target[first * channels..last * channels];
            if self.pixel_stride == channels {
                target.copy_from_slice(&self.data[source..source + target.len()]);
            } else {
                for (i, target) in target.chunks_exact_mut(channels).enumerate() {
                    let source = source + i * self.pixel_stride;
                    target.copy_from_slice(&self.data[source..source + channels]);
                }
            }
        }
    }
}

/// Side of the square blocks in which planes are turned into pixels.
const BLOCK: usize = 16;

/// From `[images, channels, area]` to `[images, area, channels]`.
pub fn interleave(planes: &[f32], [images, channels, area]: [usize; 3]) -> Vec<f32> {
    transpose(planes, images, channels, area)
}

/// From `[images, area, channels]` to `[images, channels, area]`.
pub fn separate(pixels: &[f32], [images, channels, area]: [usize; 3]) -> Vec<f32> {
    transpose(pixels, images, area, channels)
}

/// Transposes every `rows x columns` matrix.
fn transpose(input: &[f32], matrices: usize, rows: usize, columns: usize) -> Vec<f32> {
    let mut output = vec![0.0; matrices * rows * columns];
    if output.is_empty() {
        return output;
    }
    // Bands of output rows: parallel even for a single matrix.
    let band = BLOCK.max(columns / 8).next_multiple_of(BLOCK).min(columns);
    for (input, output) in input
        .chunks_exact(rows * columns)
        .zip(output.chunks_exact_mut(rows * columns))
    {
        output
            .par_chunks_mut(band * rows)
            .enumerate()
            .for_each(|(index, output)| {
                let first = index * band;
                let count = output.len() / rows;
                for column_block in (0..count).step_by(BLOCK) {
                    let block = BLOCK.min(count - column_block);
                    for row_block in (0..rows).step_by(BLOCK) {
                        for row in row_block..(row_block + BLOCK).min(rows) {
                            let source = &input[row * columns + first + column_block..][..block];
                            let target = &mut output[column_block * rows + row..];
                            for (value, target) in
                                source.iter().zip(target.iter_mut().step_by(rows))
                            {
                                *target = *value;
                            }
                        }
                    }
                }
            });
    }
    output
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counting(len: usize) -> Vec<f32> {
        (0..len).map(|i| i as f32).collect()
    }

    #[test]
    fn interleaving_and_separating_are_inverse_for_odd_sizes() {
        for shape in [[2, 3, 35], [1, 1, 7], [1, 33, 257], [3, 17, 16]] {
            let planes = counting(shape.iter().product());
            let pixels = interleave(&planes, shape);
            assert_eq!(separate(&pixels, shape), planes);
            let [_, channels, area] = shape;
            assert_eq!(pixels[1 % channels], planes[1 % channels * area]);
        }
    }

    #[test]
    fn a_window_is_zero_outside_of_the_image_and_skips_foreign_channels() {
        let data = counting(2 * 3 * 4);
        let pixels = Pixels {
            channels: 2,
            pixel_stride: 4,
            ..Pixels::dense(&data, [1, 2, 3, 4])
        };
        let mut window = vec![9.0; 3 * 5 * 2];
        pixels.copy_window(0, [-1, -1], [3, 5], &mut window);
        let row = |y: usize| &window[y * 10..(y + 1) * 10];
        assert_eq!(row(0), [0.0; 10]);
        assert_eq!(row(1), [0.0, 0.0, 0.0, 1.0, 4.0, 5.0, 8.0, 9.0, 0.0, 0.0]);
        let low = [0.0, 0.0, 12.0, 13.0, 16.0, 17.0, 20.0, 21.0, 0.0, 0.0];
        assert_eq!(row(2), low);
    }

    #[test]
    fn a_window_beside_the_image_is_all_zero() {
        let data = counting(4);
        let pixels = Pixels::dense(&data, [1, 2, 2, 1]);
        for corner in [[0, 5], [0, -9], [7, 0], [-7, 0]] {
            let mut window = vec![9.0; 4];
            pixels.copy_window(0, corner, [2, 2], &mut window);
            assert_eq!(window, [0.0; 4], "{corner:?}");
        }
    }
}
