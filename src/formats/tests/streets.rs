//! Foreign datasets as others write them.

use std::fmt::Write as _;

use super::*;
use crate::geometry::PixelBox;

const SIZE: [u32; 2] = [620, 188];
const FOCAL: f64 = 360.0;
const BASELINE: f64 = 0.54;

/// A calibration as KITTI's: the left colour camera stands 6 cm beside the reference.
fn calibration(focal: f64) -> String {
    let p = |name: &str, x_m: f64| {
        format!(
            "{name}: {focal} 0 309.5 {} 0 {focal} 93.5 0 0 0 1 0\n",
            focal * x_m
        )
    };
    p("P0", 0.0) + &p("P1", -0.5) + &p("P2", 0.06) + &p("P3", 0.06 - BASELINE)
}

/// A car that drives away, its place given as KITTI does, and its box in the left image.
fn car(x: f64, z: f64) -> String {
    let (height, width, length, bottom) = (1.5, 1.6, 4.0, 1.7);
    let near = z - length / 2.0;
    let u = |x: f64| 309.5 + FOCAL * (x + 0.06) / near;
    let v = |y: f64| 93.5 + FOCAL * y / near;
    format!(
        "Car 0 0 0 {} {} {} {} {height} {width} {length} {x} {bottom} {z} -1.5707963",
        u(x - width / 2.0).max(0.0),
        v(bottom - height),
        u(x + width / 2.0),
        v(bottom)
    )
}

/// A KITTI folder of four frames.
fn kitti_folder(place: &Place) -> (PathBuf, ImportOptions) {
    for id in 0..4_u32 {
        let name = format!("{id:06}");
        let z = 12.0 + 3.0 * f64::from(id);
        for (folder, ending) in [("image_2", "png"), ("image_3", "jpg")] {
            let seed = id * 2 + u32::from(folder == "image_3");
            place.image(
                &format!("kitti/training/{folder}/{name}.{ending}"),
                SIZE,
                seed,
            );
        }
        place.write(
            &format!("kitti/training/calib/{name}.txt"),
            &calibration(FOCAL),
        );
        let lines = [
            car(-2.0, z),
            "Tram 0 0 0 10 10 90 60 3 2.4 20 9 1.6 50 0".to_owned(),
            car(2.0, z + 8.0).replace("Car 0 0", "Van 0.7 1"),
            "DontCare -1 -1 -10 400 80 440 99 -1 -1 -1 -1000 -1000 -1000 -10".to_owned(),
        ];
        place.write(
            &format!("kitti/training/label_2/{name}.txt"),
            &lines.join("\n"),
        );
    }
    (place.path("kitti"), ImportOptions::default())
}

#[test]
fn kitti_becomes_a_sound_dataset_whose_numbers_are_those_of_the_geometry() {
    let place = Place::new();
    let options = kitti_folder(&place);
    let report = import(
        "kitti",
        &options.0,
        &options.1,
        &place.target("out"),
        &Silent,
    )
    .unwrap();
    assert_eq!(report.frames(), 4);
    // The truncated van and the region are ignored, the tram is no vehicle of ours.
    assert_eq!(
        (report.vehicles, report.ignored, report.with_distance),
        (12, 8, 8)
    );
    let dataset = place.open("out");
    let rig = dataset.rig();
    assert!((rig.baseline_m - BASELINE).abs() < 1e-9);
    assert_eq!((rig.left.center_x_px, rig.left.center_y_px), (310.0, 94.0));
    assert_eq!(dataset.info.classes, ["car"]);
    for (frame, z) in dataset.frames.iter().zip([12.0, 15.0, 18.0, 21.0]) {
        let [vehicle] = &frame.vehicles(BoxKind::Tight)[..] else {
            panic!("one car counts");
        };
        assert_eq!(vehicle.id, 0);
        // The rig's middle is 21 cm right of the reference; the centre is 75 cm above the bottom.
        let expected_m = ((-2.0 - 0.21_f64).powi(2) + 0.95_f64.powi(2) + z * z).sqrt();
        assert!(
            (vehicle.distance_m - expected_m).abs() < 1e-4,
            "{expected_m}"
        );
        assert_eq!(frame.row.distance_m, Some(vehicle.distance_m));
        assert_eq!(frame.row.view, Some(crate::dataset::View::Rear));
        let disparity = vehicle.left.center_pixel[0] - vehicle.right.center_pixel[0];
        assert!((disparity - FOCAL * BASELINE / z).abs() < 1e-3);
        // The right box is the left one moved by the disparity of the near face.
        let near = FOCAL * BASELINE / (z - 2.0);
        let moved = vehicle.left.box_pixel.x_min - vehicle.right.box_pixel.x_min;
        assert!((moved - near).abs() < 1e-2, "{moved} {near}");
        // Images are copied as they are.
        let ending =
            |image: &crate::dataset::FrameImage| image.path.extension().unwrap().to_owned();
        assert_eq!(ending(&frame.left), "png");
        assert_eq!(ending(frame.right.as_ref().unwrap()), "jpg");
    }
    assert_sound(&place.path("out"));
}

