//! Grey images in floating point, for finding and comparing points in them.

use image::RgbImage;

/// Share of each colour in the grey value (Rec. 601).
const GREY_FROM_RGB: [f32; 3] = [0.299, 0.587, 0.114];

/// Grey values, 0 to 255, row by row; places are counted from the centre of the first pixel.
#[derive(Debug, Clone)]
pub(super) struct Grey {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f32>,
}

impl Grey {
    pub fn of(image: &RgbImage) -> Self {
        let grey = |rgb: &[u8; 3]| {
            let products = rgb.iter().zip(GREY_FROM_RGB);
            products.map(|(value, part)| f32::from(*value) * part).sum()
        };
        Self {
            width: image.width() as usize,
            height: image.height() as usize,
            values: image.as_raw().as_chunks::<3>().0.iter().map(grey).collect(),
        }
    }

    pub fn row(&self, y: usize) -> &[f32] {
        &self.values[y * self.width..][..self.width]
    }

    /// At half the resolution: means of two by two pixels, an odd last row or column left out.
    pub fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut values = Vec::with_capacity(width * height);
        for y in 0..height {
            let (above, below) = (self.row(2 * y), self.row(2 * y + 1));
            let pairs = above
                .as_chunks::<2>()
                .0
                .iter()
                .zip(below.as_chunks::<2>().0);
            values.extend(pairs.map(|([a, b], [c, d])| 0.25 * (a + b + c + d)));
        }
        Self {
            width,
            height,
            values,
        }
    }

    /// Smoothed by 1 2 1 along both axes: what lies between pixels can be interpolated then.
    pub fn smoothed(&self) -> Self {
        let along_x = self.filtered(|y, x| {
            let row = self.row(y);
            let (before, after) = (x.saturating_sub(1), (x + 1).min(self.width - 1));
            0.25 * (row[before] + row[after]) + 0.5 * row[x]
        });
        along_x.filtered(|y, x| {
            let (above, below) = (y.saturating_sub(1), (y + 1).min(self.height - 1));
            0.25 * (along_x.row(above)[x] + along_x.row(below)[x]) + 0.5 * along_x.row(y)[x]
        })
    }

    /// How fast values change to the right and down, per pixel.
    pub fn gradients(&self) -> [Self; 2] {
        let along_x = self.filtered(|y, x| {
            let row = self.row(y);
            0.5 * (row[(x + 1).min(self.width - 1)] - row[x.saturating_sub(1)])
        });
        let along_y = self.filtered(|y, x| {
            let (above, below) = (y.saturating_sub(1), (y + 1).min(self.height - 1));
            0.5 * (self.row(below)[x] - self.row(above)[x])
        });
        [along_x, along_y]
    }

    fn filtered(&self, value: impl Fn(usize, usize) -> f32) -> Self {
        let value = &value;
        let values = (0..self.height)
            .flat_map(|y| (0..self.width).map(move |x| value(y, x)))
            .collect();
        Self { values, ..*self }
    }

    /// Whether a square of this radius around a place, and a pixel more, lies in the image.
    pub fn holds(&self, [x, y]: [f64; 2], radius: usize) -> bool {
        let margin = (radius + 1) as f64;
        x >= margin
            && y >= margin
            && x <= self.width as f64 - 1.0 - margin
            && y <= self.height as f64 - 1.0 - margin
    }
}

/// Where a place lies between four pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tap {
    index: usize,
    weights: [f32; 4],
}

impl Tap {
    /// Of a place inside an image of this width; it must not lie in the last row or column.
    pub fn new([x, y]: [f64; 2], width: usize) -> Self {
        let (column, row) = (x.floor(), y.floor());
        let (fx, fy) = ((x - column) as f32, (y - row) as f32);
        Self {
            index: row as usize * width + column as usize,
            weights: [
                (1.0 - fx) * (1.0 - fy),
                fx * (1.0 - fy),
                (1.0 - fx) * fy,
                fx * fy,
            ],
        }
    }

    /// The bilinear value there.
    pub fn value(&self, grey: &Grey) -> f32 {
        let above = &grey.values[self.index..self.index + 2];
        let below = &grey.values[self.index + grey.width..][..2];
        let [a, b, c, d] = self.weights;
        a * above[0] + b * above[1] + c * below[0] + d * below[1]
    }
}
