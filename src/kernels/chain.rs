//! Unpadded convolutions one after the other and the twin pooling behind them, a few rows at a time.
//!
//! Each convolution keeps the few rows of its output that the next one still needs, so what lies
//! between the first input and the pooled output never leaves the second-level cache. In the
//! ranging network that is nine tenths of all values.

use std::ops::Range;

use rayon::prelude::*;

use super::epilogue::{Epilogue, SharedOutput, part};
use super::layout::Pixels;
use super::packed::{Algorithm, Packed};
use super::pool::{self, TwinInput};
use super::shape::ConvShape;
use super::windows::Windows;
use super::winograd;

/// Rows that a convolution adds at a time: those of a tile of Winograd's algorithm.
const ROWS: usize = winograd::STEP;
/// Least pooled rows of a task: each task begins its convolutions anew.
const TASK_ROWS: usize = 16;
/// Tasks for every thread, so that all end at about the same time.
const TASKS_PER_THREAD: usize = 4;

/// One convolution: stride 1, no padding, no activation.
#[derive(Debug, Clone, Copy)]
pub struct Link<'a> {
    /// Channels of its output.
    pub channels_out: usize,
    /// Kernel height and width.
    pub kernel: [usize; 2],
    /// Packed by [`super::packed::pack_weights`] for the algorithm that [`Algorithm::of`] names.
    pub weights: &'a [f32],
    /// One value an output channel.
    pub bias: &'a [f32],
}

/// The shapes of the links, one after the other, for whole images.
fn shapes(input: &Pixels, links: &[Link]) -> Vec<ConvShape> {
    let mut size = [input.height, input.width, input.channels];
    links
        .iter()
        .map(|link| {
            let shape = ConvShape {
                batch: input.images,
                channels_in: size[2],
                channels_out: link.channels_out,
                height_in: size[0],
                width_in: size[1],
                kernel: link.kernel,
                stride: 1,
                padding: 0,
                depthwise: false,
            };
            size = [shape.height_out(), shape.width_out(), shape.channels_out];
            shape
        })
        .collect()
}

/// All convolutions, then both poolings: `[2 batch, height / 2, width / 2, channels]` of the last
/// convolution's output, as [`pool::forward`] returns it.
///
/// # Panics
/// Without links, or when the kernels leave nothing of the image.
pub fn forward(input: Pixels, links: &[Link], kind: TwinInput) -> Vec<f32> {
    let shapes = shapes(&input, links);
    let Some(last) = shapes.last() else {
        panic!("a chain has a convolution");
    };
    let (rows, columns) = (last.height_out() / 2, last.width_out() / 2);
    let row_values = columns * last.channels_out;
    let pathway_values = pool::pathway_images(&input, kind) * rows * row_values;
    let mut output = vec![0.0; 2 * pathway_values];
    if output.is_empty() {
        return output;
    }
    let shared = SharedOutput::new(&mut output);
    let wanted = (TASKS_PER_THREAD * rayon::current_num_threads()).div_ceil(input.images);
    let bands = wanted.clamp(1, rows.div_ceil(TASK_ROWS));
    (0..input.images * bands).into_par_iter().for_each(|task| {
        let (image, band) = (task / bands, part(rows, task % bands, bands));
        let mut chain = Chain::new(input, image, links, &shapes, &band);
        for row in band {
            let pooled = chain.pooled_rows(row);
            let start = (image * rows + row) * row_values;
            let targets: [Option<usize>; 2] = match kind {
                TwinInput::Shared => [Some(start), Some(pathway_values + start)],
                TwinInput::Stacked if start < pathway_values => [Some(start), None],
                TwinInput::Stacked => [None, Some(start)],
            };
            let [maxima, means] = targets.map(|start| match start {
                // SAFETY: the row lies inside the output, and belongs to this image and pathway,
                // and so to this task, alone.
                Some(start) => unsafe {
                    std::slice::from_raw_parts_mut(shared.get().add(start), row_values)
                },
                None => &mut [],
            });
            pool::row(&pooled, 0, 0, maxima, means);
        }
    });
    output
}

/// The latest rows of every convolution of one image.
struct Chain<'a> {
    input: Pixels<'a>,
    image: usize,
    stages: Vec<Stage<'a>>,
}

