//! Other ways to split a dataset into training and validation than the one in `frames.csv`.
//!
//! Test frames always stay test frames.

use std::collections::BTreeMap;
use std::str::FromStr;

use rand::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::frame::Frame;
use super::reader::StereoDataset;
use super::{FrameRow, Split};
use crate::error::{Error, Result};

/// The part of the frames that validates (paper, section 4: 80/20).
const VALIDATION_PART: f64 = 0.2;

/// Views of one scene that differ by less than this in azimuth and in elevation, degrees, and by
/// less than [`NEAR_DISTANCE_RATIO`] in distance show the same picture. Neighbours of the capture
/// plan lie at least 10 degrees apart, so only repeated views are caught.
const NEAR_ANGLE_DEG: f64 = 2.0;

/// See [`NEAR_ANGLE_DEG`].
const NEAR_DISTANCE_RATIO: f64 = 1.02;

/// What must not be torn apart by a split.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SplitBy {
    /// Whole scenes stay together: validation shows scenes that training never saw.
    Scene,
    /// The paper's way: single frames at random; only near-duplicate views stay together. Frames
    /// of one scene look alike, so it flatters every figure.
    Frame,
}

impl FromStr for SplitBy {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        match word {
            "scene" => Ok(Self::Scene),
            "frame" => Ok(Self::Frame),
            _ => Err(format!("'{word}' is none of scene, frame")),
        }
    }
}

impl StereoDataset {
    /// Splits the frames that are not test frames anew, 80 % to train and 20 % to val, at random
    /// by `seed`. The files on disk keep their split; composites have to be prepared again.
    ///
    /// # Errors
    /// [`Error::Value`] when scenes are asked for and a frame has none, or when there are fewer
    /// than two groups that could be kept apart.
    pub fn resplit(&mut self, by: SplitBy, seed: u64) -> Result<()> {
        let indices: Vec<usize> = (0..self.frames.len())
            .filter(|index| self.frames[*index].row.split != Split::Test)
            .collect();
        let groups = match by {
            SplitBy::Scene => scenes(&self.frames, &indices)?,
            SplitBy::Frame => near_duplicates(&self.frames, &indices),
        };
        if groups.len() < 2 {
            return Err(Error::value(
                "split",
                format!(
                    "{} frames in {} groups cannot be split in two",
                    indices.len(),
                    groups.len()
                ),
                "use more frames or scenes, or split by frame",
            ));
        }
        let validation = choose_validation(groups, VALIDATION_PART, seed);
        for index in indices {
            self.frames[index].row.split = Split::Train;
        }
        for index in validation {
            self.frames[index].row.split = Split::Val;
        }
        Ok(())
    }
}

/// Chooses groups at random by `seed` so that their frames come as close to this part of all as
/// whole groups allow; at least one group is chosen.
pub(crate) fn choose_validation(mut groups: Vec<Vec<usize>>, part: f64, seed: u64) -> Vec<usize> {
    // Random keys and a sort: unlike a library's shuffle, this order never changes.
    let mut rng = Pcg64::seed_from_u64(seed);
    groups.sort_by_cached_key(|group| (rng.next_u64(), group.first().copied()));
    let frames: usize = groups.iter().map(Vec::len).sum();
    let target = part * frames as f64;
    let mut validation: Vec<usize> = Vec::new();
    for (place, group) in groups.iter().enumerate() {
        let missing = target - validation.len() as f64;
        // A group goes to validation if that brings the part closer to its target; the last one
        // must, if no other did.
        let closer = (missing - group.len() as f64).abs() < missing.abs();
        if closer || (validation.is_empty() && place + 1 == groups.len()) {
            validation.extend(group);
        }
    }
    validation
}

/// The frames of each scene.
fn scenes(frames: &[Frame], indices: &[usize]) -> Result<Vec<Vec<usize>>> {
    let mut groups: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for index in indices {
        let frame = &frames[*index];
        let scene = frame.row.scene.ok_or_else(|| {
            Error::value(
                "split by scene",
                format!("frame {} has no scene number", frame.name()),
                "fill the column 'scene' of frames.csv, or split by frame",
            )
        })?;
        groups.entry(scene).or_default().push(*index);
    }
    Ok(groups.into_values().collect())
}

