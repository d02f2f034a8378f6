//! Polygons in pixels, such as the region of an image that matters.

use std::str::FromStr;

use crate::error::{Error, Result};

/// More corners than anybody draws.
const MOST_CORNERS: usize = 10_000;

/// No image reaches further, pixels.
const LARGEST_PIXEL: f64 = 1e6;

/// What a polygon may look like.
const REMEDY: &str =
    "write at least three corners as x,y in pixels, such as \"0,200 640,200 640,360\"";

/// A polygon of at least three corners with a positive area.
///
/// Where its edges cross each other, the even-odd rule says what is inside: a point from which a
/// ray crosses the outline an odd number of times.
///
/// ```
/// use twinsight::geometry::Polygon;
///
/// # fn main() -> twinsight::Result<()> {
/// let road: Polygon = "0,200 640,200 640,360 0,360".parse()?;
/// assert!(road.contains([320.0, 300.0]));
/// assert!(!road.contains([320.0, 100.0]));
/// assert!("0,200 640,200".parse::<Polygon>().is_err());
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Polygon {
    corners: Vec<[f64; 2]>,
}

impl Polygon {
    /// The polygon with these corners (x, y), pixels, in the order of its outline.
    ///
    /// # Errors
    /// Fewer than three corners, more than 10,000, numbers that are not finite or beyond every
    /// image, or no area.
    pub fn new(corners: Vec<[f64; 2]>) -> Result<Self> {
        let refuse = |problem: String| Err(Error::value("polygon", problem, REMEDY));
        if !(3..=MOST_CORNERS).contains(&corners.len()) {
            return refuse(format!("has {} corners", corners.len()));
        }
        let is_usable = |v: &f64| v.is_finite() && v.abs() <= LARGEST_PIXEL;
        if let Some([x, y]) = corners.iter().find(|corner| !corner.iter().all(is_usable)) {
            return refuse(format!("has a corner at {x},{y}, outside of every image"));
        }
        let polygon = Self { corners };
        let [low, high] = polygon.bounds();
        let is_flat = |[a, b]: [&[f64; 2]; 2]| {
            let first = polygon.corners[0];
            let (u, v) = (
                [a[0] - first[0], a[1] - first[1]],
                [b[0] - first[0], b[1] - first[1]],
            );
            (u[0] * v[1] - u[1] * v[0]).abs() < 1e-9
        };
        let all_flat = polygon
            .corners
            .windows(2)
            .all(|pair| is_flat([&pair[0], &pair[1]]));
        if all_flat || low[0] >= high[0] || low[1] >= high[1] {
            return refuse("has no area".to_owned());
        }
        Ok(polygon)
    }

    /// The corners, pixels.
    pub fn corners(&self) -> &[[f64; 2]] {
        &self.corners
    }

    /// Smallest and largest (x, y) of all corners.
    pub fn bounds(&self) -> [[f64; 2]; 2] {
        let extreme = |axis: usize, choose: fn(f64, f64) -> f64, from: f64| {
            self.corners
                .iter()
                .map(|corner| corner[axis])
                .fold(from, choose)
        };
        [
            [0, 1].map(|axis| extreme(axis, f64::min, f64::INFINITY)),
            [0, 1].map(|axis| extreme(axis, f64::max, f64::NEG_INFINITY)),
        ]
    }

    /// Whether any part of the polygon's bounds lies inside an image of this size.
    pub fn reaches_into(&self, width: u32, height: u32) -> bool {
        let [low, high] = self.bounds();
        low[0] < f64::from(width) && low[1] < f64::from(height) && high[0] > 0.0 && high[1] > 0.0
    }

    /// Whether a point (x, y) lies inside.
    pub fn contains(&self, [x, y]: [f64; 2]) -> bool {
        let mut is_inside = false;
        let mut before = self.corners[self.corners.len() - 1];
        for &corner in &self.corners {
            // Half-open in y, so that a corner on the ray counts for one of its two edges.
            if (corner[1] > y) != (before[1] > y) {
                let share = (y - corner[1]) / (before[1] - corner[1]);
                if x < corner[0] + share * (before[0] - corner[0]) {
                    is_inside = !is_inside;
                }
            }
            before = corner;
        }
        is_inside
    }
}

