//! How long work reports where it is, without knowing who listens.

use rayon::prelude::*;

use crate::error::{Error, Result};

/// Listens to long work. The command line shows bars; a library user may ignore everything.
pub trait Progress: Send + Sync {
    /// A phase of `total` steps begins.
    fn begin(&self, label: &str, total: u64);
    /// Steps of the current phase are done.
    fn advance(&self, steps: u64);
    /// The current state in a few words, such as the running loss.
    fn status(&self, text: &str);
    /// Something worth keeping on the screen: a warning, an epoch's result.
    fn note(&self, text: &str);
    /// The current phase is over.
    fn end(&self);
    /// The user asked to stop: finish the step at hand, save and return
    /// [`Error::Interrupted`].
    fn interrupted(&self) -> bool {
        false
    }
}

/// One phase of work on many items at once; the results in the items' order.
///
/// # Errors
/// The first error of the work, or [`Error::Interrupted`] with the way to go on.
pub(crate) fn in_parallel<T: Sync, R: Send>(
    progress: &dyn Progress,
    label: &str,
    resume: &str,
    items: &[T],
    work: impl Fn(&T) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    progress.begin(label, items.len() as u64);
    let results = items
        .par_iter()
        .map(|item| {
            if progress.interrupted() {
                return Err(Error::Interrupted {
                    resume: resume.to_owned(),
                });
            }
            let result = work(item);
            progress.advance(1);
            result
        })
        .collect();
    progress.end();
    results
}

/// Reports nothing and never asks to stop.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn status(&self, _: &str) {}
    fn note(&self, _: &str) {}
    fn end(&self) {}
}
