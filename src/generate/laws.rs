//! What must hold of every generated dataset, checked on the files themselves.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use tempfile::TempDir;

use super::*;
use crate::dataset::{BoxKind, Side, StereoDataset, read_objects_csv};
use crate::geometry::PixelBox;
use crate::progress::Silent;

const SIZE: [u32; 2] = [256, 144];

fn everything() -> GenerateConfig {
    GenerateConfig {
        frames: 8,
        frames_per_scene: 2,
        width: SIZE[0],
        height: SIZE[1],
        distance_max_m: 30.0,
        samples_per_pixel: 1,
        outputs: Outputs {
            depth: true,
            disparity: true,
            instances: true,
            poses: true,
        },
        ..GenerateConfig::default()
    }
}

/// A dataset with every output, made once.
fn made() -> &'static Path {
    static MADE: LazyLock<TempDir> = LazyLock::new(|| {
        let folder = tempfile::tempdir().unwrap();
        generate(&everything(), folder.path(), &Silent).unwrap();
        folder
    });
    MADE.path()
}

fn map(root: &Path, folder: &str, side: Side, stamp: u64) -> Vec<u16> {
    let path = root.join(format!("{folder}/{side}_{stamp:05}.png"));
    let image = image::open(path).unwrap();
    assert_eq!([image.width(), image.height()], SIZE);
    image.into_luma16().into_raw()
}

fn instances(root: &Path, side: Side, stamp: u64) -> Vec<u8> {
    let path = root.join(format!("instances/{side}_{stamp:05}.png"));
    image::open(path).unwrap().into_luma8().into_raw()
}

#[test]
fn depth_disparity_and_labels_say_the_same_of_every_pixel_in_both_images() {
    let root = made();
    let rig = everything().rig().unwrap();
    let (mut seen_twice, mut agree) = (0_u32, 0_u32);
    for stamp in 0..8 {
        let [left, right] = Side::ALL.map(|side| map(root, "depth", side, stamp));
        let disparity = map(root, "disparity", Side::Left, stamp);
        let masks = Side::ALL.map(|side| instances(root, side, stamp));
        for (index, (&centimetres, &counts)) in left.iter().zip(&disparity).enumerate() {
            assert_eq!(centimetres == 0, counts == 0, "pixel {index}");
            if centimetres == 0 {
                continue;
            }
            let z = f64::from(centimetres) / 100.0;
            let disparity_px = f64::from(counts) / 256.0;
            // Half a count of either map.
            let tolerance = rig.disparity_px(z) * 0.005 / z + 0.5 / 256.0 + 1e-6;
            assert!((disparity_px - rig.disparity_px(z)).abs() < tolerance);
            // The same point of the world in the right image.
            let x = f64::from(index as u32 % SIZE[0]) + 0.5 - disparity_px;
            if x < 0.0 {
                continue;
            }
            let other = index / SIZE[0] as usize * SIZE[0] as usize + x as usize;
            seen_twice += 1;
            let same_depth = (f64::from(right[other]) / 100.0 - z).abs() < 0.05 * z;
            agree += u32::from(same_depth && masks[0][index] == masks[1][other]);
        }
    }
    // The rest is hidden from one camera, or at an edge.
    let part = f64::from(agree) / f64::from(seen_twice);
    assert!(part > 0.85, "{part} of {seen_twice}");
}

#[test]
fn projected_points_of_a_vehicle_land_where_it_was_rendered() {
    let root = made();
    let dataset = StereoDataset::open(root).unwrap();
    let objects = read_objects_csv(root.join("objects.csv")).unwrap();
    let mut checked = 0;
    for frame in &dataset.frames {
        let stamp = frame.row.stamp;
        let depth = map(root, "depth", Side::Left, stamp);
        let mask = instances(root, Side::Left, stamp);
        for vehicle in frame.vehicles(BoxKind::Tight) {
            let [x, y] = vehicle.left.center_pixel;
            let inside = x > 0.0 && y > 0.0 && x < f64::from(SIZE[0]) && y < f64::from(SIZE[1]);
            if vehicle.left.visible.unwrap() < 0.98 || !inside {
                continue;
            }
            let object = objects
                .iter()
                .find(|o| o.stamp == stamp && o.id == vehicle.id)
                .unwrap();
            // The centre is inside the body: its pixel shows the vehicle, nearer by less than
            // half of its diagonal.
            let pixel = y as usize * SIZE[0] as usize + x as usize;
            assert_eq!(u32::from(mask[pixel]), vehicle.id + 1, "frame {stamp}");
            let diagonal = libm::hypot(object.length_m, object.height_m + object.width_m);
            let nearer = object.z_m - f64::from(depth[pixel]) / 100.0;
            assert!((0.0..0.5 * diagonal).contains(&nearer), "{nearer} m");
            checked += 1;
        }
    }
    assert!(checked >= 5, "only {checked} vehicles are in full view");
}

