//! Runs the built program in a fresh folder.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use tempfile::TempDir;

/// A fresh folder in which the program is run; it disappears with the value.
pub struct Workplace {
    folder: TempDir,
}

/// What a run of the program left behind.
pub struct Outcome {
    /// Exit code; none if a signal ended it.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

impl Workplace {
    pub fn new() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
        }
    }

    /// A path in the folder.
    pub fn path(&self, name: impl AsRef<Path>) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a file; its parents are created.
    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, content).unwrap();
        path
    }

    /// Writes an image of one colour.
    pub fn write_image(&self, name: &str, width: u32, height: u32) -> PathBuf {
        let path = self.path(name);
        let grey = image::Rgb([90, 100, 110]);
        image::RgbImage::from_pixel(width, height, grey)
            .save(&path)
            .unwrap();
        path
    }

    /// The program, ready to be given arguments; relative paths are in the folder.
    pub fn command(&self) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_twinsight"));
        command.current_dir(self.folder.path()).stdin(Stdio::null());
        command
    }

    /// Runs the program to its end.
    pub fn run<S: AsRef<OsStr>>(&self, args: impl IntoIterator<Item = S>) -> Outcome {
        Outcome::of(self.command().args(args).output().unwrap())
    }

    /// Runs a line of arguments that blanks divide.
    pub fn line(&self, line: &str) -> Outcome {
        self.run(line.split_whitespace())
    }

    /// Runs a line of arguments with a variable in its environment.
    pub fn line_with(&self, line: &str, (name, value): (&str, &str)) -> Outcome {
        let mut command = self.command();
        command.args(line.split_whitespace()).env(name, value);
        Outcome::of(command.output().unwrap())
    }
}

impl Outcome {
    pub fn of(output: Output) -> Self {
        Self {
            code: output.status.code(),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }

    /// Standard output of a run that must have succeeded.
    pub fn success(self) -> String {
        assert_eq!(
            self.code,
            Some(0),
            "should succeed, but said: {}",
            self.stderr
        );
        self.stdout
    }

    /// The one error of a run that must have failed, without a result on standard output.
    pub fn error(self) -> String {
        assert_eq!(self.code, Some(2), "should fail; stderr: {}", self.stderr);
        assert_eq!(self.stdout, "", "an error is no result");
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
        let errors = self.stderr.match_indices("error: ").count();
        assert_eq!(errors, 1, "one error is said once: {}", self.stderr);
        self.stderr
    }

    /// Fails unless the error says all of this.
    pub fn error_says(self, words: &[&str]) {
        let error = self.error();
        for word in words {
            assert!(error.contains(word), "\"{word}\" should be in: {error}");
        }
    }
}
