//! The learning rate of every step.

use burn::optim::LearningRate;
use burn::optim::lr_scheduler::{LrScheduler, LrSchedulerRecord};

use super::config::Schedule;
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

/// Factor of the learning rate after so many epochs (fractions allowed) of `epochs`.
pub fn schedule_factor(schedule: Schedule, epoch: f64, epochs: f64, last: f64) -> f64 {
    match schedule {
        Schedule::Linear => (1.0 - epoch / epochs).max(0.0) * (1.0 - last) + last,
        Schedule::Cosine => {
            1.0 + (last - 1.0) * (1.0 - (std::f64::consts::PI * epoch / epochs).cos()) / 2.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_schedules_start_at_one_and_end_at_the_last_rate() {
        for schedule in [Schedule::Linear, Schedule::Cosine] {
            assert!((schedule_factor(schedule, 0.0, 30.0, 0.01) - 1.0).abs() < 1e-12);
            assert!((schedule_factor(schedule, 30.0, 30.0, 0.01) - 0.01).abs() < 1e-12);
        }
    }

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
