//! Weighted, zero-mean, normalised cross-correlation of a patch with a strip of another image.
//!
//! Knows grey values on grids, not cameras or vehicles. A correlation of 1 means equal up to
//! brightness and contrast, 0 means unrelated.

use std::ops::Range;

use image::RgbImage;

/// Values that are summed side by side: a 512-bit vector of floats, or several shorter ones.
const LANES: usize = 16;

/// Share of each colour in the grey value (Rec. 601).
const GREY_FROM_RGB: [f32; 3] = [0.299, 0.587, 0.114];

/// Least variance of grey values that can be compared, in squared 8-bit counts: less than a tenth
/// of a count is rounding, not a picture.
const LEAST_VARIANCE: f64 = 0.01;

/// A grid of points in an image: pixel coordinates of the first point, step and number along x
/// and y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Grid {
    pub first: [f64; 2],
    pub step: [f64; 2],
    pub width: usize,
    pub height: usize,
}

/// Grey values on a grid, less their mean.
///
/// Columns that lie outside the image are 0 and not `visible`; rows outside repeat the nearest row.
#[derive(Debug, Clone)]
pub(crate) struct GreyPlane {
    pub width: usize,
    pub height: usize,
    /// Distance of rows in `values`: at least `LANES` more than `width`, so that whole vectors can
    /// be read at every column.
    stride: usize,
    /// Columns inside the image.
    visible: Range<usize>,
    values: Vec<f32>,
}

impl GreyPlane {
    fn empty(width: usize, height: usize, visible: Range<usize>) -> Self {
        let stride = width + LANES;
        Self {
            width,
            height,
            stride,
            visible: visible.start..visible.end.max(visible.start),
            values: vec![0.0; stride * height],
        }
    }

    /// Samples an image bilinearly.
    pub fn sample(image: &RgbImage, grid: &Grid) -> Self {
        let columns: Vec<Tap> = (0..grid.width)
            .map(|x| Tap::new(grid.first[0] + x as f64 * grid.step[0], image.width()))
            .collect();
        let first = columns.iter().take_while(|tap| !tap.inside).count();
        let inside = columns[first..].iter().take_while(|tap| tap.inside).count();
        let mut plane = Self::empty(grid.width, grid.height, first..first + inside);
        let columns = &columns[plane.visible.clone()];
        let (Some(leftmost), Some(rightmost)) = (columns.first(), columns.last()) else {
            return plane;
        };
        let (source, source_end) = (leftmost.index, rightmost.next + 1);
        let stride = 3 * image.width() as usize;
        let grey_row = |y: usize, grey: &mut [f32]| {
            let row = &image.as_raw()[y * stride + 3 * source..y * stride + 3 * source_end];
            for (grey, rgb) in grey.iter_mut().zip(row.as_chunks::<3>().0) {
                let [red, green, blue] = rgb.map(f32::from);
                let [r, g, b] = GREY_FROM_RGB;
                *grey = r * red + g * green + b * blue;
            }
        };
        let mut above = vec![0.0; source_end - source];
        let mut below = above.clone();
        for y in 0..grid.height {
            let row = Tap::new(grid.first[1] + y as f64 * grid.step[1], image.height());
            grey_row(row.index, &mut above);
            if row.fraction > 0.0 {
                grey_row(row.next, &mut below);
                for (above, below) in above.iter_mut().zip(&below) {
                    *above += row.fraction * (below - *above);
                }
            }
            let out = &mut plane.values[y * plane.stride..][plane.visible.clone()];
            for (out, tap) in out.iter_mut().zip(columns) {
                let (a, b) = (above[tap.index - source], above[tap.next - source]);
                *out = a + tap.fraction * (b - a);
            }
        }
        plane.subtract_mean();
        plane
    }

    /// Single precision holds the spread of the values better without their mean.
    fn subtract_mean(&mut self) {
        let (stride, visible) = (self.stride, self.visible.clone());
        let rows = |values: &[f32]| -> f64 {
            let row_sum = |row: &[f32]| f64::from(row[visible.clone()].iter().sum::<f32>());
            values.chunks_exact(stride).map(row_sum).sum()
        };
        let count = visible.len() * self.height;
        if count == 0 {
            return;
        }
        let mean = (rows(&self.values) / count as f64) as f32;
        for row in self.values.chunks_exact_mut(stride) {
            for value in &mut row[visible.clone()] {
                *value -= mean;
            }
        }
    }

    /// The plane at half the resolution: means of two by two points. An odd last row or column, and
    /// columns that are visible by half, are left out.
    pub fn halved(&self) -> Self {
        let visible = self.visible.start.div_ceil(2)..self.visible.end / 2;
        let mut half = Self::empty(self.width / 2, self.height / 2, visible);
        for y in 0..half.height {
            let [above, below] = [2 * y, 2 * y + 1].map(|y| &self.values[y * self.stride..]);
            for x in half.visible.clone() {
                let sum = above[2 * x] + above[2 * x + 1] + below[2 * x] + below[2 * x + 1];
                half.values[y * half.stride + x] = 0.25 * sum;
            }
        }
        half
    }
}

