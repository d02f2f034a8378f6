//! Datasets with the user's own vehicles and props.

use std::fs;

use serde_json::json;
use tempfile::TempDir;

use super::tests::{StopAfter, content, tiny};
use super::*;
use crate::dataset::{BoxKind, StereoDataset, read_objects_csv};
use crate::geometry::PixelBox;
use crate::progress::Silent;
use crate::render::BodyName;
use crate::world::assets::fixture::Boxes;

/// A folder with a lorry, a car with a hole through it and a kiosk.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    Boxes::car([9.0, 2.4, 3.2]).write(&root.join("vehicles/lorry.glb"));
    let net = image::RgbaImage::from_fn(16, 16, |x, y| {
        let alpha = if x % 4 == 0 || y % 4 == 0 { 255 } else { 0 };
        image::Rgba([250, 250, 20, alpha])
    });
    Boxes::car([4.2, 1.8, 1.6])
        .of(json!({
            "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0.0},
            "alphaMode": "MASK",
        }))
        .with_picture(&net)
        .write(&root.join("vehicles/cage.glb"));
    Boxes::car([1.2, 3.0, 2.6]).write(&root.join("props/kiosk.glb"));
    folder
}

fn with_assets(folder: &Path) -> GenerateConfig {
    let mut config = GenerateConfig {
        assets: Some(Assets::of(folder.to_owned())),
        outputs: Outputs {
            instances: true,
            ..Outputs::default()
        },
        ..tiny()
    };
    config.appearance.bodies = ["lorry", "cage"]
        .map(|name| BodyName::Own(name.to_owned()))
        .to_vec();
    config
}

#[test]
fn own_vehicles_are_labelled_like_any_other_and_the_same_on_every_run() {
    let assets = folder();
    let folder = tempfile::tempdir().unwrap();
    let [one, two] = ["one", "two"].map(|name| {
        let out = folder.path().join(name);
        generate(&with_assets(assets.path()), &out, &Silent).unwrap();
        out
    });
    assert!(content(&one) == content(&two));
    let objects = read_objects_csv(one.join("objects.csv")).unwrap();
    for name in ["lorry", "cage"] {
        assert!(objects.iter().any(|object| object.style == name));
    }
    for object in &objects {
        let length = if object.style == "lorry" { 9.0 } else { 4.2 };
        assert!((object.length_m - length).abs() < 1e-4, "{object:?}");
        assert!(["lorry", "cage"].contains(&object.style.as_str()));
    }
    let dataset = StereoDataset::open(&one).unwrap();
    assert!(dataset.problems.is_empty(), "{:?}", dataset.problems);
    let mut checked = 0;
    for frame in &dataset.frames {
        for (side, image) in frame.images() {
            let path = one.join(format!("instances/{side}_{:05}.png", frame.row.stamp));
            let mask = image::open(path).unwrap().into_luma8();
            for label in image.labels_of(BoxKind::Tight) {
                // Nothing of the vehicle is outside its box.
                let b = label.box_pixel;
                let outward = PixelBox::new(
                    b.x_min.floor(),
                    b.y_min.floor(),
                    b.x_max.ceil(),
                    b.y_max.ceil(),
                );
                for (x, y, pixel) in mask.enumerate_pixels() {
                    if u32::from(pixel.0[0]) == label.id + 1 {
                        let [x, y] = [x, y].map(|v| f64::from(v) + 0.5);
                        assert!(x > outward.x_min && x < outward.x_max);
                        assert!(y > outward.y_min && y < outward.y_max);
                        checked += 1;
                    }
                }
            }
        }
    }
    assert!(checked > 500, "{checked}");
}