#[test]
fn kitti_goes_out_and_comes_back_with_sizes_and_both_kinds_of_box() {
    let place = Place::new();
    let options = kitti_folder(&place);
    import(
        "kitti",
        &options.0,
        &options.1,
        &place.target("first"),
        &Silent,
    )
    .unwrap();
    let first = place.open("first");
    kitti::export(&first, BoxKind::Tight, &place.path("again"), &Silent).unwrap();
    let mut target = place.target("second");
    target.classes = Some("car".parse().unwrap());
    let options = (place.path("again"), ImportOptions::default());
    import("kitti", &options.0, &options.1, &target, &Silent).unwrap();
    let second = place.open("second");
    assert_eq!(first.info.label_kinds, second.info.label_kinds);
    let objects =
        |d: &StereoDataset| crate::dataset::read_objects_csv(d.folder.join("objects.csv")).unwrap();
    for (a, b) in objects(&first).iter().zip(objects(&second)) {
        assert_eq!(
            (a.stamp, a.length_m, a.width_m),
            (b.stamp, b.length_m, b.width_m)
        );
        assert!((a.yaw_deg - b.yaw_deg).abs() < 2e-4 && (a.z_m - b.z_m).abs() < 2e-3);
    }
    for (a, b) in first.frames.iter().zip(&second.frames) {
        for kind in first.info.label_kinds.iter().copied() {
            let pairs = [a.vehicles(kind), b.vehicles(kind)];
            assert_eq!(pairs[0].len(), 1);
            for (a, b) in pairs[0].iter().zip(&pairs[1]) {
                assert!(a.left.box_pixel.iou(&b.left.box_pixel) > 0.999);
                assert!(a.right.box_pixel.iou(&b.right.box_pixel) > 0.999);
                assert!((a.distance_m - b.distance_m).abs() < 1e-3);
            }
        }
    }
}

#[test]
fn boxes_of_label_3_are_taken_where_their_disparity_is_possible() {
    let place = Place::new();
    let options = kitti_folder(&place);
    let own = car(-2.0, 12.0);
    let mut words: Vec<String> = own.split(' ').map(str::to_owned).collect();
    let left: Vec<f64> = [4, 6]
        .iter()
        .map(|&i: &usize| words[i].parse().unwrap())
        .collect();
    let mut with_shift = |name: &str, shift: f64| {
        for (i, edge) in [4, 6].into_iter().zip(&left) {
            words[i] = (edge - shift).to_string();
        }
        place.write("kitti/training/label_3/000000.txt", &words.join(" "));
        import(
            "kitti",
            &options.0,
            &options.1,
            &place.target(name),
            &Silent,
        )
        .unwrap();
        let frame = place.open(name).frames[0].clone();
        let vehicle = &frame.vehicles(BoxKind::Tight)[0];
        vehicle.left.box_pixel.x_min - vehicle.right.box_pixel.x_min
    };
    // The disparity of the centre is 16.2 px, that of the near face 19.4 px.
    assert!((with_shift("given", 18.0) - 18.0).abs() < 1e-3);
    assert!((with_shift("doubled", 36.0) - 19.44).abs() < 1e-3);
}

