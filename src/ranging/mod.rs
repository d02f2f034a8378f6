//! The twin-branch network that turns a composite and a box size into metres.

mod fused;
mod inference;
mod inputs;
mod loss;
mod merge;
mod network;
mod other_rig;
mod posterior;
mod ranger;
mod readout;
pub mod size;
mod surface;
mod witness;

pub use fused::{FusedRanger, NamedBox, RangerKind};
pub use inference::{DistanceEstimator, RangingHeader, Sighting};
pub use inputs::{Crops, Reading, VehicleSizes};
pub use loss::{RangingLoss, ranging_loss};
pub use merge::compose_convolutions;
pub use network::{BLOCK_CHANNELS, RangingConfig, RangingFeatures, RangingNetwork};
pub use other_rig::{RigNote, sizes_as_trained};
pub use posterior::{Mode, Posterior};
pub use ranger::{
    Body, PairDoubt, Ranged, Ranger, RangerSettings, Target, TrustedRig, VehicleDoubt,
};
pub use readout::Readout;
pub use surface::surface_m;
pub use witness::SizeWitness;
