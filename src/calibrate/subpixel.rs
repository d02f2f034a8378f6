//! Places found to a few hundredths of a pixel.
//!
//! Gauss and Newton's method moves a window over the other image until the grey values agree best
//! (Lucas, Kanade 1981), up to brightness and contrast. Surfaces are seldom square to the cameras, so
//! the window may also be stretched along x and sheared along it from row to row.

use super::grey::{Grey, Tap};
use super::linear::{Cholesky, add_outer};

/// Radius of the window, pixels.
pub(super) const RADIUS: usize = 7;

/// Standard deviation of the Gaussian that weighs the window's pixels, pixels.
const SPREAD_PX: f64 = 4.0;

/// Steps after which a search that has not settled is given up.
const MOST_STEPS: usize = 15;

/// A step shorter than this is the last one, pixels.
const SETTLED_PX: f64 = 0.003;

/// A window that moves further than this from where it was found belongs to something else, pixels.
const FARTHEST_PX: f64 = 1.5;

/// Standard deviation of the stretch and of the shear that surfaces give, parts.
const SLOPES: [f64; 2] = [0.1, 0.2];

/// An image that windows are moved over.
#[derive(Debug)]
pub(super) struct Surface {
    pub grey: Grey,
    /// Along x and y.
    pub gradients: [Grey; 2],
}

impl Surface {
    pub fn new(grey: &Grey) -> Self {
        let grey = grey.smoothed();
        let gradients = grey.gradients();
        Self { grey, gradients }
    }
}

/// A place and how well it is known.
#[derive(Debug, Clone, Copy)]
pub(super) struct Refined {
    pub place: [f64; 2],
    /// Standard deviation along x and y by the window's noise and texture, pixels.
    pub std: [f64; 2],
}

/// Where in `target` the surroundings of `place` in `template` lie, from a first guess. None where
/// that leads out of the image, nowhere or away.
pub(super) fn refine(
    template: &Surface,
    place: [f64; 2],
    target: &Surface,
    guess: [f64; 2],
) -> Option<Refined> {
    if !template.grey.holds(place, RADIUS) {
        return None;
    }
    let window = Window::new(&template.grey, place);
    // Place, stretch and shear along x, contrast, brightness.
    let mut state = [guess[0], guess[1], 0.0, 0.0, 1.0, 0.0];
    for _ in 0..MOST_STEPS {
        let equations = window.equations(target, &state)?;
        let cholesky = Cholesky::new(&equations.matrix)?;
        let step = cholesky.solve(&equations.right);
        for (value, step) in state.iter_mut().zip(&step) {
            *value += step;
        }
        let moved = (state[0] - guess[0]).hypot(state[1] - guess[1]);
        // Not a number is not near either.
        if !(moved <= FARTHEST_PX && (0.3..3.0).contains(&state[4])) {
            return None;
        }
        if step[0].hypot(step[1]) < SETTLED_PX {
            let inverse = cholesky.inverse();
            return Some(Refined {
                place: [state[0], state[1]],
                std: [0, 1].map(|i| (inverse[i][i] * equations.variance).sqrt()),
            });
        }
    }
    None
}

/// The pixels of a template's window.
struct Window {
    /// Offset along x and y, weight, grey value.
    pixels: Vec<[f64; 4]>,
    weight: f64,
}

struct Equations {
    matrix: [[f64; 6]; 6],
    right: [f64; 6],
    /// Of the grey values' differences.
    variance: f64,
}

impl Window {
    fn new(grey: &Grey, [x, y]: [f64; 2]) -> Self {
        let radius = RADIUS as i32;
        let mut pixels = Vec::with_capacity((2 * RADIUS + 1) * (2 * RADIUS + 1));
        for row in -radius..=radius {
            for column in -radius..=radius {
                let (i, j) = (f64::from(column), f64::from(row));
                let weight = libm::exp(-0.5 * (i * i + j * j) / (SPREAD_PX * SPREAD_PX));
                let value = Tap::new([x + i, y + j], grey.width).value(grey);
                pixels.push([i, j, weight, f64::from(value)]);
            }
        }
        let weight = pixels.iter().map(|pixel| pixel[2]).sum();
        Self { pixels, weight }
    }

