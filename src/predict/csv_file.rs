//! Results as a table: one row a vehicle.

use std::path::Path;

use image::RgbImage;

use super::{FrameRecord, Outcome, Sink};
use crate::error::{Error, Result};
use crate::files::GrowingFile;
use crate::geometry::PixelBox;
use crate::pipeline::DetectedIn;
use crate::ranging::VehicleDoubt;

/// The columns.
const HEADER: [&str; 23] = [
    "frame",
    "time_s",
    "vehicle",
    "class",
    "score",
    "distance_m",
    "distance_std_m",
    "distance_low_m",
    "distance_high_m",
    "size_m",
    "stereo_m",
    "network_m",
    "doubt",
    "detected_in",
    "left_x_min",
    "left_y_min",
    "left_x_max",
    "left_y_max",
    "right_x_min",
    "right_y_min",
    "right_x_max",
    "right_y_max",
    "disparity_px",
];

/// A CSV file that is being written. Frames without vehicles, and failed ones, have no row.
#[derive(Debug)]
pub struct CsvFile {
    file: GrowingFile,
}

impl CsvFile {
    /// Begins a file.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        let mut file = GrowingFile::create(path)?;
        file.write(Self::header().as_bytes())?;
        Ok(Self { file })
    }

    /// The header as a line.
    pub fn header() -> String {
        format!("{}\n", HEADER.join(","))
    }

    /// The rows of a frame, none where it has no vehicles.
    ///
    /// # Errors
    /// None in practice: memory is written to.
    pub fn rows(record: &FrameRecord) -> Result<String> {
        let mut writer = csv::WriterBuilder::new()
            .has_headers(false)
            .from_writer(Vec::new());
        let mut number = 0;
        let mut write = |class: &str,
                         score: f32,
                         distances: [Option<f64>; 7],
                         doubt: Option<VehicleDoubt>,
                         detected_in: DetectedIn,
                         boxes: [Option<&PixelBox>; 2],
                         disparity_px: Option<f64>| {
            number += 1;
            let shown = |value: Option<f64>| value.map_or_else(String::new, |v| v.to_string());
            let mut row = vec![
                record.frame.clone(),
                shown(record.time_s),
                number.to_string(),
                class.to_owned(),
                score.to_string(),
            ];
            row.extend(distances.map(shown));
            row.push(doubt.map_or_else(String::new, |doubt| doubt.word().to_owned()));
            row.push(detected_in.word().to_owned());
            for b in boxes {
                let edges = b.map(|b| [b.x_min, b.y_min, b.x_max, b.y_max]);
                row.extend((0..4).map(|i| shown(edges.map(|edges| edges[i]))));
            }
            row.push(shown(disparity_px));
            writer.write_record(row)
        };
        let written = match &record.outcome {
            Outcome::Measured {
                vehicles,
                without_distance,
            } => {
                let with = vehicles.iter().try_for_each(|v| {
                    let boxes = [Some(&v.left), Some(&v.right)];
                    let distances = [
                        Some(v.distance_m),
                        v.distance_std_m,
                        v.distance_low_m,
                        v.distance_high_m,
                        v.size_m,
                        v.stereo_m,
                        v.network_m,
                    ];
                    let (seen, disparity_px) = (v.detected_in, v.disparity_px);
                    write(
                        &v.class,
                        v.score,
                        distances,
                        v.doubt,
                        seen,
                        boxes,
                        disparity_px,
                    )
                });
                let without = without_distance.iter().try_for_each(|v| {
                    let is_left = v.detected_in == DetectedIn::Left;
                    let boxes = [
                        is_left.then_some(&v.box_pixel),
                        (!is_left).then_some(&v.box_pixel),
                    ];
                    write(
                        &v.class,
                        v.score,
                        [None; 7],
                        None,
                        v.detected_in,
                        boxes,
                        None,
                    )
                });
                with.and(without)
            }
            Outcome::Failed { .. } => Ok(()),
        };
        let rows = written.map_err(|error| error.to_string()).and_then(|()| {
            let bytes = writer.into_inner().map_err(|error| error.to_string())?;
            String::from_utf8(bytes).map_err(|error| error.to_string())
        });
        rows.map_err(|problem| {
            Error::value(
                format!("frame {}", record.frame),
                format!("cannot be written as CSV: {problem}"),
                "report this as a bug",
            )
        })
    }
}

impl Sink for CsvFile {
    fn take(&mut self, record: &FrameRecord, _: Option<[&RgbImage; 2]>) -> Result<()> {
        self.file.write(Self::rows(record)?.as_bytes())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.file.finish()
    }
}
