//! The twin pooling of the ranging network on slices: 2x2 windows, by maximum for one pathway and
//! by average for the other, then ReLU.

use rayon::prelude::*;

use super::simd;

/// Where the two pathways take their input from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TwinInput {
    /// Both pool the same `[batch, ..]`.
    Shared,
    /// The first half of `[2 batch, ..]` is pooled by maximum, the second by average.
    Stacked,
}

/// Extent of the pooled planes.
#[derive(Debug, Clone, Copy)]
pub struct TwinShape {
    /// Planes of the input: images times channels.
    pub planes: usize,
    /// Height and width of an input plane.
    pub size: [usize; 2],
    /// Where the pathways' input is.
    pub input: TwinInput,
}

impl TwinShape {
    /// Height and width of an output plane; incomplete windows are dropped.
    pub fn pooled(&self) -> [usize; 2] {
        self.size.map(|side| side / 2)
    }

    /// Planes of each pathway.
    fn pathway(&self) -> usize {
        match self.input {
            TwinInput::Shared => self.planes,
            TwinInput::Stacked => self.planes / 2,
        }
    }
}

/// Pools both pathways: planes of the maximum pathway, then of the average pathway.
pub fn forward(shape: &TwinShape, input: &[f32]) -> Vec<f32> {
    let [height, width] = shape.size;
    let [rows, columns] = shape.pooled();
    let pathway = shape.pathway();
    let mut output = vec![0.0; 2 * pathway * rows * columns];
    output
        .par_chunks_exact_mut(rows * columns)
        .enumerate()
        .for_each(|(plane, output)| {
            let source = if shape.input == TwinInput::Shared {
                plane % pathway
            } else {
                plane
            };
            let input = &input[source * height * width..][..height * width];
            simd::vectorized(|| {
                for (y, row) in output.chunks_exact_mut(columns).enumerate() {
                    let upper = &input[2 * y * width..][..2 * columns];
                    let lower = &input[(2 * y + 1) * width..][..2 * columns];
                    let (upper, _) = upper.as_chunks::<2>();
                    let (lower, _) = lower.as_chunks::<2>();
                    for ((value, a), b) in row.iter_mut().zip(upper).zip(lower) {
                        *value = if plane < pathway {
                            a[0].max(a[1]).max(b[0]).max(b[1]).max(0.0)
                        } else {
                            (0.25 * (a[0] + a[1] + b[0] + b[1])).max(0.0)
                        };
                    }
                }
            });
        });
    output
}

/// Gradient of the input. The maximum's gradient goes to the first largest value of the window;
/// windows whose result the ReLU cut pass nothing on.
pub fn backward(shape: &TwinShape, input: &[f32], grad: &[f32]) -> Vec<f32> {
    let [height, width] = shape.size;
    let [rows, columns] = shape.pooled();
    let pathway = shape.pathway();
    let area = rows * columns;
    let mut output = vec![0.0; shape.planes * height * width];
    output
        .par_chunks_exact_mut(height * width)
        .enumerate()
        .for_each(|(plane, output)| {
            let input = &input[plane * height * width..][..height * width];
            let shared = shape.input == TwinInput::Shared;
            let maximum = (shared || plane < pathway).then(|| &grad[plane * area..][..area]);
            let average = if shared {
                Some(pathway + plane)
            } else {
                (plane >= pathway).then_some(plane)
            };
            let average = average.map(|plane| &grad[plane * area..][..area]);
            simd::vectorized(|| {
                for y in 0..rows {
                    let (upper, lower) = output[2 * y * width..][..2 * width].split_at_mut(width);
                    let (upper, _) = upper[..2 * columns].as_chunks_mut::<2>();
                    let (lower, _) = lower[..2 * columns].as_chunks_mut::<2>();
                    let (a, _) = input[2 * y * width..][..2 * columns].as_chunks::<2>();
                    let (b, _) = input[(2 * y + 1) * width..][..2 * columns].as_chunks::<2>();
                    if let Some(grad) = maximum {
                        let grad = &grad[y * columns..][..columns];
                        for x in 0..columns {
                            let window = [a[x][0], a[x][1], b[x][0], b[x][1]];
                            let largest = window[0].max(window[1]).max(window[2]).max(window[3]);
                            let g = if largest > 0.0 { grad[x] } else { 0.0 };
                            let first = window[0] >= largest;
                            let second = !first && window[1] >= largest;
                            let third = !first && !second && window[2] >= largest;
                            let fourth = !(first || second || third);
                            upper[x][0] += if first { g } else { 0.0 };
                            upper[x][1] += if second { g } else { 0.0 };
                            lower[x][0] += if third { g } else { 0.0 };
                            lower[x][1] += if fourth { g } else { 0.0 };
                        }
                    }
                    if let Some(grad) = average {
                        let grad = &grad[y * columns..][..columns];
                        for x in 0..columns {
                            let mean = a[x][0] + a[x][1] + b[x][0] + b[x][1];
                            let g = if mean > 0.0 { 0.25 * grad[x] } else { 0.0 };
                            upper[x]
                                .iter_mut()
                                .chain(&mut lower[x])
                                .for_each(|value| *value += g);
                        }
                    }
                }
            });
        });
    output
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_gives_its_maximum_and_its_mean_and_odd_edges_are_dropped() {
        let shape = TwinShape {
            planes: 1,
            size: [3, 3],
            input: TwinInput::Shared,
        };
        let input = [1.0, 4.0, 9.0, -3.0, 2.0, 9.0, 9.0, 9.0, 9.0];
        assert_eq!(forward(&shape, &input), vec![4.0, 1.0]);
        let grad = backward(&shape, &input, &[10.0, 4.0]);
        assert_eq!(grad, vec![1.0, 11.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn a_window_below_zero_passes_no_gradient() {
        let shape = TwinShape {
            planes: 2,
            size: [2, 2],
            input: TwinInput::Stacked,
        };
        let input = [-1.0; 8];
        assert_eq!(forward(&shape, &input), vec![0.0, 0.0]);
        assert_eq!(backward(&shape, &input, &[1.0, 1.0]), vec![0.0; 8]);
    }
}
