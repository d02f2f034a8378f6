//! Files as exporters write them, and as nobody should.

use std::fs;
use std::path::Path;

use base64::Engine as _;
use glam::Vec3A;
use image::{Rgba, RgbaImage};
use serde_json::json;

use super::fixture::{Boxes, glb};
use super::*;

const CAR: [f32; 3] = [4.4, 1.8, 1.5];

fn library(folder: &Path) -> AssetLibrary {
    AssetLibrary::read(folder).unwrap()
}

fn message(folder: &Path) -> String {
    AssetLibrary::read(folder).unwrap_err().to_string()
}

/// A folder with one car, and what `assets.toml` says.
fn folder_of(car: &Boxes, manifest: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    car.write(&folder.path().join("vehicles/van 1.glb"));
    fs::write(folder.path().join("assets.toml"), manifest).unwrap();
    folder
}

fn assert_size(model: &Model, wanted: [f32; 3]) {
    for (size, wanted) in model.size_m.iter().zip(wanted) {
        assert!((size - wanted).abs() < 1e-4, "{:?}", model.size_m);
    }
    let corners = || model.triangles.iter().flat_map(|t| t.vertices);
    let low = corners().fold(Vec3A::INFINITY, Vec3A::min);
    let high = corners().fold(Vec3A::NEG_INFINITY, Vec3A::max);
    let half = Vec3A::new(0.5 * wanted[0], 0.5 * wanted[1], 0.0);
    assert!((low + half).length() < 1e-4, "{low}");
    assert!(
        (high - half - Vec3A::Z * wanted[2]).length() < 1e-4,
        "{high}"
    );
}

/// How wide a model is near its front and its rear.
fn ends(model: &Model) -> [f32; 2] {
    [1.0, -1.0].map(|end| {
        let corners = model.triangles.iter().flat_map(|t| t.vertices);
        let near = corners.filter(|v| v.x * end > 0.49 * model.size_m[0]);
        near.map(|v| 2.0 * v.y.abs()).fold(0.0, f32::max)
    })
}

#[test]
fn a_model_stands_on_the_ground_with_its_front_ahead_whatever_its_nodes_do() {
    // Centimetres under a node that shrinks them, lifted and shifted.
    let centimetres = Boxes::car(CAR).scaled(100.0).under(json!({
        "scale": [0.01, 0.01, 0.01], "translation": [5.0, 3.0, -2.0],
    }));
    let folder = folder_of(&centimetres, "");
    let library = library(folder.path());
    let vehicle = &library.vehicles()[0];
    assert_eq!((vehicle.name.as_str(), vehicle.weight), ("van 1", 1));
    assert_size(&vehicle.model, CAR);
    let [front, rear] = ends(&vehicle.model);
    assert!(
        (front - 0.9).abs() < 1e-4 && (rear - 1.8).abs() < 1e-4,
        "{front} {rear}"
    );
}

#[test]
fn axes_and_sizes_in_the_manifest_turn_and_scale() {
    // A quarter turn about the vertical puts the front where the file's x points.
    let turned = Boxes::car([4.4, 1.2, 1.5])
        .under(json!({"rotation": [0.0, 0.5_f32.sqrt(), 0.0, 0.5_f32.sqrt()]}));
    let folder = folder_of(
        &turned,
        "[vehicles.\"van 1\"]\nforward = \"+x\"\nname = \"bus\"\nlength_m = 8.8\n",
    );
    let library = library(folder.path());
    let bus = &library.vehicles()[0];
    assert_eq!(bus.name, "bus");
    assert_size(&bus.model, [8.8, 2.4, 3.0]);
}