#[test]
fn own_vehicles_join_the_built_in_ones_and_props_change_nothing_of_the_city() {
    let assets = folder();
    let config = GenerateConfig {
        assets: Some(Assets::of(assets.path().to_owned())),
        ..tiny()
    };
    let (_, wardrobe) = config.dressed().unwrap();
    let mut names = std::collections::BTreeSet::new();
    let mut props = 0;
    for number in 0..6 {
        let scene = Scene::draw_dressed(4, number, 40.0, 8, 30.0, &wardrobe);
        names.extend(scene.vehicles.iter().map(|v| v.body_name().to_owned()));
        let plain = Scene::draw(4, number, 40.0);
        let [own, plain] = [&scene, &plain].map(|scene| &scene.city.mesh.triangles);
        assert!(own.iter().zip(plain).all(|(a, b)| a.vertices == b.vertices));
        props += (own.len() - plain.len()) / 36;
        for corner in own[plain.len()..].iter().flat_map(|t| t.vertices) {
            let layout = &scene.city.layout;
            let on_road = |axis: usize| {
                let near = layout.nearest(axis, corner[axis]);
                near.offset.abs() < near.half_width
            };
            assert!(!on_road(0) && !on_road(1) && corner.z >= 0.0, "{corner}");
        }
    }
    assert!(
        names.contains("lorry") && names.contains("cage"),
        "{names:?}"
    );
    assert!(names.contains("sedan") && names.len() > 10, "{names:?}");
    assert!(props > 30, "{props}");
}

#[test]
fn a_dataset_knows_its_assets_wherever_they_are_and_refuses_others() {
    let assets = folder();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    let config = with_assets(assets.path());
    generate(&config, &out, &StopAfter::new(2)).unwrap_err();
    // The same files elsewhere.
    let moved = folder.path().join("moved");
    for name in ["vehicles/lorry.glb", "vehicles/cage.glb", "props/kiosk.glb"] {
        fs::create_dir_all(moved.join(name).parent().unwrap()).unwrap();
        fs::copy(assets.path().join(name), moved.join(name)).unwrap();
    }
    let changed = moved.join("vehicles/lorry.glb");
    let original = fs::read(&changed).unwrap();
    Boxes::car([8.0, 2.4, 3.2]).write(&changed);
    let message = generate(&with_assets(&moved), &out, &Silent)
        .unwrap_err()
        .to_string();
    assert!(message.contains("other assets"), "{message}");
    fs::write(&changed, &original).unwrap();
    generate(&with_assets(&moved), &out, &Silent).unwrap();
    let whole = folder.path().join("whole");
    generate(&config, &whole, &Silent).unwrap();
    assert!(content(&out) == content(&whole));

    // Its settings alone make it again, from the folder that they name.
    let text = fs::read_to_string(out.join("dataset.toml")).unwrap();
    let table: toml::Table = text.parse().unwrap();
    let settings = toml::to_string(&table["made_by"]["settings"]).unwrap();
    assert!(settings.contains("digest"), "{settings}");
    let path = folder.path().join("again.toml");
    fs::write(&path, settings).unwrap();
    let again = GenerateConfig::from_toml_file(&path).unwrap();
    let copy = folder.path().join("copy");
    generate(&again, &copy, &Silent).unwrap();
    assert!(content(&copy) == content(&whole));

    let report = add_frames(3, &out, Some(&moved), &Silent).unwrap();
    assert_eq!(report.frames, 9);
    Boxes::car([8.0, 2.4, 3.2]).write(&changed);
    for message in [
        add_frames(3, &out, Some(&moved), &Silent)
            .unwrap_err()
            .to_string(),
        generate(
            &GenerateConfig {
                frames: 20,
                ..with_assets(&moved)
            },
            &out,
            &Silent,
        )
        .unwrap_err()
        .to_string(),
    ] {
        assert!(message.contains("assets"), "{message}");
    }
    let plain = folder.path().join("plain");
    generate(&tiny(), &plain, &Silent).unwrap();
    let message = add_frames(3, &plain, Some(&moved), &Silent)
        .unwrap_err()
        .to_string();
    assert!(message.contains("without assets"), "{message}");
}

#[test]
fn a_body_that_nobody_has_is_refused_with_those_that_there_are() {
    let assets = folder();
    let mut config = with_assets(assets.path());
    config
        .appearance
        .bodies
        .push(BodyName::Own("tank".to_owned()));
    let out = tempfile::tempdir().unwrap();
    let message = generate(&config, out.path(), &Silent)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("tank") && message.contains("cage, lorry"),
        "{message}"
    );
    config.assets = None;
    let message = config.validate().unwrap_err().to_string();
    assert!(message.contains("--assets"), "{message}");
}
