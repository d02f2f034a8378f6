//! What a detector says of one vehicle in one image.

use serde::{Deserialize, Serialize};

use crate::geometry::PixelBox;

/// One detected vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Detection {
    /// The box, pixels of the full image.
    pub box_pixel: PixelBox,
    /// Confidence, 0 to 1.
    pub score: f32,
    /// Class number.
    pub class: usize,
}
