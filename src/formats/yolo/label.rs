//! The lines of YOLO's label files.

use super::super::number::{finite, whole};
use super::data_yaml::Keypoints;
use crate::geometry::PixelBox;

/// Centres and sizes of boxes beyond this many images are pixels and no fractions. Boxes reach over
/// the border where rounding or augmentation put them; that part is cut off.
const FARTHEST: f64 = 2.0;

/// What the numbers of a line are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct LineShape {
    /// Behind the box come key points.
    pub keypoints: Option<Keypoints>,
    /// Behind the box comes a distance.
    pub distance_column: bool,
}

/// One line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct YoloLabel {
    pub class: u32,
    /// Pixels.
    pub box_pixel: PixelBox,
    /// Metres.
    pub distance_m: Option<f64>,
}

/// What a line says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Line {
    /// An object, and whether a number behind it was taken for a confidence.
    Object(YoloLabel, bool),
    /// Nothing that can be seen, for this reason.
    Nothing(&'static str),
}

impl YoloLabel {
    /// Reads a line; the reason against it in words.
    pub fn parse(line: &str, shape: LineShape, [width, height]: [u32; 2]) -> Result<Line, String> {
        let mut words = line.split_whitespace();
        let class = whole(words.next().unwrap_or_default(), "the class")?;
        let numbers = words
            .map(|word| finite(word, "a coordinate"))
            .collect::<Result<Vec<f64>, String>>()?;
        let (edges, sixth) = match shape.keypoints {
            Some(keypoints) => keypoint_box(&numbers, keypoints)?,
            None => plain_box(&numbers)?,
        };
        let [x_min, y_min, x_max, y_max] = edges;
        if x_max < x_min || y_max < y_min {
            return Err("the box has no size".to_owned());
        }
        let distance_m = sixth.filter(|_| shape.distance_column);
        if let Some(distance_m) = distance_m.filter(|&distance_m| distance_m <= 0.0) {
            return Err(format!("the distance is {distance_m} m"));
        }
        if edges.iter().any(|edge| edge.abs() > FARTHEST) {
            return Err(
                "the box reaches far out of the image: YOLO's numbers are fractions".to_owned(),
            );
        }
        if x_max == x_min || y_max == y_min {
            return Ok(Line::Nothing("a box has no size"));
        }
        let (width, height) = (f64::from(width), f64::from(height));
        let box_pixel = PixelBox::new(x_min * width, y_min * height, x_max * width, y_max * height)
            .clipped(width, height);
        if !box_pixel.is_valid() {
            return Ok(Line::Nothing("a box lies outside of the image"));
        }
        let label = Self {
            class,
            box_pixel,
            distance_m,
        };
        Ok(Line::Object(label, sixth.is_some() && distance_m.is_none()))
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

/// Edges of a box, and the number behind it.
type EdgesAndSixth = ([f64; 4], Option<f64>);

/// A box with one number more or none, or a polygon.
fn plain_box(numbers: &[f64]) -> Result<EdgesAndSixth, String> {
    match *numbers {
        [x, y, w, h] => Ok((box_of(x, y, w, h), None)),
        [x, y, w, h, sixth] => Ok((box_of(x, y, w, h), Some(sixth))),
        // Trackers write their confidence and the number of the track behind the box; a polygon has
        // no corner that far out.
        [x, y, w, h, sixth, track] if track > 1.0 && track.fract() == 0.0 => {
            Ok((box_of(x, y, w, h), Some(sixth)))
        }
        [_, _, _, _, _, _, ..] if numbers.len().is_multiple_of(2) => Ok((around(numbers), None)),
        [_, _, _, _, _, _, ..] if are_seen_points(&numbers[4..]) => Err(format!(
            "has {} numbers after the class, which look like a box and key points: then data.yaml \
             needs kpt_shape",
            numbers.len()
        )),
        // A polygon and its confidence.
        [ref corners @ .., sixth] if corners.len() >= 6 => Ok((around(corners), Some(sixth))),
        _ => Err(format!("has {} numbers after the class", numbers.len())),
    }
}

/// Whether numbers could be key points, each with 0, 1 or 2 for how it is seen.
fn are_seen_points(numbers: &[f64]) -> bool {
    let (points, rest) = numbers.as_chunks::<3>();
    rest.is_empty()
        && points
            .iter()
            .all(|[_, _, seen]| [0.0, 1.0, 2.0].contains(seen))
}

/// A box, its key points where it has them, and one number more or none.
fn keypoint_box(numbers: &[f64], keypoints: Keypoints) -> Result<EdgesAndSixth, String> {
    let fits = |count: usize| match keypoints {
        Keypoints::Numbers(expected) => count == expected,
        Keypoints::Points(points) => count == 2 * points || count == 3 * points,
    };
    let [x, y, w, h, ref rest @ ..] = *numbers else {
        return Err(format!("has {} numbers after the class", numbers.len()));
    };
    let edges = box_of(x, y, w, h);
    match rest {
        [] => Ok((edges, None)),
        _ if fits(rest.len()) => Ok((edges, None)),
        [sixth] => Ok((edges, Some(*sixth))),
        [.., last] if fits(rest.len() - 1) => Ok((edges, Some(*last))),
        _ => Err(format!(
            "has {} numbers after the class, which are not a box and the key points of data.yaml",
            numbers.len()
        )),
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

    const DISTANCE: LineShape = LineShape {
        keypoints: None,
        distance_column: true,
    };

    fn label(line: &str, shape: LineShape, size: [u32; 2]) -> (YoloLabel, bool) {
        match YoloLabel::parse(line, shape, size).unwrap() {
            Line::Object(label, has_confidence) => (label, has_confidence),
            Line::Nothing(reason) => panic!("{line}: {reason}"),
        }
    }

    #[test]
    fn a_label_comes_back_from_its_line_to_a_ten_thousandth_of_a_pixel() {
        let size = [2048, 1152];
        for distance_m in [None, Some(57.1234)] {
            let written = YoloLabel {
                class: 2,
                box_pixel: PixelBox::new(0.0, 1.2345, 1234.5678, 1152.0),
                distance_m,
            };
            let (back, _) = label(&written.to_line(size), DISTANCE, size);
            assert_eq!((back.class, back.distance_m), (2, distance_m));
            let edges = |b: PixelBox| [b.x_min, b.y_min, b.x_max, b.y_max];
            for (a, b) in edges(back.box_pixel).iter().zip(edges(written.box_pixel)) {
                assert!((a - b).abs() < 2e-5, "{a} {b}");
            }
        }
    }

    #[test]
    fn a_polygon_becomes_the_box_around_it() {
        let (label, _) = label("0 0.1 0.2 0.5 0.1 0.3 0.4", DISTANCE, [100, 100]);
        assert_eq!(label.box_pixel, PixelBox::new(10.0, 10.0, 50.0, 40.0));
    }

    #[test]
    fn key_points_are_no_polygon_where_data_yaml_speaks_of_them() {
        let line = "0 0.5 0.5 0.25 0.25 0.45 0.45 0.55 0.45 0.55 0.55 0.45 0.55";
        let shape = |keypoints| LineShape {
            keypoints: Some(keypoints),
            distance_column: false,
        };
        let whole = PixelBox::new(37.5, 37.5, 62.5, 62.5);
        for keypoints in [Keypoints::Numbers(8), Keypoints::Points(4)] {
            let found = label(line, shape(keypoints), [100, 100]);
            assert_eq!((found.0.box_pixel, found.1), (whole, false));
            // Behind them, or without them, a confidence.
            for scored in [&format!("{line} 0.9"), "0 0.5 0.5 0.25 0.25 0.9"] {
                let found = label(scored, shape(keypoints), [100, 100]);
                assert_eq!((found.0.box_pixel, found.1), (whole, true));
            }
        }
        let visible = "0 0.5 0.5 0.25 0.25 0.45 0.45 2 0.55 0.45 1";
        for keypoints in [Keypoints::Numbers(6), Keypoints::Points(2)] {
            let found = label(visible, shape(keypoints), [100, 100]);
            assert_eq!(found.0.box_pixel, whole);
        }
        let wrong = YoloLabel::parse(line, shape(Keypoints::Numbers(6)), [100, 100]);
        assert!(wrong.unwrap_err().contains("12 numbers"));
        let unsaid = YoloLabel::parse("0 0.5 0.5 0.2 0.2 0.4 0.4 2", DISTANCE, [100, 100]);
        assert!(unsaid.unwrap_err().contains("kpt_shape"));
    }

    #[test]
    fn a_sixth_number_is_a_distance_only_where_that_is_said() {
        let line = "0 0.5 0.5 0.25 0.25 0.873";
        let (plain, has_confidence) = label(line, LineShape::default(), [64, 48]);
        assert_eq!((plain.distance_m, has_confidence), (None, true));
        let (told, has_confidence) = label(line, DISTANCE, [64, 48]);
        assert_eq!((told.distance_m, has_confidence), (Some(0.873), false));
    }

    #[test]
    fn what_detectors_and_trackers_write_behind_boxes_and_polygons_is_no_corner() {
        let size = [100, 100];
        let middle = PixelBox::new(40.0, 40.0, 60.0, 60.0);
        let found = label("0 0.5 0.5 0.2 0.2 0.873 7", LineShape::default(), size);
        assert_eq!((found.0.box_pixel, found.1), (middle, true));
        let found = label("0 0.1 0.2 0.5 0.1 0.3 0.4 0.91", LineShape::default(), size);
        let around = PixelBox::new(10.0, 10.0, 50.0, 40.0);
        assert_eq!((found.0.box_pixel, found.1), (around, true));
        // A corner at the border stays one.
        let found = label("0 0.1 0.2 0.5 0.1 0.3 1", LineShape::default(), size);
        assert_eq!(found.0.box_pixel, PixelBox::new(10.0, 10.0, 50.0, 100.0));
    }

    #[test]
    fn classes_as_floats_are_read_and_boxes_over_the_border_are_cut_off() {
        let size = [100, 100];
        let shape = LineShape::default();
        let (found, _) = label("1.000e+00 0.97 0.5 0.2 2.0e-1", shape, size);
        assert_eq!(found.class, 1);
        let expected = PixelBox::new(87.0, 40.0, 100.0, 60.0);
        assert!(found.box_pixel.iou(&expected) > 0.999_999);
        for (line, why) in [
            ("0 0.5 0.5 0 0.2", "no size"),
            ("0 1.3 0.5 0.2 0.2", "outside"),
            ("0 -0.3 0.5 0.2 0.2", "outside"),
        ] {
            let nothing = YoloLabel::parse(line, shape, size).unwrap();
            assert!(matches!(nothing, Line::Nothing(reason) if reason.contains(why)));
        }
    }

    #[test]
    fn damaged_lines_are_refused_with_the_reason() {
        for (line, why) in [
            ("car 0.5 0.5 0.1 0.1", "not a value for the class"),
            ("0.5 0.5 0.5 0.1 0.1", "not a value for the class"),
            ("-1 0.5 0.5 0.1 0.1", "not a value for the class"),
            ("0 0.5 0.5 0.1", "3 numbers"),
            ("0 0.5 0.5 nan 0.1", "NaN"),
            ("0 0.5 0.5 -0.1 0.1", "no size"),
            ("0 320 200 50 40", "fractions"),
            ("0 0.5 0.5 0.1 0.1 0", "distance is 0"),
        ] {
            let reason = YoloLabel::parse(line, DISTANCE, [640, 360]).unwrap_err();
            assert!(reason.contains(why), "{line}: {reason}");
        }
    }

    #[test]
    fn damaged_lines_are_refused_or_read_and_nothing_else() {
        let seeds: [&[u8]; 4] = [
            b"0 0.5 0.5 0.25 0.25 0.873",
            b"3.0 1e-1 0.2 0.5 0.1 0.3 0.4",
            b"0 0.5 0.5 0.25 0.25 0.45 0.45 0.55 0.45 0.55 0.55 0.45 0.55",
            b"1 0.97 0.5 0.2 0.2",
        ];
        let shapes = [
            None,
            Some(Keypoints::Numbers(8)),
            Some(Keypoints::Points(4)),
        ];
        crate::mutate::damaged(&seeds, |bytes| {
            let text = String::from_utf8_lossy(bytes);
            for keypoints in shapes {
                let shape = LineShape {
                    keypoints,
                    distance_column: bytes.len() % 2 == 0,
                };
                if let Ok(Line::Object(label, _)) = YoloLabel::parse(&text, shape, [96, 64]) {
                    let inside = label.box_pixel.clipped(96.0, 64.0);
                    assert!(inside.is_valid() && inside == label.box_pixel);
                }
            }
        });
    }
}
