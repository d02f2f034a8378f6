//! The extent along the line of sight that a dataset tells of a vehicle: how far its centre lies behind
//! the surface that an image shows of it, along the optical axis.
//!
//! Exactly where the dataset has disparity and instance maps: the median over the vehicle's visible
//! pixels. Otherwise from `objects.csv`: rays through the box meet a simple body in the vehicle's
//! bounding box, of which the same median is taken.

use std::path::{Path, PathBuf};

use image::{ImageBuffer, Luma};

use crate::dataset::{ObjectRow, Side, stamp_name};
use crate::geometry::{Camera, PixelBox, StereoRig};

/// Rays through a box, across and down.
const RAYS: [u32; 2] = [24, 16];

/// Bodies at least so high are boxes, metres; others have a bonnet.
const BOXY_M: f64 = 1.85;

/// Counts of a disparity map for a pixel.
const DISPARITY_PER_PX: f64 = 256.0;

/// Fewer pixels of a vehicle than this say nothing.
const FEWEST_PIXELS: usize = 12;

/// A box in vehicle axes (forward, right, up; origin at the bounding box's centre): bounds of each
/// axis, metres.
type Block = [[f64; 2]; 3];

/// Disparity and instance maps of one image, where a dataset has them.
pub struct Maps {
    disparity: ImageBuffer<Luma<u16>, Vec<u16>>,
    instances: ImageBuffer<Luma<u8>, Vec<u8>>,
}

impl Maps {
    /// Reads the maps of an image; none where they are missing or cannot be read.
    pub fn read(dataset: &Path, stamp: u64, side: Side) -> Option<Self> {
        let file = |folder: &str| -> PathBuf {
            let name = format!("{}_{}.png", side.word(), stamp_name(stamp));
            dataset.join(folder).join(name)
        };
        let (disparity, instances) = (file("disparity"), file("instances"));
        if !disparity.exists() || !instances.exists() {
            return None;
        }
        Some(Self {
            disparity: image::open(disparity).ok()?.into_luma16(),
            instances: image::open(instances).ok()?.into_luma8(),
        })
    }

    /// Depth of the visible surface of a vehicle in a box, metres: that of the median disparity of its
    /// pixels. None where hardly a pixel is its.
    pub fn surface_z_m(&self, id: u32, area: &PixelBox, rig: &StereoRig) -> Option<f64> {
        let (width, height) = self.disparity.dimensions();
        if self.instances.dimensions() != (width, height) {
            return None;
        }
        let own = u8::try_from(id + 1).ok()?;
        let area = area.clipped(f64::from(width), f64::from(height));
        let range = |low: f64, high: f64| (low.floor() as u32)..(high.ceil() as u32);
        let mut disparities: Vec<u16> = range(area.y_min, area.y_max)
            .flat_map(|y| range(area.x_min, area.x_max).map(move |x| (x, y)))
            .filter(|&(x, y)| self.instances.get_pixel(x, y).0 == [own])
            .map(|(x, y)| self.disparity.get_pixel(x, y).0[0])
            .filter(|&disparity| disparity > 0)
            .collect();
        if disparities.len() < FEWEST_PIXELS {
            return None;
        }
        let middle = disparities.len() / 2;
        let (_, median, _) = disparities.select_nth_unstable(middle);
        Some(rig.depth_m(f64::from(*median) / DISPARITY_PER_PX))
    }
}

/// Depth of the surface of a vehicle in its box, metres, from its bounding box in space: that of the
/// median disparity of rays that meet a body in it.
pub fn cuboid_surface_z_m(
    object: &ObjectRow,
    area: &PixelBox,
    side: Side,
    rig: &StereoRig,
) -> Option<f64> {
    let camera = rig.camera(side);
    let offset_m = match side {
        Side::Left => rig.baseline_m / 2.0,
        Side::Right => -rig.baseline_m / 2.0,
    };
    let center = [object.x_m + offset_m, object.y_m, object.z_m];
    let axes = axes(object)?;
    let blocks = blocks(object);
    let mut inverse_depths = Vec::with_capacity((RAYS[0] * RAYS[1]) as usize);
    for row in 0..RAYS[1] {
        for column in 0..RAYS[0] {
            let part = |index: u32, count: u32| (f64::from(index) + 0.5) / f64::from(count);
            let pixel = [
                area.x_min + area.width() * part(column, RAYS[0]),
                area.y_min + area.height() * part(row, RAYS[1]),
            ];
            if let Some(z_m) = first_hit_m(pixel, camera, center, &axes, &blocks) {
                inverse_depths.push(1.0 / z_m);
            }
        }
    }
    if inverse_depths.len() < FEWEST_PIXELS {
        return None;
    }
    inverse_depths.sort_by(f64::total_cmp);
    Some(1.0 / inverse_depths[inverse_depths.len() / 2])
}

/// Forward, right and up of a vehicle in the camera's axes. None where they do not fit together.
fn axes(object: &ObjectRow) -> Option<[[f64; 3]; 3]> {
    let forward = [object.forward_x, object.forward_y, object.forward_z];
    let up = up(object)?;
    // Right completes forward and up; the camera's axes (right, down, forward) turn the same way.
    let right = [
        forward[1] * up[2] - forward[2] * up[1],
        forward[2] * up[0] - forward[0] * up[2],
        forward[0] * up[1] - forward[1] * up[0],
    ];
    let length = dot(right, right).sqrt();
    (length > 0.5).then(|| [forward, right.map(|v| v / length), up])
}

