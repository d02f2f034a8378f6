//! The learning rate of every step.

use burn::optim::LearningRate;
use burn::optim::lr_scheduler::module_lr_scheduler::ModuleLrScheduler;
use burn::optim::lr_scheduler::{LrScheduler, LrSchedulerRecord};

use super::optimizer::{parameter_group, schedule_factor, warmed_up};
use super::stage::Steering;
use crate::error::Result;

/// Name of the step count in the scheduler's record.
const STEPS: &str = "steps";

/// A straight rise, then a straight or cosine fall (yolo11.md, section 8.2), by optimiser steps.
#[derive(Debug, Clone)]
struct RiseAndFall {
    steering: Steering,
    steps_per_epoch: u64,
    /// Where the rise begins.
    first: f64,
    steps: u64,
}

/// The rates of a stage before its first step; where the biases' warm-up begins elsewhere they have
/// their own.
///
/// # Errors
/// Never in practice: the group's pattern is constant.
pub fn schedule(steering: &Steering, steps_per_epoch: u64) -> Result<ModuleLrScheduler> {
    let rates = RiseAndFall::new(steering.clone(), steps_per_epoch);
    let first = steering.first_bias_rate;
    if first <= 0.0 {
        return Ok(rates.into());
    }
    let biases = RiseAndFall {
        first,
        ..rates.clone()
    };
    Ok(ModuleLrScheduler::new(rates).with_group(parameter_group("(beta|bias)$")?, biases))
}

impl RiseAndFall {
    fn new(steering: Steering, steps_per_epoch: u64) -> Self {
        Self {
            steering,
            steps_per_epoch,
            first: 0.0,
            steps: 0,
        }
    }

    /// The rate of a step, counted from 0.
    fn rate(&self, step: u64) -> f64 {
        let steering = &self.steering;
        let epoch = step as f64 / self.steps_per_epoch.max(1) as f64;
        let last = steering.final_learning_rate;
        let factor = schedule_factor(steering.schedule, epoch, f64::from(steering.epochs), last);
        let full = steering.learning_rate * factor;
        let steps = steering.warmup_steps(self.steps_per_epoch);
        // A step at a rate of zero would move nothing: a step has the rate of its end.
        warmed_up(self.first, full, (step + 1) as f64, steps)
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

    #[test]
    fn biases_come_down_to_the_rate_to_which_all_others_rise() {
        let steering = Steering {
            first_bias_rate: 0.1,
            ..Steering::example()
        };
        let mut schedule = schedule(&steering, 5).unwrap();
        let id = burn::module::ParamId::new();
        for step in 0..12 {
            let rates = schedule.step();
            let of = |path: &str| rates.lr_from_param(id, Some(path));
            let [weight, bias] = ["network.a.conv.weight", "network.a.norm.beta"].map(of);
            assert_eq!(weight, of("network.a.norm.gamma"));
            assert_eq!(bias, of("network.head.bias"));
            // Ten steps of warm-up.
            assert_eq!(bias > weight, step < 9, "step {step}: {bias} {weight}");
        }
    }
}
