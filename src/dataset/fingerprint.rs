//! Telling whether a dataset is still the one that a run was started on.

use std::fs;

use crc32fast::Hasher;

use super::StereoDataset;
use crate::error::{Error, Result};

impl StereoDataset {
    /// A short mark of the dataset's content: rig, classes, rows, labels, and name and size of every
    /// image file. It is the same wherever the folder lies, and another one as soon as a frame is
    /// added, left out, moved to another split or labelled differently. The pixels are not read:
    /// two images of the same size in bytes look alike to it.
    ///
    /// # Errors
    /// An image file that cannot be looked at.
    pub fn fingerprint(&self) -> Result<String> {
        let mut hasher = Hasher::new();
        hasher.update(format!("{:?}{:?}", self.rig(), self.classes()).as_bytes());
        for frame in &self.frames {
            hasher.update(format!("{:?}", frame.row).as_bytes());
            for (side, image) in frame.images() {
                let path = &image.path;
                let bytes = fs::metadata(path).map_err(Error::io("read", path))?.len();
                let name = path.file_name().unwrap_or_default().display();
                let text = format!("{side:?}{name}/{bytes}{:?}", image.labels);
                hasher.update(text.as_bytes());
            }
        }
        Ok(format!("{:08x}", hasher.finalize()))
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::Fixture;

    fn fingerprint(dataset: &Fixture) -> String {
        dataset.open().fingerprint().unwrap()
    }

    #[test]
    fn a_copy_has_the_same_mark_and_a_changed_dataset_another() {
        let (first, second) = (Fixture::new(5), Fixture::new(5));
        let mark = fingerprint(&first);
        assert_eq!(mark, fingerprint(&second));
        second.edit("frames.csv", "train", "val");
        let moved = fingerprint(&second);
        assert_ne!(mark, moved);
        first.remove("frames/left_00002.png");
        assert_ne!(mark, fingerprint(&first));
    }
}
