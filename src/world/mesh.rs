//! Triangles with what the renderer must know of their surface, and the solids built from them.

use glam::Vec3A;

use super::noise;

/// What a triangle is made of; procedural colours are looked up by position when it is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Surface {
    /// Wall of a building, by its index in the city.
    Wall(u16),
    /// Roof of a building, by its index in the city.
    Roof(u16),
    /// Cornices, parapets and balconies of a building, by its index in the city.
    Stone(u16),
    /// Striped cloth over a shop window, by the shop's number.
    Awning(u16),
    /// Leaves; the number varies the tint.
    Foliage(u16),
    /// Trunks.
    Bark,
    /// Galvanised metal of lamp posts and the like.
    Metal,
    /// Street furniture in one of a few colours.
    Painted(u16),
    /// Traffic signs.
    Sign,
    /// Lamps of traffic lights: red, amber, green, and the same switched on.
    Signal(u16),
    /// Part of the vehicle.
    Vehicle(VehiclePart),
    /// Part of a model of the user's: its number, and the triangle's in it.
    Model(u16, u32),
}

/// Which part of the vehicle a triangle belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum VehiclePart {
    /// Everything below the windows.
    Body,
    /// Windows, pillars and roof.
    Cabin,
    /// Tyres and rims.
    Wheel,
    /// Mirrors.
    Trim,
    /// Roof rails and aerials.
    Rail,
    /// A taxi's sign.
    RoofSign,
    /// A truck's box.
    Cargo,
}

/// One triangle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Triangle {
    /// Corners, metres.
    pub vertices: [Vec3A; 3],
    /// Shading normals at the corners, unit length; the side they point to does not matter.
    pub normals: [Vec3A; 3],
    /// What it is made of.
    pub surface: Surface,
    /// Triangles of one smooth or flat face share this; the renderer looks for edges where it
    /// changes.
    pub face: u32,
}

/// A growing list of triangles.
#[derive(Debug, Default)]
pub(crate) struct Mesh {
    /// The triangles.
    pub triangles: Vec<Triangle>,
    next_face: u32,
}

impl Mesh {
    /// The number of a new face.
    pub fn new_face(&mut self) -> u32 {
        self.next_face += 1;
        self.next_face
    }

    fn push_flat(&mut self, vertices: [Vec3A; 3], surface: Surface, face: u32) {
        let normal = (vertices[1] - vertices[0])
            .cross(vertices[2] - vertices[0])
            .normalize_or_zero();
        self.triangles.push(Triangle {
            vertices,
            normals: [normal; 3],
            surface,
            face,
        });
    }

    /// Triangles from elsewhere, with their own division into faces.
    pub fn append(&mut self, triangles: impl IntoIterator<Item = Triangle>) {
        let first = self.next_face;
        for triangle in triangles {
            let face = first + triangle.face;
            self.next_face = self.next_face.max(face);
            self.triangles.push(Triangle { face, ..triangle });
        }
    }

    /// One triangle of a face.
    pub fn push(&mut self, vertices: [Vec3A; 3], normals: [Vec3A; 3], surface: Surface, face: u32) {
        self.triangles.push(Triangle {
            vertices,
            normals,
            surface,
            face,
        });
    }

    /// A flat polygon that is convex, as a fan.
    pub fn polygon(&mut self, corners: &[Vec3A], surface: Surface) {
        let face = self.new_face();
        for pair in corners[1..].windows(2) {
            self.push_flat([corners[0], pair[0], pair[1]], surface, face);
        }
    }

    /// The upper five faces of an axis-aligned block; what stands on the ground needs no bottom.
    pub fn block(&mut self, low: Vec3A, high: Vec3A, walls: Surface, top: Surface) {
        let [a, b, c, d] = [
            (low.x, low.y),
            (high.x, low.y),
            (high.x, high.y),
            (low.x, high.y),
        ];
        for (from, to) in [(a, b), (b, c), (c, d), (d, a)] {
            self.polygon(
                &[
                    Vec3A::new(from.0, from.1, low.z),
                    Vec3A::new(to.0, to.1, low.z),
                    Vec3A::new(to.0, to.1, high.z),
                    Vec3A::new(from.0, from.1, high.z),
                ],
                walls,
            );
        }
        self.polygon(&[a, b, c, d].map(|(x, y)| Vec3A::new(x, y, high.z)), top);
    }

    /// All six faces of an axis-aligned block.
    pub fn slab(&mut self, low: Vec3A, high: Vec3A, surface: Surface) {
        self.block(low, high, surface, surface);
        let corner = |x: f32, y: f32| Vec3A::new(x, y, low.z);
        let below = [
            corner(low.x, low.y),
            corner(high.x, low.y),
            corner(high.x, high.y),
            corner(low.x, high.y),
        ];
        self.polygon(&below, surface);
    }

