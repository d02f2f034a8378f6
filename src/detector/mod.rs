//! The YOLO11 detector: network, decoding, assignment, loss, suppression.

pub mod assign;
mod config;
pub mod decode;
pub mod detection;
mod head;
mod inference;
pub mod loss;
mod network;
pub mod nms;
pub mod weights;

pub use config::Scale;
pub use detection::Detection;
pub use head::{
    BOX_CHANNELS, BoxBranch, ClassBranch, FlatOutput, Head, HeadConfig, REG_MAX, RawOutput, STRIDES,
};
pub use inference::{DetectorHeader, LetterboxedCandidates, VehicleDetector, letterbox};
pub use network::{Yolo11, Yolo11Config};
