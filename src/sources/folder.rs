//! Frames from folders: one folder a side, or one for both.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::files::Entry;
use super::layout::Layout;
use super::names::{natural_order, side_and_rest, stem};
use crate::dataset::Side;
use crate::error::{Error, Result};

/// Endings of images that can be read.
const ENDINGS: [&str; 3] = ["png", "jpg", "jpeg"];

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

/// The images directly in a folder, by name; hidden and other files are no concern of ours.
fn images(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut images = Vec::new();
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let ending = path.extension().and_then(|ending| ending.to_str());
        let is_image = ending.is_some_and(|ending| {
            ENDINGS
                .iter()
                .any(|known| known.eq_ignore_ascii_case(ending))
        });
        let is_hidden = stem(&path).starts_with('.');
        if is_image && !is_hidden && !path.is_dir() {
            images.push(path);
        }
    }
    images.sort_by(|a, b| {
        natural_order(&stem(a), &stem(b)).then_with(|| a.file_name().cmp(&b.file_name()))
    });
    Ok(images)
}

/// The images of a folder, of which there must be one.
fn some_images(folder: &Path) -> Result<Vec<PathBuf>> {
    let images = images(folder)?;
    if images.is_empty() {
        return Err(Error::value(
            folder.display().to_string(),
            "holds no PNG or JPEG images",
            "check the path, or convert the images to PNG",
        ));
    }
    Ok(images)
}

/// Pictures that show both sides.
pub(super) fn stacked(folder: &Path, layout: Layout) -> Result<Vec<Entry>> {
    let entries = some_images(folder)?.into_iter();
    Ok(entries
        .map(|path| Entry::stacked(stem(&path), &path, layout))
        .collect())
}

/// A folder of left and a folder of right images: those of the same name, but for the side in it,
/// are a pair; where no names agree, the first one of each folder, the second ones and so on.
pub(super) fn two(folders: [&Path; 2]) -> Result<Vec<Entry>> {
    let [left, right] = [some_images(folders[0])?, some_images(folders[1])?];
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
        return Ok(joined(&sides, folders));
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
    Ok(entries
        .map(|(left, right)| Entry::pair(stem(left), [left, right]))
        .collect())
}

/// A folder that holds both sides: folders for each, or names that say which.
pub(super) fn both_sides(folder: &Path) -> Result<Vec<Entry>> {
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
    let found = sided(folder)?;
    let (found, folder) = match found {
        Some(found) => (found, folder),
        // A dataset of this program.
        None if inner.is_dir() => (sided(&inner)?.unwrap_or_default(), inner.as_path()),
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
    Ok(joined(&found, [folder, folder]))
}

/// The images whose names say which side they are; None without any.
fn sided(folder: &Path) -> Result<Option<[ByName; 2]>> {
    let mut sides = [ByName::new(), ByName::new()];
    for path in images(folder)? {
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
