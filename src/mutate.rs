//! Damaged copies of sound files, for tests of readers.

use std::panic::{AssertUnwindSafe, catch_unwind};

use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

/// Copies that a test looks at; `TWINSIGHT_FUZZ` in the environment says another number.
const COPIES: u64 = 2000;

/// Damages of one copy, at most.
const MOST_DAMAGES: u32 = 4;

/// Pieces that readers stumble over.
const PIECES: [&str; 30] = [
    "-1",
    "0",
    "1e308",
    "1e-320",
    "-0.0",
    "NaN",
    ".nan",
    "inf",
    "99999999999999999999",
    "null",
    "[",
    "]",
    "{",
    "}",
    "\"",
    "'",
    ":",
    ",",
    "=",
    "\n",
    "\n---\n",
    "%",
    "&a ",
    "*a",
    "!!x ",
    "\t",
    "\\",
    "\0",
    "é",
    "\u{feff}",
];

/// Gives damaged copies of `seeds` to `check`, which may find them wrong but must come to an end.
pub(crate) fn damaged(seeds: &[&[u8]], check: impl Fn(&[u8])) {
    let copies = std::env::var("TWINSIGHT_FUZZ");
    let copies = copies.ok().and_then(|count| count.parse().ok());
    for copy in 0..copies.unwrap_or(COPIES) {
        let bytes = damaged_copy(seeds, copy);
        let outcome = catch_unwind(AssertUnwindSafe(|| check(&bytes)));
        assert!(
            outcome.is_ok(),
            "copy {copy}: {}",
            String::from_utf8_lossy(&bytes)
        );
    }
}

/// One copy, the same for the same number.
fn damaged_copy(seeds: &[&[u8]], copy: u64) -> Vec<u8> {
    let mut random = Pcg64::seed_from_u64(copy);
    let seed = |random: &mut Pcg64| seeds[random.random_range(0..seeds.len())];
    let mut bytes = seed(&mut random).to_vec();
    for _ in 0..random.random_range(1..=MOST_DAMAGES) {
        let from = random.random_range(0..=bytes.len());
        let to = (from + random.random_range(0..=16)).min(bytes.len());
        match random.random_range(0..7) {
            0 if from < bytes.len() => bytes[from] ^= 1 << random.random_range(0..8),
            1 if from < bytes.len() => bytes[from] = random.next_u32() as u8,
            2 => drop(bytes.drain(from..to)),
            3 => {
                let piece = bytes[from..to].to_vec();
                bytes.splice(from..from, piece);
            }
            4 => {
                let piece = PIECES[random.random_range(0..PIECES.len())];
                bytes.splice(from..to, piece.bytes());
            }
            5 => bytes.truncate(from),
            _ => {
                let other = seed(&mut random);
                let end = random.random_range(0..=other.len());
                let begin = end.saturating_sub(random.random_range(0..=64));
                bytes.splice(from..to, other[begin..end].iter().copied());
            }
        }
    }
    bytes
}
