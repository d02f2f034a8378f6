//! Where a run's networks are, or what is missing.

use std::fs;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::train::{CONFIG, StageFolder};

/// Where runs usually are, below the current folder.
const USUAL: &str = "checkpoints";

/// Runs named in an error.
const SHOWN: usize = 5;

/// The best weights of a run's detector and of its distance network.
///
/// # Errors
/// No such folder, one that is no run, or a run without one of them.
pub(super) fn weights(run: &Path) -> Result<[PathBuf; 2]> {
    let stages = ["detector", "distance"];
    let paths = stages.map(|stage| StageFolder::new(run, stage).best());
    let Some((stage, missing)) = stages.iter().zip(&paths).find(|(_, path)| !path.exists()) else {
        return Ok(paths);
    };
    let name = format!("run {}", run.display());
    if !run.is_dir() {
        let problem = if run.exists() {
            "is no folder"
        } else {
            "no such folder"
        };
        return Err(Error::value(name, problem, remedy(run)));
    }
    // Weights alone, copied to where they are used, are enough; this is for what has not even them.
    if !run.join(CONFIG).exists() && !paths.iter().any(|path| path.exists()) {
        let problem = format!("is no run: the folder has no {CONFIG}");
        return Err(Error::value(name, problem, remedy(run)));
    }
    Err(Error::weights(
        missing,
        "does not exist",
        format!(
            "train this run's {stage} first: twinsight train {stage} --run {}",
            run.display()
        ),
    ))
}

/// The weights of a run's size network, where it has one.
pub(crate) fn size_weights(run: &Path) -> Option<PathBuf> {
    Some(StageFolder::new(run, "size").calibrated()).filter(|path| path.exists())
}

/// The runs that there are, or how to make one.
fn remedy(run: &Path) -> String {
    let parent = match run.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent.to_path_buf(),
        _ => PathBuf::from("."),
    };
    let mut runs = Vec::new();
    for folder in [&parent, &parent.join(USUAL), run] {
        for found in runs_in(folder) {
            if !runs.contains(&found) {
                runs.push(found);
            }
        }
    }
    if runs.is_empty() {
        return format!("train one: twinsight train --run {}", run.display());
    }
    let more = match runs.len().saturating_sub(SHOWN) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    runs.truncate(SHOWN);
    format!("give one of {}{more}", runs.join(", "))
}

/// The runs directly in a folder, by name.
fn runs_in(folder: &Path) -> Vec<String> {
    let Ok(entries) = fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut runs: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.join(CONFIG).is_file())
        .collect();
    runs.sort();
    runs.iter()
        .map(|run| run.strip_prefix(".").unwrap_or(run).display().to_string())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_that_is_none_is_told_with_those_that_there_are() {
        let place = tempfile::tempdir().unwrap();
        let path = |name: &str| place.path().join(name);
        let message = |name: &str| weights(&path(name)).unwrap_err().to_string();
        let text = message("typo");
        assert!(
            text.contains("no such folder") && text.contains("train one"),
            "{text}"
        );
        for run in ["b", "a", "checkpoints/quick"] {
            fs::create_dir_all(path(run)).unwrap();
            fs::write(path(run).join("config.json"), "{}").unwrap();
        }
        fs::create_dir(path("empty")).unwrap();
        fs::write(path("file"), "").unwrap();
        let list = ["a", "b", "checkpoints/quick"].map(|run| path(run).display().to_string());
        for (run, problem) in [
            ("typo", "no such folder"),
            ("empty", "is no run"),
            ("file", "is no folder"),
            ("checkpoints", "is no run"),
        ] {
            let text = message(run);
            assert!(text.contains(problem), "{text}");
            assert!(text.contains(&list[2]), "{text}");
        }
        assert!(message("typo").contains(&list.join(", ")));
        let text = message("a");
        assert!(
            text.contains("detector") && text.contains("twinsight train detector"),
            "{text}"
        );
    }

    #[test]
    fn weights_without_settings_are_enough() {
        let place = tempfile::tempdir().unwrap();
        for stage in ["detector", "distance"] {
            let folder = StageFolder::new(place.path(), stage);
            folder.create().unwrap();
            fs::write(folder.best(), "").unwrap();
        }
        assert!(weights(place.path()).is_ok());
        fs::remove_file(StageFolder::new(place.path(), "distance").best()).unwrap();
        let text = weights(place.path()).unwrap_err().to_string();
        assert!(text.contains("train distance"), "{text}");
    }
}
