//! Devices chosen at run time: `flex`, `ndarray`, `wgpu`, `cuda`, with `:N` for the N-th of a kind, and
//! `remote:ADDRESS` for one that [`crate::worker`] serves on another machine.

use std::fmt;
use std::str::FromStr;

use burn::tensor::Device;

use crate::error::{Error, Result};

/// What a device is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Flex,
    NdArray,
    Wgpu,
    Cuda,
    Remote,
}

impl Kind {
    const ALL: [Self; 5] = [
        Self::Flex,
        Self::NdArray,
        Self::Wgpu,
        Self::Cuda,
        Self::Remote,
    ];

    fn word(self) -> &'static str {
        match self {
            Self::Flex => "flex",
            Self::NdArray => "ndarray",
            Self::Wgpu => "wgpu",
            Self::Cuda => "cuda",
            Self::Remote => "remote",
        }
    }

    fn about(self) -> &'static str {
        match self {
            Self::Flex => "processor, Twinsight's own kernels (default)",
            Self::NdArray => "processor, Burn's older backend; slow, for comparison",
            Self::Wgpu => "graphics card through Vulkan, Metal or DirectX 12",
            Self::Cuda => "NVIDIA graphics card",
            Self::Remote => "device of another machine, served by `twinsight worker`",
        }
    }

    fn built_in(self) -> bool {
        match self {
            Self::Flex => cfg!(feature = "flex"),
            Self::NdArray => cfg!(feature = "ndarray"),
            Self::Wgpu => cfg!(feature = "wgpu"),
            Self::Cuda => cfg!(feature = "cuda"),
            Self::Remote => cfg!(feature = "remote"),
        }
    }
}

/// A device as a person names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeviceName {
    kind: Kind,
    index: usize,
    /// Of a remote device: `ID@HOST:PORT`.
    address: Option<String>,
}

impl DeviceName {
    /// The default: Flex on the processor.
    pub const FLEX: Self = Self {
        kind: Kind::Flex,
        index: 0,
        address: None,
    };

    /// Whether devices of this kind can add up their gradients among themselves. Burn's processors
    /// and other graphics cards cannot, and remote devices only within one worker.
    pub(crate) fn is_collective(&self) -> bool {
        self.kind == Kind::Cuda
    }

    /// Opens the device.
    ///
    /// # Errors
    /// A device that this build was not made for or that this machine does not have.
    pub fn open(&self) -> Result<Device> {
        if !self.kind.built_in() {
            let word = self.kind.word();
            return Err(Error::device(
                self.to_string(),
                "this program was built without it",
                format!(
                    "build with `cargo build --release --features {word}`, or use --device flex"
                ),
            ));
        }
        if self.index > 0 && matches!(self.kind, Kind::Flex | Kind::NdArray) {
            return Err(Error::device(
                self.to_string(),
                "the processor is one device",
                format!("use --device {}", self.kind.word()),
            ));
        }
        match self.kind {
            #[cfg(feature = "flex")]
            Kind::Flex => Ok(Device::flex()),
            #[cfg(feature = "ndarray")]
            #[allow(
                deprecated,
                reason = "ndarray stays selectable for as long as Burn ships it"
            )]
            Kind::NdArray => Ok(Device::ndarray()),
            #[cfg(feature = "wgpu")]
            Kind::Wgpu => gpu::open_wgpu(self),
            #[cfg(feature = "cuda")]
            Kind::Cuda => gpu::open_cuda(self),
            #[cfg(feature = "remote")]
            Kind::Remote => {
                crate::worker::connect(self.address.as_deref().unwrap_or(""), self.index)
            }
            #[allow(unreachable_patterns, reason = "reached when a feature is off")]
            _ => Err(Error::device(
                self.to_string(),
                "not built in",
                "see `twinsight devices`",
            )),
        }
    }
}

