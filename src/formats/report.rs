//! What imports and exports say when they are done.

use crate::dataset::{Problem, SplitCounts};

/// What an import did.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportReport {
    /// Frames in each split.
    pub counts: SplitCounts,
    /// Vehicles in the left images.
    pub vehicles: usize,
    /// Of these, how many are marked as ignored.
    pub ignored: usize,
    /// Of these, how many have a distance.
    pub with_distance: usize,
    /// Images without labels of their own, which are taken to show nothing.
    pub unlabelled: usize,
    /// Frames that could not be used, and lesser things that were left out.
    pub left_out: Vec<Problem>,
}

impl ImportReport {
    /// All frames.
    pub fn frames(&self) -> u64 {
        self.counts.train + self.counts.val + self.counts.test
    }
}

/// What an export did.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ExportReport {
    /// Images written.
    pub images: usize,
    /// Boxes written.
    pub boxes: usize,
    /// What was not written, and why.
    pub left_out: Vec<Problem>,
}
