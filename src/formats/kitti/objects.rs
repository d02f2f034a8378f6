//! The lines of KITTI's label files.

use super::super::number::finite;
use crate::calibration::HALF_PIXEL;
use crate::geometry::{Cuboid, PixelBox};

/// What KITTI calls a region whose objects were not labelled.
pub(super) const DONT_CARE: &str = "DontCare";

/// One line of a label file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Object {
    /// The class, such as `Car`.
    pub class: String,
    /// How much of it is outside the image, 0 to 1; none where unknown.
    pub truncated: Option<f64>,
    /// 0 visible, 1 partly hidden, 2 largely hidden, 3 unknown.
    pub occluded: u8,
    /// In pixels of this crate.
    pub box_pixel: PixelBox,
    /// In axes of KITTI's reference camera; none for a region without a box in space. Sizes of zero
    /// stand for unknown ones.
    pub cuboid: Option<Cuboid>,
}

impl Object {
    /// Reads a line; the reason against it in words.
    pub fn parse(line: &str) -> Result<Self, String> {
        let words: Vec<&str> = line.split_whitespace().collect();
        // Boxes in the image alone end behind them; results of detectors have a score as the last
        // word.
        if ![8, 15, 16].contains(&words.len()) {
            return Err(format!("has {} words, not 15", words.len()));
        }
        let names = [
            "truncated",
            "occluded",
            "alpha",
            "left",
            "top",
            "right",
            "bottom",
            "height",
            "width",
            "length",
            "x",
            "y",
            "z",
            "rotation_y",
        ];
        // What is not there is as unknown as KITTI writes it.
        let mut numbers = [
            0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, -1.0, -1.0, -1000.0, -1000.0, -1000.0, -10.0,
        ];
        for (number, (word, name)) in numbers.iter_mut().zip(words[1..].iter().zip(names)) {
            *number = finite(word, name)?;
        }
        let [
            truncated,
            occluded,
            _,
            left,
            top,
            right,
            bottom,
            height_m,
            width_m,
            length_m,
            x,
            y,
            z,
            yaw_rad,
        ] = numbers;
        let box_pixel = PixelBox::new(
            left + HALF_PIXEL,
            top + HALF_PIXEL,
            right + HALF_PIXEL,
            bottom + HALF_PIXEL,
        );
        if !box_pixel.is_valid() {
            return Err(format!(
                "the box {left} {top} {right} {bottom} is empty or inverted"
            ));
        }
        let sizes = [height_m, width_m, length_m];
        // KITTI writes -1 for unknown sizes and -1000 for an unknown place; others write 0 for all.
        let all = |numbers: &[f64], value: f64| numbers.iter().all(|&number| number == value);
        let place = [x, y, z];
        let without_size = all(&sizes, -1.0) || all(&sizes, 0.0);
        let without_place = all(&place, -1000.0) || (without_size && all(&place, 0.0));
        if !without_size && sizes.iter().any(|&size| size <= 0.0) {
            return Err(format!(
                "the size {height_m} x {width_m} x {length_m} m is not positive"
            ));
        }
        let [height_m, width_m, length_m] = if without_size { [0.0; 3] } else { sizes };
        Ok(Self {
            class: words[0].to_owned(),
            truncated: (0.0..=1.0).contains(&truncated).then_some(truncated),
            occluded: match occluded {
                v if v == 0.0 || v == 1.0 || v == 2.0 => v as u8,
                _ => 3,
            },
            box_pixel,
            cuboid: (!without_place).then_some(Cuboid {
                center_camera: [x, y - height_m / 2.0, z],
                length_m,
                width_m,
                height_m,
                yaw_rad,
            }),
        })
    }

    /// Reads a label file; the reason against its first bad line.
    pub fn parse_file(text: &str, name: &str) -> Result<Vec<Self>, String> {
        text.lines()
            .enumerate()
            .filter(|(_, line)| !line.trim().is_empty())
            .map(|(index, line)| {
                Self::parse(line).map_err(|why| format!("{name} line {}: {why}", index + 1))
            })
            .collect()
    }

