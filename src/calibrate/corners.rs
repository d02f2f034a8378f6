//! Corners: points whose surroundings change along both axes, so that they can be found again
//! exactly (Shi, Tomasi: "Good features to track", 1994).

use super::grey::Grey;

/// Radius of the square whose gradients are summed, pixels.
const RADIUS: usize = 3;

/// Least eigenvalue of the mean product of gradients, squared grey values per pixel: two and a half
/// counts in the weaker direction, above the noise of cameras and of JPEG.
const LEAST_STRENGTH: f32 = 6.0;

/// Corners keep this distance from each other, pixels.
const APART: usize = 4;

/// Parts of the image, along x and y, that each get their share of corners.
const CELLS: [usize; 2] = [24, 12];

/// The strongest corners of an image, spread over it: at most `most`, and none nearer to the border
/// than `margin`. Places of pixels.
pub(super) fn corners(
    [along_x, along_y]: &[Grey; 2],
    most: usize,
    margin: usize,
) -> Vec<[usize; 2]> {
    let (width, height) = (along_x.width, along_x.height);
    let margin = margin.max(RADIUS + 1);
    if width <= 2 * margin + 2 * APART || height <= 2 * margin + 2 * APART {
        return Vec::new();
    }
    let strengths = strengths(along_x, along_y);
    let mut cells: Vec<Vec<(f32, [usize; 2])>> = vec![Vec::new(); CELLS[0] * CELLS[1]];
    for y in margin..height - margin {
        for x in margin..width - margin {
            let strength = strengths[y * width + x];
            if strength < LEAST_STRENGTH || !is_peak(&strengths, width, [x, y]) {
                continue;
            }
            let cell = (y * CELLS[1] / height) * CELLS[0] + x * CELLS[0] / width;
            cells[cell].push((strength, [x, y]));
        }
    }
    let share = most.div_ceil(cells.len()).max(1);
    for cell in &mut cells {
        cell.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        cell.truncate(share);
    }
    cells
        .into_iter()
        .flatten()
        .map(|(_, place)| place)
        .collect()
}

/// Whether no pixel nearby is stronger; of equals the first one wins.
fn is_peak(strengths: &[f32], width: usize, [x, y]: [usize; 2]) -> bool {
    let own = strengths[y * width + x];
    (y - APART..=y + APART).all(|row| {
        (x - APART..=x + APART).all(|column| {
            let other = strengths[row * width + column];
            other < own || (other == own && (row, column) >= (y, x))
        })
    })
}

/// The smaller eigenvalue of the mean products of gradients around each pixel; 0 near the border.
fn strengths(along_x: &Grey, along_y: &Grey) -> Vec<f32> {
    let (width, height) = (along_x.width, along_x.height);
    let products = |a: &Grey, b: &Grey| -> Vec<f32> {
        let values = a.values.iter().zip(&b.values).map(|(a, b)| a * b);
        box_means(&values.collect::<Vec<f32>>(), width, height)
    };
    let (xx, xy, yy) = (
        products(along_x, along_x),
        products(along_x, along_y),
        products(along_y, along_y),
    );
    xx.iter()
        .zip(&xy)
        .zip(&yy)
        .map(|((xx, xy), yy)| {
            let half = 0.5 * (xx - yy);
            0.5 * (xx + yy) - (half * half + xy * xy).sqrt()
        })
        .collect()
}

/// Means over squares, rows first; 0 where the square reaches out of the image.
fn box_means(values: &[f32], width: usize, height: usize) -> Vec<f32> {
    let side = 2 * RADIUS + 1;
    let mut rows = vec![0.0; values.len()];
    for (out, row) in rows.chunks_exact_mut(width).zip(values.chunks_exact(width)) {
        for (out, part) in out[RADIUS..].iter_mut().zip(row.windows(side)) {
            *out = part.iter().sum();
        }
    }
    let mut means = vec![0.0; values.len()];
    let scale = 1.0 / (side * side) as f32;
    for y in RADIUS..height.saturating_sub(RADIUS) {
        for part in y - RADIUS..=y + RADIUS {
            let out = &mut means[y * width..][..width];
            for (out, value) in out.iter_mut().zip(&rows[part * width..][..width]) {
                *out += scale * value;
            }
        }
    }
    means
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, RgbImage};

    fn found(level: impl Fn(u32, u32) -> u8) -> Vec<[usize; 2]> {
        let image = RgbImage::from_fn(120, 90, |x, y| Rgb([level(x, y); 3]));
        corners(&Grey::of(&image).smoothed().gradients(), 500, 10)
    }

    #[test]
    fn the_corners_of_a_square_are_found_and_its_edges_are_not() {
        let inside = |x: u32, y: u32| (40..80).contains(&x) && (30..60).contains(&y);
        let places = found(|x, y| if inside(x, y) { 200 } else { 50 });
        assert_eq!(places.len(), 4, "{places:?}");
        for [x, y] in places {
            let near = |v: usize, ends: [usize; 2]| ends.iter().any(|end| v.abs_diff(*end) <= 3);
            assert!(near(x, [40, 79]) && near(y, [30, 59]), "{x}, {y}");
        }
    }

    #[test]
    fn plain_areas_edges_and_ramps_have_no_corners() {
        assert!(found(|_, _| 90).is_empty());
        assert!(found(|x, _| if x < 60 { 20 } else { 220 }).is_empty());
        assert!(found(|x, y| (x + y) as u8).is_empty());
    }

    #[test]
    fn corners_are_spread_over_the_image() {
        // Strong contrast on the left, weak contrast on the right.
        let chance = |x: u32, y: u32| (x / 5 * 7919 + y / 5 * 104_729) % 13;
        let places = found(|x, y| (100 + chance(x, y) * if x < 60 { 10 } else { 3 }) as u8);
        let right = places.iter().filter(|[x, _]| *x >= 60).count();
        assert!(3 * right > places.len(), "{right} of {}", places.len());
    }
}
