//! Where an image lies on the canvas, and its pixels there.

use std::ops::Range;

use pulp::Simd;

use super::Scene;
use super::color::Recolor;
use crate::error::Result;
use crate::geometry::PixelBox;
use crate::geometry::letterbox::{Enlarging, Frame, Letterbox, Size};
use crate::kernels::simd::dispatch;

/// A scene laid on a canvas that is then zoomed, shifted and mirrored into the network's input.
pub struct Tile<'a> {
    /// The scene.
    pub scene: Scene<'a>,
    /// Canvas pixels per image pixel.
    scale: [f64; 2],
    /// Where the image's first corner lies on the canvas.
    corner: [f64; 2],
    /// The part of the canvas that it may fill.
    area: PixelBox,
}

impl<'a> Tile<'a> {
    /// The plain letterbox: the canvas is the network's input.
    ///
    /// # Errors
    /// An image of impossible size.
    pub fn letterboxed(scene: Scene<'a>, input: Size) -> Result<Self> {
        let original = Size::new(scene.image.width(), scene.image.height());
        let letterbox = Letterbox::new(original, input, Frame::Exact, Enlarging::Allowed)?;
        Ok(Self {
            scene,
            scale: [
                f64::from(letterbox.resized.width) / f64::from(original.width),
                f64::from(letterbox.resized.height) / f64::from(original.height),
            ],
            corner: [f64::from(letterbox.left), f64::from(letterbox.top)],
            area: PixelBox::new(
                f64::NEG_INFINITY,
                f64::NEG_INFINITY,
                f64::INFINITY,
                f64::INFINITY,
            ),
        })
    }

    /// One of the four parts of a mosaic: column and row 0 or 1, touching the centre with its
    /// nearest corner. The canvas is twice the input and has its middle where the input's is.
    pub fn of_mosaic(scene: Scene<'a>, input: Size, center: [f64; 2], part: [bool; 2]) -> Self {
        let sides = [f64::from(input.width), f64::from(input.height)];
        let original = [
            f64::from(scene.image.width()),
            f64::from(scene.image.height()),
        ];
        let scale = (sides[0] / original[0]).min(sides[1] / original[1]);
        let mut corner = center;
        let mut area = [[0.0; 2]; 2];
        for axis in 0..2 {
            let (start, end) = (-sides[axis] / 2.0, 1.5 * sides[axis]);
            area[axis] = if part[axis] {
                [center[axis], end]
            } else {
                corner[axis] -= scale * original[axis];
                [start, center[axis]]
            };
        }
        let [x, y] = area;
        Self {
            scene,
            scale: [scale, scale],
            corner,
            area: PixelBox::new(x[0], y[0], x[1], y[1]),
        }
    }

    /// A box on the canvas, cut at the edges of the part that the scene may fill.
    pub fn canvas_from_image(&self, area: &PixelBox) -> PixelBox {
        let at = |value: f64, axis: usize| value * self.scale[axis] + self.corner[axis];
        let limit = &self.area;
        PixelBox::new(
            at(area.x_min, 0).max(limit.x_min),
            at(area.y_min, 1).max(limit.y_min),
            at(area.x_max, 0).min(limit.x_max),
            at(area.y_max, 1).min(limit.y_max),
        )
    }

    /// The two image columns between which each canvas column lies that shows this image: those in
    /// the range, of `canvas_x` in order, rising or falling.
    pub fn columns(&self, canvas_x: &[f64]) -> Columns {
        let (limits, width) = ([self.area.x_min, self.area.x_max], self.scene.image.width());
        let between: Vec<Option<Between>> = canvas_x
            .iter()
            .map(|&x| self.between(x, 0, limits, width))
            .collect();
        let start = between.iter().take_while(|column| column.is_none()).count();
        let inside: Vec<Between> = between.into_iter().flatten().collect();
        Columns {
            range: start..start + inside.len(),
            bytes: inside.iter().map(|b| [3 * b.first, 3 * b.second]).collect(),
            shares: inside.iter().map(|b| b.share).collect(),
        }
    }

    /// The two image rows between which a canvas row lies, where it shows this image.
    pub fn rows(&self, canvas_y: f64) -> Option<ImageRows<'a>> {
        let limits = [self.area.y_min, self.area.y_max];
        let image = self.scene.image;
        let between = self.between(canvas_y, 1, limits, image.height())?;
        let bytes = 3 * image.width() as usize;
        let row = |row: usize| &image.as_raw()[row * bytes..][..bytes];
        Some(ImageRows {
            above: row(between.first),
            below: row(between.second),
            share: between.share,
        })
    }

    fn between(&self, canvas: f64, axis: usize, limits: [f64; 2], length: u32) -> Option<Between> {
        let at = (canvas - self.corner[axis]) / self.scale[axis];
        let shown = canvas >= limits[0] && canvas < limits[1] && at >= 0.0 && at < length.into();
        shown.then(|| {
            let at = (at - 0.5).max(0.0) as f32;
            let first = at as usize;
            Between {
                first,
                second: (first + 1).min(length as usize - 1),
                share: at - first as f32,
            }
        })
    }
}

/// Two neighbouring rows or columns of an image, and the second one's share.
struct Between {
    first: usize,
    second: usize,
    share: f32,
}

/// Columns of the input that show an image.
pub struct Columns {
    range: Range<usize>,
    /// First bytes of the two image columns, in an image row.
    bytes: Vec<[usize; 2]>,
    /// The second column's share.
    shares: Vec<f32>,
}

/// Two rows of an image, and the second one's share.
pub struct ImageRows<'a> {
    above: &'a [u8],
    below: &'a [u8],
    share: f32,
}

/// A row of the input: images between grey, bilinear, then recoloured into 0..1.
pub struct Row<'a> {
    /// Its red, green and blue values.
    pub channels: [&'a mut [f32]; 3],
    /// The images in it.
    pub images: &'a [(&'a Columns, ImageRows<'a>)],
    /// What is done to its colours.
    pub recolor: Recolor,
    /// What lies outside all images, as a byte.
    pub grey: f32,
}

impl Row<'_> {
    /// Fills the channels.
    pub fn draw(self) {
        dispatch(self);
    }
}

impl pulp::WithSimd for Row<'_> {
    type Output = ();

    /// The compiler vectorises the colours for the width that this is compiled for.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            mut channels,
            images,
            recolor,
            grey,
        } = self;
        for channel in &mut channels {
            channel.fill(grey);
        }
        for (columns, rows) in images {
            let [red, green, blue] = channels
                .each_mut()
                .map(|channel| &mut channel[columns.range.clone()]);
            let targets = red.iter_mut().zip(green).zip(blue);
            let places = columns.bytes.iter().zip(&columns.shares);
            for (((red, green), blue), (&bytes, &share)) in targets.zip(places) {
                [*red, *green, *blue] = bilinear(rows, bytes, share);
            }
        }
        recolor.apply(channels);
    }
}

/// The colour between four pixels, in bytes.
#[inline(always)]
fn bilinear(rows: &ImageRows, [left, right]: [usize; 2], share: f32) -> [f32; 3] {
    let pixel = |row: &[u8], byte: usize| {
        let pixel = &row[byte..byte + 3];
        [pixel[0], pixel[1], pixel[2]].map(f32::from)
    };
    let (a, b) = (pixel(rows.above, left), pixel(rows.above, right));
    let (c, d) = (pixel(rows.below, left), pixel(rows.below, right));
    std::array::from_fn(|channel| {
        let upper = a[channel] + share * (b[channel] - a[channel]);
        let lower = c[channel] + share * (d[channel] - c[channel]);
        upper + rows.share * (lower - upper)
    })
}
