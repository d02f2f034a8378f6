//! Training of both networks: settings, recipes, checkpoints, logs.

pub mod augment;
mod checkpoint;
mod choices;
mod config;
mod detector;
mod devices;
mod distance;
mod events;
mod loader;
mod log;
mod metrics;
mod normalize;
pub mod optimizer;
mod plan;
mod readout;
mod reporting;
mod run;
mod running;
mod saved;
mod schedule;
mod sgd;
mod size;
mod stage;
mod trainee;

pub use checkpoint::{StageFolder, StageState};
pub use config::{
    DetectorMerit, DetectorTraining, DistanceMerit, DistanceTraining, OptimizerKind, Schedule,
    SizeTraining, TrainConfig, TrainingBoxes,
};
pub(crate) use devices::DeviceSet;
pub use log::{EpochRow, RunLog};
pub use plan::{StagePlan, TrainPlan, plan};
pub use run::{NotEvaluated, Stage, TrainRequest, TrainSummary, train};
pub(crate) use saved::CONFIG;
pub use saved::{SavedRun, saved_config};
