//! Keeping freed memory for the next allocation.

/// Tells the system's allocator to keep freed memory instead of returning it.
///
/// A training step allocates and frees the same few hundred megabytes again and again. GNU libc
/// returns large blocks to the system at once, and half of a step's time then goes into the page
/// faults of getting them back. Call this first in `main`, before threads are started; elsewhere
/// than on Linux with GNU libc it does nothing.
pub fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: `mallopt` only sets numbers of the allocator; unknown ones are refused.
    unsafe {
        // Large blocks come from the heap, not from a mapping of their own.
        libc::mallopt(libc::M_MMAP_MAX, 0);
        // The heap's end is not given back, and grows in large steps.
        libc::mallopt(libc::M_TRIM_THRESHOLD, libc::c_int::MAX);
        libc::mallopt(libc::M_TOP_PAD, 64 << 20);
        // One heap for all threads, so that each can use what another freed.
        libc::mallopt(libc::M_ARENA_MAX, 1);
    }
}
