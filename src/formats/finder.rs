//! Images under the names that they had on another machine.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};
use std::sync::OnceLock;

use crate::imaging::{files_in, is_image};

/// Folders of images are at most this deep.
const DEEPEST: usize = 8;

/// Looks images up by the names in a file of labels: paths of this machine or another, with `/` or
/// `\`, in the folders where they may be.
#[derive(Debug)]
pub(super) struct Finder {
    /// Where paths begin, in the order in which they are tried.
    roots: Vec<PathBuf>,
    /// Where names alone are looked for, with all folders below.
    below: Vec<PathBuf>,
    /// The images below those folders by their names alone.
    by_name: OnceLock<BTreeMap<String, BTreeSet<PathBuf>>>,
}

impl Finder {
    pub fn new(roots: Vec<PathBuf>, below: Vec<PathBuf>) -> Self {
        Self {
            roots,
            below,
            by_name: OnceLock::new(),
        }
    }

    /// Finds an image: as the path says, without the folders before it that only another machine has,
    /// or else the only one of its name; the reason against it in words.
    pub fn find(&self, name: &str) -> Result<PathBuf, String> {
        if let Some(found) = shortened(name, &self.roots, Path::is_file) {
            return Ok(found);
        }
        let plain = name.replace('\\', "/");
        let base = plain.rsplit('/').next().unwrap_or_default();
        let by_name = self.by_name.get_or_init(|| {
            let mut by_name = BTreeMap::new();
            for folder in &self.below {
                collect(folder, 0, &mut by_name);
            }
            by_name
        });
        let same = by_name.get(base);
        match same.map(|same| (same.len(), same.first())) {
            Some((1, Some(found))) => Ok(found.clone()),
            Some((count, _)) if count > 1 => Err(format!(
                "the image is not there, and {count} others are called {base}"
            )),
            _ => Err("the image is not there".to_owned()),
        }
    }
}

/// The first place where a foreign path leads to what is wanted: as it is, or without its first
/// parts, as few of them as possible.
pub(super) fn shortened(
    name: &str,
    roots: &[PathBuf],
    is_wanted: impl Fn(&Path) -> bool,
) -> Option<PathBuf> {
    let own = Path::new(name);
    let as_it_is = roots.iter().map(|root| root.join(own));
    if let Some(found) = as_it_is.clone().find(|path| is_wanted(path)) {
        return Some(found);
    }
    let plain = name.replace('\\', "/");
    // What is above a root is not looked for: `..` of another machine leads nowhere.
    let parts: Vec<Component<'_>> = Path::new(&plain)
        .components()
        .filter(|part| matches!(part, Component::Normal(_)))
        .collect();
    (0..parts.len()).find_map(|first| {
        let rest: PathBuf = parts[first..].iter().collect();
        let places = roots.iter().map(|root| root.join(&rest));
        places.into_iter().find(|path| is_wanted(path))
    })
}

/// The images of a folder and those below. A folder that cannot be read has none.
fn collect(folder: &Path, depth: usize, by_name: &mut BTreeMap<String, BTreeSet<PathBuf>>) {
    let Ok(files) = files_in(folder) else {
        return;
    };
    for path in files.images.into_iter().filter(|path| is_image(path)) {
        if let Some(name) = path.file_name() {
            let same = by_name.entry(name.to_string_lossy().into_owned());
            same.or_default().insert(path);
        }
    }
    // Links to a folder above would go round for ever.
    let is_own = |path: &PathBuf| !path.is_symlink();
    for inner in files.folders.iter().filter(|path| is_own(path)) {
        if depth < DEEPEST {
            collect(inner, depth + 1, by_name);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn foreign_paths_are_found_by_their_ends_and_names_only_where_they_are_the_only_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in ["a/x.png", "b/x.png", "a/only.jpg", "plain.png"] {
            fs::create_dir_all(path(name).parent().unwrap()).unwrap();
            fs::write(path(name), "").unwrap();
        }
        let root = folder.path().to_path_buf();
        let finder = Finder::new(vec![root.clone()], vec![root]);
        for (name, expected) in [
            ("plain.png", "plain.png"),
            ("a/x.png", "a/x.png"),
            ("C:\\data\\set\\b\\x.png", "b/x.png"),
            ("/content/drive/b/x.png", "b/x.png"),
            ("../images/a/x.png", "a/x.png"),
            ("/elsewhere/only.jpg", "a/only.jpg"),
            ("only.jpg", "a/only.jpg"),
        ] {
            assert_eq!(finder.find(name), Ok(path(expected)), "{name}");
        }
        assert!(finder.find("c/x.png").unwrap_err().contains("2 others"));
        for name in ["gone.png", "", "/", "a", "..", "\\\\"] {
            assert!(
                finder.find(name).unwrap_err().contains("not there"),
                "{name}"
            );
        }
    }
}