    /// A smooth surface through a grid of points; with `wrap` the last column meets the first.
    ///
    /// Rows must have equal lengths.
    pub fn grid(&mut self, rows: &[Vec<Vec3A>], wrap: bool, surface: Surface) {
        let columns = rows.first().map_or(0, Vec::len);
        let quads = if wrap {
            columns
        } else {
            columns.saturating_sub(1)
        };
        let mut normals = vec![vec![Vec3A::ZERO; columns]; rows.len()];
        let corner = |row: usize, column: usize| (row, column % columns);
        let mut faces = Vec::new();
        for row in 0..rows.len().saturating_sub(1) {
            for column in 0..quads {
                let [a, b] = [corner(row, column), corner(row, column + 1)];
                let [c, d] = [corner(row + 1, column + 1), corner(row + 1, column)];
                faces.extend([[a, b, c], [a, c, d]]);
            }
        }
        for indices in &faces {
            let [a, b, c] = indices.map(|(row, column)| rows[row][column]);
            // Not normalised: larger triangles weigh more.
            let normal = (b - a).cross(c - a);
            for &(row, column) in indices {
                normals[row][column] += normal;
            }
        }
        let face = self.new_face();
        for indices in &faces {
            let vertices = indices.map(|(row, column)| rows[row][column]);
            let area = (vertices[1] - vertices[0])
                .cross(vertices[2] - vertices[0])
                .length();
            if area > 1e-9 {
                self.triangles.push(Triangle {
                    vertices,
                    normals: indices.map(|(row, column)| normals[row][column].normalize_or_zero()),
                    surface,
                    face,
                });
            }
        }
    }

    /// A round bar or cone between two points, without end caps.
    pub fn tube(&mut self, ends: [Vec3A; 2], radii: [f32; 2], segments: u16, surface: Surface) {
        let axis = (ends[1] - ends[0]).normalize_or_zero();
        let side = if axis.z.abs() > 0.9 {
            Vec3A::X
        } else {
            Vec3A::Z
        };
        let u = axis.cross(side).normalize_or_zero();
        let v = axis.cross(u);
        let ring = |end: usize| -> Vec<Vec3A> {
            (0..segments)
                .map(|i| {
                    let [sin, cos] = turn(f32::from(i) / f32::from(segments));
                    ends[end] + (u * cos + v * sin) * radii[end]
                })
                .collect()
        };
        self.grid(&[ring(0), ring(1)], true, surface);
    }

    /// A flat disc that faces along y.
    pub fn disc(&mut self, center: Vec3A, radius: f32, segments: u16, surface: Surface) {
        let corners: Vec<Vec3A> = (0..segments)
            .map(|i| {
                let [sin, cos] = turn(f32::from(i) / f32::from(segments));
                center + Vec3A::new(cos * radius, 0.0, sin * radius)
            })
            .collect();
        self.polygon(&corners, surface);
    }

    /// A lumpy ball, such as a tree's crown.
    pub fn blob(
        &mut self,
        center: Vec3A,
        radii: Vec3A,
        lumpiness: f32,
        seed: u32,
        surface: Surface,
    ) {
        const ROWS: u16 = 9;
        const COLUMNS: u16 = 14;
        let rows: Vec<Vec<Vec3A>> = (0..=ROWS)
            .map(|row| {
                let [sin_polar, cos_polar] = turn(0.5 * f32::from(row) / f32::from(ROWS));
                (0..COLUMNS)
                    .map(|column| {
                        let [sin, cos] = turn(f32::from(column) / f32::from(COLUMNS));
                        let direction = Vec3A::new(sin_polar * cos, sin_polar * sin, cos_polar);
                        let bump = if row == 0 || row == ROWS {
                            0.5
                        } else {
                            noise::unit(noise::hash(i32::from(row), i32::from(column), seed))
                        };
                        center + direction * radii * (1.0 + lumpiness * (bump - 0.5))
                    })
                    .collect()
            })
            .collect();
        self.grid(&rows, true, surface);
    }
}

/// Sine and cosine of a part of a full turn.
///
/// From `libm`, whose results do not depend on the machine.
pub(crate) fn turn(turns: f32) -> [f32; 2] {
    let angle = turns * std::f32::consts::TAU;
    [libm::sinf(angle), libm::cosf(angle)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_normals_of_a_ball_point_along_its_radius() {
        let mut mesh = Mesh::default();
        mesh.blob(Vec3A::ZERO, Vec3A::ONE, 0.0, 1, Surface::Bark);
        for triangle in &mesh.triangles {
            for (vertex, normal) in triangle.vertices.iter().zip(triangle.normals) {
                assert!(vertex.dot(normal).abs() > 0.9, "{vertex} {normal}");
            }
        }
    }

    #[test]
    fn a_block_has_ten_triangles_on_five_faces() {
        let mut mesh = Mesh::default();
        mesh.block(Vec3A::ZERO, Vec3A::ONE, Surface::Bark, Surface::Metal);
        let mut faces: Vec<u32> = mesh.triangles.iter().map(|t| t.face).collect();
        faces.dedup();
        assert_eq!((mesh.triangles.len(), faces.len()), (10, 5));
    }
}
