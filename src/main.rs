//! The program `twinsight`: reads the command line, runs one command, turns errors into exit codes.
//!
//! 0: done. 1: `validate` found something. 2: an error, named in one line on standard error. 130: stopped by Ctrl-C.

mod cli;

use std::io::{self, IsTerminal as _};
use std::panic;
use std::process::ExitCode;
use std::sync::{Mutex, PoisonError};

use clap::Parser as _;
use twinsight::{Error, Result};

use cli::{Cli, stderr};

/// Exit code of every error, as of clap's own usage errors.
const FAILED: u8 = 2;

/// Exit code after Ctrl-C, as shells count it: 128 and the signal's number.
pub(crate) const INTERRUPTED: u8 = 130;

/// What the first panic said. Kept rather than printed at once: the library catches some panics of
/// drivers that are not installed, and those are no defects.
static DEFECT: Mutex<Option<String>> = Mutex::new(None);

fn main() -> ExitCode {
    set_environment();
    twinsight::kernels::keep_freed_memory();
    panic::set_hook(Box::new(|info| {
        let mut defect = DEFECT.lock().unwrap_or_else(PoisonError::into_inner);
        defect.get_or_insert_with(|| info.to_string());
    }));
    match panic::catch_unwind(parse_and_run) {
        Ok(code) => code,
        Err(_) => report_defect(),
    }
}

/// Makes the processor Burn's default device, its server's log plain where nobody sees colours, and
/// graphics drivers quiet where there is no desktop.
///
/// Burn loads an optimiser's state there before it moves
/// it to where the network is; with GPU backends built in, that would open a graphics card that
/// nobody asked for, or panic where there is none. The server's log goes to standard output. To learn
/// which card shows the desktop, a layer of Mesa's looks for one, and complains about a missing
/// `XDG_RUNTIME_DIR` as if it were an error of ours.
fn set_environment() {
    let is_log = std::env::args_os().any(|word| word == "worker") && !io::stdout().is_terminal();
    let has_desktop = ["XDG_RUNTIME_DIR", "DISPLAY"]
        .iter()
        .any(|name| std::env::var_os(name).is_some());
    #[allow(
        unsafe_code,
        reason = "no other thread exists yet that could read the environment"
    )]
    // SAFETY: called first in `main`, before any thread is started.
    unsafe {
        std::env::set_var("BURN_DEVICE", "flex");
        if is_log {
            std::env::set_var("NO_COLOR", "1");
        }
        if !has_desktop {
            std::env::set_var("NODEVICE_SELECT", "1");
        }
    }
}

/// Help and usage errors are clap's, everything else is a command's.
fn parse_and_run() -> ExitCode {
    match Cli::try_parse() {
        Ok(cli) => exit_code(cli.run()),
        Err(message) => match cli::stdout::unless_closed(message.print()) {
            Ok(()) => ExitCode::from(u8::try_from(message.exit_code()).unwrap_or(FAILED)),
            Err(error) => exit_code(Err(error)),
        },
    }
}

/// Prints an error, once.
fn exit_code(outcome: Result<ExitCode>) -> ExitCode {
    match outcome {
        Ok(code) => code,
        Err(error @ Error::Interrupted { .. }) => {
            stderr::line(&error.to_string());
            ExitCode::from(INTERRUPTED)
        }
        Err(error) => {
            stderr::line(&format!("error: {error}"));
            ExitCode::from(FAILED)
        }
    }
}

/// A panic is this program's fault, never the user's.
fn report_defect() -> ExitCode {
    let defect = DEFECT.lock().unwrap_or_else(PoisonError::into_inner).take();
    let words = defect.unwrap_or_default();
    let one_line = words.split_whitespace().collect::<Vec<_>>().join(" ");
    stderr::line(&format!(
        "error: internal defect: {one_line}; please report this line and the command that you typed"
    ));
    ExitCode::from(FAILED)
}
