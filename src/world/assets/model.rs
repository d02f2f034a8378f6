//! One glTF file as triangles in vehicle axes.

use std::ops::Range;
use std::path::Path;

use glam::{Mat3A, Mat4, Vec3A};
use gltf::mesh::Mode;
use gltf::{Node, Primitive};
use sha2::Sha256;

use super::corners::Corners;
use super::manifest::Entry;
use super::material::{Coat, Materials, Place};
use super::source::Source;
use crate::error::Result;
use crate::world::mesh::{Surface, Triangle};

/// More triangles than anybody can see of a vehicle ten metres away.
const MOST_TRIANGLES: usize = 100_000;
/// Files whose nodes contain one another would never end.
const MOST_NODES: usize = 20_000;
const DEEPEST_NODE: usize = 64;

/// A vehicle or prop of the user's.
#[derive(Debug)]
pub(crate) struct Model {
    /// In vehicle axes: x forward, y left, z up, metres, the origin on the ground under the middle.
    pub triangles: Vec<Triangle>,
    /// Length, width and height of its box, metres.
    pub size_m: [f32; 3],
    skins: Vec<Skin>,
    materials: Materials,
}

/// What a triangle carries beside its corners.
#[derive(Debug, Clone, Copy)]
struct Skin {
    material: usize,
    uv: [[[f32; 2]; 2]; 3],
    color: [Vec3A; 3],
    /// Units of each set of texture coordinates on a metre.
    density: [f32; 2],
}

impl Model {
    /// Reads a file; `number` is what its triangles' surfaces call it.
    pub(super) fn read(
        path: &Path,
        entry: &Entry,
        number: u16,
        digest: &mut Sha256,
    ) -> Result<Self> {
        let source = Source::read(path, digest)?;
        let materials = Materials::read(&source, digest)?;
        let mut reader = Reader {
            source: &source,
            materials: &materials,
            number,
            nodes: 0,
            faces: 0,
            triangles: Vec::new(),
            skins: Vec::new(),
        };
        let document = &source.document;
        let scene = document
            .default_scene()
            .or_else(|| document.scenes().next());
        match scene {
            Some(scene) => {
                for node in scene.nodes() {
                    reader.node(&node, Mat4::IDENTITY, 0)?;
                }
            }
            None => return Err(source.damaged("has no scene")),
        }
        let Reader {
            mut triangles,
            mut skins,
            ..
        } = reader;
        let size_m = stand(&mut triangles, &source, entry)?;
        for (triangle, skin) in triangles.iter().zip(&mut skins) {
            skin.measure(triangle);
        }
        Ok(Self {
            triangles,
            size_m,
            skins,
            materials,
        })
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> usize {
        self.materials.bytes() + self.triangles.len() * (size_of::<Triangle>() + size_of::<Skin>())
    }

    /// Whether a triangle has holes that rays must look for.
    pub fn has_holes(&self, triangle: u32) -> bool {
        self.materials
            .has_holes(self.skins[triangle as usize].material)
    }

    /// Whether a point of a triangle is solid; `weights` are those of its second and third corner.
    pub fn is_solid(&self, triangle: u32, weights: [f32; 2]) -> bool {
        let skin = &self.skins[triangle as usize];
        self.materials.is_solid(skin.material, skin.uv_at(weights))
    }

    /// What a point of a triangle looks like, averaged over a footprint.
    pub fn coat(&self, triangle: u32, weights: [f32; 2], footprint_m: f32) -> Coat {
        let skin = &self.skins[triangle as usize];
        let [second, third] = weights;
        let [a, b, c] = skin.color;
        let place = Place {
            uv: skin.uv_at(weights),
            width: skin.density.map(|density| density * footprint_m),
            color: a * (1.0 - second - third) + b * second + c * third,
        };
        self.materials.coat(skin.material, &place)
    }
}

impl Skin {
    fn uv_at(&self, [second, third]: [f32; 2]) -> [[f32; 2]; 2] {
        let [a, b, c] = &self.uv;
        let first = 1.0 - second - third;
        std::array::from_fn(|set| {
            std::array::from_fn(|i| a[set][i] * first + b[set][i] * second + c[set][i] * third)
        })
    }

    fn measure(&mut self, triangle: &Triangle) {
        let [a, b, c] = triangle.vertices;
        let area = (b - a).cross(c - a).length().max(1e-12);
        self.density = [0, 1].map(|set| {
            let [a, b, c] = self.uv.map(|uv| uv[set]);
            let [e, f] = [b, c].map(|v| [v[0] - a[0], v[1] - a[1]]);
            ((e[0] * f[1] - e[1] * f[0]).abs() / area).sqrt()
        });
    }
}

struct Reader<'a> {
    source: &'a Source,
    materials: &'a Materials,
    number: u16,
    nodes: usize,
    faces: u32,
    triangles: Vec<Triangle>,
    skins: Vec<Skin>,
}

