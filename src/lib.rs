//! Twinsight
pub mod annotate;
pub mod dataset;
pub mod detector;
pub mod error;
pub mod files;
pub mod geometry;
pub mod imaging;
pub mod kernels;
pub mod metrics;
pub mod nn;
pub mod pairing;
pub mod progress;
pub mod ranging;
pub mod weights;
pub use error::{Error, Result};
