//! Datasets on disk: their format, how they are read, and what stage two is trained on.
//!
//! [`StereoDataset`] reads a folder and says what it had to leave out. [`prepare()`] turns it into
//! composites, which [`CompositeSet`] reads. [`DetectionSource`] and [`RangingSource`] hand either
//! to Burn's data loaders. Nothing here knows networks or tensors.

mod cache;
mod composite;
mod composite_set;
mod fingerprint;
#[cfg(test)]
pub(crate) mod fixture;
mod format;
mod frame;
mod lines;
mod objects;
mod prepare;
mod reader;
mod resplit;
mod source;
pub(crate) mod stamp;

pub(crate) use cache::{Decoded, DecodedCache};
pub use composite::{CompositeSize, composite, composite_into_planes, geometry_vector};
pub(crate) use composite::{Half, half_into_planes};
pub use composite_set::{CompositeItem, CompositeSet, CompositeStatistics, SplitCounts};
pub use format::{BoxKind, DatasetInfo, FORMAT_VERSION, FrameRow, Label, Split, View};
pub use frame::{Frame, FrameImage, Problem, Side, StereoLabel};
pub use lines::{
    FRAMES_HEADER, LABEL_HEADER, frames_csv_text, label_file_text, read_frames_csv, stamp_name,
    write_frames_csv,
};
pub use objects::{ObjectRow, objects_csv_text, read_objects_csv, write_objects_csv};
pub use prepare::{PrepareReport, is_prepared, prepare};
pub use reader::StereoDataset;
pub use resplit::SplitBy;
pub(crate) use resplit::choose_validation;
pub use source::{DetectionItem, DetectionSource, RangingItem, RangingSource};
