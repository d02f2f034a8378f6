//! The layers that the detector is made of, one a file.
//!
//! Field names equal the published architecture's, so that weight paths read naturally. Every
//! module has `forward` and `folded`, which merges batch normalisation into the convolutions.

mod attention;
mod bottleneck;
mod c3k2;
mod conv;
mod dense;
mod sppf;

pub use attention::{Attention, AttentionConfig, C2psa, C2psaConfig, PsaBlock, PsaBlockConfig};
pub use bottleneck::{Bottleneck, BottleneckConfig, C3k, C3kConfig};
pub use c3k2::{C3k2, C3k2Config};
pub use conv::{Conv, ConvBlock, ConvBlockConfig, ConvConfig};
pub use dense::{Dense, DenseConfig};
pub use sppf::{Sppf, SppfConfig};
