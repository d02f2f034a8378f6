//! Known distances: a table of places in left images and how far away they are.

use std::path::Path;

use serde::Deserialize;

use crate::error::{Error, Result};
use crate::files;
use crate::geometry::PixelBox;
use crate::sources::StereoFrame;

/// Standard deviation of a distance whose row does not say it, part of the distance.
const USUAL_STD: f64 = 0.01;

/// The columns, for messages.
const COLUMNS: &str = "columns are image, x, y, distance_m for points, image, x_min, y_min, x_max, \
                       y_max, distance_m for vehicles, and distance_std_m where it is known";

/// What is known of one place.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownDistance {
    /// Its line in the file, from 1.
    pub line: u64,
    /// The frame: its name, or the name of its left image's file.
    pub image: String,
    /// The place in the left rectified image, pixels.
    pub target: Target,
    /// From the middle between the cameras: to the surface at a point, to the centre of a vehicle;
    /// metres.
    pub distance_m: f64,
    /// Standard deviation of it, metres.
    pub distance_std_m: f64,
}

/// What a known distance leads to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// The surface that a pixel shows.
    Point([f64; 2]),
    /// The centre of the vehicle in a box, behind its surface.
    Vehicle(PixelBox),
}

impl Target {
    /// The pixel in its middle.
    pub fn pixel(&self) -> [f64; 2] {
        match self {
            Self::Point(pixel) => *pixel,
            Self::Vehicle(area) => area.center(),
        }
    }
}

#[derive(Debug, Deserialize)]
struct Row {
    image: String,
    x: Option<f64>,
    y: Option<f64>,
    x_min: Option<f64>,
    y_min: Option<f64>,
    x_max: Option<f64>,
    y_max: Option<f64>,
    distance_m: f64,
    distance_std_m: Option<f64>,
}

/// Reads a table of known distances: CSV with a header.
///
/// # Errors
/// A file that cannot be read or has no rows; rows that are none, named by their line.
pub fn read_known_distances(path: impl AsRef<Path>) -> Result<Vec<KnownDistance>> {
    let path = path.as_ref();
    let text = files::read_text(path)?;
    let refuse = |line: u64, problem: String| {
        Error::value(
            format!("{} line {line}", path.display()),
            problem,
            format!("correct it: {COLUMNS}"),
        )
    };
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_reader(text.as_bytes());
    let mut known = Vec::new();
    let headers = reader
        .headers()
        .map_err(|error| refuse(1, error.to_string()))?
        .clone();
    let mut record = csv::StringRecord::new();
    loop {
        let line = reader.position().line();
        match reader.read_record(&mut record) {
            Ok(false) => break,
            Ok(true) => {}
            Err(error) => return Err(refuse(line, error.to_string())),
        }
        let line = record.position().map_or(line, csv::Position::line);
        let row: Row = record
            .deserialize(Some(&headers))
            .map_err(|error| refuse(line, problem_of(&error)))?;
        known.push(of_row(row, line).map_err(|problem| refuse(line, problem))?);
    }
    if known.is_empty() {
        return Err(Error::value(
            path.display().to_string(),
            "has no known distances",
            format!("write one a line: {COLUMNS}"),
        ));
    }
    Ok(known)
}

/// The part of a message that is not about where.
fn problem_of(error: &csv::Error) -> String {
    match error.kind() {
        csv::ErrorKind::Deserialize { err, .. } => err.to_string(),
        _ => error.to_string(),
    }
}

