//! What the integration tests share: the number formula, the reader of fixture files, networks
//! filled by the formula, and the devices to run them on.
#![allow(dead_code, reason = "every test file uses another part of this module")]

pub mod devices;
pub mod fixture;
pub mod formula;
pub mod network;
pub mod trace;
