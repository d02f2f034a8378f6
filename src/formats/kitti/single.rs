//! KITTI's folder without places in space: single images with boxes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::super::ClassMap;
use super::super::copy;
use super::super::draft::{Draft, DraftFrame};
use super::super::flat::{Heap, HeapImage, HeapObject};
use super::super::options::ImportOptions;
use super::objects::{DONT_CARE, Object};
use crate::dataset::{BoxKind, FrameRow, Problem, Split};
use crate::error::Result;

/// What the left images are read with.
pub(super) struct Single<'a> {
    /// Why there are no pairs.
    pub reason: String,
    pub splits: BTreeMap<String, Split>,
    pub classes: ClassMap,
    pub options: &'a ImportOptions,
}

/// A left image with its labels, or the reason against them.
pub(super) struct LeftImage {
    pub name: String,
    pub path: PathBuf,
    pub objects: Result<Vec<Object>, String>,
    /// The number of its sequence.
    pub scene: Option<u32>,
}

impl Single<'_> {
    /// A dataset of single images, on which a detector can be trained.
    pub fn draft(
        &self,
        source: &Path,
        images: Vec<LeftImage>,
        mut problems: Vec<Problem>,
    ) -> Result<Draft> {
        let outcomes: Vec<Result<HeapImage, Problem>> = images
            .into_par_iter()
            .map(|image| {
                let name = image.name.clone();
                self.image(image).map_err(|reason| Problem {
                    subject: name,
                    reason,
                })
            })
            .collect();
        problems.push(Problem {
            subject: "the right images".to_owned(),
            reason: format!(
                "{}: the left ones are taken as single images, for a detector",
                self.reason
            ),
        });
        let mut heap = Heap {
            program: "twinsight import kitti",
            source: source.to_path_buf(),
            classes: self.classes.names(),
            kind: BoxKind::Tight,
            rig: None,
            images: Vec::new(),
            problems,
            unlabelled: 0,
        };
        for outcome in outcomes {
            match outcome {
                Ok(image) => heap.images.push(image),
                Err(problem) => heap.problems.push(problem),
            }
        }
        heap.into_draft(&ImportOptions {
            single: true,
            ..self.options.clone()
        })
    }

    fn image(&self, image: LeftImage) -> Result<HeapImage, String> {
        let size = copy::dimensions(&image.path).map_err(|error| error.to_string())?;
        let objects = image.objects?;
        let row = image.scene.map(|scene| {
            let row = DraftFrame::new(String::new(), 0, Vec::new(), Vec::new()).row;
            FrameRow {
                scene: Some(scene),
                ..row
            }
        });
        Ok(HeapImage {
            split: self.splits.get(&image.name).copied(),
            path: image.path,
            name: image.name,
            size,
            row,
            objects: objects
                .iter()
                .filter_map(|object| self.object(object, size))
                .collect(),
            stored: false,
        })
    }

    fn object(&self, object: &Object, [width, height]: [u32; 2]) -> Option<HeapObject> {
        let is_region = object.class == DONT_CARE;
        let class = self.classes.index_of(&object.class);
        let box_pixel = object
            .box_pixel
            .clipped(f64::from(width), f64::from(height));
        let truncated = object.truncated.unwrap_or(0.0);
        let is_hidden =
            object.occluded > self.options.most_occluded || truncated > self.options.most_truncated;
        box_pixel.is_valid().then_some(())?;
        Some(HeapObject {
            class: class.or(is_region.then_some(0))?,
            box_pixel,
            distance_m: None,
            ignored: is_region || is_hidden,
            id: None,
            center_pixel: None,
            visible: (object.occluded == 0 && !is_region).then_some(1.0 - truncated),
        })
    }
}