#[test]
fn the_tight_box_is_the_bounds_of_the_instance_map() {
    let root = made();
    let dataset = StereoDataset::open(root).unwrap();
    let mut checked = 0;
    for frame in &dataset.frames {
        for (side, image) in frame.images() {
            let mask = instances(root, side, frame.row.stamp);
            let labels: Vec<_> = image.labels_of(BoxKind::Tight).collect();
            for label in &labels {
                let tight = label.box_pixel;
                let outward = PixelBox::new(
                    tight.x_min.floor(),
                    tight.y_min.floor(),
                    tight.x_max.ceil(),
                    tight.y_max.ceil(),
                );
                // Where two vehicles share a pixel, the map has room for one.
                let shared = labels.iter().any(|other| {
                    other.id != label.id && other.box_pixel.intersection(&outward).is_valid()
                });
                if shared {
                    continue;
                }
                let bounds = (0_u32..)
                    .zip(&mask)
                    .filter(|(_, id)| u32::from(**id) == label.id + 1)
                    .map(|(index, _)| {
                        let [x, y] = [index % SIZE[0], index / SIZE[0]].map(f64::from);
                        PixelBox::new(x, y, x + 1.0, y + 1.0)
                    })
                    .reduce(|a, b| a.around(&b));
                assert_eq!(bounds, Some(outward), "vehicle {}", label.id);
                checked += 1;
            }
        }
    }
    assert!(checked >= 20, "only {checked} vehicles stand alone");
}

#[test]
fn poses_put_the_vehicles_of_a_scene_at_the_same_place_in_all_of_its_frames() {
    let root = made();
    let text = fs::read_to_string(root.join("poses.csv")).unwrap();
    let poses: BTreeMap<u64, Vec<f64>> = text
        .lines()
        .skip(1)
        .map(|line| {
            let (stamp, numbers) = line.split_once(',').unwrap();
            let numbers = numbers.split(',').map(|n| n.parse().unwrap()).collect();
            (stamp.parse().unwrap(), numbers)
        })
        .collect();
    assert_eq!(poses.len(), 8);
    let mut places: BTreeMap<(u64, u32), [f64; 3]> = BTreeMap::new();
    for object in read_objects_csv(root.join("objects.csv")).unwrap() {
        let pose = &poses[&object.stamp];
        let rig_axes = [object.x_m, object.y_m, object.z_m];
        let world = [0, 1, 2].map(|i| {
            let along: f64 = (0..3)
                .map(|axis| rig_axes[axis] * pose[3 + 3 * axis + i])
                .sum();
            pose[i] + along
        });
        // Vehicles stand on the ground.
        assert!((world[2] - 0.5 * object.height_m).abs() < 2e-3, "{world:?}");
        let place = *places.entry((object.stamp / 2, object.id)).or_insert(world);
        assert!((0..3).all(|i| (place[i] - world[i]).abs() < 1e-3));
    }
    assert_eq!(
        places.len() * 2,
        read_objects_csv(root.join("objects.csv")).unwrap().len()
    );
}

#[test]
fn settled_frames_follow_the_plan_and_no_scene_is_in_two_splits() {
    let folder = tempfile::tempdir().unwrap();
    let config = GenerateConfig {
        frames: 60,
        frames_per_scene: 10,
        distance_max_m: 60.0,
        width: 64,
        height: 64,
        samples_per_pixel: 1,
        test: Some(TestProtocol {
            distances_m: vec![15.0, 25.0],
            suns: vec![crate::world::Sun::Noon],
            views: vec![crate::dataset::View::Side],
            scenes: 1,
        }),
        ..GenerateConfig::default()
    };
    generate(&config, folder.path(), &Silent).unwrap();
    let dataset = StereoDataset::open(folder.path()).unwrap();
    let mut splits: BTreeMap<u32, Split> = BTreeMap::new();
    let mut strata: BTreeMap<u32, [u32; 10]> = BTreeMap::new();
    let mut sectors = [0; 6];
    let mut high = 0;
    for frame in &dataset.frames {
        let row = &frame.row;
        let scene = row.scene.unwrap();
        assert_eq!(*splits.entry(scene).or_insert(row.split), row.split);
        if row.split == Split::Test {
            continue;
        }
        let stratum = (row.distance_m.unwrap() - 10.0) / 5.0;
        strata.entry(scene).or_default()[(stratum as usize).min(9)] += 1;
        sectors[((row.azimuth_deg.unwrap() + 180.0) / 60.0) as usize % 6] += 1;
        high += u32::from(row.elevation_deg.unwrap() > 45.0);
    }
    assert!(
        strata.values().all(|counts| *counts == [1; 10]),
        "{strata:?}"
    );
    // 10 frames each, in turns of which only a half is flown in every scene.
    assert!(
        sectors.iter().all(|&n| (3..=20).contains(&n)),
        "{sectors:?}"
    );
    assert!((10..=45).contains(&high), "{high}");
}
