//! Frames from folders: one folder a side, or one for both.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::files::Entry;
use super::layout::Layout;
use super::names::{natural_order, side_and_rest, stem};
use crate::dataset::Side;
use crate::error::{Error, Result};
use crate::imaging::{READABLE, files_in};

/// Folders of left and right images that datasets have: plain ones, KITTI's object, raw and
/// odometry ones, `EuRoC`'s.
const SIDES: [[&str; 2]; 7] = [
    ["left", "right"],
    ["Left", "Right"],
    ["image_2", "image_3"],
    ["image_02", "image_03"],
    ["image_0", "image_1"],
    ["image_00", "image_01"],
    ["cam0", "cam1"],
];

/// Names of files shown in an error.
const SHOWN: usize = 3;

/// Images by what their frame is called; several of one name are kept to be told.
type ByName = BTreeMap<String, Vec<PathBuf>>;

/// The frames of folders, and the files there that could be pictures of a kind that is not read.
#[derive(Debug, Default)]
pub(super) struct Found {
    pub entries: Vec<Entry>,
    pub skipped: Vec<PathBuf>,
}

/// The images directly in a folder, in natural order; other files that may have been meant go to
/// `skipped`.
fn images(folder: &Path, skipped: &mut Vec<PathBuf>) -> Result<Vec<PathBuf>> {
    let found = files_in(folder)?;
    skipped.extend(found.skipped);
    let mut images = found.images;
    images.sort_by(|a, b| {
        natural_order(&stem(a), &stem(b)).then_with(|| a.file_name().cmp(&b.file_name()))
    });
    Ok(images)
}

/// The images of a folder, of which there must be one.
fn some_images(folder: &Path, skipped: &mut Vec<PathBuf>) -> Result<Vec<PathBuf>> {
    let images = images(folder, skipped)?;
    if images.is_empty() {
        let others = match skipped.first().and_then(|path| path.file_name()) {
            Some(name) => format!(" but other files such as {}", name.display()),
            None => String::new(),
        };
        return Err(Error::value(
            folder.display().to_string(),
            format!("holds no {READABLE} images{others}"),
            "check the path, or convert the images to PNG",
        ));
    }
    Ok(images)
}

/// Pictures that show both sides.
pub(super) fn stacked(folder: &Path, layout: Layout) -> Result<Found> {
    let mut skipped = Vec::new();
    let entries = some_images(folder, &mut skipped)?.into_iter();
    Ok(Found {
        entries: entries
            .map(|path| Entry::stacked(stem(&path), &path, layout))
            .collect(),
        skipped,
    })
}

/// A folder of left and a folder of right images: those of the same name, but for the side in it,
/// are a pair; where no names agree, the first one of each folder, the second ones and so on.
pub(super) fn two(folders: [&Path; 2]) -> Result<Found> {
    let mut skipped = Vec::new();
    let [left, right] = [
        some_images(folders[0], &mut skipped)?,
        some_images(folders[1], &mut skipped)?,
    ];
    let named = |images: &[PathBuf], side: Side| -> ByName {
        let mut by_name = ByName::new();
        for path in images {
            let stem = stem(path);
            let name = match side_and_rest(&stem) {
                Some((found, rest)) if found == side => rest,
                _ => stem,
            };
            by_name.entry(name).or_default().push(path.clone());
        }
        by_name
    };
    let sides = [named(&left, Side::Left), named(&right, Side::Right)];
    if sides[0].keys().any(|name| sides[1].contains_key(name)) {
        let entries = joined(&sides, folders);
        return Ok(Found { entries, skipped });
    }
    if left.len() != right.len() {
        let few = |images: &[PathBuf]| {
            let names = images.iter().take(SHOWN);
            let names: Vec<_> = names.map(|path| stem(path)).collect();
            names.join(", ")
        };
        return Err(Error::value(
            format!("{} and {}", folders[0].display(), folders[1].display()),
            format!(
                "hold {} and {} images of which no two have the same name ({} ...; {} ...)",
                left.len(),
                right.len(),
                few(&left),
                few(&right)
            ),
            "give the images of a pair the same name, or both folders the same number",
        ));
    }
    let entries = left.iter().zip(&right);
    Ok(Found {
        entries: entries
            .map(|(left, right)| Entry::pair(stem(left), [left, right]))
            .collect(),
        skipped,
    })
}

/// A folder that holds both sides: folders for each, or names that say which.
pub(super) fn both_sides(folder: &Path) -> Result<Found> {
    for sides in SIDES {
        let both = sides.map(|side| folder.join(side));
        if both.iter().all(|side| side.is_dir()) {
            // KITTI's raw recordings and EuRoC have their images one folder further down.
            let [left, right] = both.map(|side| {
                let data = side.join("data");
                if data.is_dir() { data } else { side }
            });
            return two([&left, &right]);
        }
    }
    let inner = folder.join("frames");
    let mut skipped = Vec::new();
    let found = sided(folder, &mut skipped)?;
    let (found, folder) = match found {
        Some(found) => (found, folder),
        // A dataset of this program.
        None if inner.is_dir() => {
            skipped.clear();
            let found = sided(&inner, &mut skipped)?;
            (found.unwrap_or_default(), inner.as_path())
        }
        None => (Default::default(), folder),
    };
    if found.iter().all(BTreeMap::is_empty) {
        return Err(Error::value(
            folder.display().to_string(),
            "holds no stereo pairs: neither left/ and right/ or image_2/ and image_3/, nor names \
             like left_1.png and right_1.png, 1_left.png and 1_right.png, 1_L.png and 1_R.png",
            "give a folder each for left and right images, or --layout if each picture shows both",
        ));
    }
    Ok(Found {
        entries: joined(&found, [folder, folder]),
        skipped,
    })
}

/// The images whose names say which side they are; None without any.
fn sided(folder: &Path, skipped: &mut Vec<PathBuf>) -> Result<Option<[ByName; 2]>> {
    let mut sides = [ByName::new(), ByName::new()];
    for path in images(folder, skipped)? {
        if let Some((side, name)) = side_and_rest(&stem(&path)) {
            let index = usize::from(side == Side::Right);
            sides[index].entry(name).or_default().push(path);
        }
    }
    Ok(sides.iter().any(|side| !side.is_empty()).then_some(sides))
}

/// One frame for each name, in natural order.
fn joined(sides: &[ByName; 2], folders: [&Path; 2]) -> Vec<Entry> {
    let mut names: Vec<&String> = sides.iter().flat_map(BTreeMap::keys).collect();
    names.sort_by(|a, b| natural_order(a, b));
    names.dedup();
    let folders = folders.map(|folder| format!("in {}", folder.display()));
    let side = |i: usize, name: &String| sides[i].get(name).map_or(&[][..], Vec::as_slice);
    names
        .into_iter()
        .map(|name| {
            let files = [side(0, name), side(1, name)];
            Entry::of_sides(name.clone(), files, [&folders[0], &folders[1]])
        })
        .collect()
}