#[test]
fn the_older_specular_materials_have_their_colour_and_other_extensions_are_named() {
    let picture = RgbaImage::from_pixel(8, 8, Rgba([0, 0, 255, 255]));
    for (old, color, mirror) in [
        (
            json!({"diffuseFactor": [0.1, 0.7, 0.2, 1.0]}),
            [0.1, 0.7, 0.2],
            0.04,
        ),
        (
            json!({"diffuseFactor": [0.1, 0.7, 0.2, 1.0], "specularFactor": [0.2, 0.2, 0.2],
                   "glossinessFactor": 0.3}),
            [0.1, 0.7, 0.2],
            0.04,
        ),
        (
            json!({"diffuseTexture": {"index": 0}}),
            [0.0, 0.0, 0.95],
            0.04,
        ),
        // Gold.
        (
            json!({"diffuseFactor": [0.0, 0.0, 0.0, 1.0], "specularFactor": [0.9, 0.7, 0.3]}),
            [0.135, 0.105, 0.045],
            0.6,
        ),
    ] {
        let material = json!({"extensions": {"KHR_materials_pbrSpecularGlossiness": old}});
        let folder = folder_of(&Boxes::car(CAR).of(material).with_picture(&picture), "");
        let library = library(folder.path());
        let coat = library.model(0).coat(0, [0.3, 0.3], 0.001);
        for (found, expected) in coat.albedo.to_array().iter().zip(color) {
            assert!((found - expected).abs() < 1e-3, "{old}: {coat:?}");
        }
        assert!((coat.mirror - mirror).abs() < 0.05, "{old}: {coat:?}");
    }
    for (name, remedy) in [
        ("KHR_mesh_quantization", "without compression"),
        ("EXT_texture_webp", "PNG or JPEG"),
        ("ADOBE_new_thing", "plain glTF 2.0"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let (mut json, bin) = Boxes::car(CAR).parts();
        json["extensionsRequired"] = json!(["KHR_materials_unlit", name]);
        fs::create_dir(folder.path().join("vehicles")).unwrap();
        fs::write(folder.path().join("vehicles/a.glb"), glb(&json, &bin)).unwrap();
        let message = message(folder.path());
        assert!(
            message.contains(name) && message.contains(remedy),
            "{message}"
        );
        assert!(!message.contains("KHR_materials_unlit"), "{message}");
    }
}

#[test]
fn pictures_factors_and_holes_come_out_where_the_file_puts_them() {
    let picture = RgbaImage::from_fn(64, 64, |x, _| {
        if x < 32 {
            Rgba([255, 0, 0, 255])
        } else {
            Rgba([0, 0, 255, 0])
        }
    });
    let material = json!({
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": 0}, "baseColorFactor": [0.5, 1.0, 0.5, 1.0],
            "metallicFactor": 0.0,
        },
        "alphaMode": "MASK", "emissiveFactor": [0.0, 0.25, 0.0],
    });
    let folder = folder_of(&Boxes::car(CAR).of(material).with_picture(&picture), "");
    let library = library(folder.path());
    let model = library.model(0);
    assert!(model.has_holes(0));
    for part in 0..model.triangles.len() as u32 {
        let (mut red, mut blue) = (0, 0);
        for i in 1..20_u8 {
            for k in 1..20 - i {
                let weights = [f32::from(i) / 20.0, f32::from(k) / 20.0];
                let coat = model.coat(part, weights, 0.001);
                assert_eq!(
                    (coat.glow.to_array(), coat.mirror),
                    ([0.0, 0.25, 0.0], 0.04)
                );
                let [r, _, b] = coat.albedo.to_array();
                if r > 0.49 {
                    red += 1;
                    assert!(b < 0.01 && model.is_solid(part, weights));
                } else if b > 0.49 {
                    blue += 1;
                    assert!(!model.is_solid(part, weights));
                }
            }
        }
        assert!(red > 30 && blue > 30, "{red} {blue}");
    }
}

