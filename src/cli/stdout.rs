//! Standard output: results, and nothing else.

use std::io::{self, Write as _};

use twinsight::{Error, Result};

/// Prints a result.
///
/// # Errors
/// A standard output that cannot be written, such as a file on a full disk.
pub fn print(text: &str) -> Result<()> {
    let mut stdout = io::stdout().lock();
    unless_closed(
        stdout
            .write_all(text.as_bytes())
            .and_then(|()| stdout.flush()),
    )
}

/// The outcome of printing. A reader that has seen enough, such as `head`, is no error.
///
/// # Errors
/// Any other failure.
pub fn unless_closed(outcome: io::Result<()>) -> Result<()> {
    match outcome {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        outcome => outcome.map_err(Error::io("write", "standard output")),
    }
}
