//! How good a run is: detection, distances from true boxes, and the whole pipeline, beside arithmetic
//! that a network must beat; with bounds for what is chance.
//!
//! [`evaluate()`] judges a run on a split and writes every table, as CSV and as JSON, into the run's
//! folder; [`read`] reads them back. Nothing is hidden: vehicles that the pipeline missed or made up
//! and methods without an answer are counted in every table.

mod baselines;
mod detection;
mod detections;
mod distances;
mod examples;
mod figures;
mod groups;
mod judge;
mod latency;
mod pipeline;
mod protocol;
mod reliability;
mod show;
mod subject;
mod tables;
mod training_data;
mod vehicles;

pub use baselines::Baselines;
pub use detection::detection_metrics;
pub use detections::{ClassRow, CocoRow, ConfusionRow, CurveRow};
pub use distances::{DifferenceRow, DistanceRow, RunDifference, paired_difference};
pub use examples::{ExampleKind, ExampleRow};
pub use figures::{DetectionFigures, PipelineFigures, SpreadFigures, TrueBoxFigures};
pub use groups::Grouping;
pub use latency::LatencyRow;
pub use pipeline::{
    Bootstrap, EvaluateRequest, Evaluation, evaluate, evaluate_dataset, match_vehicles,
};
pub use protocol::{MethodRow, MissingCell, Protocol, ProtocolRow};
pub use reliability::{ReliabilityRow, SpreadRow};
pub use show::{LABEL_NOTE, protocol_text};
pub use subject::Networks;
pub use tables::{Tables, evaluations, read};
pub use vehicles::{Boxes, Estimates, FalseVehicle, Method, Spread, VehicleRow};

pub(crate) use distances::{Drawing, row};
pub(crate) use groups::Groups;
pub(crate) use pipeline::DRAWS;
pub(crate) use show::{number, percent, protocol_cells};
pub(crate) use tables::{write_json, write_table};
pub(crate) use vehicles::Places;
