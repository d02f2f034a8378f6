//! Files that a command writes where the user says.

use std::fs;
use std::path::{Path, PathBuf};

use twinsight::{Error, Result, files};

/// A kind of file that a command writes.
#[derive(Debug, Clone, Copy)]
pub struct Kind {
    /// What it is, with its article.
    name: &'static str,
    /// How its names may end; a name may have no ending, too.
    endings: &'static [&'static str],
}

impl Kind {
    pub const CSV: Self = Self {
        name: "a table",
        endings: &["csv", "txt"],
    };
    pub const JSON_LINES: Self = Self {
        name: "JSON Lines",
        endings: &["jsonl", "ndjson", "json", "txt"],
    };
    pub const JSON: Self = Self {
        name: "a JSON file",
        endings: &["json", "txt"],
    };
    pub const PAGE: Self = Self {
        name: "a page",
        endings: &["html", "htm"],
    };
    pub const PICTURE: Self = Self {
        name: "a picture",
        endings: &["png", "jpg", "jpeg"],
    };
    pub const DRAWING: Self = Self {
        name: "an SVG picture",
        endings: &["svg"],
    };
    pub const CALIBRATION: Self = Self {
        name: "a calibration",
        endings: &["toml"],
    };
    pub const VIDEO: Self = Self {
        name: "a video",
        endings: &["mp4", "mkv", "mov", "webm", "avi"],
    };

    /// Whether a file's name ends as those of this kind do.
    pub fn ends(self, path: &Path) -> bool {
        let ending = path.extension().unwrap_or_default();
        self.endings
            .iter()
            .any(|known| ending.eq_ignore_ascii_case(known))
    }
}

/// Makes sure, before long work, that a file can be written there later, and that it replaces
/// nothing but an earlier one of its kind: none of the files that are read, nor one of another kind.
///
/// # Errors
/// A folder or a file that is to stay in the file's place, or a parent folder that cannot be created.
pub fn check_target(path: &Path, kind: Kind, inputs: &[PathBuf]) -> Result<()> {
    let refuse = |problem: String, remedy: &str| {
        Err(Error::value(path.display().to_string(), problem, remedy))
    };
    if path.is_dir() {
        return refuse("is a folder".to_owned(), "give the name of a file");
    }
    // Pipes and devices are written to, not replaced.
    if path.is_file() {
        let name = kind.name;
        if inputs.iter().any(|input| is_same(path, input)) {
            return refuse(
                format!("is read, and {name} would replace it"),
                "give the name of another file",
            );
        }
        // A link stays, and what it leads to is replaced: neither may be something else.
        let place = files::followed(path)?;
        let is_other = |path: &Path| path.extension().is_some() && !kind.ends(path);
        if is_other(path) || is_other(&place) {
            return refuse(
                format!("exists, and by its name it is not {name}, which would replace it"),
                &format!(
                    "give the name of a new file, or one that ends in .{}",
                    kind.endings.join(" or .")
                ),
            );
        }
    }
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => files::create_folder(parent),
        _ => Ok(()),
    }
}

/// Makes sure, before long work, that pictures written into a folder replace none that are read.
///
/// # Errors
/// A file in the folder's place, or one of the folders that are read.
pub fn check_folder(path: &Path, inputs: &[PathBuf]) -> Result<()> {
    let refuse = |problem: &str, remedy: &str| {
        Err(Error::value(path.display().to_string(), problem, remedy))
    };
    if inputs.iter().any(|input| is_same(path, input)) {
        return refuse(
            "is read, and pictures written there would replace those",
            "give the name of another folder",
        );
    }
    if Kind::PICTURE.ends(path) && !path.is_dir() {
        return refuse(
            "is the name of one picture, and there are several",
            "give the name of a folder for them",
        );
    }
    if path.is_file() {
        return refuse(
            "is a file, and several pictures need a folder",
            "give the name of a folder",
        );
    }
    Ok(())
}

