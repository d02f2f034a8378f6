//! The folder that an export writes.

use std::path::Path;

use crate::dataset::{BoxKind, Frame, Side, StereoDataset};
use crate::error::{Error, Result};
use crate::files;
use crate::progress::{Progress, in_parallel};

/// Refuses a folder that holds anything, and boxes that the dataset does not have.
pub(super) fn begin_export(dataset: &StereoDataset, kind: BoxKind, out: &Path) -> Result<()> {
    if !dataset.info.label_kinds.contains(&kind) {
        return Err(Error::dataset(
            &dataset.folder,
            format!("has no {kind} boxes"),
            "choose the other kind with --box-kind",
        ));
    }
    if let Some(content) = files::first_entry(out)? {
        return Err(Error::dataset(
            out,
            format!("is not empty (it holds {content}), and nothing is overwritten"),
            "choose another folder with --out, or delete this one",
        ));
    }
    files::create_folder(out)
}

/// Writes every frame of an export; what became of them, in order.
pub(super) fn write_frames<R: Send>(
    dataset: &StereoDataset,
    progress: &dyn Progress,
    write: impl Fn(&Frame) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    in_parallel(
        progress,
        "exporting frames",
        "delete the folder and run the same command again",
        &dataset.frames,
        write,
    )
}

/// What an exported image is called, without ending: its side and stamp, or the stamp alone where
/// there is but one side.
pub(super) fn image_stem(dataset: &StereoDataset, frame: &Frame, side: Side) -> String {
    if dataset.info.stereo {
        format!("{side}_{}", frame.name())
    } else {
        frame.name()
    }
}