#[test]
fn frames_of_another_calibration_are_named_and_make_a_dataset_of_their_own() {
    let place = Place::new();
    let mut options = kitti_folder(&place);
    place.write("kitti/training/calib/000002.txt", &calibration(352.0));
    place.image("kitti/training/image_2/000003.png", [612, 185], 9);
    place.image("kitti/training/image_3/000003.jpg", [612, 185], 8);
    let report = import(
        "kitti",
        &options.0,
        &options.1,
        &place.target("first"),
        &Silent,
    )
    .unwrap();
    assert_eq!(report.frames(), 3);
    assert!(reasons(&report).contains("000002: has another rig, focal length 352.00 px"));
    // The smaller images are filled up, and nothing about their pixels changes.
    let dataset = place.open("first");
    let images = dataset.frame(3).unwrap().load(dataset.rig()).unwrap();
    assert_eq!(images[0].dimensions(), (620, 188));
    assert_eq!(images[0].get_pixel(619, 10).0, [0, 0, 0]);
    options.1.rig = 2;
    let report = import(
        "kitti",
        &options.0,
        &options.1,
        &place.target("second"),
        &Silent,
    )
    .unwrap();
    assert_eq!(report.frames(), 1);
    options.1.rig = 3;
    let error = import(
        "kitti",
        &options.0,
        &options.1,
        &place.target("third"),
        &Silent,
    )
    .unwrap_err();
    assert!(error.to_string().contains("from 1 to 2"), "{error}");
}

#[test]
fn drives_of_a_table_are_never_split_and_lists_of_the_source_are_followed() {
    let place = Place::new();
    let options = kitti_folder(&place);
    place.write("drives.csv", "id,raw_drive\n0,a\n1,b\n2,a\n3,b\n");
    let mut target = place.target("drives");
    target.splits.table = Some(place.path("drives.csv"));
    target.splits.val_fraction = 0.5;
    import("kitti", &options.0, &options.1, &target, &Silent).unwrap();
    let dataset = place.open("drives");
    let split = |stamp| dataset.frame(stamp).unwrap().row.split;
    assert_eq!((split(0), split(1)), (split(2), split(3)));
    assert_ne!(split(0), split(1));
    let scenes = |stamp| dataset.frame(stamp).unwrap().row.scene;
    assert_eq!((scenes(0), scenes(1)), (Some(1), Some(2)));
    for (name, ids) in [
        ("train", "000001\n000002\n"),
        ("val", "000000\n"),
        ("test", "000003"),
    ] {
        place.write(&format!("kitti/ImageSets/{name}.txt"), ids);
    }
    // Whether the folder is given or its `training`.
    for (source, name) in [("kitti", "lists"), ("kitti/training", "lists-of-training")] {
        let options = (place.path(source), ImportOptions::default());
        import(
            "kitti",
            &options.0,
            &options.1,
            &place.target(name),
            &Silent,
        )
        .unwrap();
        let dataset = place.open(name);
        let splits: Vec<Split> = dataset.frames.iter().map(|frame| frame.row.split).collect();
        assert_eq!(
            splits,
            [Split::Val, Split::Train, Split::Train, Split::Test]
        );
    }
}

