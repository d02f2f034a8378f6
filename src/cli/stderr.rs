//! Standard error: everything that is no result.

use std::io::{self, Write as _};

/// Prints a line. A failure is ignored: there is nowhere left to report it.
pub fn line(text: &str) {
    writeln!(io::stderr(), "{text}").ok();
}
