//! Whole-pixel search for a patch in another image by normalised cross-correlation.

use super::grey::Grey;

/// Radius of the patch that is compared, pixels.
pub(super) const RADIUS: usize = 5;

const SIDE: usize = 2 * RADIUS + 1;

const COUNT: f64 = (SIDE * SIDE) as f64;

/// Least spread of a patch's grey values, counts: less is noise.
const LEAST_SPREAD: f64 = 1.0;

/// Columns on both sides of a peak that belong to it.
const PEAK: usize = 2;

/// A grey image prepared for comparisons.
#[derive(Debug)]
pub(super) struct Plane {
    pub grey: Grey,
    /// One over the norm of the patch around each pixel, less its mean; 0 where it has no texture or
    /// reaches out of the image.
    inverse_norms: Vec<f32>,
}

/// A patch, less its mean, of norm 1.
#[derive(Debug)]
pub(super) struct Patch([[f32; SIDE]; SIDE]);

/// Where to look: whole pixels, both ends included.
#[derive(Debug, Clone, Copy)]
pub(super) struct Range {
    pub columns: [i64; 2],
    pub rows: [i64; 2],
}

impl Range {
    /// The places around one, this far along each axis.
    pub fn around([x, y]: [usize; 2], reach: i64) -> Self {
        let (x, y) = (x as i64, y as i64);
        Self {
            columns: [x - reach, x + reach],
            rows: [y - reach, y + reach],
        }
    }
}

/// The most alike place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub place: [usize; 2],
    /// -1 to 1.
    pub correlation: f32,
    /// The best correlation in columns that do not belong to the same peak.
    pub rival: f32,
}

impl Plane {
    pub fn new(grey: Grey) -> Self {
        let (width, height) = (grey.width, grey.height);
        let mut inverse_norms = vec![0.0; width * height];
        if width < SIDE || height < SIDE {
            return Self {
                grey,
                inverse_norms,
            };
        }
        // Sums over the columns of a patch's rows, kept up to date from row to row.
        let mut sums = vec![[0.0_f64; 2]; width];
        let add = |sums: &mut [[f64; 2]], row: &[f32], sign: f64| {
            for (sums, value) in sums.iter_mut().zip(row) {
                let value = f64::from(*value);
                sums[0] += sign * value;
                sums[1] += sign * value * value;
            }
        };
        for y in 0..height {
            add(&mut sums, grey.row(y), 1.0);
            if y + 1 < SIDE {
                continue;
            }
            let out = &mut inverse_norms[(y - RADIUS) * width + RADIUS..];
            for (out, columns) in out.iter_mut().zip(sums.windows(SIDE)) {
                let sum: f64 = columns.iter().map(|column| column[0]).sum();
                let squares: f64 = columns.iter().map(|column| column[1]).sum();
                let variance = squares - sum * sum / COUNT;
                if variance >= LEAST_SPREAD * LEAST_SPREAD * COUNT {
                    *out = (1.0 / variance.sqrt()) as f32;
                }
            }
            add(&mut sums, grey.row(y + 1 - SIDE), -1.0);
        }
        Self {
            grey,
            inverse_norms,
        }
    }

    /// The patch around a place; None without texture or too near to the border.
    pub fn patch(&self, [x, y]: [usize; 2]) -> Option<Patch> {
        let inverse_norm = *self.inverse_norms.get(y * self.grey.width + x)?;
        if inverse_norm == 0.0 {
            return None;
        }
        let mut patch = [[0.0; SIDE]; SIDE];
        for (row, part) in patch.iter_mut().enumerate() {
            let values = &self.grey.row(y + row - RADIUS)[x - RADIUS..];
            part.copy_from_slice(values.first_chunk::<SIDE>()?);
        }
        let sum: f64 = patch.iter().flatten().map(|value| f64::from(*value)).sum();
        let mean = (sum / COUNT) as f32;
        for value in patch.iter_mut().flatten() {
            *value = (*value - mean) * inverse_norm;
        }
        Some(Patch(patch))
    }