impl Reader<'_> {
    fn node(&mut self, node: &Node, parent: Mat4, depth: usize) -> Result<()> {
        self.nodes += 1;
        if self.nodes > MOST_NODES || depth > DEEPEST_NODE {
            return Err(self
                .source
                .damaged("its nodes contain one another without end"));
        }
        let own = Mat4::from_cols_array_2d(&node.transform().matrix());
        let world = parent * own;
        if !world.is_finite() {
            return Err(self.source.damaged("a node's place is not finite"));
        }
        if let Some(mesh) = node.mesh() {
            for primitive in mesh.primitives() {
                self.primitive(&primitive, world)?;
            }
        }
        node.children()
            .try_for_each(|child| self.node(&child, world, depth + 1))
    }

    fn primitive(&mut self, primitive: &Primitive, world: Mat4) -> Result<()> {
        let mode = primitive.mode();
        if !matches!(
            mode,
            Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan
        ) {
            // Points and lines have no surface.
            return Ok(());
        }
        let source = self.source;
        let Some(corners) = Corners::read(primitive, source)? else {
            return Ok(());
        };
        let linear = Mat3A::from_mat4(world);
        // Normals turn with the inverse transpose, up to a factor that normalising removes.
        let [x, y, z] = [linear.x_axis, linear.y_axis, linear.z_axis];
        let upright = Mat3A::from_cols(y.cross(z), z.cross(x), x.cross(y));
        self.faces += 1;
        for triangle in fan_out(mode, corners.order.len()) {
            let [a, b, c] = triangle.map(|place| corners.order[place] as usize);
            let vertices =
                [a, b, c].map(|i| world.transform_point3a(Vec3A::from_array(corners.positions[i])));
            let flat = (vertices[1] - vertices[0]).cross(vertices[2] - vertices[0]);
            if !vertices.iter().all(|v| v.is_finite()) {
                return Err(source.damaged("a corner's place is not finite"));
            }
            if flat.length_squared() <= 0.0 {
                continue;
            }
            if self.triangles.len() == MOST_TRIANGLES {
                return Err(source.error(
                    format!("has more than {MOST_TRIANGLES} triangles"),
                    "simplify it, for example with Blender's modifier Decimate",
                ));
            }
            let flat = flat.normalize_or(Vec3A::Z);
            let normals = [a, b, c].map(|i| match &corners.normals {
                Some(normals) => (upright * Vec3A::from_array(normals[i])).normalize_or(flat),
                None => flat,
            });
            let surface = Surface::Model(self.number, self.triangles.len() as u32);
            self.triangles.push(Triangle {
                vertices,
                normals,
                surface,
                face: self.faces,
            });
            self.skins.push(Skin {
                material: primitive
                    .material()
                    .index()
                    .unwrap_or(self.materials.plain()),
                uv: [a, b, c].map(|i| corners.uv(i)),
                color: [a, b, c].map(|i| corners.color(i)),
                density: [0.0; 2],
            });
        }
        Ok(())
    }
}

/// Which corners make the triangles.
fn fan_out(mode: Mode, corners: usize) -> impl Iterator<Item = [usize; 3]> {
    let count: Range<usize> = match mode {
        Mode::Triangles => 0..corners / 3,
        _ => 0..corners.saturating_sub(2),
    };
    count.map(move |i| match mode {
        Mode::Triangles => [3 * i, 3 * i + 1, 3 * i + 2],
        Mode::TriangleFan => [0, i + 1, i + 2],
        _ => [i, i + 1, i + 2],
    })
}

/// Turns triangles from the file's axes to vehicle axes, scales them and puts them on the ground.
/// Returns length, width and height.
fn stand(triangles: &mut [Triangle], source: &Source, entry: &Entry) -> Result<[f32; 3]> {
    if triangles.is_empty() {
        return Err(source.error(
            "has no triangles",
            "export a model with surfaces, in the scene that the file shows first",
        ));
    }
    let [forward, up] = [entry.forward, entry.up].map(super::manifest::Axis::direction);
    let left = up.cross(forward);
    let turn = |v: Vec3A| Vec3A::new(v.dot(forward), v.dot(left), v.dot(up));
    for triangle in triangles.iter_mut() {
        triangle.vertices = triangle.vertices.map(turn);
        triangle.normals = triangle.normals.map(turn);
    }
    let corners = triangles.iter().flat_map(|t| t.vertices);
    let [low, high] = corners.fold([Vec3A::INFINITY, Vec3A::NEG_INFINITY], |[low, high], v| {
        [low.min(v), high.max(v)]
    });
    let size = high - low;
    let scale = match *entry {
        Entry {
            scale: Some(scale), ..
        } => scale as f32,
        Entry {
            length_m: Some(length),
            ..
        } => length as f32 / size.x,
        Entry {
            height_m: Some(height),
            ..
        } => height as f32 / size.z,
        _ => 1.0,
    };
    let size_m = size * scale;
    if !(size_m.is_finite() && size_m.min_element() >= 0.0 && size_m.max_element() > 0.0) {
        return Err(source.damaged("has no size"));
    }
    let origin = Vec3A::new(0.5 * (low.x + high.x), 0.5 * (low.y + high.y), low.z);
    for triangle in triangles {
        triangle.vertices = triangle.vertices.map(|v| (v - origin) * scale);
    }
    Ok(size_m.to_array())
}
