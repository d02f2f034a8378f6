//! What is written beside images and labels.

use serde::{Deserialize, Serialize};

/// What is written beside images and labels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[allow(
    clippy::struct_excessive_bools,
    reason = "independent switches, not states"
)]
pub struct Outputs {
    /// Depth maps.
    pub depth: bool,
    /// Disparity maps.
    pub disparity: bool,
    /// Instance maps.
    pub instances: bool,
    /// The rig's poses.
    pub poses: bool,
}

impl Outputs {
    /// Folder of the depth maps, and their name on the command line.
    pub const DEPTH: &str = "depth";
    /// Folder of the disparity maps, and their name on the command line.
    pub const DISPARITY: &str = "disparity";
    /// Folder of the instance maps, and their name on the command line.
    pub const INSTANCES: &str = "instances";

    /// Folders of the maps that are wanted.
    pub fn map_folders(self) -> impl Iterator<Item = &'static str> {
        [
            (self.depth, Self::DEPTH),
            (self.disparity, Self::DISPARITY),
            (self.instances, Self::INSTANCES),
        ]
        .into_iter()
        .filter_map(|(wanted, folder)| wanted.then_some(folder))
    }
}