/// A sample between two neighbours along one axis.
#[derive(Debug, Clone, Copy)]
struct Tap {
    index: usize,
    next: usize,
    fraction: f32,
    /// Whether it lies between the centres of the first and the last pixel.
    inside: bool,
}

impl Tap {
    fn new(pixel: f64, size: u32) -> Self {
        let last = f64::from(size.saturating_sub(1));
        let source = pixel - 0.5;
        let nearest = source.clamp(0.0, last);
        Self {
            index: nearest.floor() as usize,
            next: nearest.ceil() as usize,
            fraction: nearest.fract() as f32,
            inside: (0.0..=last).contains(&source),
        }
    }
}

/// A patch that is looked for, with the weight of each of its points.
#[derive(Debug, Clone)]
pub(crate) struct Template {
    pub width: usize,
    pub height: usize,
    /// Distance of rows: `width` filled up to whole vectors with weight 0.
    stride: usize,
    weights: Vec<f32>,
    /// Weight times grey value, less the weighted mean.
    weighted: Vec<f32>,
    /// Sums of weight, weight x value and weight x value² over all columns before this one.
    sums_before: Vec<[f64; 3]>,
}

impl Template {
    /// A plane, all of it visible, with a weight for each column and for each row. None where the
    /// grey values do not differ.
    ///
    /// # Panics
    /// When there are not as many weights as columns and rows.
    pub fn new(plane: &GreyPlane, [columns, rows]: [&[f32]; 2]) -> Option<Self> {
        let (width, height) = (plane.width, plane.height);
        assert_eq!((columns.len(), rows.len()), (width, height), "weights");
        let weight = |x: usize, y: usize| columns[x] * rows[y];
        Self::window(plane, [0, 0], [width, height], weight)
    }

    /// A part of a plane, all of it visible, from its first point `[x, y]` on, of this width and
    /// height, with a weight for each of its points. None where the grey values do not differ.
    ///
    /// # Panics
    /// When the part reaches out of the plane.
    pub fn window(
        plane: &GreyPlane,
        [left, top]: [usize; 2],
        [width, height]: [usize; 2],
        weight: impl Fn(usize, usize) -> f32,
    ) -> Option<Self> {
        let stride = width.next_multiple_of(LANES);
        let mut weights = vec![0.0; stride * height];
        for (y, row) in weights.chunks_exact_mut(stride).enumerate() {
            for (x, value) in row[..width].iter_mut().enumerate() {
                *value = weight(x, y);
            }
        }
        let value =
            |x: usize, y: usize| f64::from(plane.values[(top + y) * plane.stride + left + x]);
        let weight = |x: usize, y: usize| f64::from(weights[y * stride + x]);
        let (mut total, mut sum) = (0.0, 0.0);
        for y in 0..height {
            for x in 0..width {
                total += weight(x, y);
                sum += weight(x, y) * value(x, y);
            }
        }
        let mean = sum / total;
        let mut weighted = vec![0.0; stride * height];
        let mut sums_before = vec![[0.0; 3]; width + 1];
        let mut running = [0.0; 3];
        for x in 0..width {
            for y in 0..height {
                let centred = value(x, y) - mean;
                let product = weight(x, y) * centred;
                weighted[y * stride + x] = product as f32;
                running[0] += weight(x, y);
                running[1] += product;
                running[2] += product * centred;
            }
            sums_before[x + 1] = running;
        }
        let variance = running[2] / running[0];
        (variance >= LEAST_VARIANCE).then_some(Self {
            width,
            height,
            stride,
            weights,
            weighted,
            sums_before,
        })
    }

    /// Standard deviation of its grey values, 8-bit counts.
    pub fn deviation(&self) -> f64 {
        let [weight, _, squares] = self.sums_before[self.width];
        (squares / weight).sqrt()
    }

    /// Correlation with the part of a plane whose first point is `(x, y)`; only columns that are
    /// visible there count.
    ///
    /// None where the part reaches out of the plane, where visible columns hold less than
    /// `least_visible` of the weight, and where grey values do not differ.
    pub fn correlation(
        &self,
        plane: &GreyPlane,
        x: usize,
        y: usize,
        least_visible: f64,
    ) -> Option<f64> {
        if x + self.width > plane.width || y + self.height > plane.height {
            return None;
        }
        let column = |at: usize| at.saturating_sub(x).min(self.width);
        let before = self.sums_before[column(plane.visible.start)];
        let until = self.sums_before[column(plane.visible.end)];
        let [w, wt, wtt] = std::array::from_fn(|i| until[i] - before[i]);
        if w <= 0.0 || w < least_visible * self.sums_before[self.width][0] {
            return None;
        }
        let [ws, wss, wts] = self.sums(plane, x, y);
        let covariance = wts - wt * ws / w;
        let variance_template = wtt - wt * wt / w;
        let variance_plane = wss - ws * ws / w;
        let least = LEAST_VARIANCE * w;
        (variance_template >= least && variance_plane >= least)
            .then(|| covariance / (variance_template * variance_plane).sqrt())
    }

