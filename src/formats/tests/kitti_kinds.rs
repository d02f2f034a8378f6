//! KITTI's folders as people really have them.

use std::fmt::Write as _;

use super::kinds::default_import;
use super::*;
use crate::geometry::PixelBox;

const CAR: &str = "Car 0.00 0 -1.57 130.00 50.00 190.00 80.00 1.50 1.70 4.20 0.50 1.60 15.00 -1.57";

const CALIBRATION: &str = "P2: 200 0 160 12 0 200 60 0 0 0 1 0\nP3: 200 0 160 -96 0 200 60 0 0 0 1 0\n\
                           R_rect 1 0 0 0 1 0 0 0 1\n";

#[test]
fn tracks_of_kitti_are_pairs_with_their_sequences_kept_apart() {
    let place = Place::new();
    for sequence in ["0000", "0007"] {
        let mut labels = String::new();
        for frame in 0..3 {
            for (camera, folder) in [(1, "image_02"), (2, "image_03")] {
                let name = format!("kitti/training/{folder}/{sequence}/{frame:06}.png");
                let seed = camera * 10 + frame + u32::from(sequence == "0007") * 5;
                place.image(&name, [320, 120], seed);
            }
            write!(
                labels,
                "{frame} 4 {CAR}\n{frame} -1 DontCare -1 -1 -10 10 40 30 55 -1 -1 -1 -1000 -1000 \
                 -1000 -10\n{frame} 2 Pedestrian 0 0 0.2 200 40 210 80 1.8 0.5 0.5 3 1.6 12 0.1\n"
            )
            .unwrap();
        }
        place.write(&format!("kitti/training/calib/{sequence}.txt"), CALIBRATION);
        place.write(&format!("kitti/training/label_02/{sequence}.txt"), &labels);
    }
    let mut target = place.target("out");
    target.splits.val_fraction = 0.5;
    let options = ImportOptions::default();
    let report = import("kitti", &place.path("kitti"), &options, &target, &Silent).unwrap();
    assert_eq!((report.counts.train, report.counts.val), (3, 3));
    assert_eq!(
        (report.vehicles, report.ignored, report.with_distance),
        (12, 6, 6)
    );
    let dataset = place.open("out");
    assert!((dataset.rig().baseline_m - 0.54).abs() < 1e-9);
    for (index, frame) in dataset.frames.iter().enumerate() {
        assert_eq!(frame.row.scene, Some(1 + index as u32 / 3));
        let [vehicle] = &frame.vehicles(BoxKind::Tight)[..] else {
            panic!("one car counts");
        };
        // The rig's middle is 21 cm right of the reference; the centre is 75 cm above the bottom.
        let expected_m = ((0.5 - 0.21_f64).powi(2) + 0.85_f64.powi(2) + 225.0).sqrt();
        assert!((vehicle.distance_m - expected_m).abs() < 1e-4);
        assert_eq!(vehicle.id, 4);
        assert_eq!(
            vehicle.left.box_pixel,
            PixelBox::new(130.5, 50.5, 190.5, 80.5)
        );
    }
    let splits = |scene| -> Vec<Split> {
        let of_scene = dataset.frames.iter().filter(|f| f.row.scene == Some(scene));
        of_scene.map(|frame| frame.row.split).collect()
    };
    for scene in [1, 2] {
        let splits = splits(scene);
        assert!(splits.iter().all(|split| *split == splits[0]), "{splits:?}");
    }
    assert_sound(&place.path("out"));
    // The left images alone, of which the sequences stay apart as well.
    fs::remove_dir_all(place.path("kitti/training/image_03")).unwrap();
    target.out = place.path("left");
    let report = import("kitti", &place.path("kitti"), &options, &target, &Silent).unwrap();
    assert_eq!((report.counts.train, report.counts.val), (3, 3));
    assert_eq!((report.vehicles, report.with_distance), (12, 0));
    let left = place.open("left");
    assert!(!left.info.stereo);
    let scenes: Vec<_> = left.frames.iter().map(|frame| frame.row.scene).collect();
    assert_eq!(scenes, [1, 1, 1, 2, 2, 2].map(Some));
}

#[test]
fn kitti_with_boxes_in_the_image_alone_becomes_single_images() {
    let unknown = "car 0.00 0 0.00 130 50 190 80 0.00 0.00 0.00 0.00 0.00 0.00 0.00";
    for (line, folders) in [
        (unknown, &["image_2"][..]),
        ("Car 0 0 0 130 50 190 80", &["image_2"]),
        (CAR, &["image_2"]),
        (unknown, &["image_2", "image_3"]),
    ] {
        let place = Place::new();
        for id in 0..3 {
            for (number, folder) in folders.iter().enumerate() {
                let name = format!("kitti/training/{folder}/{id:06}.png");
                place.image(&name, [320, 120], id * 2 + number as u32);
            }
            if folders.len() == 2 {
                place.write(&format!("kitti/training/calib/{id:06}.txt"), CALIBRATION);
            }
            let lines =
                format!("{line}\nDontCare -1 -1 -10 1 1 9 9 -1 -1 -1 -1000 -1000 -1000 -10\n");
            place.write(&format!("kitti/training/label_2/{id:06}.txt"), &lines);
        }
        let report = default_import("kitti", &place, "kitti").unwrap();
        assert_eq!(
            (report.frames(), report.vehicles, report.ignored),
            (3, 6, 3),
            "{line}"
        );
        assert!(reasons(&report).contains("single images, for a detector"));
        let dataset = place.open("out");
        assert!(!dataset.info.stereo);
        let labels = &dataset.frames[0].left.labels;
        assert_eq!(labels[0].box_pixel, PixelBox::new(130.5, 50.5, 190.5, 80.5));
        assert!(!labels[0].ignored && labels[1].ignored);
        assert_eq!(labels[0].distance_m, None);
    }
}
