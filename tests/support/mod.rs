//! What the integration tests share: the number formula and the reader of fixture files.
#![allow(dead_code, reason = "every test file uses another part of this module")]

pub mod fixture;
pub mod formula;
