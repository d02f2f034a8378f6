//! Devices that share a training.

use burn::tensor::Device;
use burn::tensor::distributed::{DistributedConfig, ReduceOperation};
use burn::train::{ExecutionStrategy, MultiDeviceOptim};

use crate::device::DeviceName;
use crate::error::{Error, Result};

/// The devices of a training, all of them open.
#[derive(Debug, Clone)]
pub struct DeviceSet {
    devices: Vec<Device>,
    /// Whether they add up gradients among themselves.
    collective: bool,
}

impl DeviceSet {
    /// Opens devices.
    ///
    /// # Errors
    /// No device, one given twice, or one that cannot be used.
    pub fn open(names: &[DeviceName]) -> Result<Self> {
        if names.is_empty() {
            return Err(Error::device(
                "none",
                "training needs a device",
                "give --device flex",
            ));
        }
        for (position, name) in names.iter().enumerate() {
            if names[..position].contains(name) {
                return Err(Error::device(
                    name.to_string(),
                    "is given twice",
                    "give every device once",
                ));
            }
        }
        Ok(Self {
            devices: names.iter().map(DeviceName::open).collect::<Result<_>>()?,
            collective: names.iter().all(DeviceName::is_collective),
        })
    }

    /// The first, which holds the network between steps and validates.
    pub fn main(&self) -> &Device {
        &self.devices[0]
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.devices.len()
    }

    /// Whether each keeps the network, and they add up gradients among themselves.
    pub fn is_collective(&self) -> bool {
        self.collective
    }

    /// Which of them a device is.
    pub fn position(&self, device: &Device) -> usize {
        // Burn compares devices without regard to gradients.
        let position = self.devices.iter().position(|own| own == device);
        position.unwrap_or_default()
    }

    /// Burn's strategy for them.
    ///
    /// One device trains alone. CUDA devices each keep the network and add up their gradients
    /// among themselves (distributed data parallel); others send their gradients to the
    /// first one, which takes the step. Gradients are added, not averaged, for a pass's loss is its
    /// part of the step's.
    pub fn strategy(&self) -> ExecutionStrategy {
        let devices: Vec<Device> = self.devices.iter().cloned().map(Device::autodiff).collect();
        match (devices.len(), self.collective) {
            (1, _) => ExecutionStrategy::single(devices[0].clone()),
            (_, true) => ExecutionStrategy::ddp(
                devices,
                DistributedConfig {
                    all_reduce_op: ReduceOperation::Sum,
                },
            ),
            (_, false) => ExecutionStrategy::multi(devices, MultiDeviceOptim::OptimMainDevice),
        }
    }
}