    /// Sums of weight x s, weight x s² and weight x template x s over the values s of a plane.
    fn sums(&self, plane: &GreyPlane, x: usize, y: usize) -> [f64; 3] {
        let mut lanes = [[0.0_f32; LANES]; 3];
        let rows = self
            .weights
            .chunks_exact(self.stride)
            .zip(self.weighted.chunks_exact(self.stride))
            .enumerate();
        for (row, (weights, weighted)) in rows {
            let values = &plane.values[(y + row) * plane.stride + x..][..self.stride];
            let vectors = weights
                .as_chunks::<LANES>()
                .0
                .iter()
                .zip(weighted.as_chunks::<LANES>().0)
                .zip(values.as_chunks::<LANES>().0);
            let [ws, wss, wts] = &mut lanes;
            for ((weight, weighted), value) in vectors {
                for lane in 0..LANES {
                    let product = weight[lane] * value[lane];
                    ws[lane] += product;
                    wss[lane] += product * value[lane];
                    wts[lane] += weighted[lane] * value[lane];
                }
            }
        }
        lanes.map(|lanes| lanes.iter().map(|&sum| f64::from(sum)).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 21;
    const HEIGHT: usize = 9;

    fn level(x: u32, y: u32) -> u8 {
        ((x * 53 + y * 97 + x * y * 31) % 200) as u8
    }

    fn image(level: impl Fn(u32, u32) -> u8) -> RgbImage {
        RgbImage::from_fn(40, 30, |x, y| image::Rgb([level(x, y); 3]))
    }

    fn plane(image: &RgbImage, first: [f64; 2], width: usize, height: usize) -> GreyPlane {
        let step = [1.0, 1.0];
        GreyPlane::sample(
            image,
            &Grid {
                first,
                step,
                width,
                height,
            },
        )
    }

    fn template() -> Template {
        let patch = plane(&image(level), [8.5, 6.5], WIDTH, HEIGHT);
        Template::new(&patch, [&[1.0; WIDTH], &[0.5; HEIGHT]]).unwrap()
    }

    #[test]
    fn a_patch_equals_itself_and_opposes_its_negative() {
        let template = template();
        for (image, expected) in [
            (image(level), 1.0),
            (image(|x, y| 30 + level(x, y) / 2), 1.0),
            (image(|x, y| 255 - level(x, y)), -1.0),
        ] {
            let whole = plane(&image, [0.5, 0.5], 40, 30);
            let correlation = template.correlation(&whole, 8, 6, 1.0).unwrap();
            // Half the contrast loses half a count to rounding.
            assert!((correlation - expected).abs() < 1e-4, "{correlation}");
            assert!(template.correlation(&whole, 9, 6, 1.0).unwrap().abs() < 0.6);
        }
    }

    #[test]
    fn only_what_is_inside_the_image_counts() {
        let template = template();
        // The patch again, but its first 5 columns would lie left of this image.
        let shifted = image(|x, y| level(x + 13, y));
        let beyond = plane(&shifted, [-9.5, 0.5], 40, 30);
        let correlation = template.correlation(&beyond, 5, 6, 0.5).unwrap();
        assert!((correlation - 1.0).abs() < 1e-5, "{correlation}");
        assert_eq!(template.correlation(&beyond, 5, 6, 0.8), None);
        assert_eq!(template.correlation(&beyond, 20, 6, 0.5), None, "beyond");
    }

    #[test]
    fn plain_grey_correlates_with_nothing() {
        let plain = plane(&image(|_, _| 77), [0.5, 0.5], 40, 30);
        assert_eq!(template().correlation(&plain, 3, 3, 1.0), None);
        let patch = plane(&image(|_, _| 77), [0.5, 0.5], 4, 4);
        assert!(Template::new(&patch, [&[1.0; 4], &[1.0; 4]]).is_none());
    }

    #[test]
    fn halving_averages_two_by_two_points_and_drops_half_visible_columns() {
        let ramp = image(|x, _| 2 * x as u8);
        let half = plane(&ramp, [-0.5, 0.5], 20, 5).halved();
        assert_eq!(
            (half.width, half.height, half.visible.clone()),
            (10, 2, 1..10)
        );
        let differences: Vec<f32> = half.values[1..10].windows(2).map(|w| w[1] - w[0]).collect();
        assert!(
            differences.iter().all(|d| (d - 4.0).abs() < 1e-4),
            "{differences:?}"
        );
        assert_eq!(half.values[0], 0.0);
    }

    #[test]
    fn points_between_pixels_are_interpolated() {
        let ramp = image(|x, y| (2 * x + 3 * y) as u8);
        let [exact, between] = [[4.5, 6.5], [4.75, 6.9]].map(|first| plane(&ramp, first, 6, 4));
        for (a, b) in exact.values.iter().zip(&between.values) {
            assert!(
                (a - b).abs() < 1e-4,
                "a ramp less its mean is the same everywhere"
            );
        }
    }
}