/// Groups of near-duplicate views; most frames are alone in theirs.
fn near_duplicates(frames: &[Frame], indices: &[usize]) -> Vec<Vec<usize>> {
    // Each frame names a frame of its group; following the names leads to the group's first frame.
    let mut first: Vec<usize> = (0..frames.len()).collect();
    let root = |first: &[usize], mut index: usize| {
        while first[index] != index {
            index = first[index];
        }
        index
    };
    for (place, a) in indices.iter().enumerate() {
        for b in &indices[place + 1..] {
            if is_near(&frames[*a].row, &frames[*b].row) {
                let (root_a, root_b) = (root(&first, *a), root(&first, *b));
                first[root_a.max(root_b)] = root_a.min(root_b);
            }
        }
    }
    let mut groups: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for index in indices {
        groups.entry(root(&first, *index)).or_default().push(*index);
    }
    groups.into_values().collect()
}

/// Whether two frames show one scene from almost the same place; false where that is unknown.
fn is_near(a: &FrameRow, b: &FrameRow) -> bool {
    let (Some(scene_a), Some(scene_b)) = (a.scene, b.scene) else {
        return false;
    };
    let pose = |row: &FrameRow| Some((row.azimuth_deg?, row.elevation_deg?, row.distance_m?));
    let (Some(a), Some(b)) = (pose(a), pose(b)) else {
        return false;
    };
    let turn = (a.0 - b.0).rem_euclid(360.0);
    scene_a == scene_b
        && turn.min(360.0 - turn) < NEAR_ANGLE_DEG
        && (a.1 - b.1).abs() < NEAR_ANGLE_DEG
        && a.2.max(b.2) < a.2.min(b.2) * NEAR_DISTANCE_RATIO
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::fixture::Fixture;

    fn splits(dataset: &StereoDataset) -> Vec<Split> {
        dataset.frames.iter().map(|frame| frame.row.split).collect()
    }

    /// A dataset of many frames without their files.
    fn large() -> StereoDataset {
        let mut dataset = Fixture::new(1).open();
        let frame = dataset.frames[0].clone();
        dataset.frames = (0..500_u32)
            .map(|stamp| {
                let mut frame = frame.clone();
                frame.row.stamp = u64::from(stamp);
                frame.row.scene = Some(stamp / 10);
                frame.row.split = if stamp % 10 == 9 {
                    Split::Test
                } else {
                    Split::Train
                };
                // Each even frame looks like the one after it.
                frame.row.azimuth_deg =
                    Some(359.5 + f64::from(stamp / 2) * 20.0 + f64::from(stamp % 2));
                frame.row.elevation_deg = Some(20.0);
                frame
            })
            .collect();
        dataset
    }

    #[test]
    fn a_fifth_validates_and_test_frames_stay() {
        for by in [SplitBy::Scene, SplitBy::Frame] {
            let mut dataset = large();
            dataset.resplit(by, 5).unwrap();
            let count = |split| dataset.split(split).len();
            assert_eq!(
                [count(Split::Train), count(Split::Val), count(Split::Test)],
                [360, 90, 50]
            );
            assert!(
                dataset
                    .frames
                    .iter()
                    .all(|f| (f.row.split == Split::Test) == (f.row.stamp % 10 == 9))
            );
        }
    }

    #[test]
    fn the_seed_alone_decides() {
        let with = |seed| {
            let mut dataset = large();
            dataset.resplit(SplitBy::Frame, seed).unwrap();
            splits(&dataset)
        };
        assert_eq!(with(1), with(1));
        assert_ne!(with(1), with(2));
    }

    #[test]
    fn scenes_and_near_duplicate_views_are_not_torn_apart() {
        for (by, size) in [(SplitBy::Scene, 10), (SplitBy::Frame, 2)] {
            let mut dataset = large();
            dataset.resplit(by, 3).unwrap();
            for group in splits(&dataset).chunks(size) {
                let mut kinds: Vec<_> = group
                    .iter()
                    .filter(|split| **split != Split::Test)
                    .collect();
                kinds.dedup();
                assert_eq!(kinds.len(), 1, "{by:?}: {group:?}");
            }
        }
    }

    #[test]
    fn what_cannot_be_split_is_an_error() {
        let mut dataset = large();
        dataset.frames[3].row.scene = None;
        let message = dataset.resplit(SplitBy::Scene, 1).unwrap_err().to_string();
        assert!(message.contains("frame 00003 has no scene"), "{message}");
        dataset.frames.truncate(1);
        assert!(dataset.resplit(SplitBy::Frame, 1).is_err());
    }

    #[test]
    fn two_groups_give_both_parts_something() {
        let mut dataset = large();
        dataset.frames.truncate(20);
        dataset.resplit(SplitBy::Scene, 1).unwrap();
        assert_eq!(
            (
                dataset.split(Split::Train).len(),
                dataset.split(Split::Val).len()
            ),
            (9, 9)
        );
    }
}