#[test]
fn the_digest_follows_every_byte_and_setting_and_nothing_else() {
    let car = Boxes::car(CAR);
    let digest =
        |car: &Boxes, manifest: &str| library(folder_of(car, manifest).path()).digest().to_owned();
    let plain = digest(&car, "");
    assert_eq!(plain.len(), 64);
    assert_eq!(plain, digest(&car, "# nothing\n"));
    assert_ne!(plain, digest(&Boxes::car([4.5, 1.8, 1.5]), ""));
    assert_ne!(plain, digest(&car, "[vehicles.\"van 1\"]\nweight = 2\n"));
}

#[test]
fn external_buffers_are_found_beside_the_file_and_nowhere_else() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("vehicles");
    fs::create_dir_all(place.join("parts")).unwrap();
    let (mut json, bin) = Boxes::car(CAR).parts();
    let mut write = |uri: &str| {
        json["buffers"][0]["uri"] = json!(uri);
        fs::write(place.join("car.gltf"), json.to_string()).unwrap();
    };
    fs::write(place.join("parts/my car.bin"), &bin).unwrap();
    write("parts/my%20car.bin");
    let by_file = library(folder.path());
    assert_size(&by_file.vehicles()[0].model, CAR);
    let text = base64::engine::general_purpose::STANDARD.encode(&bin);
    write(&format!("data:application/octet-stream;base64,{text}"));
    assert_size(&library(folder.path()).vehicles()[0].model, CAR);
    fs::write(folder.path().join("secret.bin"), &bin).unwrap();
    for uri in [
        "../secret.bin",
        "parts/../../secret.bin",
        "%2e%2e/secret.bin",
        "/etc/passwd",
        "file:///etc/passwd",
        "http://a.b/c",
        "..\\secret.bin",
        "",
    ] {
        write(uri);
        let message = message(folder.path());
        assert!(message.contains("not in its folder"), "{uri}: {message}");
    }
    for (uri, words) in [
        ("missing.bin", "missing.bin, which is missing"),
        ("data:;base64,%%", "base64"),
        ("parts", "is no file"),
    ] {
        write(uri);
        let message = message(folder.path());
        assert!(message.contains(words), "{uri}: {message}");
    }
}

#[test]
fn no_cut_and_no_flipped_byte_of_a_file_is_more_than_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("vehicles/car.glb");
    let picture = RgbaImage::from_pixel(2, 2, Rgba([9, 9, 9, 255]));
    let material = json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}});
    Boxes::car(CAR)
        .of(material)
        .with_picture(&picture)
        .write(&path);
    let whole = fs::read(&path).unwrap();
    for length in (0..whole.len()).step_by(7) {
        fs::write(&path, &whole[..length]).unwrap();
        assert!(AssetLibrary::read(folder.path()).is_err(), "{length}");
    }
    for place in (0..whole.len()).step_by(5) {
        for value in [0, b'9', 0xff] {
            let mut bytes = whole.clone();
            bytes[place] = value;
            fs::write(&path, &bytes).unwrap();
            // Most are errors and some are other cars; none may end the program.
            AssetLibrary::read(folder.path()).ok();
        }
    }
}

