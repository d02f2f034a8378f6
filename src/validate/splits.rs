//! Splits that share what they should not.

use std::collections::{BTreeMap, BTreeSet};

use super::thumbnail::Thumbnail;
use super::{Finding, FindingKind};
use crate::dataset::{Split, StereoDataset};

/// Scenes that are named; the rest is counted.
const NAMED: usize = 20;

/// What is wrong with the splits. `thumbnails` are those of the frames' left images.
pub(super) fn check(dataset: &StereoDataset, thumbnails: &[Option<Thumbnail>]) -> Vec<Finding> {
    let mut findings = Vec::new();
    if dataset.split(Split::Train).is_empty() && dataset.split(Split::Test).is_empty() {
        let reason = "has neither training nor test frames";
        findings.push(Finding::new(FindingKind::Split, "frames.csv", reason));
    }
    findings.extend(shared_scenes(dataset));
    findings.extend(near_duplicates(dataset, thumbnails));
    findings
}

fn shared_scenes(dataset: &StereoDataset) -> Option<Finding> {
    let mut splits: BTreeMap<u32, BTreeSet<Split>> = BTreeMap::new();
    for frame in &dataset.frames {
        if let Some(scene) = frame.row.scene {
            splits.entry(scene).or_default().insert(frame.row.split);
        }
    }
    let shared: Vec<String> = splits
        .iter()
        .filter(|(_, splits)| splits.len() > 1)
        .map(|(scene, _)| scene.to_string())
        .collect();
    let more = match shared.len().saturating_sub(NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    (!shared.is_empty()).then(|| {
        let named = shared[..shared.len().min(NAMED)].join(", ");
        Finding::new(
            FindingKind::Split,
            "frames.csv",
            format!(
                "{} of {} scenes are in more than one split, which flatters every figure: \
                 {named}{more}",
                shared.len(),
                splits.len()
            ),
        )
    })
}

/// Frames of different splits that look alike; each frame is named with the first it resembles.
fn near_duplicates(dataset: &StereoDataset, thumbnails: &[Option<Thumbnail>]) -> Vec<Finding> {
    let known: Vec<(usize, &Thumbnail)> = thumbnails
        .iter()
        .enumerate()
        .filter_map(|(index, thumbnail)| Some((index, thumbnail.as_ref()?)))
        .collect();
    let frames = &dataset.frames;
    let mut findings = Vec::new();
    for (place, (a, thumbnail)) in known.iter().enumerate() {
        let alike = known[..place].iter().find(|(b, other)| {
            frames[*a].row.split != frames[*b].row.split && thumbnail.is_like(other)
        });
        if let Some((b, _)) = alike {
            let (a, b) = (&frames[*a], &frames[*b]);
            let reason = format!(
                "looks like frame {}, and one is in {} and the other in {}",
                b.name(),
                a.row.split,
                b.row.split
            );
            findings.push(Finding::of_frame(FindingKind::NearDuplicate, a, reason));
        }
    }
    findings
}
