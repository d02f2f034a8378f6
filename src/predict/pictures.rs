//! Results to look at: pictures of both images with boxes and distances, or a video of them.

use std::path::{Path, PathBuf};

use image::RgbImage;

use super::{FrameRecord, Outcome, Sink, file_of};
use crate::annotate::{Annotation, annotate_pair};
use crate::error::{Error, Result};
use crate::files;
use crate::imaging::save_png;
use crate::pipeline::{DetectedIn, Vehicle};
use crate::sources::{VideoEncoding, VideoWriter};

/// Both images with every vehicle's boxes, distance and score.
pub fn picture([left, right]: [&RgbImage; 2], outcome: &Outcome) -> RgbImage {
    let measured = outcome.vehicles().iter().map(|vehicle| Annotation {
        left: Some(vehicle.left),
        right: Some(vehicle.right),
        text: text(vehicle),
    });
    let unmeasured = outcome.without_distance().iter().map(|vehicle| {
        let is_left = vehicle.detected_in == DetectedIn::Left;
        Annotation {
            left: is_left.then_some(vehicle.box_pixel),
            right: (!is_left).then_some(vehicle.box_pixel),
            text: format!("? m {:.2}", vehicle.score),
        }
    });
    let annotations: Vec<Annotation> = measured.chain(unmeasured).collect();
    annotate_pair(left, right, &annotations)
}

/// A folder of PNG pictures, one a frame, named after it.
#[derive(Debug)]
pub struct PictureFolder {
    folder: PathBuf,
}

impl PictureFolder {
    /// Creates the folder.
    ///
    /// # Errors
    /// A file in its place, or a parent that cannot be written.
    pub fn create(folder: &Path) -> Result<Self> {
        if folder.is_file() {
            return Err(Error::value(
                folder.display().to_string(),
                "is a file, and several pictures need a folder",
                "give the name of a folder",
            ));
        }
        files::create_folder(folder)?;
        Ok(Self {
            folder: folder.to_path_buf(),
        })
    }
}

impl Sink for PictureFolder {
    fn take(&mut self, record: &FrameRecord, images: Option<[&RgbImage; 2]>) -> Result<()> {
        let Some(images) = images else {
            return Ok(());
        };
        let path = file_of(&self.folder, &record.frame, "png");
        save_png(path, &picture(images, &record.outcome))
    }

    fn finish(self: Box<Self>) -> Result<()> {
        Ok(())
    }
}

/// A video of the pictures, through the program `ffmpeg`. Frames that could not be read are not in
/// it.
#[derive(Debug)]
pub struct AnnotatedVideo {
    video: VideoWriter,
}

impl AnnotatedVideo {
    /// Prepares to write it.
    ///
    /// # Errors
    /// As [`VideoWriter::new`].
    pub fn create(path: &Path, encoding: VideoEncoding) -> Result<Self> {
        Ok(Self {
            video: VideoWriter::new(path, encoding)?,
        })
    }
}

impl Sink for AnnotatedVideo {
    fn take(&mut self, record: &FrameRecord, images: Option<[&RgbImage; 2]>) -> Result<()> {
        images.map_or(Ok(()), |images| {
            self.video.add(&picture(images, &record.outcome))
        })
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.video.finish().map(|_| ())
    }
}

/// Distance with its standard deviation and the detection's score; a question mark where the distance
/// may be another.
fn text(vehicle: &Vehicle) -> String {
    let spread = vehicle
        .distance_std_m
        .map_or_else(String::new, |std_m| format!("+-{std_m:.1}"));
    let doubt = if vehicle.doubt.is_some() { "?" } else { "" };
    format!(
        "{:.1}{spread} m{doubt} {:.2}",
        vehicle.distance_m, vehicle.score
    )
}