impl FromStr for DeviceName {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        if let Some(address) = text.strip_prefix("remote:") {
            let (address, index) = match address.rsplit_once('#') {
                Some((address, index)) => (address, index.parse().ok()),
                None => (address, Some(0)),
            };
            let complete = address
                .split_once('@')
                .is_some_and(|(id, place)| !id.is_empty() && place.contains(':'));
            let Some(index) = index.filter(|_| complete) else {
                return Err(Error::device(
                    format!("\"{text}\""),
                    "is not the address of a worker",
                    "give remote:ID@HOST:PORT as `twinsight worker` prints it, with #N for the N-th \
                     of its devices",
                ));
            };
            return Ok(Self {
                kind: Kind::Remote,
                index,
                address: Some(address.to_owned()),
            });
        }
        let (word, index) = match text.split_once(':') {
            Some((word, index)) => (word, index.parse().ok()),
            None => (text, Some(0)),
        };
        let kind = Kind::ALL.into_iter().find(|kind| kind.word() == word);
        match (kind, index) {
            (Some(kind), Some(index)) if kind != Kind::Remote => Ok(Self {
                kind,
                index,
                address: None,
            }),
            _ => Err(Error::device(
                format!("\"{text}\""),
                "there is no such device",
                "give flex, ndarray, wgpu or cuda, with :N for the N-th of several, or \
                 remote:ADDRESS; `twinsight devices` lists what this machine has",
            )),
        }
    }
}

impl fmt::Display for DeviceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.address, self.index) {
            (None, 0) => f.write_str(self.kind.word()),
            (None, index) => write!(f, "{}:{index}", self.kind.word()),
            (Some(address), 0) => write!(f, "remote:{address}"),
            (Some(address), index) => write!(f, "remote:{address}#{index}"),
        }
    }
}

/// What is known of one kind of device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeviceReport {
    /// What to give as `--device`.
    pub name: String,
    /// What it is, in a few words.
    pub about: &'static str,
    /// What stands in its way, with the remedy; none if it can be used.
    pub obstacle: Option<String>,
    /// The adapters or cards found, first one is index 0.
    pub found: Vec<String>,
}

/// Every kind of device: what this build and this machine can use, and how to enable the rest.
pub fn devices() -> Vec<DeviceReport> {
    Kind::ALL
        .into_iter()
        .map(|kind| {
            let found = adapters(kind);
            let obstacle = if kind.built_in() {
                (matches!(kind, Kind::Wgpu | Kind::Cuda) && found.is_empty())
                    .then(|| format!("nothing found: {}", missing(kind)))
            } else {
                let word = kind.word();
                Some(format!(
                    "not in this build: cargo build --release --features {word}"
                ))
            };
            DeviceReport {
                name: kind.word().to_owned(),
                about: kind.about(),
                obstacle,
                found,
            }
        })
        .collect()
}

/// What to install where nothing was found.
fn missing(kind: Kind) -> &'static str {
    match kind {
        Kind::Cuda => "install the NVIDIA driver and the CUDA toolkit",
        _ => "install a graphics driver (a software one: Debian's mesa-vulkan-drivers)",
    }
}

fn adapters(kind: Kind) -> Vec<String> {
    match kind {
        Kind::Flex | Kind::NdArray => {
            let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
            vec![format!("{cores} cores")]
        }
        #[cfg(feature = "wgpu")]
        Kind::Wgpu => gpu::wgpu_adapters(),
        #[cfg(feature = "cuda")]
        Kind::Cuda => gpu::cuda_cards(),
        #[allow(unreachable_patterns, reason = "reached when a feature is off")]
        _ => Vec::new(),
    }
}

#[cfg(any(feature = "wgpu", feature = "cuda"))]
mod gpu {
    use super::{Device, DeviceName, Error, Result, missing};

    /// Refuses an index that no card has: Burn itself would panic in its device thread.
    fn check(name: &DeviceName, found: &[String]) -> Result<()> {
        if name.index < found.len() {
            return Ok(());
        }
        let problem = match found.len() {
            0 => "no adapter was found".to_owned(),
            count => format!("there are only {count}: {}", found.join(", ")),
        };
        let remedy = match found.len() {
            0 => missing(name.kind).to_owned(),
            count => format!("give an index below {count}"),
        };
        Err(Error::device(
            name.to_string(),
            problem,
            format!("{remedy}, or use --device flex"),
        ))
    }

