//! The learning rate of every step.

use burn::optim::LearningRate;
use burn::optim::lr_scheduler::{LrScheduler, LrSchedulerRecord};

use super::optimizer::schedule_factor;
use super::stage::Steering;

/// Name of the step count in the scheduler's record.
const STEPS: &str = "steps";

/// A straight rise, then a straight or cosine fall (yolo11.md, section 8.2), by optimiser steps.
#[derive(Debug, Clone)]
pub struct RiseAndFall {
    steering: Steering,
    steps_per_epoch: u64,
    steps: u64,
}

impl RiseAndFall {
    /// The rates of a stage before its first step.
    pub fn new(steering: Steering, steps_per_epoch: u64) -> Self {
        Self {
            steering,
            steps_per_epoch,
            steps: 0,
        }
    }

    /// The rate of a step, counted from 0.
    fn rate(&self, step: u64) -> f64 {
        let steering = &self.steering;
        let epoch = step as f64 / self.steps_per_epoch.max(1) as f64;
        let last = steering.final_learning_rate;
        let factor = schedule_factor(steering.schedule, epoch, f64::from(steering.epochs), last);
        let rise =
            (step + 1) as f64 / (steering.warmup_epochs * self.steps_per_epoch as f64).max(1.0);
        steering.learning_rate * factor * rise.min(1.0)
    }
}

impl LrScheduler for RiseAndFall {
    fn step(&mut self) -> LearningRate {
        let rate = self.rate(self.steps);
        self.steps += 1;
        rate
    }

    fn to_record(&self) -> LrSchedulerRecord {
        LrSchedulerRecord::new().with_scalar(STEPS, self.steps)
    }

    fn load_record(&mut self, record: LrSchedulerRecord) {
        // The record's check sum was compared before, so the number is there.
        self.steps = record.scalar(STEPS).unwrap_or_default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_restored_schedule_goes_on_where_the_saved_one_was() {
        let fresh = RiseAndFall::new(Steering::example(), 5);
        let mut schedule = fresh.clone();
        let early: Vec<f64> = (0..7).map(|_| schedule.step()).collect();
        assert!(early[0] < early[4], "the rate rises first: {early:?}");
        let mut restored = fresh;
        restored.load_record(schedule.to_record());
        for _ in 0..7 {
            assert_eq!(restored.step(), schedule.step());
        }
    }
}
