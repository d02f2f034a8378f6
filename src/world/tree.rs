//! Trees and bushes: a few templates with branches and leaves, of which a city plants many copies.

use glam::Vec3A;
use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::mesh::{Mesh, Surface, turn};

/// Height of every tree template, metres; copies are scaled.
pub(crate) const TEMPLATE_HEIGHT_M: f32 = 7.0;
/// Templates with fewer, larger leaves follow those for near trees after this many.
pub(crate) const KINDS: u8 = 7;
/// Trees further from the vehicle than this get the simpler template, metres.
const SIMPLE_BEYOND_M: f32 = 75.0;

/// One planted copy of a template.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plant {
    /// Index of the template.
    pub template: u8,
    /// Where its foot stands, metres.
    pub foot: Vec3A,
    /// Sine and cosine of its turn about the vertical.
    pub turn: [f32; 2],
    /// Size against the template.
    pub scale: f32,
    /// Varies the tint of its leaves.
    pub tint: u16,
}

impl Plant {
    /// A tree of some height whose crown is of a kind.
    pub fn new(kind: u8, foot: Vec3A, height: f32, apart: f32, rng: &mut impl Rng) -> Self {
        let template = kind % KINDS + if apart > SIMPLE_BEYOND_M { KINDS } else { 0 };
        Self {
            template,
            foot,
            turn: turn(rng.random()),
            scale: height / TEMPLATE_HEIGHT_M,
            tint: rng.random_range(0..64_u16),
        }
    }

    /// How far from its foot there is trunk or leaves below a height, metres.
    pub fn reach_below(&self, height_m: f32) -> f32 {
        let form = &FORMS[usize::from(self.template % KINDS)];
        let [wide, high] = form.radii;
        // The crown is about an ellipsoid, widest at its middle.
        let down = ((form.center - height_m / self.scale) / high).clamp(0.0, 1.0);
        self.scale * (wide * (1.0 - down * down).sqrt()).max(form.trunk)
    }

    /// A direction of the template in the world.
    pub fn world_from_template(&self, v: Vec3A) -> Vec3A {
        let [sin, cos] = self.turn;
        Vec3A::new(v.x * cos - v.y * sin, v.x * sin + v.y * cos, v.z)
    }

    /// A direction of the world in the template.
    pub fn template_from_world(&self, v: Vec3A) -> Vec3A {
        let [sin, cos] = self.turn;
        Vec3A::new(v.x * cos + v.y * sin, v.y * cos - v.x * sin, v.z)
    }
}

/// The form of a kind of tree.
struct Form {
    /// Middle height and radii of the crown.
    center: f32,
    radii: [f32; 2],
    /// Clumps of leaves, and their radius against the crown's.
    clumps: u16,
    clump: f32,
    /// Narrows the crown towards the top.
    taper: f32,
    leaf_m: f32,
    leaves: u16,
    trunk: f32,
}

/// Crowns by kind: round, broad, oval, column, cone, young, and a bush.
#[rustfmt::skip]
const FORMS: [Form; KINDS as usize] = [
    Form { center: 4.7, radii: [2.0, 2.1], clumps: 15, clump: 0.42, taper: 0.1, leaf_m: 0.30, leaves: 1500, trunk: 0.16 },
    Form { center: 4.6, radii: [2.7, 1.9], clumps: 20, clump: 0.36, taper: 0.2, leaf_m: 0.32, leaves: 1900, trunk: 0.20 },
    Form { center: 4.4, radii: [1.6, 2.5], clumps: 14, clump: 0.45, taper: 0.3, leaf_m: 0.27, leaves: 1400, trunk: 0.14 },
    Form { center: 4.0, radii: [0.9, 3.0], clumps: 14, clump: 0.55, taper: 0.3, leaf_m: 0.24, leaves: 1200, trunk: 0.13 },
    Form { center: 3.9, radii: [1.7, 3.1], clumps: 22, clump: 0.36, taper: 0.85, leaf_m: 0.24, leaves: 1800, trunk: 0.15 },
    Form { center: 5.0, radii: [1.3, 1.7], clumps: 8, clump: 0.48, taper: 0.1, leaf_m: 0.28, leaves: 700, trunk: 0.08 },
    Form { center: 3.4, radii: [3.6, 3.4], clumps: 16, clump: 0.45, taper: 0.1, leaf_m: 0.55, leaves: 1100, trunk: 0.25 },
];

/// The templates: every kind for near copies, then every kind for far ones.
pub(crate) fn templates() -> Vec<Mesh> {
    let near = FORMS
        .iter()
        .zip(0_u64..)
        .map(|(form, kind)| grow(form, kind, 1.0));
    let far = FORMS
        .iter()
        .zip(0_u64..)
        .map(|(form, kind)| grow(form, kind, 2.1));
    near.chain(far).collect()
}

/// Share of the sky that leaves at this place of a template see: little inside the crown and below.
pub(crate) fn leaf_openness(template: u8, at: Vec3A) -> f32 {
    let form = &FORMS[usize::from(template % KINDS)];
    let (dx, dz) = (
        (at.x * at.x + at.y * at.y).sqrt() / form.radii[0],
        (at.z - form.center) / form.radii[1],
    );
    let depth = (dx * dx + dz * dz).min(1.6);
    (0.10 + 0.55 * depth * depth + 0.28 * dz).clamp(0.08, 1.0)
}

