//! Running statistics of batch normalisation when several devices share a training.
//!
//! Burn's running states are shared between copies of a module and move to the device of whichever
//! copy was moved last, so copies on several devices at once would take each other's statistics away,
//! or mix them in the order in which threads happen to come by. Here every device works on a copy of
//! its own, and the statistics come together between steps, always in the same order.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Device, Tensor};

use super::devices::DeviceSet;
use super::stage::device_of;

/// Last names of running statistics in module paths.
const NAMES: [&str; 2] = ["running_mean", "running_var"];

/// The statistics of each device since the last step.
#[derive(Debug)]
pub struct SharedTraining {
    devices: DeviceSet,
    statistics: Mutex<BTreeMap<usize, Vec<Tensor<1>>>>,
}

impl SharedTraining {
    /// None where a device trains alone.
    pub fn between(devices: &DeviceSet) -> Option<Self> {
        (devices.len() > 1).then(|| Self {
            devices: devices.clone(),
            statistics: Mutex::default(),
        })
    }

    fn statistics(&self) -> MutexGuard<'_, BTreeMap<usize, Vec<Tensor<1>>>> {
        self.statistics
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// A copy of a network for a pass, with statistics of its own.
    pub fn private<M: Module>(&self, network: &M) -> M {
        let device = device_of(network);
        let known = self
            .statistics()
            .get(&self.devices.position(&device))
            .cloned();
        let copy = network.valid().train().fork(&device);
        let copy = match known {
            Some(values) => with_running(copy, &values, &device),
            None => copy,
        };
        if self.devices.is_collective() {
            copy.map(&mut AddUp)
        } else {
            copy
        }
    }

    /// Keeps the statistics that a pass left in its copy.
    pub fn keep<M: Module>(&self, copy: &M) {
        let position = self.devices.position(&device_of(copy));
        let values = running(copy);
        self.statistics().insert(position, values);
    }

    /// The network of the next step: with the mean of all devices' statistics, or, where every device
    /// keeps a network of its own, with that device's.
    pub fn settle<M: Module>(&self, network: &M) -> M {
        let device = device_of(network);
        let own = network.valid().train().fork(&device);
        let mut statistics = self.statistics();
        let all = if self.devices.is_collective() {
            let position = self.devices.position(&device);
            statistics.remove(&position).into_iter().collect()
        } else {
            std::mem::take(&mut *statistics)
                .into_values()
                .collect::<Vec<_>>()
        };
        drop(statistics);
        let mut all = all.into_iter();
        let Some(mut sums) = all.next() else {
            return own;
        };
        let mut count = 1.0;
        let plain = device.clone().without_autodiff();
        for values in all {
            count += 1.0;
            sums = sums
                .into_iter()
                .zip(values)
                .map(|(sum, value)| sum.to_device(&plain) + value.to_device(&plain))
                .collect();
        }
        let means: Vec<_> = sums.into_iter().map(|sum| sum.div_scalar(count)).collect();
        with_running(own, &means, &device)
    }
}

/// Marks the parameters whose gradients the devices add up among themselves.
struct AddUp;

impl ModuleMapper for AddUp {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let id = param.id;
        param.map(|tensor| {
            if tensor.is_require_grad() {
                tensor.set_distributed(id)
            } else {
                tensor
            }
        })
    }
}

fn is_running(path: &[String]) -> bool {
    path.last()
        .is_some_and(|name| NAMES.contains(&name.as_str()))
}

/// All running statistics, flat, in the order of traversal.
fn running<M: Module>(module: &M) -> Vec<Tensor<1>> {
    #[derive(Default)]
    struct Collect {
        path: Vec<String>,
        found: Vec<Tensor<1>>,
    }
    impl ModuleVisitor for Collect {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if is_running(&self.path) {
                let tensor = param.val().without_autodiff();
                let count = tensor.shape().num_elements();
                self.found.push(tensor.reshape([count]));
            }
        }
        fn enter_module(&mut self, name: &str, _: &str) {
            self.path.push(name.to_owned());
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.pop();
        }
    }
    let mut collect = Collect::default();
    // Only a copy for inference has the latest.
    module.valid().visit(&mut collect);
    collect.found
}

/// The module with other running statistics, those of [`running`], on a device.
fn with_running<M: Module>(module: M, values: &[Tensor<1>], device: &Device) -> M {
    struct Fill<'a> {
        path: Vec<String>,
        values: std::slice::Iter<'a, Tensor<1>>,
        device: &'a Device,
    }
    impl ModuleMapper for Fill<'_> {
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            if !is_running(&self.path) {
                return param;
            }
            match self.values.next() {
                Some(value) => param.map(|tensor| {
                    let plain = self.device.clone().without_autodiff();
                    let value = value.clone().to_device(&plain).reshape(tensor.dims());
                    if self.device.is_autodiff() {
                        Tensor::from_inner(value)
                    } else {
                        value
                    }
                }),
                None => param,
            }
        }
        fn enter_module(&mut self, name: &str, _: &str) {
            self.path.push(name.to_owned());
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.path.pop();
        }
    }
    module.map(&mut Fill {
        path: Vec::new(),
        values: values.iter(),
        device,
    })
}
