//! One stereo pair with its labels, and what stages one and two take from it.

use std::fmt;
use std::path::PathBuf;

use image::RgbImage;

use super::{BoxKind, FrameRow, Label, stamp_name};
use crate::error::{Error, Result};
use crate::geometry::{Camera, PixelBox, StereoRig};
use crate::imaging;

/// One of the two images of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Side {
    /// The left camera's.
    Left,
    /// The right camera's.
    Right,
}

impl Side {
    /// Left, then right.
    pub const ALL: [Self; 2] = [Self::Left, Self::Right];

    /// How file names of this side begin, without the underscore.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
        }
    }
}

impl StereoRig {
    /// The camera of one side.
    pub const fn camera(&self, side: Side) -> &Camera {
        match side {
            Side::Left => &self.left,
            Side::Right => &self.right,
        }
    }
}

impl fmt::Display for Side {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}

/// One image of a frame with all its labels, of both kinds.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameImage {
    /// The image file.
    pub path: PathBuf,
    /// The labels in the order of the file; boxes may reach outside the image.
    pub labels: Vec<Label>,
}

impl FrameImage {
    /// The labels of one kind.
    pub fn labels_of(&self, kind: BoxKind) -> impl Iterator<Item = &Label> {
        self.labels.iter().filter(move |label| label.kind == kind)
    }

    /// Class and box of each label of one kind that is not ignored, clipped to the image: what a
    /// detector is trained to find.
    pub fn boxes(&self, kind: BoxKind, camera: &Camera) -> Vec<(u32, PixelBox)> {
        self.clipped(kind, camera)
            .filter(|(label, _)| !label.ignored)
            .map(|(label, area)| (label.class, area))
            .collect()
    }

    /// The boxes of the ignored labels of one kind, clipped to the image: what a detector may find
    /// or not.
    pub fn ignored_boxes(&self, kind: BoxKind, camera: &Camera) -> Vec<PixelBox> {
        self.clipped(kind, camera)
            .filter(|(label, _)| label.ignored)
            .map(|(_, area)| area)
            .collect()
    }

    fn clipped(&self, kind: BoxKind, camera: &Camera) -> impl Iterator<Item = (&Label, PixelBox)> {
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        self.labels_of(kind)
            .map(move |label| (label, label.box_pixel.clipped(width, height)))
            .filter(|(_, area)| area.is_valid())
    }

    /// Decodes the image, turned as its file says: labels count in the picture as it is shown.
    ///
    /// # Errors
    /// Those of [`imaging::load_upright`], and a size that is not the camera's.
    pub fn load(&self, camera: &Camera) -> Result<RgbImage> {
        let image = imaging::load_upright(&self.path)?;
        if image.dimensions() == (camera.width, camera.height) {
            return Ok(image);
        }
        Err(Error::image(
            &self.path,
            format!(
                "has {}x{} pixels but dataset.toml says {}x{}",
                image.width(),
                image.height(),
                camera.width,
                camera.height
            ),
            "correct the rig in dataset.toml or replace the image",
        ))
    }
}

/// A vehicle that is labelled in both images.
#[derive(Debug, Clone, PartialEq)]
pub struct StereoLabel {
    /// The vehicle's number in its frame.
    pub id: u32,
    /// Its class.
    pub class: u32,
    /// Its label in the left image.
    pub left: Label,
    /// Its label in the right image.
    pub right: Label,
    /// Rig midpoint to the vehicle's box centre, metres.
    pub distance_m: f64,
}

/// One stereo pair: its row of `frames.csv`, its images and their labels.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// The frame's row of `frames.csv`.
    pub row: FrameRow,
    /// The left image.
    pub left: FrameImage,
    /// The right image; none in a dataset of single images.
    pub right: Option<FrameImage>,
}

impl Frame {
    /// The frame's name: its stamp with at least five digits.
    pub fn name(&self) -> String {
        stamp_name(self.row.stamp)
    }

    /// The images that there are, left first.
    pub fn images(&self) -> impl Iterator<Item = (Side, &FrameImage)> {
        let right = self.right.iter().map(|image| (Side::Right, image));
        std::iter::once((Side::Left, &self.left)).chain(right)
    }

    /// The vehicles that have a label of this kind in both images and a known distance, and are
    /// ignored in neither, by id.
    ///
    /// A vehicle that only one camera sees is no stereo pair and does not appear.
    pub fn vehicles(&self, kind: BoxKind) -> Vec<StereoLabel> {
        let mut vehicles: Vec<_> = self
            .left
            .labels_of(kind)
            .filter(|left| !left.ignored)
            .filter_map(|left| {
                let right = self.right.as_ref()?;
                let right = right
                    .labels_of(kind)
                    .find(|right| right.id == left.id && !right.ignored)?;
                Some(StereoLabel {
                    id: left.id,
                    class: left.class,
                    left: left.clone(),
                    right: right.clone(),
                    distance_m: left.distance_m?,
                })
            })
            .collect();
        vehicles.sort_by_key(|vehicle| vehicle.id);
        vehicles
    }

    /// The boxes in one image of the vehicles that [`Frame::vehicles`] leaves out: ignored in
    /// either image, or seen by one camera only. To find such a vehicle is no error, nor is it one
    /// to miss it.
    pub fn unjudged_boxes(&self, kind: BoxKind, side: Side) -> Vec<PixelBox> {
        let judged = self.vehicles(kind);
        self.images()
            .filter(|(of, _)| *of == side)
            .flat_map(|(_, image)| image.labels_of(kind))
            .filter(|label| judged.iter().all(|vehicle| vehicle.id != label.id))
            .map(|label| label.box_pixel)
            .collect()
    }

    /// Decodes both images, left first.
    ///
    /// # Errors
    /// Those of [`imaging::load_upright`], a size that is not the rig's, and a frame without a right
    /// image.
    pub fn load(&self, rig: &StereoRig) -> Result<[RgbImage; 2]> {
        let Some(right) = &self.right else {
            return Err(Error::image(
                &self.left.path,
                "has no right image beside it",
                "give a dataset of stereo pairs",
            ));
        };
        Ok([self.left.load(&rig.left)?, right.load(&rig.right)?])
    }
}

/// Something in a dataset that had to be left out, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// What it is about: "frame 00042", "frames.csv line 7".
    pub subject: String,
    /// What is wrong with it.
    pub reason: String,
}

impl Problem {
    /// A problem of a frame.
    pub fn of_frame(stamp: u64, reason: impl Into<String>) -> Self {
        Self {
            subject: format!("frame {}", stamp_name(stamp)),
            reason: reason.into(),
        }
    }

    /// The first few problems in one line, for an error that has to explain itself.
    pub(crate) fn summary(problems: &[Self]) -> String {
        const SHOWN: usize = 3;
        let mut parts: Vec<_> = problems
            .iter()
            .take(SHOWN)
            .map(ToString::to_string)
            .collect();
        if problems.len() > SHOWN {
            parts.push(format!("and {} more", problems.len() - SHOWN));
        }
        parts.join("; ")
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.subject, self.reason)
    }
}