/// One convolution and the rows of its output that are still needed.
struct Stage<'a> {
    /// For the whole image.
    shape: ConvShape,
    algorithm: Algorithm,
    weights: Packed<'a>,
    bias: &'a [f32],
    /// The rows, one behind the other.
    values: Vec<f32>,
    held: Range<usize>,
    /// Rows from here on are not needed.
    limit: usize,
}

impl<'a> Chain<'a> {
    /// A chain that has computed nothing yet, for a band of pooled rows.
    fn new(
        input: Pixels<'a>,
        image: usize,
        links: &[Link<'a>],
        shapes: &[ConvShape],
        band: &Range<usize>,
    ) -> Self {
        let mut limit = 2 * band.end;
        let mut stages: Vec<Stage> = links
            .iter()
            .zip(shapes)
            .rev()
            .map(|(link, &shape)| {
                let algorithm = Algorithm::of(&shape);
                let depth = match algorithm {
                    Algorithm::Winograd => winograd::POINTS * shape.channels_in,
                    Algorithm::Direct | Algorithm::Depthwise => shape.fan_in(),
                };
                let stage = Stage {
                    shape,
                    algorithm,
                    weights: Packed {
                        data: link.weights,
                        channels: shape.channels_out,
                        depth,
                    },
                    bias: link.bias,
                    values: Vec::new(),
                    held: 2 * band.start..2 * band.start,
                    limit,
                };
                limit += shape.kernel[0] - 1;
                stage
            })
            .collect();
        stages.reverse();
        Self {
            input,
            image,
            stages,
        }
    }

    /// The two rows of the last convolution that a pooled row is made of.
    fn pooled_rows(&mut self, row: usize) -> Pixels<'_> {
        advance(
            &mut self.stages,
            &self.input,
            self.image,
            2 * row..2 * row + 2,
        );
        rows(
            self.stages.last(),
            &self.input,
            self.image,
            2 * row..2 * row + 2,
        )
    }
}

/// Some rows that the last of the stages holds; without stages, rows of the input.
fn rows<'s>(
    stage: Option<&'s Stage>,
    input: &Pixels<'s>,
    image: usize,
    rows: Range<usize>,
) -> Pixels<'s> {
    match stage {
        Some(stage) => {
            let (width, channels) = (stage.shape.width_out(), stage.shape.channels_out);
            let start = (rows.start - stage.held.start) * width * channels;
            Pixels::dense(&stage.values[start..], [1, rows.len(), width, channels])
        }
        None => Pixels {
            data: &input.data[input.offset(image, rows.start, 0)..],
            images: 1,
            height: rows.len(),
            ..*input
        },
    }
}

/// Computes rows of the last stage's output up to `wanted.end`; those before `wanted.start` are
/// needed no more.
fn advance(stages: &mut [Stage], input: &Pixels, image: usize, wanted: Range<usize>) {
    let Some((stage, before)) = stages.split_last_mut() else {
        return;
    };
    if stage.held.end >= wanted.end {
        return;
    }
    stage.drop_before(wanted.start);
    while stage.held.end < wanted.end {
        let first = stage.held.end;
        let count = ROWS.min(stage.limit - first);
        let seen = first..first + count + stage.shape.kernel[0] - 1;
        advance(before, input, image, seen.clone());
        stage.add(rows(before.last(), input, image, seen), count);
    }
}

impl Stage<'_> {
    fn row_values(&self) -> usize {
        self.shape.width_out() * self.shape.channels_out
    }

    fn drop_before(&mut self, row: usize) {
        let row = row.clamp(self.held.start, self.held.end);
        let width = self.row_values();
        let gone = (row - self.held.start) * width;
        self.values.copy_within(gone..self.held.len() * width, 0);
        self.held.start = row;
    }

    /// Computes the next rows from the rows that they see.
    fn add(&mut self, input: Pixels, count: usize) {
        let width = self.row_values();
        let len = self.held.len() * width;
        winograd::grow(&mut self.values, len + count * width);
        let shape = ConvShape {
            batch: 1,
            height_in: input.height,
            ..self.shape
        };
        let epilogue = Epilogue {
            bias: Some(self.bias),
            ..Epilogue::default()
        };
        let output = SharedOutput::of(&mut self.values[len..len + count * width]);
        match self.algorithm {
            Algorithm::Winograd => {
                winograd::run_image(&shape, input, self.weights, &epilogue, output);
            }
            Algorithm::Direct | Algorithm::Depthwise => {
                let windows = Windows::forward(&shape);
                windows.run_rows(input, self.weights, &epilogue, 0, 0..count, output);
            }
        }
        self.held.end += count;
    }
}