#[test]
fn files_that_cannot_be_used_are_refused_with_a_remedy() {
    type Change = fn(&mut serde_json::Value, &mut Vec<u8>);
    let cases: [(&str, Change); 14] = [
        ("no triangles", |json, _| {
            json["meshes"][0]["primitives"] = json!([{"attributes": {"POSITION": 0}, "mode": 0}]);
        }),
        ("no triangles", |json, _| {
            json["scenes"][0]["nodes"] = json!([]);
        }),
        ("has no scene", |json, _| {
            json.as_object_mut().unwrap().remove("scenes");
            json.as_object_mut().unwrap().remove("scene");
        }),
        ("not finite", |_, bin| {
            bin[..4].copy_from_slice(&f32::NAN.to_le_bytes());
        }),
        ("has no size", |json, _| {
            json["nodes"][0]["scale"] = json!([1e38, 1e38, 1e38]);
        }),
        ("beyond their buffer", |json, _| {
            json["accessors"][0]["count"] = json!(4_000_000_000_u32);
        }),
        ("beyond their buffer", |json, _| {
            json["accessors"][0]["byteOffset"] = json!(u64::MAX);
        }),
        ("no vectors of 3", |json, _| {
            json["accessors"][0]["type"] = json!("VEC2");
        }),
        ("index names a corner", |_, bin| {
            let last = bin.len() - 2;
            bin[last..].fill(0xff);
        }),
        ("without end", |json, _| {
            json["nodes"][0]["children"] = json!([0, 0]);
        }),
        ("KHR_draco_mesh_compression", |json, _| {
            json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
        }),
        ("more than 100000", |json, _| {
            let primitive = json["meshes"][0]["primitives"][0].clone();
            json["meshes"][0]["primitives"] = json!(vec![primitive; 8400]);
        }),
        ("no vehicle's size: 440.00 m", |json, _| {
            json["nodes"][0]["scale"] = json!([100.0, 100.0, 100.0]);
        }),
        ("wider than long", |json, _| {
            json["nodes"][0]["scale"] = json!([2.0, 1.0, 0.5]);
        }),
    ];
    for (words, change) in cases {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("vehicles")).unwrap();
        let (mut json, mut bin) = Boxes::car(CAR).parts();
        change(&mut json, &mut bin);
        fs::write(folder.path().join("vehicles/a.glb"), glb(&json, &bin)).unwrap();
        let message = message(folder.path());
        assert!(
            message.contains(words) && message.contains("a.glb"),
            "{words}: {message}"
        );
    }
}

#[test]
fn folders_and_manifests_that_make_no_sense_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    assert!(message(&root.join("nowhere")).contains("is no folder"));
    assert!(message(root).contains("no vehicles and no props"));
    let car = Boxes::car(CAR);
    for (manifest, words) in [
        ("[vehicles.lorry]\n", "no such file"),
        ("[vehicles.\"van 1\"]\ncolour = 3\n", "colour"),
        ("[vehicles.\"van 1\"]\nforward = \"north\"\n", "forward"),
        ("[vehicles.\"van 1\"]\nforward = \"+y\"\n", "right angles"),
        (
            "[vehicles.\"van 1\"]\nscale = 0.0\n",
            "scale = 0 is out of range",
        ),
        ("[vehicles.\"van 1\"]\nscale = nan\n", "out of range"),
        (
            "[vehicles.\"van 1\"]\nscale = 1.0\nlength_m = 4.0\n",
            "size twice",
        ),
        ("[vehicles.\"van 1\"]\nweight = 0\n", "weight = 0"),
        ("[vehicles.\"van 1\"]\nname = \"taxi\"\n", "built-in"),
        ("[vehicles.\"van 1\"]\nname = \"a,b\"\n", "letters"),
        ("[vehicles", "assets.toml"),
    ] {
        let message = message(folder_of(&car, manifest).path());
        assert!(message.contains(words), "{manifest}: {message}");
    }
    let folder = folder_of(&car, "");
    car.write(&folder.path().join("props/van 1.glb"));
    assert!(message(folder.path()).contains("another file has the name"));
    fs::rename(
        folder.path().join("props/van 1.glb"),
        folder.path().join("props/b.glb"),
    )
    .unwrap();
    assert!(message(folder.path()).contains("for a pavement"));
}

#[test]
fn weights_say_how_often_each_is_drawn_and_keep_equals_apart() {
    let folder = folder_of(&Boxes::car(CAR), "[vehicles.b]\nweight = 3\n");
    Boxes::car([5.0, 2.0, 1.8]).write(&folder.path().join("vehicles/b.glb"));
    let library = library(folder.path());
    let names: Vec<&str> = library.vehicle_names().collect();
    assert_eq!(names, ["b", "van 1"]);
    assert_eq!(library.weighted(0..2), [0, 1, 0, 0]);
}
