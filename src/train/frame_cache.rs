//! Decoded stereo frames in memory.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use image::RgbImage;

use crate::dataset::Frame;
use crate::error::Result;
use crate::geometry::StereoRig;

/// Decoded frames, kept until a budget of bytes is used up.
pub(super) struct FrameCache {
    budget: usize,
    kept: Mutex<Kept>,
}

#[derive(Default)]
struct Kept {
    bytes: usize,
    frames: HashMap<u64, Arc<[RgbImage; 2]>>,
}

impl FrameCache {
    /// An empty cache for so many bytes.
    pub(super) fn new(budget: usize) -> Self {
        Self {
            budget,
            kept: Mutex::default(),
        }
    }

    /// Both images of a frame.
    ///
    /// # Errors
    /// Images that cannot be read.
    pub(super) fn load(&self, frame: &Frame, rig: &StereoRig) -> Result<Arc<[RgbImage; 2]>> {
        let lock = || self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(images) = lock().frames.get(&frame.row.stamp) {
            return Ok(Arc::clone(images));
        }
        let images = Arc::new(frame.load(rig)?);
        let bytes = images
            .iter()
            .map(|image| image.as_raw().len())
            .sum::<usize>();
        let mut kept = lock();
        if kept.bytes + bytes <= self.budget && !kept.frames.contains_key(&frame.row.stamp) {
            kept.bytes += bytes;
            kept.frames.insert(frame.row.stamp, Arc::clone(&images));
        }
        Ok(images)
    }
}