    fn equations(&self, target: &Surface, state: &[f64; 6]) -> Option<Equations> {
        let [x, y, stretch, shear, contrast, brightness] = *state;
        let reach = RADIUS as f64;
        let wide = reach * (stretch.abs() + shear.abs());
        if !target.grey.holds([x, y], RADIUS + wide.ceil() as usize) {
            return None;
        }
        let mut matrix = [[0.0; 6]; 6];
        let mut right = [0.0; 6];
        let mut squares = 0.0;
        for &[i, j, weight, value] in &self.pixels {
            let place = [x + i + stretch * i + shear * j, y + j];
            let tap = Tap::new(place, target.grey.width);
            let seen = f64::from(tap.value(&target.grey));
            let [along_x, along_y] = target
                .gradients
                .each_ref()
                .map(|gradient| contrast * f64::from(tap.value(gradient)));
            let slopes = [along_x, along_y, along_x * i, along_x * j, seen, 1.0];
            let difference = value - contrast * seen - brightness;
            add_outer(&mut matrix, &slopes, weight);
            for (right, slope) in right.iter_mut().zip(slopes) {
                *right += weight * slope * difference;
            }
            squares += weight * difference * difference;
        }
        let variance = squares / self.weight;
        for (i, (spread, value)) in SLOPES.iter().zip([stretch, shear]).enumerate() {
            // A grey value's variance, at least one of rounding, is the unit of the sums.
            let information = variance.max(1.0) / (spread * spread);
            matrix[2 + i][2 + i] += information;
            right[2 + i] -= information * value;
        }
        Some(Equations {
            matrix,
            right,
            variance,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, RgbImage};

    /// A lively pattern, sampled where `place` says.
    fn surface(place: impl Fn(f64, f64) -> [f64; 2]) -> Surface {
        let image = RgbImage::from_fn(60, 50, |x, y| {
            let [x, y] = place(f64::from(x), f64::from(y));
            let wave = |a: f64, b: f64, phase: f64| libm::sin(a * x + b * y + phase);
            let sum = wave(0.7, 0.2, 0.0) + wave(-0.3, 0.8, 1.0) + wave(0.5, 0.55, 2.0);
            Rgb([(128.0 + 35.0 * sum).round() as u8; 3])
        });
        Surface::new(&Grey::of(&image))
    }

    #[test]
    fn a_shift_is_found_to_a_hundredth_of_a_pixel() {
        let template = surface(|x, y| [x, y]);
        for [dx, dy] in [[0.0, 0.0], [0.3, -0.4], [-0.75, 0.5], [0.5, 0.5]] {
            let target = surface(|x, y| [x - dx, 0.9 * 0.0 + y - dy]);
            let found = refine(&template, [30.0, 25.0], &target, [30.0, 25.0]).unwrap();
            let [x, y] = found.place;
            assert!((x - 30.0 - dx).abs() < 0.015, "{x} for {dx}");
            assert!((y - 25.0 - dy).abs() < 0.015, "{y} for {dy}");
            assert!(found.std.iter().all(|std| *std < 0.02), "{:?}", found.std);
        }
    }

    #[test]
    fn a_slanted_surface_is_found_at_its_middle() {
        let template = surface(|x, y| [x, y]);
        // The target is the template stretched by 5 % and sheared by 0.1 around (30, 25).
        let target = surface(|x, y| {
            let y0 = y - 0.2;
            [30.0 + ((x - 30.4) - 0.1 * (y0 - 25.0)) / 1.05, y0]
        });
        let found = refine(&template, [30.0, 25.0], &target, [30.0, 25.0]).unwrap();
        assert!((found.place[0] - 30.4).abs() < 0.02, "{:?}", found.place);
        assert!((found.place[1] - 25.2).abs() < 0.02, "{:?}", found.place);
    }

    #[test]
    fn windows_that_leave_the_image_or_lead_away_are_not_found() {
        let template = surface(|x, y| [x, y]);
        assert!(refine(&template, [6.0, 25.0], &template, [30.0, 25.0]).is_none());
        assert!(refine(&template, [30.0, 25.0], &template, [55.0, 25.0]).is_none());
        let far = surface(|x, y| [x - 2.5, y]);
        assert!(refine(&template, [30.0, 25.0], &far, [30.0, 25.0]).is_none());
    }
}