    /// The place most alike a patch; None where nothing there can be compared.
    pub fn find(&self, patch: &Patch, range: Range) -> Option<Found> {
        let within = |[low, high]: [i64; 2], side: usize| {
            let low = low.max(RADIUS as i64) as usize;
            let high = high.min(side as i64 - 1 - RADIUS as i64);
            (high >= low as i64).then(|| low..high as usize + 1)
        };
        let columns = within(range.columns, self.grey.width)?;
        let rows = within(range.rows, self.grey.height)?;
        let mut best = vec![(f32::NEG_INFINITY, 0); columns.len()];
        for y in rows {
            for (best, x) in best.iter_mut().zip(columns.clone()) {
                let correlation = self.correlation(patch, [x, y]);
                if correlation > best.0 {
                    *best = (correlation, y);
                }
            }
        }
        let (index, &(correlation, row)) = best
            .iter()
            .enumerate()
            .max_by(|(_, (a, _)), (_, (b, _))| a.total_cmp(b))?;
        let others = best.iter().enumerate();
        let rival = others
            .filter(|(other, _)| other.abs_diff(index) > PEAK)
            .map(|(_, (correlation, _))| *correlation)
            .fold(f32::NEG_INFINITY, f32::max);
        (correlation > 0.0).then_some(Found {
            place: [columns.start + index, row],
            correlation,
            rival,
        })
    }

    fn correlation(&self, patch: &Patch, [x, y]: [usize; 2]) -> f32 {
        let width = self.grey.width;
        let inverse_norm = self.inverse_norms[y * width + x];
        if inverse_norm == 0.0 {
            return 0.0;
        }
        let mut sums = [0.0_f32; SIDE];
        for (row, part) in patch.0.iter().enumerate() {
            let start = (y + row - RADIUS) * width + x - RADIUS;
            if let Some(values) = self.grey.values[start..].first_chunk::<SIDE>() {
                for ((sum, a), b) in sums.iter_mut().zip(part).zip(values) {
                    *sum += a * b;
                }
            }
        }
        sums.iter().sum::<f32>() * inverse_norm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, RgbImage};

    fn plane(level: impl Fn(u32, u32) -> u8) -> Plane {
        let image = RgbImage::from_fn(90, 40, |x, y| Rgb([level(x, y); 3]));
        Plane::new(Grey::of(&image))
    }

    fn noise(x: u32, y: u32) -> u8 {
        ((x * 53 + y * 97 + x * y * 31) % 200) as u8
    }

    const WHOLE: Range = Range {
        columns: [-100, 200],
        rows: [-9, 99],
    };

    #[test]
    fn a_patch_is_found_where_it_lies_whatever_the_brightness() {
        let patch = plane(noise).patch([40, 20]).unwrap();
        let found = plane(|x, y| 20 + noise(x + 13, y + 2) / 2).find(&patch, WHOLE);
        let found = found.unwrap();
        assert_eq!(found.place, [27, 18]);
        assert!(found.correlation > 0.999 && found.rival < 0.7, "{found:?}");
    }

    #[test]
    fn a_patch_that_repeats_has_a_rival() {
        let stripes = |x: u32, y: u32| noise(x % 20, y);
        let found = plane(stripes).find(&plane(stripes).patch([45, 20]).unwrap(), WHOLE);
        assert!(found.unwrap().rival > 0.999);
    }

    #[test]
    fn plain_grey_is_neither_a_patch_nor_found() {
        let plain = plane(|_, _| 80);
        assert!(plain.patch([40, 20]).is_none());
        let patch = plane(noise).patch([40, 20]).unwrap();
        assert!(plain.find(&patch, WHOLE).is_none());
        let narrow = Range::around([2, 2], 1);
        assert!(plane(noise).find(&patch, narrow).is_none(), "at the border");
    }
}
