//! `objects.csv`: what is known of each vehicle of each frame beyond its boxes. Optional.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::lines::short;
use crate::error::{Error, Result};
use crate::files;

/// One row of `objects.csv`: one vehicle in one frame, whether an image shows it or not.
///
/// Rig axes are those of the left camera moved to the midpoint between the cameras: x right, y
/// down, z along the optical axes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ObjectRow {
    /// The frame's number.
    #[serde(with = "super::stamp")]
    pub stamp: u64,
    /// The vehicle's number in the frame's labels.
    pub id: u32,
    /// Its kind of body, such as `sedan`; empty where unknown.
    pub style: String,
    /// Length of its bounding box, metres.
    pub length_m: f64,
    /// Width of its bounding box, metres.
    pub width_m: f64,
    /// Height of its bounding box, metres.
    pub height_m: f64,
    /// Centre of its bounding box, rig axes, metres.
    pub x_m: f64,
    /// Centre of its bounding box, rig axes, metres.
    pub y_m: f64,
    /// Centre of its bounding box, rig axes, metres.
    pub z_m: f64,
    /// Unit vector of its forward direction, rig axes.
    pub forward_x: f64,
    /// Unit vector of its forward direction, rig axes.
    pub forward_y: f64,
    /// Unit vector of its forward direction, rig axes.
    pub forward_z: f64,
    /// Its heading against the rig's, about the vertical, degrees: 0 drives away from the rig, 90
    /// to the right, -90 to the left. KITTI's `rotation_y` of a level camera is this less 90.
    pub yaw_deg: f64,
    /// The rig's angle around it, 0 in front and 90 at its right, degrees.
    pub azimuth_deg: f64,
    /// The rig's angle above the horizon as seen from it, degrees.
    pub elevation_deg: f64,
    /// Rig midpoint to the centre of its bounding box, metres.
    pub distance_m: f64,
}

impl ObjectRow {
    /// The row with numbers of four decimals, as files keep them.
    fn rounded(&self) -> Self {
        let mut row = self.clone();
        for value in [
            &mut row.length_m,
            &mut row.width_m,
            &mut row.height_m,
            &mut row.x_m,
            &mut row.y_m,
            &mut row.z_m,
            &mut row.forward_x,
            &mut row.forward_y,
            &mut row.forward_z,
            &mut row.yaw_deg,
            &mut row.azimuth_deg,
            &mut row.elevation_deg,
            &mut row.distance_m,
        ] {
            *value = short(*value);
        }
        row
    }
}

/// The text of `objects.csv`; numbers are rounded to four decimals.
///
/// # Errors
/// The reason in words, which only a style that is no text could cause.
pub fn objects_csv_text(rows: &[ObjectRow]) -> Result<String, String> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer
            .serialize(row.rounded())
            .map_err(|error| error.to_string())?;
    }
    let bytes = writer.into_inner().map_err(|error| error.to_string())?;
    String::from_utf8(bytes).map_err(|error| error.to_string())
}

/// Writes `objects.csv` at `path`, in the order of `rows`.
///
/// # Errors
/// [`Error::Io`] when the file cannot be written.
pub fn write_objects_csv(path: impl AsRef<Path>, rows: &[ObjectRow]) -> Result<()> {
    let path = path.as_ref();
    let text = objects_csv_text(rows)
        .map_err(|reason| Error::dataset(path, reason, "report this as a bug"))?;
    files::write_atomically(path, text.as_bytes())
}

/// Reads `objects.csv`; columns may stand in any order, and further ones are left out.
///
/// # Errors
/// A file that cannot be read, or its first row that cannot be understood.
pub fn read_objects_csv(path: impl AsRef<Path>) -> Result<Vec<ObjectRow>> {
    let path = path.as_ref();
    let text = files::read_text(path)?;
    csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_reader(text.as_bytes())
        .deserialize()
        .collect::<Result<_, csv::Error>>()
        .map_err(|error| {
            Error::dataset(
                path,
                error.to_string(),
                "correct the row, or delete the file: nothing needs it",
            )
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_come_back_from_the_file_and_a_damaged_one_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("objects.csv");
        let row = ObjectRow {
            stamp: 42,
            id: 3,
            style: "suv".to_owned(),
            length_m: 4.5,
            width_m: 1.8,
            height_m: 1.6,
            x_m: -3.25,
            y_m: 2.0,
            z_m: 30.125,
            forward_x: 1.0,
            forward_y: 0.0,
            forward_z: 0.0,
            yaw_deg: 90.0,
            azimuth_deg: -90.0,
            elevation_deg: 3.5,
            distance_m: 30.3655,
        };
        write_objects_csv(&path, &[row.clone(), row.clone()]).unwrap();
        assert_eq!(read_objects_csv(&path).unwrap(), [row.clone(), row]);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replacen("30.125", "far", 1)).unwrap();
        let message = read_objects_csv(&path).unwrap_err().to_string();
        assert!(
            message.contains("objects.csv") && message.contains("line: 2"),
            "{message}"
        );
    }
}
