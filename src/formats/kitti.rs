//! KITTI's object detection folder: stereo pairs of driving scenes with boxes in space.
//!
//! ```text
//! <folder>/training/image_2/000042.png   left colour image, PNG or JPEG
//!                   image_3/000042.png   right colour image
//!                   calib/000042.txt     P2 and P3: projections of both cameras
//!                   label_2/000042.txt   objects, with boxes in the left image and in space
//!                   label_3/000042.txt   optional, not part of KITTI: boxes in the right image
//! <folder>/ImageSets/train.txt, val.txt, test.txt   optional: which frame is for what
//! ```
//!
//! KITTI counts pixels from the centre of the first one and this crate from its corner, so half a
//! pixel is added to everything on the way in and taken off on the way out. KITTI's `location` is
//! the centre of the bottom of the box; distances of this crate run from the middle between the
//! cameras to the centre of the box.

mod calib;
mod export;
mod import;
mod objects;

pub use export::export;
pub use import::{KittiOptions, import};