#[test]
fn virtual_kitti_becomes_a_sound_dataset_with_its_scenes() {
    let place = Place::new();
    for (scene, variant) in [(1, "clone"), (1, "sunset"), (2, "clone")] {
        let folder = format!("vkitti/Scene{scene:02}/{variant}");
        let mut boxes = "frame cameraID trackID left right top bottom number_pixels \
                         truncation_ratio occupancy_ratio isMoving\n"
            .to_owned();
        let mut poses = "frame cameraID trackID alpha width height length world_space_X \
                         world_space_Y world_space_Z rotation_world_space_y \
                         rotation_world_space_x rotation_world_space_z camera_space_X \
                         camera_space_Y camera_space_Z rotation_camera_space_y \
                         rotation_camera_space_x rotation_camera_space_z\n"
            .to_owned();
        let mut cameras = "frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]\n".to_owned();
        let mut extrinsics = "frame cameraID r1,1 r1,2 r1,3 t1 r2,1 r2,2 r2,3 t2 r3,1 r3,2 r3,3 \
                              t3 0 0 0 1\n"
            .to_owned();
        for frame in 0..2_u32 {
            for camera in 0..2_u32 {
                let seed = scene * 40 + frame * 2 + camera + if variant == "clone" { 0 } else { 9 };
                let name = format!("{folder}/frames/rgb/Camera_{camera}/rgb_{frame:05}.jpg");
                place.image(&name, SIZE, seed);
                let x = 1.0 - f64::from(camera) * BASELINE;
                let z = 15.0 + f64::from(frame);
                let u = |x: f64| (309.5 + FOCAL * x / (z - 2.0)).round();
                for (track, occupancy) in [(0, 0.9), (3, 0.1)] {
                    writeln!(
                        boxes,
                        "{frame} {camera} {track} {} {} 90 130 500 0 {occupancy} True",
                        u(x - 0.8),
                        u(x + 0.8) - 1.0
                    )
                    .unwrap();
                    writeln!(
                        poses,
                        "{frame} {camera} {track} 0 1.6 1.5 4 0 0 0 0 0 0 {x} 1.7 {z} 1.5707963 0 0"
                    )
                    .unwrap();
                }
                writeln!(cameras, "{frame} {camera} {FOCAL} {FOCAL} 309.5 93.5").unwrap();
                let t1 = 7.0 - f64::from(camera) * BASELINE;
                writeln!(
                    extrinsics,
                    "{frame} {camera} 1 0 0 {t1} 0 1 0 0 0 0 1 0 0 0 0 1"
                )
                .unwrap();
            }
        }
        place.write(&format!("{folder}/bbox.txt"), &boxes);
        place.write(&format!("{folder}/pose.txt"), &poses);
        place.write(&format!("{folder}/intrinsic.txt"), &cameras);
        place.write(&format!("{folder}/extrinsic.txt"), &extrinsics);
        let info = "trackID label model color\n0 Car Ford Red\n3 Van VW Blue\n";
        place.write(&format!("{folder}/info.txt"), info);
    }
    let options = ImportOptions {
        least_visible: 0.25,
        ..ImportOptions::default()
    };
    let source = place.path("vkitti");
    let report = import("vkitti2", &source, &options, &place.target("out"), &Silent).unwrap();
    assert_eq!(
        (report.frames(), report.vehicles, report.ignored),
        (6, 12, 6)
    );
    let dataset = place.open("out");
    assert!((dataset.rig().baseline_m - BASELINE).abs() < 1e-9);
    let rows: Vec<_> = dataset
        .frames
        .iter()
        .map(|f| (f.row.scene, f.row.sun.clone()))
        .collect();
    assert_eq!(rows[0], (Some(1), None));
    assert_eq!(rows[2], (Some(1), Some("sunset".to_owned())));
    assert_eq!(rows[4], (Some(2), None));
    let vehicle = &dataset.frames[1].vehicles(BoxKind::Tight)[0];
    let expected_m = ((1.0 - BASELINE / 2.0_f64).powi(2) + 0.95_f64.powi(2) + 256.0).sqrt();
    assert!((vehicle.distance_m - expected_m).abs() < 1e-4);
    assert_eq!(vehicle.left.visible, Some(0.9));
    // Boxes include their last pixel.
    assert_eq!(vehicle.left.box_pixel.y_max, 131.0);
    assert_sound(&place.path("out"));
    let options = ImportOptions {
        variants: vec!["sunset".to_owned()],
        ..options
    };
    let report = import(
        "vkitti2",
        &source,
        &options,
        &place.target("sunset"),
        &Silent,
    )
    .unwrap();
    assert_eq!(report.frames(), 2);
}

