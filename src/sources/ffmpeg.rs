//! The programs `ffmpeg` and `ffprobe`: videos to pixels and back, through pipes.
//!
//! A video is never held as a whole: pixels of one frame go through at a time. The programs may
//! read nothing but the file that they are given, and are ended with the value that started them.

mod decode;
mod encode;

use std::ffi::{OsStr, OsString};
use std::io::{self, Read};
use std::path::Path;
use std::process::{Child, ChildStderr, Command, Stdio};
use std::thread::{self, JoinHandle};

use crate::error::{Error, Result};

pub(super) use decode::{Decoder, Ending, VideoInfo, probe};
pub use encode::{VideoEncoding, VideoWriter};

/// What a program says is kept up to this many bytes.
const MOST_WORDS: u64 = 16 << 10;

/// Videos may refer to other files and to addresses; only these ways of access are allowed.
const PROTOCOLS: &str = "file,pipe";

/// A program of FFmpeg that is ended with this value.
#[derive(Debug)]
struct Program {
    child: Child,
    words: Option<JoinHandle<String>>,
}

impl Program {
    fn start(mut command: Command, needed_for: &str) -> Result<Self> {
        command.stderr(Stdio::piped());
        // Ctrl-C on a terminal is for us: we end the programs when we have taken what we want.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command
            .spawn()
            .map_err(|error| not_started(&command, needed_for, error))?;
        let words = child
            .stderr
            .take()
            .map(|stderr| thread::spawn(move || words_of(stderr)));
        Ok(Self { child, words })
    }

    /// Waits for its end. None for success, otherwise what it says.
    fn end(&mut self) -> Option<String> {
        let status = self.child.wait();
        let words = self.words.take().and_then(|words| words.join().ok());
        let words = first_line(&words.unwrap_or_default());
        match status {
            Ok(status) if status.success() && words.is_empty() => None,
            Ok(_) if !words.is_empty() => Some(words),
            Ok(status) => Some(status.to_string()),
            Err(error) => Some(error.to_string()),
        }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // Both fail where it has ended already, which is what is wanted.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// What a program says, to its end, so that it never waits for a reader; the beginning is kept.
fn words_of(mut stderr: ChildStderr) -> String {
    let mut words = Vec::new();
    let kept = stderr.by_ref().take(MOST_WORDS).read_to_end(&mut words);
    let rest = io::copy(&mut stderr, &mut io::sink());
    kept.and(rest).ok();
    String::from_utf8_lossy(&words).into_owned()
}

/// The first line that says something, without the address of the part that says it.
fn first_line(words: &str) -> String {
    let line = words.lines().map(str::trim).find(|line| !line.is_empty());
    let line = line.unwrap_or_default();
    match line.split_once("] ") {
        Some((part, message)) if part.starts_with('[') && part.contains("@ 0x") => message.trim(),
        _ => line,
    }
    .to_owned()
}

/// A program that cannot be started, with the way to get it.
fn not_started(command: &Command, needed_for: &str, error: io::Error) -> Error {
    let program = command.get_program().to_string_lossy().into_owned();
    if error.kind() != io::ErrorKind::NotFound {
        return Error::io("start", program)(error);
    }
    Error::value(
        program.clone(),
        format!("is not installed, and {needed_for} needs it"),
        format!(
            "install FFmpeg so that {program} is found (Debian, Ubuntu: apt install ffmpeg), or \
             use folders of PNG or JPEG images"
        ),
    )
}

/// A path that no program takes for an option or an address.
fn file_argument(path: &Path) -> OsString {
    let mut argument = OsString::from("file:");
    argument.push(path);
    argument
}

/// A program with its common arguments.
fn command<S: AsRef<OsStr>>(program: &str, args: impl IntoIterator<Item = S>) -> Command {
    let mut command = Command::new(program);
    command.args(["-hide_banner", "-v", "error"]).args(args);
    command
}

/// The arguments that keep each frame as it is: neither doubled nor dropped for a constant rate.
/// They have had another name since version 5.1.
fn passthrough(needed_for: &str) -> Result<[&'static str; 2]> {
    let output = Command::new("ffmpeg")
        .arg("-version")
        .stdin(Stdio::null())
        .output()
        .map_err(|error| not_started(&Command::new("ffmpeg"), needed_for, error))?;
    let text = String::from_utf8_lossy(&output.stdout);
    let is_old = text
        .strip_prefix("ffmpeg version ")
        .and_then(version_number)
        .is_some_and(|version| version < (5, 1));
    Ok([if is_old { "-vsync" } else { "-fps_mode" }, "passthrough"])
}

/// Major and minor number of a version such as `5.1.9-0+deb12u1`; None for the name of a snapshot.
fn version_number(text: &str) -> Option<(u32, u32)> {
    let text = text.strip_prefix('n').unwrap_or(text);
    let mut numbers = text.split(|c: char| !c.is_ascii_digit());
    let major = numbers.next()?.parse().ok()?;
    let minor = numbers.next().and_then(|minor| minor.parse().ok());
    Some((major, minor.unwrap_or(0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_read_from_the_names_of_builds() {
        for (text, version) in [
            ("5.1.9-0+deb12u1 Copyright (c)", Some((5, 1))),
            ("4.4.2-0ubuntu0.22.04.1", Some((4, 4))),
            ("n7.0", Some((7, 0))),
            ("8 Copyright", Some((8, 0))),
            ("N-112233-gabcdef", None),
            ("", None),
        ] {
            assert_eq!(version_number(text), version, "{text}");
        }
    }

    #[test]
    fn of_what_a_program_says_the_first_message_is_kept() {
        assert_eq!(
            first_line("\n[mov,mp4 @ 0x5581] moov atom not found\nfile:a.mp4: Invalid data"),
            "moov atom not found"
        );
        assert_eq!(first_line("[a] plain"), "[a] plain");
        assert_eq!(first_line(""), "");
    }
}
