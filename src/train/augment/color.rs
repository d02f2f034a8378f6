//! Random changes of hue, saturation and value.

/// A change of colours.
#[derive(Debug, Clone, Copy)]
pub struct Recolor {
    /// Turn of the hue, sixths of the circle.
    turn: f32,
    /// Factor of the saturation.
    saturation: f32,
    /// Factor of the value.
    value: f32,
}

impl Recolor {
    /// Turns the hue by a share of the circle, at most once around, and scales saturation and value
    /// by one and a share.
    pub fn new(gains: [f64; 3]) -> Self {
        let [hue, saturation, value] = gains.map(|gain| gain as f32);
        Self {
            turn: 6.0 * hue,
            saturation: 1.0 + saturation,
            value: 1.0 + value,
        }
    }

    /// Changes red, green and blue values of 0..255 and brings them to 0..1.
    #[inline(always)]
    pub fn apply(self, [red, green, blue]: [&mut [f32]; 3]) {
        for ((red, green), blue) in red.iter_mut().zip(green).zip(blue) {
            [*red, *green, *blue] = self.changed([*red / 255.0, *green / 255.0, *blue / 255.0]);
        }
    }

    /// Without a branch, so that it can be vectorised.
    #[inline(always)]
    fn changed(self, [r, g, b]: [f32; 3]) -> [f32; 3] {
        let largest = r.max(g).max(b);
        let chroma = largest - r.min(g).min(b);
        let brightness = (largest * self.value).clamp(0.0, 1.0);
        // Numbers without meaning where all three are the same; they are not used then.
        let sector = if largest == r {
            wrapped((g - b) / chroma)
        } else if largest == g {
            (b - r) / chroma + 2.0
        } else {
            (r - g) / chroma + 4.0
        };
        let sector = wrapped(sector + self.turn);
        let strength = (chroma / largest * self.saturation).clamp(0.0, 1.0);
        // The usual closed form: each channel is a clipped triangle wave of the hue.
        [5.0, 3.0, 1.0].map(|phase: f32| {
            let k = wrapped(phase + sector);
            let changed = brightness * (1.0 - strength * k.min(4.0 - k).clamp(0.0, 1.0));
            if chroma > 0.0 { changed } else { brightness }
        })
    }
}

/// A position on the circle of six sectors, brought into 0..=6 from less than once around outside.
#[inline(always)]
fn wrapped(sector: f32) -> f32 {
    if sector < 0.0 {
        sector + 6.0
    } else if sector >= 6.0 {
        sector - 6.0
    } else {
        sector
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_survive_a_change_of_nothing_and_a_full_turn_of_the_hue() {
        for color in [
            [0.1, 0.5, 0.9],
            [0.9, 0.2, 0.2],
            [0.3, 0.3, 0.3],
            [0.0, 0.8, 0.1],
            [0.0, 0.0, 0.0],
        ] {
            for hue in [-1.0, 0.0, 1.0] {
                let changed = Recolor::new([hue, 0.0, 0.0]).changed(color);
                for (a, b) in changed.iter().zip(color) {
                    assert!((a - b).abs() < 1e-5, "{changed:?} {color:?}");
                }
            }
        }
    }

    #[test]
    fn a_third_of_a_turn_moves_every_channel_on_by_one() {
        let [r, g, b] = [0.2, 0.9, 0.5];
        let changed = Recolor::new([1.0 / 3.0, 0.0, 0.0]).changed([r, g, b]);
        for (a, b) in changed.iter().zip([b, r, g]) {
            assert!((a - b).abs() < 1e-5, "{changed:?}");
        }
    }

    #[test]
    fn no_saturation_leaves_grey_and_no_value_black() {
        let grey = Recolor::new([0.1, -1.0, 0.0]).changed([0.2, 0.9, 0.5]);
        assert_eq!(grey, [0.9; 3]);
        let black = Recolor::new([0.1, 0.0, -1.0]).changed([0.2, 0.9, 0.5]);
        assert_eq!(black, [0.0; 3]);
    }
}
