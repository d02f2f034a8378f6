//! How good detections and distances are. Plain numbers in double precision, no tensors.

pub mod average_precision;
pub mod bootstrap;
mod coco;
mod confusion;
mod curves;
pub mod distance;
mod matching;

pub use average_precision::{ClassMetrics, DetectionMetrics, DetectionSummary, Target, is_covered};
pub use bootstrap::{Interval, Resamples};
pub use coco::CocoSummary;
pub use confusion::Confusion;
pub use curves::{CONFIDENCE_STEPS, DetectionCurves};
pub(crate) use distance::quantile_of;
pub use distance::{DistanceErrors, DistanceSummary};
pub use matching::IOU_THRESHOLDS;
