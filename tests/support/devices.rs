//! The devices that the tests run on: the default one, and those of the features in the build.

use burn::tensor::Device;

/// The default processor backend.
pub fn flex() -> Device {
    Device::flex()
}

/// Every device of this build and machine by name, the default one first. A graphics card that
/// the build supports but the machine does not have is left out, with a line that says why.
pub fn every() -> Vec<(&'static str, Device)> {
    #[allow(unused_mut, reason = "only some features add devices")]
    let mut devices = vec![("flex", flex())];
    #[cfg(feature = "ndarray")]
    #[allow(deprecated, reason = "a second opinion for as long as Burn ships it")]
    devices.push(("ndarray", Device::ndarray()));
    #[cfg(feature = "wgpu")]
    match "wgpu"
        .parse::<twinsight::device::DeviceName>()
        .unwrap()
        .open()
    {
        Ok(device) => devices.push(("wgpu", device)),
        Err(error) => println!("skipped on wgpu: {error}"),
    }
    devices
}