#[test]
fn images_of_many_sizes_share_a_canvas_and_boxes_stay_on_their_pixels() {
    let place = Place::new();
    place.write(
        "yolo/data.yaml",
        "train: ../train/images\nval: val/images\nnc: 2\nnames: ['car', 'a walker']\n",
    );
    for (name, size) in [
        ("train/a", [200, 100]),
        ("train/b", [100, 160]),
        ("val/c", [400, 50]),
    ] {
        let (folder, file) = name.split_once('/').unwrap();
        place.image(&format!("yolo/{folder}/images/{file}.png"), size, size[0]);
        place.write(
            &format!("yolo/{folder}/labels/{file}.txt"),
            "0 0.5 0.5 0.5 0.5\n1 0.1 0.1 0.2 0.1\n",
        );
    }
    let source = place.path("yolo");
    let options = ImportOptions::default();
    import("yolo", &source, &options, &place.target("whole"), &Silent).unwrap();
    let dataset = place.open("whole");
    assert_eq!(
        (dataset.rig().left.width, dataset.rig().left.height),
        (400, 160)
    );
    let first = &dataset.frames[0].left.labels;
    assert_eq!(first[0].box_pixel, PixelBox::new(50.0, 25.0, 150.0, 75.0));
    assert_eq!((first[1].class, first[1].distance_m), (1, None));
    assert_sound(&place.path("whole"));
    let options = ImportOptions {
        canvas: Some([100, 100]),
        ..options
    };
    let mut target = place.target("small");
    target.classes = Some("walker=a walker".parse().unwrap());
    import("yolo", &source, &options, &target, &Silent).unwrap();
    let dataset = place.open("small");
    assert_eq!(dataset.info.classes, ["walker"]);
    let labels = &dataset.frames[0].left.labels;
    assert_eq!(labels.len(), 1);
    assert_eq!(labels[0].box_pixel, PixelBox::new(0.0, 2.5, 20.0, 7.5));
    let image = dataset.frames[0].left.load(&dataset.rig().left).unwrap();
    assert_eq!(image.get_pixel(50, 60).0, [0, 0, 0]);
    assert_sound(&place.path("small"));
}

#[test]
fn crowds_of_coco_are_ignored_and_a_mostly_empty_canvas_is_refused() {
    let place = Place::new();
    place.image("coco/images/a.png", [100, 80], 3);
    let json = r#"{"info": {}, "images": [{"id": 7, "file_name": "a.png", "width": 100,
        "height": 80, "license": 1}], "annotations": [
        {"id": 1, "image_id": 7, "category_id": 3, "bbox": [10, 20, 30.5, 40], "iscrowd": 0,
         "segmentation": [[1, 2, 3]], "area": 99},
        {"id": 2, "image_id": 7, "category_id": 3, "bbox": [0, 0, 100, 30], "iscrowd": 1},
        {"id": 3, "image_id": 7, "category_id": 4, "bbox": [0, 0, 10, 30]}],
        "categories": [{"id": 3, "name": "car"}, {"id": 4, "name": "dog"}]}"#;
    place.write("coco/annotations/instances_val.json", json);
    let mut target = place.target("out");
    target.classes = Some("car".parse().unwrap());
    let (source, options) = (place.path("coco"), ImportOptions::default());
    let report = import("coco", &source, &options, &target, &Silent).unwrap();
    assert_eq!(
        (report.vehicles, report.ignored, report.counts.val),
        (2, 1, 1)
    );
    let labels = &place.open("out").frames[0].left.labels;
    assert_eq!(labels[0].box_pixel, PixelBox::new(10.0, 20.0, 40.5, 60.0));
    assert!(labels[1].ignored && !labels[0].ignored);
    for seed in 0..9 {
        place.image(&format!("heap/images/{seed}.png"), [20, 20], seed);
    }
    place.image("heap/images/huge.png", [900, 900], 3);
    place.write("heap/data.yaml", "train: images\nnames: [car]\n");
    let source = place.path("heap");
    let options = ImportOptions {
        background: true,
        ..options
    };
    let error = import(
        "yolo",
        &source,
        &options,
        &place.target("heap-out"),
        &Silent,
    )
    .unwrap_err();
    assert!(error.to_string().contains("--size"), "{error}");
}
