//! Where a YOLO dataset's images and labels are.

use std::path::{Component, Path, PathBuf};

use super::super::finder::{Finder, shortened};
use crate::error::{Error, Result};
use crate::files;
use crate::imaging::{files_in, is_image};

/// Folders of images are at most this deep.
const DEEPEST: usize = 16;

/// Folders of images, each with the one in which its labels are.
const LABELS: [[&str; 2]; 3] = [
    ["images", "labels"],
    ["Images", "Labels"],
    ["JPEGImages", "labels"],
];

/// What is found at a place that `data.yaml` names.
#[derive(Debug, Default)]
pub(super) struct PlaceImages {
    pub images: Vec<PathBuf>,
    /// Files that may be pictures but not of a kind that is read.
    pub skipped: Vec<PathBuf>,
    /// Names in a list that lead to no image, with the reason.
    pub missing: Vec<(String, String)>,
}

/// All images at a place: a folder, a list, or one image.
pub(super) fn images_at(folder: &Path, base: Option<&str>, place: &str) -> Result<PlaceImages> {
    // Tools disagree about what a path is relative to, and some write one `..` too many.
    let mut roots = vec![folder.to_path_buf()];
    if let Some(base) = base {
        roots.insert(0, folder.join(base.replace('\\', "/")));
    }
    let Some(found) = shortened(place.trim(), &roots, Path::exists) else {
        return Err(Error::dataset(
            folder,
            format!("data.yaml names {place}, which is not there"),
            "correct the path in it; it may be relative to data.yaml",
        ));
    };
    let mut at_place = PlaceImages::default();
    if found.is_dir() {
        collect(&found, 0, &mut at_place)?;
    } else if is_image(&found) {
        at_place.images.push(found);
    } else {
        let beside = found.parent().unwrap_or(folder).to_path_buf();
        roots.insert(0, beside);
        let finder = Finder::new(roots, vec![folder.to_path_buf()]);
        let text = files::read_text(&found)?;
        for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
            match finder.find(line) {
                Ok(path) => at_place.images.push(path),
                Err(reason) => at_place.missing.push((line.to_owned(), reason)),
            }
        }
    }
    Ok(at_place)
}

fn collect(folder: &Path, depth: usize, at_place: &mut PlaceImages) -> Result<()> {
    let files = files_in(folder)?;
    at_place.images.extend(files.images);
    at_place.skipped.extend(files.skipped);
    for inner in files.folders.iter().filter(|_| depth < DEEPEST) {
        collect(inner, depth + 1, at_place)?;
    }
    Ok(())
}

/// Where the labels of an image may be: in `labels` where the image is in `images`, or beside it.
pub(super) fn label_places(image: &Path) -> Vec<PathBuf> {
    let parts: Vec<Component<'_>> = image.components().collect();
    let beside = LABELS.iter().filter_map(|[images, labels]| {
        let last = parts.iter().rposition(|part| part.as_os_str() == *images)?;
        let path: PathBuf = parts
            .iter()
            .enumerate()
            .map(|(i, part)| match part {
                _ if i == last => Path::new(labels),
                part => Path::new(part.as_os_str()),
            })
            .collect();
        Some(path)
    });
    let with_ending = |path: PathBuf| path.with_extension("txt");
    let mut places: Vec<PathBuf> = beside.map(with_ending).collect();
    places.push(image.with_extension("txt"));
    places
}

/// A path inside the dataset, with `/`.
pub(super) fn name_in(folder: &Path, path: &Path) -> String {
    let inside = path.strip_prefix(folder).unwrap_or(path);
    let parts = inside
        .components()
        .filter(|part| !matches!(part, Component::CurDir))
        .map(|part| part.as_os_str().to_string_lossy());
    parts.collect::<Vec<_>>().join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_looked_for_where_the_images_are_and_beside_them() {
        let places = |image: &str| -> Vec<String> {
            let shown = |path: PathBuf| path.to_string_lossy().into_owned();
            label_places(Path::new(image))
                .into_iter()
                .map(shown)
                .collect()
        };
        assert_eq!(
            places("a/images/train/x.jpg"),
            ["a/labels/train/x.txt", "a/images/train/x.txt"]
        );
        assert_eq!(
            places("images/images/x.jpg"),
            ["images/labels/x.txt", "images/images/x.txt"]
        );
        assert_eq!(
            places("VOC/JPEGImages/x.y.jpg"),
            ["VOC/labels/x.y.txt", "VOC/JPEGImages/x.y.txt"]
        );
        assert_eq!(places("x"), ["x.txt"]);
    }
}