    #[cfg(feature = "wgpu")]
    pub fn open_wgpu(name: &DeviceName) -> Result<Device> {
        use burn::tensor::DeviceKind;
        let found = enumerate();
        let names: Vec<String> = found.iter().map(|info| info.name.clone()).collect();
        check(name, &names)?;
        // Burn counts adapters within a type; ours are counted over all of them.
        let chosen = &found[name.index];
        if chosen.name.contains("llvmpipe") {
            // Half of what still comes out right.
            crate::kernels::bands::limit_sums(1 << 13);
        }
        let within = found[..name.index]
            .iter()
            .filter(|info| info.device_type == chosen.device_type)
            .count();
        Ok(Device::wgpu(match chosen.device_type {
            wgpu::DeviceType::DiscreteGpu => DeviceKind::DiscreteGpu(within),
            wgpu::DeviceType::IntegratedGpu => DeviceKind::IntegratedGpu(within),
            wgpu::DeviceType::VirtualGpu => DeviceKind::VirtualGpu(within),
            wgpu::DeviceType::Cpu => DeviceKind::Cpu,
            wgpu::DeviceType::Other => DeviceKind::DefaultDevice,
        }))
    }

    /// Adapters, real graphics cards before software ones.
    #[cfg(feature = "wgpu")]
    fn enumerate() -> Vec<wgpu::AdapterInfo> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        // Drivers of OpenGL need not be started: they are not asked for below.
        descriptor.backends = wgpu::Backends::PRIMARY;
        let instance = wgpu::Instance::new(descriptor);
        let adapters = instance.enumerate_adapters(wgpu::Backends::PRIMARY);
        let mut found: Vec<_> = pollster::block_on(adapters)
            .iter()
            .map(wgpu::Adapter::get_info)
            .collect();
        found.sort_by_key(|info| match info.device_type {
            wgpu::DeviceType::DiscreteGpu => 0,
            wgpu::DeviceType::IntegratedGpu => 1,
            wgpu::DeviceType::VirtualGpu => 2,
            wgpu::DeviceType::Other => 3,
            wgpu::DeviceType::Cpu => 4,
        });
        found
    }

    #[cfg(feature = "wgpu")]
    pub fn wgpu_adapters() -> Vec<String> {
        enumerate()
            .into_iter()
            .map(|info| format!("{} ({:?}, {:?})", info.name, info.device_type, info.backend))
            .collect()
    }

    #[cfg(feature = "cuda")]
    pub fn open_cuda(name: &DeviceName) -> Result<Device> {
        check(name, &cuda_cards())?;
        Ok(Device::cuda(name.index))
    }

    #[cfg(feature = "cuda")]
    pub fn cuda_cards() -> Vec<String> {
        use burn::tensor::DeviceType;
        // Without a driver the CUDA runtime panics while it looks for cards.
        std::panic::catch_unwind(|| Device::enumerate(DeviceType::Cuda).into_vec().len())
            .map(|count| (0..count).map(|index| format!("card {index}")).collect())
            .unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn device_names_round_trip() {
        for text in [
            "flex",
            "ndarray",
            "wgpu",
            "wgpu:2",
            "cuda:1",
            "remote:ab12@gpu.local:7411",
            "remote:ab12@[::1]:7411#1",
        ] {
            assert_eq!(text.parse::<DeviceName>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn an_unknown_device_is_named_with_the_known_ones() {
        for text in ["tpu", "cuda:x", "", "flex:-1"] {
            let message = text.parse::<DeviceName>().unwrap_err().to_string();
            assert!(message.contains("flex, ndarray, wgpu or cuda"), "{message}");
        }
    }

    #[test]
    fn an_incomplete_address_is_refused_with_its_form() {
        for text in [
            "remote",
            "remote:",
            "remote:ab12",
            "remote:@host:1",
            "remote:a@b:1#x",
        ] {
            let message = text.parse::<DeviceName>().unwrap_err().to_string();
            assert!(message.contains(text), "{message}");
        }
    }

    #[test]
    fn a_second_processor_is_refused() {
        let message = "flex:1"
            .parse::<DeviceName>()
            .unwrap()
            .open()
            .unwrap_err()
            .to_string();
        assert!(message.contains("use --device flex"), "{message}");
    }
}