#[cfg(test)]
mod tests {
    use super::super::conv;
    use super::super::packed::pack_weights;
    use super::*;

    fn numbers(len: usize, seed: u32) -> Vec<f32> {
        (0..len as u32)
            .map(|i| {
                let mixed = (i ^ seed).wrapping_mul(0x9e37_79b9).rotate_left(13);
                (mixed.wrapping_mul(0x85eb_ca6b) >> 8) as f32 / 8_388_608.0 - 1.0
            })
            .collect()
    }

    /// Convolutions as (channels out, kernel size), one after the other on whole images.
    fn check(size: [usize; 4], convolutions: &[(usize, usize)], kind: TwinInput) {
        let values = numbers(size.iter().product(), 1);
        let input = Pixels::dense(&values, size);
        let mut channels = size[3];
        let mut whole = (values.clone(), size);
        let mut parts = Vec::new();
        for (index, &(channels_out, kernel)) in convolutions.iter().enumerate() {
            let shape = ConvShape {
                batch: size[0],
                channels_in: channels,
                channels_out,
                height_in: whole.1[1],
                width_in: whole.1[2],
                kernel: [kernel; 2],
                stride: 1,
                padding: 0,
                depthwise: false,
            };
            let weights = numbers(channels_out * shape.fan_in(), 7 + index as u32);
            let weights = pack_weights(&shape, Algorithm::of(&shape), &weights);
            let bias = numbers(channels_out, 99);
            let epilogue = Epilogue {
                bias: Some(&bias),
                ..Epilogue::default()
            };
            let source = Pixels::dense(&whole.0, whole.1);
            let output = conv::forward(
                &shape,
                Algorithm::of(&shape),
                &[source.into()],
                &weights,
                &epilogue,
            );
            let [height, width] = [shape.height_out(), shape.width_out()];
            whole = (output, [size[0], height, width, channels_out]);
            parts.push((channels_out, kernel, weights, bias));
            channels = channels_out;
        }
        let links: Vec<Link> = parts
            .iter()
            .map(|(channels_out, kernel, weights, bias)| Link {
                channels_out: *channels_out,
                kernel: [*kernel; 2],
                weights,
                bias,
            })
            .collect();
        let expected = pool::forward(Pixels::dense(&whole.0, whole.1), kind);
        let actual = forward(input, &links, kind);
        assert_eq!(actual.len(), expected.len());
        let largest = expected.iter().fold(0.0_f32, |most, x| most.max(x.abs()));
        for (actual, expected) in actual.iter().zip(&expected) {
            assert!(
                (actual - expected).abs() <= 1e-5 * largest,
                "{actual} against {expected} of {largest}"
            );
        }
    }

    #[test]
    fn a_chain_equals_its_convolutions_and_pooling_one_after_the_other() {
        check([1, 60, 21, 3], &[(32, 7)], TwinInput::Shared);
        check([3, 30, 16, 3], &[(9, 5), (10, 3)], TwinInput::Shared);
        let block = [(25, 3), (25, 3), (25, 3)];
        check([2, 101, 23, 32], &block, TwinInput::Stacked);
        check([4, 9, 11, 10], &[(5, 3), (5, 3)], TwinInput::Stacked);
    }

    #[test]
    fn a_chain_that_leaves_less_than_two_rows_pools_to_nothing() {
        let values = numbers(5 * 9 * 3, 1);
        let (weights, bias) = (vec![0.0; 16 * 75], vec![0.0; 1]);
        let link = Link {
            channels_out: 1,
            kernel: [5, 5],
            weights: &weights,
            bias: &bias,
        };
        let input = Pixels::dense(&values, [1, 5, 9, 3]);
        assert!(forward(input, &[link], TwinInput::Shared).is_empty());
    }
}
