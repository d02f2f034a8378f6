//! The procedural world: cities, vehicles and the sun, made from a seed without any asset
//! files; the user's own glTF models join them on request.
//!
//! A [`Scene`] is a triangle mesh with procedural colours around a [`Vehicle`], among others or alone; `render` turns it
//! into stereo pairs. Everything here is a function of the seed: random numbers come from PCG, sine
//! and power from `libm`, so a scene is the same to the last bit on every machine.
//!
//! Axes: `world` is metres with z up and the ground at z = 0; `vehicle` is x forward, y left, z up.

pub(crate) mod assets;
mod body;
pub(crate) mod city;
pub(crate) mod facade;
pub(crate) mod ground;
mod layout;
pub(crate) mod livery;
pub(crate) mod mesh;
pub(crate) mod noise;
mod paint;
mod props;
mod scene;
pub(crate) mod sky;
mod sun;
mod traffic;
pub(crate) mod tree;
pub(crate) mod vehicle;

pub use assets::AssetLibrary;
pub use paint::Paint;
pub use scene::Scene;
pub use sky::Air;
pub use sun::{Sun, SunPlace};
pub use vehicle::{BodyStyle, OwnAssets, Vehicle, Wardrobe};
