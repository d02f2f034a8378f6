//! What can go wrong, in words that name the file or value and the remedy.

use std::path::{Path, PathBuf};

/// The result of every fallible operation of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Everything that can go wrong in the library.
///
/// Each message is complete: it names the file or value, what is wrong with it and what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused to read or write a file.
    #[error("cannot {action} {}: {source}{}", path.display(), io_remedy(source))]
    Io {
        /// What was tried, as a verb: "read", "write", "create folder".
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// An image file that cannot be decoded, or has an unusable size or pixel format.
    #[error("image {}: {problem}; {remedy}", path.display())]
    Image {
        /// The image file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
        /// What to do about it.
        remedy: String,
    },
    /// A dataset, or a file of one, that breaks the format.
    #[error("dataset {}: {problem}; {remedy}", path.display())]
    Dataset {
        /// The dataset folder or the file in it.
        path: PathBuf,
        /// What is wrong.
        problem: String,
        /// What to do about it.
        remedy: String,
    },
    /// Weights that do not belong to the network, or a damaged weights file.
    #[error("weights {}: {problem}; {remedy}", path.display())]
    Weights {
        /// The weights file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
        /// What to do about it.
        remedy: String,
    },
    /// A vehicle or prop of the user's that cannot be used.
    #[error("asset {}: {problem}; {remedy}", path.display())]
    Asset {
        /// The glTF file, or the file or folder that belongs to it.
        path: PathBuf,
        /// What is wrong.
        problem: String,
        /// What to do about it.
        remedy: String,
    },
    /// A calibration file that cannot be used.
    #[error("calibration {}: {problem}; {remedy}", path.display())]
    Calibration {
        /// The file, or the first of them.
        path: PathBuf,
        /// What is wrong.
        problem: String,
        /// What to do about it.
        remedy: String,
    },
    /// A setting, argument or input value that cannot be used.
    #[error("{name}: {problem}; {remedy}")]
    Value {
        /// The setting's name, with its value where that helps.
        name: String,
        /// What is wrong.
        problem: String,
        /// What to do about it.
        remedy: String,
    },
    /// A device that this build or this machine does not have.
    #[error("device {device}: {problem}; {remedy}")]
    Device {
        /// The device as it was asked for.
        device: String,
        /// What is wrong.
        problem: String,
        /// What to do about it.
        remedy: String,
    },
    /// Training that cannot go on, such as a loss that is no longer finite.
    #[error("training: {problem}; {remedy}")]
    Training {
        /// What happened.
        problem: String,
        /// What to do about it.
        remedy: String,
    },
    /// Stopped by Ctrl-C after everything was saved.
    #[error("interrupted; {resume}")]
    Interrupted {
        /// How to go on.
        resume: String,
    },
}

impl Error {
    /// An [`Error::Io`], for `map_err`: `fs::read(path).map_err(Error::io("read", path))`.
    pub fn io(action: &'static str, path: impl AsRef<Path>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.as_ref().to_path_buf();
        move |source| Self::Io {
            action,
            path,
            source,
        }
    }

    /// An [`Error::Image`].
    pub fn image(
        path: impl AsRef<Path>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Image {
            path: path.as_ref().to_path_buf(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// An [`Error::Dataset`].
    pub fn dataset(
        path: impl AsRef<Path>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Dataset {
            path: path.as_ref().to_path_buf(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// An [`Error::Weights`].
    pub fn weights(
        path: impl AsRef<Path>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Weights {
            path: path.as_ref().to_path_buf(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// An [`Error::Asset`].
    pub fn asset(
        path: impl AsRef<Path>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Asset {
            path: path.as_ref().to_path_buf(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// An [`Error::Calibration`].
    pub fn calibration(
        path: impl AsRef<Path>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Calibration {
            path: path.as_ref().to_path_buf(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// An [`Error::Value`].
    pub fn value(
        name: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Value {
            name: name.into(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// An [`Error::Device`].
    pub fn device(
        device: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Device {
            device: device.into(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// An [`Error::Training`].
    pub fn training(problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Training {
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }
}

/// What a person can do about the common input/output failures.
fn io_remedy(source: &std::io::Error) -> &'static str {
    use std::io::ErrorKind as Kind;
    match source.kind() {
        Kind::NotFound => "; check the path",
        Kind::PermissionDenied => "; check the permissions or choose another folder",
        Kind::StorageFull | Kind::QuotaExceeded => "; free some space or choose another folder",
        Kind::ReadOnlyFilesystem => "; choose a folder that can be written",
        _ => "",
    }
}

/// The first line of what the YAML parser says, which goes on with an excerpt.
pub(crate) fn yaml_problem(error: &serde_saphyr::Error) -> String {
    let text = error.to_string();
    let line = text.lines().next().unwrap_or_default();
    let line = line.strip_prefix("error: ").unwrap_or(line);
    // What a program could call instead is nothing that a person can do.
    let line = line.split("; use from_").next().unwrap_or_default();
    line.to_owned()
}

/// What the JSON parser says, without the names of this crate's types.
pub(crate) fn json_problem(error: &serde_json::Error) -> String {
    let text = error.to_string();
    let Some((said, rest)) = text.split_once("expected struct ") else {
        return text;
    };
    let place = rest.split_once(" at ").map_or("", |(_, place)| place);
    format!("{said}expected a table of names and values at {place}")
}
