//! Loaders of burn-train's loops: passes of training items and ranges of validation items.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;
use std::time::Instant;

use burn::data::dataloader::{DataLoader, DataLoaderIterator, Progress};
use burn::tensor::Device;
use burn_dataset::transform::ShuffledDataset;
use burn_dataset::{Dataset as _, DatasetError, InMemDataset};

use super::stage::{Recipe, Steering};
use super::trainee::Failure;
use crate::error::Error;

/// Passes that wait for their step, at most.
const LOADED_AHEAD: usize = 1;

/// The items of one forward and backward pass, loaded.
pub struct Pass<B> {
    /// What the recipe made of them.
    pub batch: B,
    /// Their numbers.
    pub items: Vec<usize>,
    /// Their part of the optimiser step.
    pub share: f64,
    /// The epoch, from 0.
    pub epoch: u32,
    /// When the epoch began.
    pub epoch_started: Instant,
}

/// Optimiser steps of an epoch. Devices have equal parts of every batch, or they would wait for each
/// other in vain; what is left over of the last batch is left out, other items every time.
pub fn steps_per_epoch(items: usize, batch: usize, devices: usize) -> u64 {
    let last = usize::from(items % batch >= devices);
    (items / batch + last) as u64
}

/// Training passes, epoch after epoch: shuffled by seed and epoch alone, loaded on a thread beside
/// the steps.
///
/// On several devices each has its part of *every* batch, so that a step sees the same items
/// however many devices share it.
pub struct PassLoader<R> {
    recipe: Arc<R>,
    seed: u64,
    batch: usize,
    micro_batch: usize,
    /// Devices that will share the batches, one slice each.
    devices: usize,
    /// Epochs begun.
    epoch: AtomicU32,
    /// Number of this part and of all parts.
    part: [usize; 2],
    /// Where errors go.
    failure: Failure,
}

impl<R: Recipe> PassLoader<R> {
    /// A loader that goes on after so many epochs.
    pub fn new(
        recipe: Arc<R>,
        steering: &Steering,
        devices: usize,
        finished_epochs: u32,
        failure: Failure,
    ) -> Self {
        Self {
            recipe,
            seed: steering.seed,
            batch: steering.batch,
            micro_batch: steering.micro_batch,
            devices,
            epoch: AtomicU32::new(finished_epochs),
            part: [0, 1],
            failure,
        }
    }

    fn with_part(&self, part: [usize; 2]) -> Self {
        Self {
            recipe: Arc::clone(&self.recipe),
            seed: self.seed,
            batch: self.batch,
            micro_batch: self.micro_batch,
            devices: self.devices,
            epoch: AtomicU32::new(self.epoch.load(Ordering::Relaxed)),
            part,
            failure: self.failure.clone(),
        }
    }
}

/// The passes of one part of the devices over an epoch's items: items and share of the step.
fn passes(
    order: &[usize],
    batch: usize,
    micro_batch: usize,
    [number, parts]: [usize; 2],
) -> Vec<(Vec<usize>, f64)> {
    let mut passes = Vec::new();
    for batch in order.chunks(batch) {
        // Equal parts: see `steps_per_epoch`.
        let each = batch.len() / parts;
        let own = &batch[number * each..(number + 1) * each];
        for items in own.chunks(micro_batch) {
            let share = items.len() as f64 / (each * parts) as f64;
            passes.push((items.to_vec(), share));
        }
    }
    passes
}

