//! The folder that an export writes.

use std::path::Path;

use crate::dataset::{BoxKind, Frame, Side, StereoDataset};
use crate::error::{Error, Result};
use crate::files;
use crate::progress::Progress;

/// Refuses a folder that holds anything, and boxes that the dataset does not have.
pub(super) fn begin_export(dataset: &StereoDataset, kind: BoxKind, out: &Path) -> Result<()> {
    if !dataset.info.label_kinds.contains(&kind) {
        return Err(Error::dataset(
            &dataset.folder,
            format!("has no {kind} boxes"),
            "choose the other kind with --box-kind",
        ));
    }
    let is_empty = |path: &Path| {
        path.read_dir()
            .is_ok_and(|mut entries| entries.next().is_none())
    };
    if out.exists() && !is_empty(out) {
        return Err(Error::dataset(
            out,
            "is not empty, and nothing is overwritten",
            "choose another folder with --out, or delete this one",
        ));
    }
    files::create_folder(out)
}

/// Stops where the user asked for it.
pub(super) fn interrupted(progress: &dyn Progress) -> Result<()> {
    if progress.interrupted() {
        return Err(Error::Interrupted {
            resume: "delete the folder and run the same command again".to_owned(),
        });
    }
    Ok(())
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