fn of_row(row: Row, line: u64) -> Result<KnownDistance, String> {
    let corners = [row.x_min, row.y_min, row.x_max, row.y_max];
    let target = match (row.x, row.y, corners) {
        (Some(x), Some(y), [None, None, None, None]) => Target::Point([x, y]),
        (None, None, [Some(x_min), Some(y_min), Some(x_max), Some(y_max)]) => {
            let area = PixelBox::new(x_min, y_min, x_max, y_max);
            if !(area.width() > 0.0 && area.height() > 0.0) {
                return Err("x_min, y_min, x_max, y_max are no box".to_owned());
            }
            Target::Vehicle(area)
        }
        _ => {
            return Err(
                "has neither a point (x, y) nor a box (x_min, y_min, x_max, y_max) alone"
                    .to_owned(),
            );
        }
    };
    if !target.pixel().iter().all(|v| v.is_finite()) {
        return Err("its place is no number of pixels".to_owned());
    }
    let distance_m = row.distance_m;
    if !(distance_m.is_finite() && distance_m > 0.0) {
        return Err(format!(
            "distance_m = {distance_m} is no distance in metres"
        ));
    }
    let distance_std_m = row.distance_std_m.unwrap_or(USUAL_STD * distance_m);
    if !(distance_std_m.is_finite() && distance_std_m >= 0.0) {
        return Err(format!(
            "distance_std_m = {distance_std_m} is no standard deviation"
        ));
    }
    if row.image.is_empty() {
        return Err("names no image".to_owned());
    }
    Ok(KnownDistance {
        line,
        image: row.image,
        target,
        distance_m,
        distance_std_m,
    })
}

impl KnownDistance {
    /// Whether this frame is meant: by its name, or by the path, name or stem of its left image's
    /// file.
    pub(super) fn is_of(&self, frame: &StereoFrame) -> bool {
        let origin = Path::new(&frame.origins[0]);
        let named = [origin.file_name(), origin.file_stem()];
        self.image == frame.name
            || Path::new(&self.image) == origin
            || named.iter().flatten().any(|name| **name == *self.image)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<KnownDistance>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("known.csv");
        std::fs::write(&path, text).unwrap();
        read_known_distances(path)
    }

    #[test]
    fn points_and_boxes_are_read_from_one_table() {
        let known = read(
            "# measured with a tape\nimage, x, y, x_min, y_min, x_max, y_max, distance_m, distance_std_m\n\
             00001, 320.5, 200, , , , , 12.5, 0.02\n\
             left_00002.png,,,10,20,110,80,31,\n",
        )
        .unwrap();
        assert_eq!(known[0].target, Target::Point([320.5, 200.0]));
        assert_eq!((known[0].line, known[0].distance_std_m), (3, 0.02));
        let Target::Vehicle(area) = known[1].target else {
            panic!("a vehicle");
        };
        assert_eq!(area.center(), [60.0, 50.0]);
        assert!((known[1].distance_std_m - 0.31).abs() < 1e-12);
        assert_eq!(read("image,x,y,distance_m\na,1,2,3\n").unwrap().len(), 1);
    }

    #[test]
    fn rows_that_are_none_are_named_by_their_line() {
        let header = "image,x,y,x_min,y_min,x_max,y_max,distance_m\nok,1,2,,,,,3\n";
        for (row, words) in [
            ("a,1,2,,,,,-4", "distance_m = -4"),
            ("a,1,2,,,,,0", "distance_m = 0"),
            ("a,1,2,,,,,far", "invalid float"),
            ("a,1,2,,,,,inf", "distance_m = inf"),
            ("a,1,,,,,,4", "neither a point"),
            ("a,1,2,3,4,5,6,4", "neither a point"),
            ("a,,,5,4,3,6,4", "no box"),
            ("a,NaN,2,,,,,4", "no number of pixels"),
            (",1,2,,,,,4", "names no image"),
            ("a,1,2", "found record with 3 fields"),
        ] {
            let refusal = read(&format!("{header}{row}\n")).unwrap_err().to_string();
            assert!(refusal.contains("line 3"), "{refusal}");
            assert!(refusal.contains(words), "{refusal}");
        }
        for text in ["", "image,x,y,distance_m\n"] {
            assert!(read(text).unwrap_err().to_string().contains("no known"));
        }
        let refusal = read("frame,x,y,distance_m\na,1,2,3\n").unwrap_err();
        assert!(
            refusal.to_string().contains("missing field `image`"),
            "{refusal}"
        );
    }
}
