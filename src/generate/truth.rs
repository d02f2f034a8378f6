//! Extra outputs on request: depth, disparity and instance maps, and the rig's poses.

use std::fmt::Write as _;

use super::Outputs;
use super::settle::Capture;
use super::write::Target;
use crate::dataset::stamp_name;
use crate::error::Result;
use crate::geometry::StereoRig;
use crate::render::{Eye, RigPose, Stage, depth};

/// Counts of a depth map for a metre: hundredths, so that 655 m fit into 16 bits.
const DEPTH_PER_M: f64 = 100.0;
/// Counts of a disparity map for a pixel, as in KITTI.
const DISPARITY_PER_PX: f64 = 256.0;

/// Writes the maps of one image that were asked for; `instances` is its instance map.
pub(super) fn write_maps(
    outputs: Outputs,
    stage: &Stage,
    capture: &Capture,
    eye: Eye,
    instances: &[u8],
    target: &Target,
) -> Result<()> {
    let stamp = capture.row.stamp;
    if outputs.depth || outputs.disparity {
        let depths = depth(stage, target.rig(), &capture.pose, eye);
        if outputs.depth {
            let map: Vec<u16> = depths.iter().map(|&z| counts(z * DEPTH_PER_M)).collect();
            target.write_map_16(Outputs::DEPTH, stamp, eye, &map)?;
        }
        if outputs.disparity {
            let map = disparity_map(target.rig(), &depths);
            target.write_map_16(Outputs::DISPARITY, stamp, eye, &map)?;
        }
    }
    if outputs.instances {
        target.write_map_8(Outputs::INSTANCES, stamp, eye, instances)?;
    }
    Ok(())
}

fn disparity_map(rig: &StereoRig, depths: &[f64]) -> Vec<u16> {
    depths
        .iter()
        .map(|&z| {
            if z.is_finite() {
                counts(rig.disparity_px(z) * DISPARITY_PER_PX)
            } else {
                0
            }
        })
        .collect()
}

/// A number as 16 bits; 0, which means unknown, where it does not fit.
fn counts(value: f64) -> u16 {
    let rounded = (value + 0.5).floor();
    if (1.0..=f64::from(u16::MAX)).contains(&rounded) {
        rounded as u16
    } else {
        0
    }
}

/// The text of `poses.csv`, by stamp: where the rig's midpoint is in the world (metres, z up) and
/// where its axes point (unit vectors).
pub(super) fn poses_csv_text(poses: &[(u64, RigPose)]) -> String {
    let mut text = "stamp,x_m,y_m,z_m,right_x,right_y,right_z,down_x,down_y,down_z,\
                    forward_x,forward_y,forward_z\n"
        .to_owned();
    for (stamp, pose) in poses {
        text.push_str(&stamp_name(*stamp));
        for vector in [
            pose.position_world,
            pose.right_world,
            pose.down_world,
            pose.forward_world,
        ] {
            for value in vector {
                // Writing to a String cannot fail; the sum turns -0 into 0.
                write!(text, ",{:.9}", value + 0.0).ok();
            }
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_fit_into_sixteen_bits_is_unknown() {
        for (value, expected) in [
            (f64::INFINITY, 0),
            (f64::NAN, 0),
            (65_536.0, 0),
            (65_535.4, 65_535),
            (1.4, 1),
            (0.2, 0),
        ] {
            assert_eq!(counts(value), expected, "{value}");
        }
    }
}
