//! Settings that are one of a few words.

use serde::{Deserialize, Serialize};

/// How the learning rate falls after the warm-up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Schedule {
    /// In a straight line.
    Linear,
    /// Along half a cosine.
    Cosine,
}

/// What turns gradients into steps.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OptimizerKind {
    /// Adam, as in the paper; weight decay is added to the gradient.
    #[default]
    Adam,
    /// Adam with decoupled weight decay.
    AdamW,
    /// Stochastic gradient descent with Nesterov momentum; wants a learning rate of about 0.01.
    Sgd,
}

/// What the best epoch of the detector is best by.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum DetectorMerit {
    /// Mean average precision over IoU 0.50 to 0.95.
    #[default]
    #[serde(rename = "map50_95")]
    Map50To95,
    /// Mean average precision at IoU 0.50.
    #[serde(rename = "map50")]
    Map50,
}

/// What the best epoch of the distance network is best by; the smallest is best.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DistanceMerit {
    /// Mean relative error.
    #[default]
    Mre,
    /// Mean absolute error.
    Mae,
    /// Root mean squared error.
    Rmse,
}

/// Whose boxes the distance network is trained on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TrainingBoxes {
    /// The labels', moved at random as a detector's errors do.
    #[default]
    Labels,
    /// Those that the run's own detector finds in the training frames; of vehicles that it misses,
    /// the labels'.
    Detector,
}
