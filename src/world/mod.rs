//! The procedural world: cities, vehicles and the sun, made from a seed without any asset files.
//!
//! A [`Scene`] is a triangle mesh with procedural colours around a [`Vehicle`], among others or alone; `render` turns it
//! into stereo pairs. Everything here is a function of the seed: random numbers come from PCG, sine
//! and power from `libm`, so a scene is the same to the last bit on every machine.
//!
//! Axes: `world` is metres with z up and the ground at z = 0; `vehicle` is x forward, y left, z up.

mod body;
pub(crate) mod city;
pub(crate) mod facade;
pub(crate) mod ground;
mod layout;
pub(crate) mod livery;
pub(crate) mod mesh;
pub(crate) mod noise;
mod scene;
pub(crate) mod sun;
mod traffic;
mod vehicle;

pub use scene::Scene;
pub use sun::Sun;
pub use vehicle::{BodyStyle, Vehicle};
