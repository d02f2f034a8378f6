//! Frames from numbered files, named by a pattern such as `left_%05d.png`.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::files::Entry;
use super::layout::Layout;
use crate::error::{Error, Result};

/// A path whose name has a place for a number.
struct Pattern<'a> {
    path: &'a Path,
    folder: PathBuf,
    before: &'a str,
    after: &'a str,
    /// Digits at least, with leading zeros.
    digits: usize,
}

impl<'a> Pattern<'a> {
    fn new(path: &'a Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?;
        let (before, rest) = name.split_once('%')?;
        let (width, after) = rest.split_once('d')?;
        let is_padded = width.len() > 1 && width.starts_with('0');
        let is_number = width.bytes().all(|byte| byte.is_ascii_digit());
        let digits = if width.is_empty() {
            1
        } else {
            (is_padded && is_number).then(|| width.parse().ok())??
        };
        let folder = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent.to_path_buf(),
            _ => PathBuf::from("."),
        };
        let is_one = !after.contains('%') && !path.exists();
        is_one.then_some(Self {
            path,
            folder,
            before,
            after,
            digits,
        })
    }

    /// The number in a file's name.
    fn number(&self, name: &str) -> Option<u64> {
        let digits = name.strip_prefix(self.before)?.strip_suffix(self.after)?;
        let is_number = digits.len() >= self.digits && digits.bytes().all(|b| b.is_ascii_digit());
        is_number.then(|| digits.parse().ok())?
    }

    /// All files of this pattern, of which there must be one.
    fn files(&self) -> Result<BTreeMap<u64, Vec<PathBuf>>> {
        let mut files: BTreeMap<u64, Vec<PathBuf>> = BTreeMap::new();
        for entry in fs::read_dir(&self.folder).map_err(Error::io("read", &self.folder))? {
            let path = entry.map_err(Error::io("read", &self.folder))?.path();
            let name = path.file_name().and_then(|name| name.to_str());
            if let Some(number) = name.and_then(|name| self.number(name)) {
                files.entry(number).or_default().push(path);
            }
        }
        if files.is_empty() {
            return Err(Error::value(
                self.path.display().to_string(),
                "is the name of no file, with any number in it",
                "check the pattern: %05d stands for five digits or more, %d for any",
            ));
        }
        for same in files.values_mut() {
            same.sort();
        }
        Ok(files)
    }

    fn name(&self, number: u64) -> String {
        format!("{number:0digits$}", digits = self.digits)
    }
}

/// Whether a path is a pattern and no file.
pub(super) fn is_pattern(path: &Path) -> bool {
    Pattern::new(path).is_some()
}

fn pattern(path: &Path) -> Result<Pattern<'_>> {
    Pattern::new(path).ok_or_else(|| {
        Error::value(
            path.display().to_string(),
            "is no pattern",
            "write it like left_%05d.png",
        )
    })
}

/// Left and right files of the same number.
pub(super) fn pairs(patterns: [&Path; 2]) -> Result<Vec<Entry>> {
    let patterns = [pattern(patterns[0])?, pattern(patterns[1])?];
    let [left, right] = [patterns[0].files()?, patterns[1].files()?];
    let mut numbers: Vec<u64> = left.keys().chain(right.keys()).copied().collect();
    numbers.sort_unstable();
    numbers.dedup();
    let expected = patterns.each_ref().map(|p| p.path.display().to_string());
    let side = |files: &'_ BTreeMap<u64, Vec<PathBuf>>, number| -> Vec<PathBuf> {
        files.get(number).cloned().unwrap_or_default()
    };
    Ok(numbers
        .iter()
        .map(|number| {
            let [left, right] = [side(&left, number), side(&right, number)];
            let expected = [expected[0].as_str(), expected[1].as_str()];
            Entry::of_sides(patterns[0].name(*number), [&left, &right], expected)
        })
        .collect())
}

/// Numbered pictures that show both sides.
pub(super) fn stacked(path: &Path, layout: Layout) -> Result<Vec<Entry>> {
    let pattern = pattern(path)?;
    let files = pattern.files()?.into_iter();
    Ok(files
        .map(|(number, same)| match &same[..] {
            [file] => Entry::stacked(pattern.name(number), file, layout),
            several => Entry::of_sides(pattern.name(number), [several, several], ["", ""]),
        })
        .collect())
}
