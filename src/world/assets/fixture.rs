//! Small glTF files for tests, written byte by byte.

use std::fs;
use std::io::Cursor;
use std::path::Path;

use image::RgbaImage;
use serde_json::{Value, json};

/// A mesh of boxes in the file's own axes: y up, z forward.
pub(crate) struct Boxes {
    parts: Vec<([[f32; 3]; 2], usize)>,
    materials: Vec<Value>,
    pictures: Vec<Vec<u8>>,
    node: Value,
}

impl Boxes {
    /// Something as long, wide and high as a vehicle, with a bump in front, of one material.
    pub fn car([length, width, height]: [f32; 3]) -> Self {
        let [x, z] = [0.5 * width, 0.5 * length];
        Self {
            parts: vec![
                ([[-x, 0.3, -z], [x, height, z - 0.2]], 0),
                ([[-x, 0.0, -z + 0.3], [x, 0.3, z - 0.6]], 0),
                ([[-0.5 * x, 0.4, z - 0.2], [0.5 * x, 0.6, z]], 0),
            ],
            materials: vec![json!({"pbrMetallicRoughness": {
                "baseColorFactor": [0.8, 0.1, 0.6, 1.0],
                "metallicFactor": 0.0, "roughnessFactor": 0.9,
            }})],
            pictures: Vec::new(),
            node: json!({}),
        }
    }

    /// In other units.
    pub fn scaled(mut self, factor: f32) -> Self {
        for (corners, _) in &mut self.parts {
            *corners = corners.map(|corner| corner.map(|v| v * factor));
        }
        self
    }

    /// One material for all, as JSON.
    pub fn of(mut self, material: Value) -> Self {
        self.materials = vec![material];
        self
    }

    /// With a picture, the next one in number; its texture has the same number.
    pub fn with_picture(mut self, image: &RgbaImage) -> Self {
        let mut png = Cursor::new(Vec::new());
        image.write_to(&mut png, image::ImageFormat::Png).unwrap();
        self.pictures.push(png.into_inner());
        self
    }

    /// Under a node with this JSON beside its mesh.
    pub fn under(mut self, node: Value) -> Self {
        self.node = node;
        self
    }

    /// The JSON and the binary buffer.
    pub fn parts(&self) -> (Value, Vec<u8>) {
        let mut bin = Vec::new();
        let mut views = Vec::new();
        let mut accessors = Vec::new();
        let mut primitives = Vec::new();
        let mut add = |bytes: &[u8], accessor: Option<Value>| {
            let view = views.len();
            views.push(json!({"buffer": 0, "byteOffset": bin.len(), "byteLength": bytes.len()}));
            bin.extend_from_slice(bytes);
            bin.resize(bin.len().next_multiple_of(4), 0);
            if let Some(mut accessor) = accessor {
                accessor["bufferView"] = json!(view);
                accessors.push(accessor);
            }
            view
        };
        let images: Vec<Value> = self
            .pictures
            .iter()
            .map(|png| json!({"bufferView": add(png, None), "mimeType": "image/png"}))
            .collect();
        let textures: Vec<Value> = (0..images.len()).map(|i| json!({"source": i})).collect();
        let mut next = 0;
        for &([low, high], material) in &self.parts {
            let (positions, uv, order) = faces(low, high);
            let bytes = |v: &[f32]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
            add(
                &bytes(positions.as_flattened()),
                Some(
                    json!({"componentType": 5126, "count": 24, "type": "VEC3", "min": low, "max": high}),
                ),
            );
            add(
                &bytes(uv.as_flattened()),
                Some(json!({"componentType": 5126, "count": 24, "type": "VEC2"})),
            );
            let order: Vec<u8> = order.iter().flat_map(|i| i.to_le_bytes()).collect();
            add(
                &order,
                Some(json!({"componentType": 5123, "count": 36, "type": "SCALAR"})),
            );
            primitives.push(json!({
                "attributes": {"POSITION": next, "TEXCOORD_0": next + 1},
                "indices": next + 2, "material": material,
            }));
            next += 3;
        }
        let mut node = self.node.clone();
        node["mesh"] = json!(0);
        let json = json!({
            "asset": {"version": "2.0"},
            "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [node],
            "meshes": [{"primitives": primitives}], "materials": self.materials,
            "accessors": accessors, "bufferViews": views,
            "buffers": [{"byteLength": bin.len()}],
        });
        let mut json = json;
        if !images.is_empty() {
            json["images"] = json!(images);
            json["textures"] = json!(textures);
        }
        (json, bin)
    }

    /// The whole file.
    pub fn glb(&self) -> Vec<u8> {
        let (json, bin) = self.parts();
        glb(&json, &bin)
    }

    /// Writes the file, and the folders that it needs.
    pub fn write(&self, path: &Path) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, self.glb()).unwrap();
    }
}

/// A binary glTF file of two chunks.
pub(crate) fn glb(json: &Value, bin: &[u8]) -> Vec<u8> {
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF".to_vec();
    let length = 12 + 8 + text.len() + 8 + bin.len();
    for word in [2, length as u32, text.len() as u32] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(b"JSON");
    bytes.extend(text);
    bytes.extend((bin.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(bin);
    bytes
}

type Corners = (Vec<[f32; 3]>, Vec<[f32; 2]>, Vec<u16>);

/// Six faces with corners of their own, each with the whole picture.
fn faces(low: [f32; 3], high: [f32; 3]) -> Corners {
    let (mut positions, mut uv, mut order) = (Vec::new(), Vec::new(), Vec::new());
    for axis in 0..3 {
        for end in [low, high] {
            let first = positions.len() as u16;
            for [a, b] in [[0, 0], [1, 0], [1, 1], [0, 1]] {
                let mut corner = end;
                corner[(axis + 1) % 3] = [low, high][a][(axis + 1) % 3];
                corner[(axis + 2) % 3] = [low, high][b][(axis + 2) % 3];
                positions.push(corner);
                uv.push([a as f32, b as f32]);
            }
            order.extend([0, 1, 2, 0, 2, 3].map(|i| first + i));
        }
    }
    (positions, uv, order)
}