fn grow(form: &Form, kind: u64, coarse: f32) -> Mesh {
    let mut rng = Pcg64::seed_from_u64(0x7ee5 + kind);
    let rng = &mut rng;
    let mut mesh = Mesh::default();
    let center = Vec3A::new(0.0, 0.0, form.center);
    let [wide, high] = form.radii;
    let clumps: Vec<(Vec3A, f32)> = (0..form.clumps)
        .map(|i| {
            // Spread over the height, round by the golden angle.
            let up = 1.7 * (f32::from(i) + 0.5) / f32::from(form.clumps) - 0.85;
            let [sin, cos] = turn(0.381_966 * f32::from(i) + rng.random_range(-0.06..0.06_f32));
            let level = (1.0 - up * up).sqrt() * (1.0 - form.taper * (0.5 + 0.5 * up));
            let out = rng.random_range(0.40..0.78_f32) * level * wide;
            let place = center + Vec3A::new(cos * out, sin * out, up * high * 0.82);
            let size = form.clump * wide.min(high) * rng.random_range(0.8..1.25_f32);
            (place, size * (1.0 - 0.45 * form.taper * (0.5 + 0.5 * up)))
        })
        .collect();
    // The trunk leans a little; branches reach into every second clump.
    let lean = Vec3A::new(
        rng.random_range(-0.15..0.15),
        rng.random_range(-0.15..0.15),
        0.0,
    );
    let fork = center + lean - Vec3A::Z * (0.35 * high);
    let bark = Surface::Bark;
    let foot = form.trunk * 1.25;
    mesh.tube([Vec3A::ZERO, Vec3A::Z * 0.3], [foot * 1.25, foot], 8, bark);
    mesh.tube([Vec3A::Z * 0.3, fork], [foot, form.trunk * 0.8], 8, bark);
    mesh.tube(
        [fork, center + lean + Vec3A::Z * (0.5 * high)],
        [form.trunk * 0.8, 0.03],
        6,
        bark,
    );
    for (place, _) in clumps.iter().step_by(2) {
        mesh.tube([fork, *place], [form.trunk * 0.45, 0.02], 5, bark);
    }
    let leaf = Surface::Foliage(0);
    let face = mesh.new_face();
    let leaves = (f32::from(form.leaves) / (coarse * coarse)) as u32;
    for index in 0..leaves {
        let (middle, size) = clumps[index as usize % clumps.len()];
        let out = on_sphere(rng);
        let reach = size * rng.random_range(0.55..1.0_f32).sqrt();
        let at = middle + out * reach * Vec3A::new(1.0, 1.0, 0.85);
        // Lit like the crown and the clump that the leaf belongs to, with a little of its own.
        let crown = ((at - center) / Vec3A::new(wide, wide, high)).normalize_or(Vec3A::Z);
        let normal = (crown * 0.7 + out * 0.6 + on_sphere(rng) * 0.35 + Vec3A::Z * 0.15)
            .normalize_or(Vec3A::Z);
        let facing = (out + on_sphere(rng) * 0.9).normalize_or(Vec3A::Z);
        let side = facing.cross(on_sphere(rng)).normalize_or(Vec3A::X);
        let along = facing.cross(side);
        let length = form.leaf_m * coarse * rng.random_range(0.75..1.3_f32);
        let breadth = length * rng.random_range(0.42..0.62_f32);
        // A spray of leaves: a kite, bent along its middle.
        let droop = facing * (-0.22 * length);
        let tip = [
            at - along * length * 0.9 + droop,
            at + along * length + droop,
        ];
        let edge = [at - side * breadth, at + side * breadth];
        for corners in [[tip[0], edge[0], tip[1]], [tip[0], tip[1], edge[1]]] {
            mesh.push(corners, [normal; 3], leaf, face);
        }
    }
    mesh
}

/// A direction, all equally likely.
fn on_sphere(rng: &mut impl Rng) -> Vec3A {
    let up = rng.random_range(-1.0..1.0_f32);
    let [sin, cos] = turn(rng.random());
    let level = (1.0 - up * up).sqrt();
    Vec3A::new(cos * level, sin * level, up)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_template_stands_on_the_ground_and_is_about_as_tall_as_it_says() {
        for mesh in templates() {
            let heights = mesh.triangles.iter().flat_map(|t| t.vertices).map(|v| v.z);
            let (low, high) = heights.fold((f32::INFINITY, 0.0_f32), |(low, high), z| {
                (low.min(z), high.max(z))
            });
            // Bushes reach into the ground.
            assert!((-0.8..=0.001).contains(&low), "{low}");
            assert!((6.2..8.2).contains(&high), "{high}");
        }
    }

    #[test]
    fn turning_a_plant_back_and_forth_changes_nothing() {
        let mut rng = Pcg64::seed_from_u64(2);
        let plant = Plant::new(1, Vec3A::ZERO, 6.0, 10.0, &mut rng);
        let v = Vec3A::new(0.3, -2.0, 1.0);
        let back = plant.template_from_world(plant.world_from_template(v));
        assert!((v - back).length() < 1e-5);
    }
}
