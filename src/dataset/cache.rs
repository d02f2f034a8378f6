//! Decoded images in memory.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::{Arc, Mutex, PoisonError};

use image::RgbImage;

use crate::error::Result;

/// What a cache may hold: one image, or both of a frame.
pub trait Decoded {
    /// Bytes of its pixels.
    fn bytes(&self) -> usize;
}

impl Decoded for RgbImage {
    fn bytes(&self) -> usize {
        self.as_raw().len()
    }
}

impl Decoded for [RgbImage; 2] {
    fn bytes(&self) -> usize {
        self.iter().map(Decoded::bytes).sum()
    }
}

/// Decoded images by key, up to a number of bytes.
///
/// What comes first stays and the rest is decoded every time: epochs visit everything equally
/// often, so no image is worth more than another and nothing is gained by throwing one out.
#[derive(Debug)]
pub struct DecodedCache<K, V> {
    budget_bytes: usize,
    held: Mutex<Held<K, V>>,
}

#[derive(Debug)]
struct Held<K, V> {
    images: HashMap<K, Arc<V>>,
    bytes: usize,
}

impl<K: Eq + Hash + Copy, V: Decoded> DecodedCache<K, V> {
    /// An empty cache for so many bytes.
    pub fn new(budget_bytes: usize) -> Self {
        Self {
            budget_bytes,
            held: Mutex::new(Held {
                images: HashMap::new(),
                bytes: 0,
            }),
        }
    }

    /// The images of this key, decoded by `load` unless they are held.
    ///
    /// # Errors
    /// Those of `load`.
    pub fn get(&self, key: K, load: impl FnOnce() -> Result<V>) -> Result<Arc<V>> {
        // Nothing can go wrong while the lock is held, so a poisoned lock guards sound data.
        let lock = || self.held.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(images) = lock().images.get(&key) {
            return Ok(Arc::clone(images));
        }
        // Decoding takes milliseconds and happens without the lock; two threads that want the same
        // images at once both decode them, which is rare and harmless.
        let images = Arc::new(load()?);
        let bytes = images.bytes();
        let mut held = lock();
        if held.bytes + bytes <= self.budget_bytes && !held.images.contains_key(&key) {
            held.bytes += bytes;
            held.images.insert(key, Arc::clone(&images));
        }
        Ok(images)
    }

    /// How many keys are held, and their bytes.
    #[cfg(test)]
    pub fn held(&self) -> (usize, usize) {
        let held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        (held.images.len(), held.bytes)
    }
}
