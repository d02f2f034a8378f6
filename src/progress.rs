//! How long work reports where it is, without knowing who listens.

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
    /// [`Error::Interrupted`](crate::Error::Interrupted).
    fn interrupted(&self) -> bool {
        false
    }
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
