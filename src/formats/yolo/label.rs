//! The lines of YOLO's label files.

use super::super::number::{finite, whole};
use crate::geometry::PixelBox;

/// Boxes may reach this far over the image's border before they are called wrong, as a fraction of
/// the image: rounding does that.
const OVER_BORDER: f64 = 0.01;

/// One line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct YoloLabel {
    pub class: u32,
    /// Pixels.
    pub box_pixel: PixelBox,
    /// Metres.
    pub distance_m: Option<f64>,
}

impl YoloLabel {
    /// Reads a line; the reason against it in words.
    pub fn parse(line: &str, [width, height]: [u32; 2]) -> Result<Self, String> {
        let mut words = line.split_whitespace();
        let class = whole(words.next().unwrap_or_default(), "the class")?;
        let numbers = words
            .map(|word| finite(word, "a coordinate"))
            .collect::<Result<Vec<f64>, String>>()?;
        let (edges, distance_m) = match numbers[..] {
            [x, y, w, h] => (box_of(x, y, w, h), None),
            [x, y, w, h, distance_m] => (box_of(x, y, w, h), Some(distance_m)),
            ref points if points.len() >= 6 && points.len() % 2 == 0 => (around(points), None),
            _ => return Err(format!("has {} numbers after the class", numbers.len())),
        };
        let [x_min, y_min, x_max, y_max] = edges;
        let inside = -OVER_BORDER..=1.0 + OVER_BORDER;
        if x_max <= x_min || y_max <= y_min {
            return Err("the box has no size".to_owned());
        }
        if edges.iter().any(|edge| !inside.contains(edge)) {
            return Err(
                "the box reaches out of the image: YOLO's numbers are fractions".to_owned(),
            );
        }
        if let Some(distance_m) = distance_m.filter(|&distance_m| distance_m <= 0.0) {
            return Err(format!("the distance is {distance_m} m"));
        }
        let (width, height) = (f64::from(width), f64::from(height));
        Ok(Self {
            class,
            box_pixel: PixelBox::new(x_min * width, y_min * height, x_max * width, y_max * height)
                .clipped(width, height),
            distance_m,
        })
    }

    /// The label as a line.
    pub fn to_line(self, [width, height]: [u32; 2]) -> String {
        // A billionth of the image: boxes come back to the last of their four decimals.
        let short = |value: f64| (value * 1e9).round() / 1e9;
        let (width, height) = (f64::from(width), f64::from(height));
        let [x, y] = self.box_pixel.center();
        let numbers = [
            x / width,
            y / height,
            self.box_pixel.width() / width,
            self.box_pixel.height() / height,
        ]
        .map(short);
        let [x, y, w, h] = numbers;
        let line = format!("{} {x} {y} {w} {h}", self.class);
        match self.distance_m {
            Some(distance_m) => format!("{line} {}", (distance_m * 1e4).round() / 1e4),
            None => line,
        }
    }
}

fn box_of(x: f64, y: f64, w: f64, h: f64) -> [f64; 4] {
    [x - w / 2.0, y - h / 2.0, x + w / 2.0, y + h / 2.0]
}

/// The box around a polygon's corners.
fn around(points: &[f64]) -> [f64; 4] {
    let axis = |start: usize| points.iter().skip(start).step_by(2).copied();
    let least = |start| axis(start).fold(f64::INFINITY, f64::min);
    let most = |start| axis(start).fold(f64::NEG_INFINITY, f64::max);
    [least(0), least(1), most(0), most(1)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_label_comes_back_from_its_line_to_a_ten_thousandth_of_a_pixel() {
        let size = [2048, 1152];
        for distance_m in [None, Some(57.1234)] {
            let label = YoloLabel {
                class: 2,
                box_pixel: PixelBox::new(0.0, 1.2345, 1234.5678, 1152.0),
                distance_m,
            };
            let back = YoloLabel::parse(&label.to_line(size), size).unwrap();
            assert_eq!((back.class, back.distance_m), (2, distance_m));
            let edges = |b: PixelBox| [b.x_min, b.y_min, b.x_max, b.y_max];
            for (a, b) in edges(back.box_pixel).iter().zip(edges(label.box_pixel)) {
                assert!((a - b).abs() < 2e-5, "{a} {b}");
            }
        }
    }

    #[test]
    fn a_polygon_becomes_the_box_around_it() {
        let label = YoloLabel::parse("0 0.1 0.2 0.5 0.1 0.3 0.4", [100, 100]).unwrap();
        assert_eq!(label.box_pixel, PixelBox::new(10.0, 10.0, 50.0, 40.0));
    }

    #[test]
    fn damaged_lines_are_refused_with_the_reason() {
        for (line, why) in [
            ("car 0.5 0.5 0.1 0.1", "not a value for the class"),
            ("0 0.5 0.5 0.1", "3 numbers"),
            ("0 0.5 0.5 nan 0.1", "NaN"),
            ("0 0.5 0.5 -0.1 0.1", "no size"),
            ("0 320 200 50 40", "fractions"),
            ("0 0.5 0.5 0.1 0.1 0", "distance is 0"),
        ] {
            let reason = YoloLabel::parse(line, [640, 360]).unwrap_err();
            assert!(reason.contains(why), "{line}: {reason}");
        }
    }
}