/// Up of a camera that does not roll: its pitch follows from the elevation under which the vehicle sees
/// it. Of the two pitches that fit, the one on which the vehicle stands level counts.
fn up(object: &ObjectRow) -> Option<[f64; 3]> {
    let (y, z) = (object.y_m, object.z_m);
    let across = y.hypot(z);
    let rise = object.distance_m * object.elevation_deg.to_radians().sin();
    if across < 1e-6 || rise.abs() > across {
        return None;
    }
    // Up is (0, -cos p, -sin p), and the camera lies `rise` over the vehicle: up . center = -rise.
    let (towards, swing) = (z.atan2(y), (rise / across).acos());
    let level =
        |pitch: &f64| (object.forward_y * pitch.cos() + object.forward_z * pitch.sin()).abs();
    let pitch = [towards + swing, towards - swing]
        .into_iter()
        .filter(|pitch| pitch.cos() > 0.0)
        .min_by(|a, b| level(a).total_cmp(&level(b)))?;
    Some([0.0, -pitch.cos(), -pitch.sin()])
}

/// A body that fills a bounding box: a box, or a lower half with a cabin on it.
fn blocks(object: &ObjectRow) -> Vec<Block> {
    let (length, width, height) = (object.length_m, object.width_m, object.height_m);
    let whole = |size: f64| [-size / 2.0, size / 2.0];
    if height > BOXY_M {
        return vec![[whole(length), whole(width), whole(height)]];
    }
    // Rounder than its bounding box.
    let belt = -height / 2.0 + 0.56 * height;
    let floor = -height / 2.0 + 0.1 * height;
    vec![
        [whole(length * 0.95), whole(width * 0.95), [floor, belt]],
        [
            [-0.34 * length, 0.10 * length],
            whole(width * 0.78),
            [belt, height / 2.0],
        ],
    ]
}

/// Depth where the ray through a pixel first meets one of the blocks, metres.
fn first_hit_m(
    pixel: [f64; 2],
    camera: &Camera,
    center: [f64; 3],
    axes: &[[f64; 3]; 3],
    blocks: &[Block],
) -> Option<f64> {
    let ray = camera.camera_from_pixel(pixel);
    let origin = axes.map(|axis| -dot(axis, center));
    let direction = axes.map(|axis| dot(axis, ray));
    blocks
        .iter()
        .filter_map(|block| {
            let (mut near, mut far) = (0.0_f64, f64::INFINITY);
            for axis in 0..3 {
                let [low, high] = block[axis];
                if direction[axis].abs() < 1e-12 {
                    if !(low..=high).contains(&origin[axis]) {
                        return None;
                    }
                    continue;
                }
                let ends = [low, high].map(|end| (end - origin[axis]) / direction[axis]);
                near = near.max(ends[0].min(ends[1]));
                far = far.min(ends[0].max(ends[1]));
            }
            // The ray's depth is 1, so that its parameter is the depth.
            (near > 0.0 && near <= far).then_some(near)
        })
        .min_by(f64::total_cmp)
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn object(forward: [f64; 3], center: [f64; 3], height_m: f64, elevation_deg: f64) -> ObjectRow {
        let [x_m, y_m, z_m] = center;
        ObjectRow {
            stamp: 1,
            id: 0,
            style: String::new(),
            length_m: 4.0,
            width_m: 2.0,
            height_m,
            x_m,
            y_m,
            z_m,
            forward_x: forward[0],
            forward_y: forward[1],
            forward_z: forward[2],
            yaw_deg: 0.0,
            azimuth_deg: 0.0,
            elevation_deg,
            distance_m: dot(center, center).sqrt(),
        }
    }

    fn rig() -> StereoRig {
        StereoRig::from_hfov(640, 360, 90.0, 0.8).unwrap()
    }

    #[test]
    fn a_box_seen_from_behind_shows_its_rear_half_a_length_before_its_centre() {
        let rig = rig();
        let object = object([0.0, 0.0, 1.0], [0.0, 0.0, 20.0], 2.0, 0.0);
        let [x, y] = rig.left.pixel_from_camera([0.4, 0.0, 18.0]).unwrap();
        let area = PixelBox::from_center([x, y], 32.0, 32.0);
        let z_m = cuboid_surface_z_m(&object, &area, Side::Left, &rig).unwrap();
        assert!((z_m - 18.0).abs() < 0.05, "{z_m}");
    }

    #[test]
    fn from_straight_above_the_surface_is_the_roof() {
        let rig = rig();
        // The camera looks down: up is against its axis, the vehicle drives along its x.
        let object = object([1.0, 0.0, 0.0], [0.0, 0.0, 20.0], 2.0, 90.0);
        let area = PixelBox::from_center([326.4, 180.0], 50.0, 20.0);
        let z_m = cuboid_surface_z_m(&object, &area, Side::Left, &rig).unwrap();
        assert!((z_m - 19.0).abs() < 0.05, "{z_m}");
    }

    #[test]
    fn the_camera_above_sees_a_pitched_vehicle_upright() {
        // 30 degrees from above: up in camera axes is (0, -cos 30, -sin 30).
        let (sin, cos) = (0.5, 0.75_f64.sqrt());
        let object = object([0.0, -sin, cos], [0.0, 0.0, 20.0], 2.0, 30.0);
        let [forward, right, up] = axes(&object).unwrap();
        assert!(
            (up[1] + cos).abs() < 1e-9 && (up[2] + sin).abs() < 1e-9,
            "{up:?}"
        );
        assert!(dot(forward, up).abs() < 1e-9 && right[0].abs() > 0.999);
    }
}