impl FromStr for Polygon {
    type Err = Error;

    /// Reads corners `x,y` divided by blanks, lines or semicolons, or a JSON list of `[x, y]`.
    /// What follows a `#` in a line is a comment.
    fn from_str(text: &str) -> Result<Self> {
        if text.trim_start().starts_with('[') {
            let corners = serde_json::from_str(text).map_err(|error| {
                Error::value("polygon", format!("is no list of [x, y]: {error}"), REMEDY)
            })?;
            return Self::new(corners);
        }
        let lines = text
            .lines()
            .map(|line| line.split('#').next().unwrap_or(""));
        let words = lines.flat_map(|line| line.split([' ', '\t', ';', '\r']));
        let corners = words.filter(|word| !word.is_empty()).map(|word| {
            let numbers = word
                .split_once(',')
                .and_then(|(x, y)| Some([x.trim().parse().ok()?, y.trim().parse().ok()?]));
            numbers.ok_or_else(|| {
                Error::value("polygon", format!("\"{word}\" is no corner x,y"), REMEDY)
            })
        });
        // One more than is allowed is enough to be refused.
        Self::new(corners.take(MOST_CORNERS + 1).collect::<Result<_>>()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn polygon(text: &str) -> Polygon {
        text.parse().unwrap()
    }

    #[test]
    fn points_are_inside_or_outside_of_shapes_that_are_not_convex() {
        // An L.
        let shape = polygon("0,0 10,0 10,4 4,4 4,10 0,10");
        for inside in [[1.0, 1.0], [9.0, 3.0], [3.0, 9.0]] {
            assert!(shape.contains(inside), "{inside:?}");
        }
        for outside in [
            [5.0, 5.0],
            [-1.0, 4.0],
            [11.0, 4.0],
            [5.0, 10.0],
            [f64::NAN, 1.0],
        ] {
            assert!(!shape.contains(outside), "{outside:?}");
        }
    }

    #[test]
    fn every_point_lies_in_exactly_one_of_two_neighbours() {
        let (left, right) = (polygon("0,0 5,0 5,10 0,10"), polygon("5,0 10,0 10,10 5,10"));
        for i in 0..100 {
            let point = [f64::from(i % 10), f64::from(i / 10)];
            assert_ne!(left.contains(point), right.contains(point), "{point:?}");
        }
    }

    #[test]
    fn the_same_corners_may_be_written_in_several_ways() {
        let expected = polygon("0,0 10,0 5,8.5");
        for text in [
            "0,0;10,0;5,8.5",
            "# the road\n0,0 # first\n10,0\r\n5,8.5\n",
            "[[0, 0], [10, 0], [5, 8.5]]",
            "  0,0\t10,0  5,8.5 ",
        ] {
            assert_eq!(polygon(text), expected, "{text:?}");
        }
    }

    #[test]
    fn what_is_no_polygon_is_refused_with_the_way_to_write_one() {
        for text in [
            "",
            "1,2 3,4",
            "0,0 1,1 2,2",
            "0,0 0,0 0,0",
            "0,0 1,0 NaN,5",
            "0,0 1,0 inf,5",
            "0,0 1,0 1e300,5",
            "0,0 1,0 5",
            "0,0 1,0 a,b",
            "[[0, 0], [1, 0]]",
            "[[0, 0, 0], [1, 0, 0], [1, 1, 0]]",
            "[",
        ] {
            let message = text.parse::<Polygon>().unwrap_err().to_string();
            assert!(
                message.contains("at least three corners"),
                "{text:?}: {message}"
            );
        }
        let many = "0,0 ".repeat(MOST_CORNERS + 50);
        assert!(many.parse::<Polygon>().is_err());
    }
}