impl<R: Recipe> DataLoader<Pass<R::Batch>> for PassLoader<R> {
    fn iter<'a>(&'a self) -> Box<dyn DataLoaderIterator<Pass<R::Batch>> + 'a> {
        let epoch = self.epoch.fetch_add(1, Ordering::Relaxed);
        let order = shuffled(self.recipe.items(), self.seed, epoch);
        let passes = passes(&order, self.batch, self.micro_batch, self.part);
        let total = passes.iter().map(|(items, _)| items.len()).sum();
        let epoch_started = Instant::now();
        let (sender, receiver) = sync_channel(LOADED_AHEAD);
        let recipe = Arc::clone(&self.recipe);
        let failure = self.failure.clone();
        let thread = std::thread::spawn(move || {
            for (items, share) in passes {
                let batch = match recipe.load(epoch, &items) {
                    Ok(batch) => batch,
                    // Ends the epoch early, and with it the training.
                    Err(error) => return failure.set(error),
                };
                let pass = Pass {
                    batch,
                    items,
                    share,
                    epoch,
                    epoch_started,
                };
                if sender.send(pass).is_err() {
                    return;
                }
            }
        });
        Box::new(Passes {
            receiver: Some(receiver),
            thread: Some(thread),
            processed: 0,
            total,
            failure: self.failure.clone(),
        })
    }

    fn num_items(&self) -> usize {
        self.recipe.items()
    }

    /// A pass goes to a device with its step.
    fn to_device(&self, _: &Device) -> Arc<dyn DataLoader<Pass<R::Batch>>> {
        Arc::new(self.with_part(self.part))
    }

    /// Not these items, but their share of every batch.
    fn slice(&self, start: usize, _: usize) -> Arc<dyn DataLoader<Pass<R::Batch>>> {
        let length = (self.num_items() / self.devices).max(1);
        Arc::new(self.with_part([start / length, self.devices]))
    }
}

/// Passes as they are loaded.
struct Passes<B> {
    receiver: Option<Receiver<Pass<B>>>,
    thread: Option<JoinHandle<()>>,
    processed: usize,
    total: usize,
    failure: Failure,
}

impl<B> Iterator for Passes<B> {
    type Item = std::result::Result<Pass<B>, DatasetError>;

    fn next(&mut self) -> Option<Self::Item> {
        let Ok(pass) = self.receiver.as_ref()?.recv() else {
            self.finish();
            return None;
        };
        self.processed += pass.items.len();
        Some(Ok(pass))
    }
}

impl<B> Passes<B> {
    /// Ends the thread; an epoch that it broke off must not count as finished.
    fn finish(&mut self) {
        // It ends when nobody takes its passes any more.
        drop(self.receiver.take());
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            self.failure.set(Error::training(
                "loading training items stopped with a panic".to_owned(),
                "report this as a defect",
            ));
        }
    }
}

impl<B> DataLoaderIterator<Pass<B>> for Passes<B> {
    fn progress(&self) -> Progress {
        Progress::new(self.processed, self.total, Some("items".to_owned()))
    }
}

impl<B> Drop for Passes<B> {
    fn drop(&mut self) {
        self.finish();
    }
}

/// Some validation items.
#[derive(Debug, Clone)]
pub struct Check {
    /// Their numbers.
    pub items: Range<usize>,
    /// Whether pictures and weights are to be shown with them: once per validation.
    pub shows: bool,
}

/// Validation items, in the epochs that validate.
pub struct CheckLoader {
    items: usize,
    batch: usize,
    steering: Steering,
    /// Epochs begun.
    epoch: AtomicU32,
}

impl CheckLoader {
    /// A loader for so many items that goes on after so many epochs.
    pub fn new(items: usize, batch: usize, steering: &Steering, finished_epochs: u32) -> Self {
        Self {
            items,
            batch,
            steering: steering.clone(),
            epoch: AtomicU32::new(finished_epochs),
        }
    }

    fn again(&self) -> Self {
        Self {
            items: self.items,
            batch: self.batch,
            steering: self.steering.clone(),
            epoch: AtomicU32::new(self.epoch.load(Ordering::Relaxed)),
        }
    }
}