    /// The object as a line of a label file.
    pub fn to_line(&self) -> String {
        let PixelBox {
            x_min,
            y_min,
            x_max,
            y_max,
        } = self.box_pixel;
        let corners = [x_min, y_min, x_max, y_max].map(|v| rounded(v - HALF_PIXEL, 1e4));
        let [left, top, right, bottom] = corners;
        let truncated = self.truncated.unwrap_or(-1.0);
        let (sizes, place, alpha, yaw) = match &self.cuboid {
            None => ([-1.0; 3], [-1000.0; 3], -10.0, -10.0),
            Some(cuboid) => {
                let [x, y, z] = cuboid.center_camera;
                let known = cuboid.height_m > 0.0;
                let sizes = if known {
                    [cuboid.height_m, cuboid.width_m, cuboid.length_m]
                } else {
                    [-1.0; 3]
                };
                let yaw = if known { cuboid.yaw_rad } else { -10.0 };
                // The angle at which the camera sees the object.
                let alpha = if known {
                    yaw - libm::atan2(x, z)
                } else {
                    -10.0
                };
                (sizes, [x, y + cuboid.height_m / 2.0, z], alpha, yaw)
            }
        };
        let [height, width, length] = sizes.map(|v| rounded(v, 1e4));
        // A millionth of a metre: distances come back to the last of their four decimals.
        let [x, y, z] = place.map(|v| rounded(v, 1e6));
        let (alpha, yaw) = (rounded(alpha, 1e4), rounded(yaw, 1e6));
        format!(
            "{} {} {} {alpha} {left} {top} {right} {bottom} {height} {width} {length} {x} {y} {z} {yaw}",
            self.class,
            rounded(truncated, 1e4),
            if self.class == DONT_CARE {
                -1
            } else {
                i32::from(self.occluded)
            },
        )
    }
}

fn rounded(value: f64, scale: f64) -> f64 {
    (value * scale).round() / scale + 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAR: &str = "Car 0.5 1 -1.57 100.25 50 200.5 90 1.5 1.625 4 2.5 1.75 20 1.570796";

    #[test]
    fn an_object_comes_back_from_its_line() {
        let object = Object::parse(CAR).unwrap();
        assert_eq!(object.box_pixel, PixelBox::new(100.75, 50.5, 201.0, 90.5));
        assert_eq!(object.cuboid.unwrap().center_camera, [2.5, 1.0, 20.0]);
        assert_eq!(Object::parse(&object.to_line()), Ok(object));
        let region = "DontCare -1 -1 -10 1 2 3 4 -1 -1 -1 -1000 -1000 -1000 -10";
        let object = Object::parse(region).unwrap();
        assert_eq!((object.cuboid, object.truncated), (None, None));
        assert_eq!(object.to_line(), region);
        let placed = "Car 0 0 -10 1 2 3 4 -1 -1 -1 2.5 1.75 20 -10";
        let object = Object::parse(placed).unwrap();
        assert_eq!(object.cuboid.unwrap().center_camera, [2.5, 1.75, 20.0]);
        assert_eq!(object.to_line(), placed);
    }

    #[test]
    fn lines_of_boxes_in_the_image_alone_say_nothing_of_space() {
        for line in [
            "car 0.00 0 0.00 100.25 50 200.5 90 0.00 0.00 0.00 0.00 0.00 0.00 0.00",
            "car 0 0 -10 100.25 50 200.5 90 -1 -1 -1 -1000 -1000 -1000 -10",
            "car 0 0 -10 100.25 50 200.5 90 -1 -1 -1 -1000 -1000 -1000 -10 0.98",
            "car 0 0 0 100.25 50 200.5 90",
        ] {
            let object = Object::parse(line).unwrap();
            assert_eq!(object.box_pixel, PixelBox::new(100.75, 50.5, 201.0, 90.5));
            assert_eq!((object.cuboid, object.occluded), (None, 0), "{line}");
        }
    }

    #[test]
    fn damaged_lines_are_refused_with_the_reason() {
        for (line, why) in [
            ("Car 0 0 0 1 2 3", "7 words"),
            (&CAR.replace("200.5", "nan"), "right is NaN"),
            (
                &CAR.replace("200.5", "wide"),
                "'wide' is not a value for right",
            ),
            (&CAR.replace("200.5", "99"), "empty or inverted"),
            (&CAR.replace("1.625", "-1.625"), "not positive"),
        ] {
            let reason = Object::parse(line).unwrap_err();
            assert!(reason.contains(why), "{line}: {reason}");
        }
    }
}
