//! COCO's files of annotations: where they are, and which split they are of.

use std::fs;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use super::CocoFile;
use super::lenient::without_nan;
use crate::dataset::Split;
use crate::error::{Error, Result, json_problem};
use crate::files;
use crate::imaging;

/// How the names of files that are no instances begin, in COCO's own folder.
const OTHERS: [&str; 5] = [
    "captions",
    "person_keypoints",
    "stuff",
    "panoptic",
    "image_info",
];

/// The files of annotations in a folder: in itself, in `annotations`, or in the folders in it.
pub(super) fn json_paths(source: &Path) -> Result<Vec<PathBuf>> {
    if !source.is_dir() {
        return Ok(vec![source.to_path_buf()]);
    }
    let mut folders = vec![vec![source.join("annotations")], vec![source.to_path_buf()]];
    let inner = imaging::files_in(source)?.folders;
    folders.push(
        inner
            .iter()
            .map(|inner| inner.join("annotations"))
            .collect(),
    );
    folders.push(inner);
    for folders in folders {
        let mut found = Vec::new();
        for folder in folders.iter().filter(|folder| folder.is_dir()) {
            found.extend(jsons_in(folder)?);
        }
        // COCO's own folder has captions and key points beside the instances.
        let is_instances = |path: &PathBuf| file_word(path).starts_with("instances");
        if found.iter().any(is_instances) {
            found.retain(is_instances);
        }
        let is_other = |path: &PathBuf| OTHERS.iter().any(|o| file_word(path).starts_with(o));
        if !found.iter().all(is_other) {
            found.retain(|path| !is_other(path));
        }
        // Settings and the like may lie beside them.
        if found.iter().any(|path| speaks_of_coco(path)) {
            found.retain(|path| speaks_of_coco(path));
        }
        if !found.is_empty() {
            return Ok(found);
        }
    }
    Err(Error::dataset(
        source,
        "holds no JSON file",
        "give the file of annotations",
    ))
}

fn jsons_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).map_err(Error::io("read", folder))?;
    let is_json = |path: &PathBuf| {
        path.extension()
            .is_some_and(|ending| ending.eq_ignore_ascii_case("json"))
    };
    let mut found: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(is_json)
        .collect();
    found.sort();
    Ok(found)
}

/// Whether the beginning or the end of a file has one of the words that COCO's lists are called.
pub(super) fn speaks_of_coco(path: &Path) -> bool {
    const PIECE: u64 = 1 << 16;
    let Ok(mut file) = fs::File::open(path) else {
        return false;
    };
    let length = file.metadata().map_or(0, |metadata| metadata.len());
    let mut bytes = Vec::new();
    let read = file.by_ref().take(PIECE).read_to_end(&mut bytes);
    if length > PIECE && file.seek(SeekFrom::End(-(PIECE as i64))).is_ok() {
        file.take(PIECE).read_to_end(&mut bytes).ok();
    }
    let text = String::from_utf8_lossy(&bytes);
    let has = |word: &str| text.contains(word);
    read.is_ok() && (has("\"annotations\"") || has("\"categories\"")) && has("\"images\"")
        || has("\"image_id\"") && has("\"bbox\"") && has("\"categories\"")
}

/// A file's name without folders and ending.
pub(super) fn file_word(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default();
    stem.to_string_lossy().into_owned()
}

/// The split that a word speaks of, such as `instances_train2017` or `valid`.
pub(super) fn split_of(word: &str) -> Option<Split> {
    let word = word.to_lowercase();
    Split::ALL
        .iter()
        .copied()
        .find(|split| word.contains(split.word()))
}

pub(super) fn read_file(path: &Path) -> Result<CocoFile> {
    parse(&files::read_text(path)?).map_err(|problem| {
        Error::dataset(
            path,
            format!("is not COCO's: {problem}"),
            "it needs the lists images, annotations and categories",
        )
    })
}

/// Reads a file's text; the reason against it in words.
pub(super) fn parse(text: &str) -> Result<CocoFile, String> {
    serde_json::from_str(&without_nan(text)).map_err(|error| json_problem(&error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_and_folders_say_which_split_they_are() {
        for (word, split) in [
            ("instances_train2017", Some(Split::Train)),
            ("valid", Some(Split::Val)),
            ("Validation", Some(Split::Val)),
            ("test-dev", Some(Split::Test)),
            ("_annotations.coco", None),
        ] {
            assert_eq!(split_of(word), split, "{word}");
        }
    }
}