impl DataLoader<Check> for CheckLoader {
    fn iter<'a>(&'a self) -> Box<dyn DataLoaderIterator<Check> + 'a> {
        let finished = self.epoch.fetch_add(1, Ordering::Relaxed) + 1;
        let validates = self.steering.validates(finished);
        Box::new(Checks {
            next: 0,
            items: if validates { self.items } else { 0 },
            batch: self.batch,
        })
    }

    fn num_items(&self) -> usize {
        self.items
    }

    fn to_device(&self, _: &Device) -> Arc<dyn DataLoader<Check>> {
        Arc::new(self.again())
    }

    /// Validation is never divided.
    fn slice(&self, _: usize, _: usize) -> Arc<dyn DataLoader<Check>> {
        Arc::new(self.again())
    }
}

struct Checks {
    next: usize,
    items: usize,
    batch: usize,
}

impl Iterator for Checks {
    type Item = std::result::Result<Check, DatasetError>;

    fn next(&mut self) -> Option<Self::Item> {
        let start = self.next;
        if start >= self.items {
            return None;
        }
        self.next = (start + self.batch).min(self.items);
        Some(Ok(Check {
            items: start..self.next,
            shows: start == 0,
        }))
    }
}

impl DataLoaderIterator<Check> for Checks {
    fn progress(&self) -> Progress {
        Progress::new(self.next, self.items, Some("items".to_owned()))
    }
}

/// The order of the items in an epoch: it depends on seed and epoch alone.
fn shuffled(items: usize, seed: u64, epoch: u32) -> Vec<usize> {
    let seed = seed
        .wrapping_mul(0x9E37_79B9_7F4A_7C15)
        .wrapping_add(u64::from(epoch));
    let order = ShuffledDataset::new(InMemDataset::new((0..items).collect()), seed);
    (0..order.len())
        .filter_map(|index| order.get(index).ok())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_share_every_batch_evenly_and_see_each_item_once() {
        let order = shuffled(23, 7, 3);
        for parts in [1, 2, 4] {
            let own: Vec<_> = (0..parts)
                .map(|number| passes(&order, 8, 2, [number, parts]))
                .collect();
            let mut seen: Vec<usize> = own
                .iter()
                .flatten()
                .flat_map(|(items, _)| items.clone())
                .collect();
            seen.sort_unstable();
            seen.dedup();
            // 23 items are two batches of 8 and one of 7.
            assert_eq!(seen.len(), 16 + 7 / parts * parts, "{parts} devices");
            assert!(own.iter().all(|passes| passes.len() == own[0].len()));
            let shares: f64 = own.iter().flatten().map(|(_, share)| share).sum();
            assert!((shares - steps_per_epoch(23, 8, parts) as f64).abs() < 1e-12);
        }
    }

    #[test]
    fn an_epoch_too_short_for_all_devices_leaves_its_last_items_out() {
        assert_eq!(steps_per_epoch(17, 8, 1), 3);
        assert_eq!(steps_per_epoch(17, 8, 2), 2);
        let order = shuffled(17, 1, 0);
        assert_eq!(passes(&order, 8, 8, [1, 2]).len(), 2);
    }

    #[test]
    fn the_order_is_another_in_every_epoch_and_the_same_again_for_a_seed() {
        assert_eq!(shuffled(50, 1, 2), shuffled(50, 1, 2));
        assert_ne!(shuffled(50, 1, 2), shuffled(50, 1, 3));
        assert_ne!(shuffled(50, 1, 2), shuffled(50, 2, 2));
    }

    #[test]
    fn validation_comes_in_its_epochs_and_in_the_last_one() {
        let steering = Steering {
            epochs: 5,
            validate_every: 2,
            ..Steering::example()
        };
        let loader = CheckLoader::new(5, 2, &steering, 0);
        let counts: Vec<usize> = (0..5).map(|_| loader.iter().count()).collect();
        assert_eq!(counts, [0, 3, 0, 3, 3]);
        let resumed = CheckLoader::new(5, 2, &steering, 3);
        assert_eq!(resumed.iter().count(), 3);
    }
}
