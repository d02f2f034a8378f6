//! Training of both networks: settings, recipes, checkpoints, logs.

pub mod augment;
mod checkpoint;
mod choices;
mod config;
mod detector;
mod distance;
mod frame_cache;
mod learner;
mod log;
mod normalize;
pub mod optimizer;
mod plan;
mod readout;
mod run;
mod stage;

pub use checkpoint::{StageFolder, StageState};
pub use config::{
    DetectorMerit, DetectorTraining, DistanceMerit, DistanceTraining, OptimizerKind, Schedule,
    TrainConfig, TrainingBoxes,
};
pub use log::{EpochRow, RunLog};
pub use plan::{StagePlan, TrainPlan, plan};
pub use run::{Stage, TrainRequest, TrainSummary, saved_config, train};
