//! Progress on standard error: bars on a terminal, a line now and then in a log file.

use std::io::{self, IsTerminal as _};
use std::process;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use twinsight::Result;
use twinsight::progress::Progress;

use super::stderr;
use crate::INTERRUPTED;

/// Shortest time between two lines of a phase in a log file.
const LINE_INTERVAL: Duration = Duration::from_secs(15);

/// How often a bar's clock moves while nothing else happens.
const TICK: Duration = Duration::from_secs(1);

/// A bar with its phase, count, remaining time and status.
const BAR: &str = "{prefix} [{bar:24}] {pos}/{len}, {eta} left  {wide_msg}";

/// Runs long work that shows its progress, and that Ctrl-C asks to stop. A second Ctrl-C ends the
/// program at once.
///
/// Once a process only: the handler of Ctrl-C stays.
///
/// # Errors
/// Those of the work.
pub fn with_progress<T>(quiet: bool, work: impl FnOnce(&dyn Progress) -> Result<T>) -> Result<T> {
    let terminal = Arc::new(Terminal::new(Screen::choose(quiet)));
    listen(&terminal);
    let _clear = ClearAtEnd(&terminal);
    work(terminal.as_ref())
}

/// Takes the bars off the screen, also when the work panics.
struct ClearAtEnd<'a>(&'a Terminal);

impl Drop for ClearAtEnd<'_> {
    fn drop(&mut self) {
        while self.0.pop() {}
    }
}

/// Turns the first Ctrl-C into a request and the second into the end.
fn listen(terminal: &Arc<Terminal>) {
    let heard = Arc::clone(terminal);
    let installed = ctrlc::set_handler(move || {
        if heard.interrupted.swap(true, Ordering::Relaxed) {
            process::exit(i32::from(INTERRUPTED));
        }
        heard.note("stopping after the step at hand; press Ctrl-C again to stop at once");
    });
    if let Err(error) = installed {
        terminal.note(&format!(
            "Ctrl-C will stop at once, without saving: {error}"
        ));
    }
}

/// Where progress is shown.
enum Screen {
    /// Bars, below the notes.
    Bars(MultiProgress),
    /// Plain lines: standard error is a file or a pipe.
    Lines,
    /// Nowhere.
    Silent,
}

impl Screen {
    fn choose(quiet: bool) -> Self {
        let dumb = std::env::var_os("TERM").is_some_and(|term| term == "dumb");
        if quiet {
            Self::Silent
        } else if io::stderr().is_terminal() && !dumb {
            Self::Bars(MultiProgress::with_draw_target(ProgressDrawTarget::stderr()))
        } else {
            Self::Lines
        }
    }
}

/// What listens to the library's work.
struct Terminal {
    screen: Screen,
    /// The phases that have begun; one may begin inside another.
    phases: Mutex<Vec<Phase>>,
    interrupted: AtomicBool,
}

/// Work that has begun and not ended.
struct Phase {
    label: String,
    total: u64,
    done: u64,
    status: String,
    began: Instant,
    shown: Instant,
    bar: Option<ProgressBar>,
}

impl Terminal {
    fn new(screen: Screen) -> Self {
        Self {
            screen,
            phases: Mutex::new(Vec::new()),
            interrupted: AtomicBool::new(false),
        }
    }

    fn phases(&self) -> MutexGuard<'_, Vec<Phase>> {
        self.phases.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the innermost phase; false when there is none.
    fn pop(&self) -> bool {
        let Some(phase) = self.phases().pop() else {
            return false;
        };
        if let (Some(bar), Screen::Bars(bars)) = (phase.bar, &self.screen) {
            bar.finish_and_clear();
            bars.remove(&bar);
        }
        true
    }

    /// Changes the innermost phase and shows the change.
    fn update(&self, change: impl FnOnce(&mut Phase)) {
        let mut phases = self.phases();
        let Some(phase) = phases.last_mut() else {
            return;
        };
        change(phase);
        if matches!(self.screen, Screen::Lines) && phase.shown.elapsed() >= LINE_INTERVAL {
            phase.shown = Instant::now();
            stderr::line(&phase.line(phase.began.elapsed()));
        }
    }
}

impl Phase {
    fn new(label: &str, total: u64, bar: Option<ProgressBar>) -> Self {
        let now = Instant::now();
        Self {
            label: label.to_owned(),
            total,
            done: 0,
            status: String::new(),
            began: now,
            shown: now,
            bar,
        }
    }

    /// The state as a line of text, this long after the beginning.
    fn line(&self, elapsed: Duration) -> String {
        let (label, done, total) = (&self.label, self.done, self.total);
        let comma = if self.status.is_empty() { "" } else { ", " };
        // Work of unknown length.
        if total == 0 && done > 0 {
            return format!("{label}: {done}{comma}{}", self.status);
        }
        let percent = (100 * done).checked_div(total).unwrap_or(100);
        let left = if done > 0 {
            let left = total.saturating_sub(done) as f64 / done as f64;
            format!(", {} left", HumanDuration(elapsed.mul_f64(left)))
        } else {
            String::new()
        };
        format!(
            "{label}: {percent} % ({done}/{total}){left}{comma}{}",
            self.status
        )
    }
}

impl Progress for Terminal {
    fn begin(&self, label: &str, total: u64) {
        let bar = match &self.screen {
            Screen::Bars(bars) => {
                let bar = bars.add(ProgressBar::new(total).with_prefix(label.to_owned()));
                let style = ProgressStyle::with_template(BAR);
                bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
                bar.enable_steady_tick(TICK);
                Some(bar)
            }
            _ => None,
        };
        self.phases().push(Phase::new(label, total, bar));
    }

    fn advance(&self, steps: u64) {
        self.update(|phase| {
            phase.done += steps;
            if let Some(bar) = &phase.bar {
                bar.inc(steps);
            }
        });
    }

    fn status(&self, text: &str) {
        self.update(|phase| {
            text.clone_into(&mut phase.status);
            if let Some(bar) = &phase.bar {
                bar.set_message(text.to_owned());
            }
        });
    }

    fn note(&self, text: &str) {
        match &self.screen {
            Screen::Bars(bars) => bars.suspend(|| stderr::line(text)),
            Screen::Lines => stderr::line(text),
            Screen::Silent => {}
        }
    }

    fn end(&self) {
        self.pop();
    }

    fn interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_how_far_it_is_how_long_it_takes_and_how_it_goes() {
        let mut phase = Phase::new("epoch 2/24", 40, None);
        assert_eq!(phase.line(Duration::from_secs(9)), "epoch 2/24: 0 % (0/40)");
        phase.done = 10;
        phase.status = "loss 3.2".to_owned();
        assert_eq!(
            phase.line(Duration::from_mins(1)),
            "epoch 2/24: 25 % (10/40), 3 minutes left, loss 3.2"
        );
        assert_eq!(
            Phase::new("nothing", 0, None).line(Duration::ZERO),
            "nothing: 100 % (0/0)"
        );
        let mut endless = Phase::new("predicting", 0, None);
        endless.done = 7;
        assert_eq!(endless.line(Duration::from_secs(1)), "predicting: 7");
    }

    #[test]
    fn steps_count_for_the_innermost_phase() {
        let terminal = Terminal::new(Screen::Silent);
        terminal.advance(1);
        terminal.begin("training", 3);
        terminal.begin("epoch", 5);
        terminal.advance(2);
        terminal.end();
        terminal.advance(1);
        let done: Vec<u64> = terminal.phases().iter().map(|phase| phase.done).collect();
        assert_eq!(done, [1]);
        terminal.end();
        terminal.end();
    }
}
