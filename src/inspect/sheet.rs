//! The sheet of samples: one picture.

use image::{Rgb, RgbImage, imageops};

use super::samples::Row;
use crate::annotate::write_text;

/// Room between samples, pixels.
const GAP: u32 = 8;

/// Height of a line of text with its room, pixels.
const LINE: u32 = 24;

const PAPER: Rgb<u8> = Rgb([245; 3]);
const INK: Rgb<u8> = Rgb([30; 3]);

/// All rows below each other, each under its title, every sample above its caption.
pub(super) fn compose(rows: &[Row]) -> RgbImage {
    let samples = || rows.iter().flat_map(|row| &row.samples);
    let columns = rows.iter().map(|row| row.samples.len()).max().unwrap_or(1) as u32;
    let sample_width = samples()
        .map(|sample| sample.picture.width())
        .max()
        .unwrap_or(1);
    let heights: Vec<u32> = rows
        .iter()
        .map(|row| {
            row.samples
                .iter()
                .map(|s| s.picture.height())
                .max()
                .unwrap_or(0)
        })
        .collect();
    let width = GAP + columns * (sample_width + GAP);
    let height: u32 = GAP
        + heights
            .iter()
            .map(|height| height + 2 * LINE + GAP)
            .sum::<u32>();
    let mut sheet = RgbImage::from_pixel(width, height, PAPER);
    let mut top = GAP;
    for (row, height) in rows.iter().zip(heights) {
        write_text(
            &mut sheet,
            [i64::from(GAP), i64::from(top) + 2],
            &row.title,
            2,
            INK,
        );
        top += LINE;
        for (column, sample) in (0..).zip(&row.samples) {
            let left = i64::from(GAP + column * (sample_width + GAP));
            imageops::replace(&mut sheet, &sample.picture, left, i64::from(top));
            let below = i64::from(top + height) + 5;
            write_text(&mut sheet, [left, below], &sample.caption, 1, INK);
        }
        top += height + LINE + GAP;
    }
    sheet
}
