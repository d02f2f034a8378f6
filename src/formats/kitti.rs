//! KITTI's folders of objects and of tracks: stereo pairs of driving scenes with boxes in space.
//!
//! ```text
//! <folder>/training/image_2/000042.png   left colour image
//!                   image_3/000042.png   right colour image
//!                   calib/000042.txt     P2 and P3: projections of both cameras
//!                   label_2/000042.txt   objects, with boxes in the left image and in space
//!                   label_3/000042.txt   optional, not part of KITTI: boxes in the right image
//! <folder>/ImageSets/train.txt, val.txt, test.txt   optional: which frame is for what
//!
//! <folder>/training/image_02/0000/000042.png   tracking: a folder a sequence, and
//!                   image_03/0000/000042.png   ...
//!                   calib/0000.txt             ... one calibration for it
//!                   label_02/0000.txt          ... and one file, frame and track before each object
//! ```
//!
//! Where nothing says where the objects are in space (no `image_3`, no `calib`, or boxes in the image
//! alone, as detectors are trained on), the left images become single images.
//!
//! KITTI counts pixels from the centre of the first one and this crate from its corner, so half a
//! pixel is added to everything on the way in and taken off on the way out. KITTI's `location` is
//! the centre of the bottom of the box; distances of this crate run from the middle between the
//! cameras to the centre of the box.

mod calib;
mod export;
mod import;
mod objects;
mod single;
mod tracking;

pub use export::export;
pub(super) use import::{Objects, wanted_classes};
pub(super) use tracking::Tracking;
