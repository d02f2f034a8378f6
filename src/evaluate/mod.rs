//! How good a run is: detection, distances from true boxes, and the whole pipeline.

mod detection;
mod pipeline;

pub use detection::detection_metrics;
pub use pipeline::{
    DetectionFigures, EvaluateRequest, Evaluation, PipelineFigures, evaluate, evaluate_dataset,
    match_vehicles,
};