/// Whether two names lead to the same place; a place that is not there yet is the one of its folder
/// and name.
pub fn is_same(a: &Path, b: &Path) -> bool {
    let place = |path: &Path| {
        let path = if path.as_os_str().is_empty() {
            Path::new(".")
        } else {
            path
        };
        if let Ok(found) = path.canonicalize() {
            return Some(found);
        }
        let parent = path
            .parent()
            .filter(|parent| !parent.as_os_str().is_empty());
        let parent = parent.unwrap_or(Path::new(".")).canonicalize().ok()?;
        Some(parent.join(path.file_name()?))
    };
    a == b || place(a).is_some_and(|a| Some(a) == place(b))
}

/// The files of a run that commands read.
pub fn of_run(run: &Path) -> impl Iterator<Item = PathBuf> {
    [
        "config.json",
        "metrics.csv",
        "summary.json",
        "detector/best.safetensors",
        "distance/best.safetensors",
    ]
    .into_iter()
    .map(|file| run.join(file))
}

/// Writes a file whole or not at all; a pipe or device is written to, not replaced.
///
/// # Errors
/// A file that cannot be written.
pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    if files::is_replaceable(path) {
        return files::write_atomically(path, bytes);
    }
    fs::write(path, bytes).map_err(Error::io("write", path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn a_link_is_neither_a_way_to_replace_an_input_nor_a_file_of_another_kind() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in ["in.csv", "best.safetensors", "old.csv"] {
            fs::write(path(name), "").unwrap();
            std::os::unix::fs::symlink(name, path(&format!("to-{name}.csv"))).unwrap();
        }
        let check = |name: &str| check_target(&path(name), Kind::CSV, &[path("in.csv")]);
        assert!(
            check("to-in.csv.csv")
                .unwrap_err()
                .to_string()
                .contains("is read")
        );
        let message = check("to-best.safetensors.csv").unwrap_err().to_string();
        assert!(message.contains("not a table"), "{message}");
        check("to-old.csv.csv").unwrap();
    }

    #[test]
    fn a_file_replaces_an_earlier_one_of_its_kind_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| {
            let path = folder.path().join(name);
            fs::write(&path, "").unwrap();
            path
        };
        let inputs = [file("in.csv"), folder.path().join("missing.csv")];
        for name in ["old.csv", "OLD.CSV", "old.txt", "without"] {
            assert!(
                check_target(&file(name), Kind::CSV, &inputs).is_ok(),
                "{name}"
            );
        }
        for name in ["new.csv", "new.xyz", "sub/new.csv"] {
            let path = folder.path().join(name);
            assert!(check_target(&path, Kind::CSV, &inputs).is_ok(), "{name}");
        }
        for (name, words) in [
            ("in.csv", "is read"),
            ("sub/../in.csv", "is read"),
            ("weights.safetensors", "ends in .csv or .txt"),
            ("picture.png", "not a table"),
        ] {
            if !name.contains("in.csv") {
                file(name);
            }
            let path = folder.path().join(name);
            let text = check_target(&path, Kind::CSV, &inputs).unwrap_err();
            assert!(text.to_string().contains(words), "{text}");
        }
        assert!(check_target(folder.path(), Kind::CSV, &[]).is_err());
        #[cfg(unix)]
        assert!(check_target(Path::new("/dev/null"), Kind::CSV, &[]).is_ok());
    }

    #[test]
    fn pictures_go_into_no_folder_that_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let inputs = [folder.path().join("left"), PathBuf::new()];
        fs::create_dir(&inputs[0]).unwrap();
        let text = |path: &Path| check_folder(path, &inputs).unwrap_err().to_string();
        assert!(text(&folder.path().join("left/../left/.")).contains("is read"));
        assert!(text(Path::new(".")).contains("is read"));
        assert!(text(&folder.path().join("seen.png")).contains("folder"));
        fs::write(folder.path().join("file"), "").unwrap();
        assert!(text(&folder.path().join("file")).contains("is a file"));
        for good in ["seen", "left/seen"] {
            assert!(check_folder(&folder.path().join(good), &inputs).is_ok());
        }
    }
}
