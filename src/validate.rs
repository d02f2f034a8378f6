//! Checks a dataset as a whole and names everything that is wrong with it.
//!
//! [`StereoDataset`] leaves out frames that cannot be used; this looks at the others too: whether
//! images can be decoded, labels of the two images agree with each other and with the rig, splits
//! are apart, composites are those of these labels, and nothing is left over in the folder.

mod folder;
mod labels;
mod partners;
mod splits;
mod thumbnail;

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::dataset::{Frame, StereoDataset, stamp_name};
use crate::error::Result;
use crate::progress::{Progress, in_parallel};
use thumbnail::Thumbnail;

/// What kind of thing is wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FindingKind {
    /// A frame or row that cannot be used at all: missing or unreadable files, labels that break
    /// the format, contradictions, doubled stamps.
    Unusable,
    /// An image that cannot be decoded, has another size than the rig's, or is the same as its
    /// partner.
    Image,
    /// A box or number of one label that cannot be right.
    Label,
    /// A vehicle that is labelled in one image alone although the other one shows it.
    Partner,
    /// Two labels of one vehicle whose disparity is not that of its distance.
    Disparity,
    /// Two labels of one vehicle that are not on the same rows.
    Rows,
    /// A row of `frames.csv` that says something else than the labels.
    Row,
    /// Scenes in more than one split, or a split without frames.
    Split,
    /// Almost the same picture in two splits.
    NearDuplicate,
    /// Composites that are not those of the dataset's labels.
    Composite,
    /// Files that belong to nothing.
    Leftover,
}

impl FindingKind {
    /// All kinds, in the order of their declaration.
    pub const ALL: [Self; 11] = [
        Self::Unusable,
        Self::Image,
        Self::Label,
        Self::Partner,
        Self::Disparity,
        Self::Rows,
        Self::Row,
        Self::Split,
        Self::NearDuplicate,
        Self::Composite,
        Self::Leftover,
    ];

    /// The word for it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Unusable => "unusable",
            Self::Image => "image",
            Self::Label => "label",
            Self::Partner => "partner",
            Self::Disparity => "disparity",
            Self::Rows => "rows",
            Self::Row => "row",
            Self::Split => "split",
            Self::NearDuplicate => "near-duplicate",
            Self::Composite => "composite",
            Self::Leftover => "leftover",
        }
    }
}

impl fmt::Display for FindingKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}

/// Something that is wrong with a dataset.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What kind of thing.
    pub kind: FindingKind,
    /// The file, frame or scene.
    pub subject: String,
    /// What is wrong with it.
    pub reason: String,
}

impl Finding {
    fn new(kind: FindingKind, subject: impl Into<String>, reason: impl Into<String>) -> Self {
        Self {
            kind,
            subject: subject.into(),
            reason: reason.into(),
        }
    }

    fn of_frame(kind: FindingKind, frame: &Frame, reason: impl Into<String>) -> Self {
        Self::new(
            kind,
            format!("frame {}", stamp_name(frame.row.stamp)),
            reason,
        )
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}: {}", self.kind, self.subject, self.reason)
    }
}

/// What [`validate`] found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Validation {
    /// The dataset's folder.
    pub dataset: PathBuf,
    /// Frames whose text files can be used.
    pub frames: usize,
    /// Images that were decoded.
    pub images: usize,
    /// How often each kind of thing was found; kinds that were not are absent.
    pub counts: BTreeMap<FindingKind, usize>,
    /// Everything that is wrong, kind by kind.
    pub findings: Vec<Finding>,
    /// What is right and yet worth knowing.
    pub notes: Vec<String>,
}

/// Checks a dataset folder.
///
/// # Errors
/// A folder that is no dataset or has no usable frame, as [`StereoDataset::open`] says, or
/// [`Error::Interrupted`](crate::Error::Interrupted).
pub fn validate(folder: &Path, progress: &dyn Progress) -> Result<Validation> {
    let dataset = StereoDataset::open(folder)?;
    let mut findings: Vec<Finding> = dataset
        .problems
        .iter()
        .map(|problem| Finding::new(FindingKind::Unusable, &problem.subject, &problem.reason))
        .collect();
    findings.extend(labels::check_dataset(&dataset));
    let looks = look_at_images(&dataset, progress)?;
    let mut thumbnails = Vec::with_capacity(looks.len());
    for (frame, look) in dataset.frames.iter().zip(looks) {
        findings.extend(labels::check_frame(&dataset, frame));
        findings.extend(look.findings);
        thumbnails.push(look.thumbnail);
    }
    findings.extend(splits::check(&dataset, &thumbnails));
    findings.extend(folder::check(&dataset)?);
    findings.sort_by_key(|finding| finding.kind);
    let mut counts = BTreeMap::new();
    for finding in &findings {
        *counts.entry(finding.kind).or_default() += 1;
    }
    Ok(Validation {
        dataset: folder.to_path_buf(),
        frames: dataset.frames.len(),
        images: dataset.frames.iter().map(|f| f.images().count()).sum(),
        counts,
        findings,
        notes: labels::without_distance(&dataset).into_iter().collect(),
    })
}

/// What decoding the images of a frame brought.
struct Look {
    findings: Vec<Finding>,
    /// Of the left image.
    thumbnail: Option<Thumbnail>,
}

fn look_at_images(dataset: &StereoDataset, progress: &dyn Progress) -> Result<Vec<Look>> {
    in_parallel(
        progress,
        "checking images",
        "run the same command again",
        &dataset.frames,
        |frame| Ok(look_at_frame(dataset, frame)),
    )
}

fn look_at_frame(dataset: &StereoDataset, frame: &Frame) -> Look {
    let mut findings = Vec::new();
    let mut decoded = Vec::new();
    for (side, image) in frame.images() {
        match image.load(dataset.rig().camera(side)) {
            Ok(image) => decoded.push((side, image)),
            Err(error) => findings.push(Finding::of_frame(
                FindingKind::Image,
                frame,
                error.to_string(),
            )),
        }
    }
    if let [(_, left), (_, right)] = &decoded[..] {
        if left == right {
            let reason = "the right image is the left one once more";
            findings.push(Finding::of_frame(FindingKind::Image, frame, reason));
        } else {
            findings.extend(partners::check(dataset.rig(), frame, [left, right]));
        }
    }
    let left = decoded
        .first()
        .filter(|(side, _)| *side == crate::dataset::Side::Left);
    Look {
        findings,
        thumbnail: left.map(|(_, image)| Thumbnail::new(image)),
    }
}

#[cfg(test)]
mod tests;
