//! The parametric car: styles, sizes and paints, and its place in the world.
//!
//! Vehicle axes: x forward, y left, z up, metres, the origin on the ground under the middle of the
//! car. The *vehicle's origin* of labels is the centre of its bounding box.

use glam::Vec3A;
use rand::{Rng, RngExt as _};

use super::body;
use super::mesh::{Mesh, Triangle};

/// Body styles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BodyStyle {
    /// Four doors and a boot.
    Sedan,
    /// Short, with a tailgate.
    Hatchback,
    /// Long, with a tailgate.
    Estate,
    /// Tall, with a tailgate.
    Suv,
    /// One box with a short bonnet.
    Van,
    /// Cabin in front, open bed behind.
    Pickup,
    /// Two doors, low.
    Coupe,
}

impl BodyStyle {
    const ALL: [Self; 7] = [
        Self::Sedan,
        Self::Hatchback,
        Self::Estate,
        Self::Suv,
        Self::Van,
        Self::Pickup,
        Self::Coupe,
    ];

    /// Its name in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sedan => "sedan",
            Self::Hatchback => "hatchback",
            Self::Estate => "estate",
            Self::Suv => "suv",
            Self::Van => "van",
            Self::Pickup => "pickup",
            Self::Coupe => "coupe",
        }
    }
}

/// The measures of a body, metres; `*_part` are parts of the length counted from the front bumper.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shape {
    pub style: BodyStyle,
    pub length: f32,
    pub width: f32,
    pub height: f32,
    pub clearance: f32,
    pub wheel_radius: f32,
    pub wheelbase: f32,
    /// Height of the bonnet's front edge.
    pub nose: f32,
    /// Height of the window line at the windscreen.
    pub cowl: f32,
    /// Height of the boot lid or bed.
    pub deck: f32,
    /// Where the windscreen begins.
    pub cowl_part: f32,
    /// Where the roof begins.
    pub roof_front_part: f32,
    /// Where the roof ends.
    pub roof_rear_part: f32,
    /// Where the rear window ends.
    pub deck_part: f32,
}

impl Shape {
    #[rustfmt::skip]
    fn of(style: BodyStyle) -> Self {
        let shape = |size: [f32; 3], ground: [f32; 3], heights: [f32; 3], parts: [f32; 4]| Self {
            style,
            length: size[0], width: size[1], height: size[2],
            clearance: ground[0], wheel_radius: ground[1], wheelbase: ground[2],
            nose: heights[0], cowl: heights[1], deck: heights[2],
            cowl_part: parts[0], roof_front_part: parts[1], roof_rear_part: parts[2], deck_part: parts[3],
        };
        match style {
            BodyStyle::Sedan => shape([4.65, 1.82, 1.45], [0.17, 0.32, 2.72], [0.75, 0.96, 1.02], [0.26, 0.42, 0.70, 0.86]),
            BodyStyle::Hatchback => shape([4.05, 1.76, 1.48], [0.16, 0.31, 2.55], [0.77, 0.97, 1.00], [0.23, 0.40, 0.86, 0.965]),
            BodyStyle::Estate => shape([4.75, 1.83, 1.50], [0.17, 0.33, 2.80], [0.77, 0.97, 1.02], [0.25, 0.41, 0.89, 0.975]),
            BodyStyle::Suv => shape([4.60, 1.90, 1.72], [0.24, 0.37, 2.70], [0.97, 1.12, 1.15], [0.23, 0.37, 0.88, 0.97]),
            BodyStyle::Van => shape([5.15, 1.97, 2.05], [0.20, 0.34, 3.10], [0.97, 1.18, 1.22], [0.14, 0.27, 0.955, 0.985]),
            BodyStyle::Pickup => shape([5.30, 1.90, 1.82], [0.26, 0.38, 3.20], [1.03, 1.16, 1.12], [0.25, 0.36, 0.575, 0.62]),
            BodyStyle::Coupe => shape([4.40, 1.85, 1.30], [0.14, 0.33, 2.60], [0.68, 0.88, 0.93], [0.30, 0.46, 0.63, 0.90]),
        }
    }

    /// The x of a part of the length.
    pub fn x(&self, part: f32) -> f32 {
        self.length * (0.5 - part)
    }

    /// The x of the front and the rear axle.
    pub fn axles(&self) -> [f32; 2] {
        // The front overhang is a little shorter than the rear one.
        [
            self.wheelbase * 0.5 + 0.04 * self.length,
            -self.wheelbase * 0.5 + 0.04 * self.length,
        ]
    }
}

/// A vehicle, standing somewhere.
#[derive(Debug, Clone)]
pub struct Vehicle {
    pub(crate) shape: Shape,
    pub(crate) paint: Vec3A,
    /// Plates, lamps and trim vary with it.
    pub(crate) seed: u32,
    /// Centre of the bounding box, metres, world.
    pub center_world: [f64; 3],
    /// Unit vector of its forward direction, world.
    pub forward_world: [f64; 3],
    /// Length, width and height of its bounding box, metres.
    pub size_m: [f64; 3],
    pub(crate) triangles: Vec<Triangle>,
}

/// Linear colours of paints, darkest to lightest and then the bright ones.
const PAINTS: [[f32; 3]; 14] = [
    [0.012, 0.012, 0.014],
    [0.045, 0.048, 0.052],
    [0.17, 0.175, 0.18],
    [0.42, 0.43, 0.44],
    [0.74, 0.74, 0.72],
    [0.78, 0.78, 0.78],
    [0.36, 0.012, 0.015],
    [0.52, 0.03, 0.02],
    [0.012, 0.04, 0.20],
    [0.03, 0.14, 0.42],
    [0.015, 0.09, 0.045],
    [0.62, 0.40, 0.03],
    [0.58, 0.16, 0.02],
    [0.30, 0.24, 0.16],
];

impl Vehicle {
    /// A vehicle of the given number: numbers that differ by less than 7 differ in style, and by
    /// less than 13 in paint.
    ///
    /// It stands at `(x, y)` on the ground and heads `heading` radians from the world's x axis.
    pub(crate) fn draw(number: u32, at: [f64; 2], heading: f64, rng: &mut impl Rng) -> Self {
        let styles = BodyStyle::ALL;
        let mut shape = Shape::of(styles[number as usize % styles.len()]);
        let [length, width, height] = [(); 3].map(|()| rng.random_range(0.95..1.05_f32));
        shape.length *= length;
        shape.wheelbase *= length;
        shape.width *= width;
        shape.height *= height;
        // A step coprime to the list's length visits every paint before it repeats one; the shift
        // after each round keeps style and paint from pairing up.
        let base = Vec3A::from_array(
            PAINTS[(number as usize * 5 + number as usize / 14 + 3) % PAINTS.len()],
        );
        let paint = (base * rng.random_range(0.85..1.15_f32)).min(Vec3A::splat(0.82));
        let mesh = body::build(&shape);
        Self::place(shape, paint, rng.random(), &mesh, at, heading)
    }

    fn place(
        shape: Shape,
        paint: Vec3A,
        seed: u32,
        mesh: &Mesh,
        at: [f64; 2],
        heading: f64,
    ) -> Self {
        let (mut low, mut high) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        for vertex in mesh.triangles.iter().flat_map(|t| t.vertices) {
            low = low.min(vertex);
            high = high.max(vertex);
        }
        let middle = (low + high) * 0.5;
        let [sin, cos] = [libm::sin(heading), libm::cos(heading)];
        let forward_world = [cos, sin, 0.0];
        // The mesh is symmetric from side to side, and its middle is where the caller wants it.
        let center_world = [at[0], at[1], f64::from(middle.z)];
        let rotate = |v: Vec3A| {
            let (x, y) = (f64::from(v.x), f64::from(v.y));
            Vec3A::new((x * cos - y * sin) as f32, (x * sin + y * cos) as f32, v.z)
        };
        let base = Vec3A::new(at[0] as f32, at[1] as f32, 0.0);
        let offset = Vec3A::new(middle.x, middle.y, 0.0);
        let triangles = mesh
            .triangles
            .iter()
            .map(|t| Triangle {
                vertices: t.vertices.map(|v| rotate(v - offset) + base),
                normals: t.normals.map(rotate),
                ..*t
            })
            .collect();
        let size_m = (high - low).to_array().map(f64::from);
        Self {
            shape,
            paint,
            seed,
            center_world,
            forward_world,
            size_m,
            triangles,
        }
    }

    /// Style of its body.
    pub fn style(&self) -> BodyStyle {
        self.shape.style
    }

    /// Radius of the bounding sphere: half the diagonal of the bounding box, metres.
    pub fn radius_sphere_m(&self) -> f64 {
        let [length, width, height] = self.size_m;
        0.5 * (length * length + width * width + height * height).sqrt()
    }

    /// Radius when seen along its length: half the diagonal of the width by height cross-section,
    /// metres.
    pub fn radius_min_m(&self) -> f64 {
        let [_, width, height] = self.size_m;
        0.5 * (width * width + height * height).sqrt()
    }

    /// A point of the world in vehicle axes.
    pub(crate) fn vehicle_from_world(&self, point: Vec3A) -> Vec3A {
        let [cos, sin, _] = self.forward_world.map(|v| v as f32);
        let x = point.x - self.center_world[0] as f32;
        let y = point.y - self.center_world[1] as f32;
        Vec3A::new(x * cos + y * sin, y * cos - x * sin, point.z)
    }

    /// A direction of the world in vehicle axes.
    pub(crate) fn vehicle_direction_from_world(&self, direction: Vec3A) -> Vec3A {
        let [cos, sin, _] = self.forward_world.map(|v| v as f32);
        Vec3A::new(
            direction.x * cos + direction.y * sin,
            direction.y * cos - direction.x * sin,
            direction.z,
        )
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn every_style_fills_a_box_of_about_its_size_around_its_centre() {
        let mut rng = Pcg64::seed_from_u64(5);
        for number in 0..7 {
            let vehicle = Vehicle::draw(number, [3.0, -2.0], 0.7, &mut rng);
            let [length, width, height] = vehicle.size_m;
            assert!((3.7..5.7).contains(&length), "{length}");
            assert!((1.6..2.4).contains(&width), "{width}");
            assert!((1.1..2.3).contains(&height), "{height}");
            let reach = vehicle.radius_sphere_m();
            for vertex in vehicle.triangles.iter().flat_map(|t| t.vertices) {
                let apart: f64 = (0..3)
                    .map(|i| (f64::from(vertex[i]) - vehicle.center_world[i]).powi(2))
                    .sum();
                assert!(apart.sqrt() <= reach + 1e-4);
                assert!(vertex.z >= -1e-6);
            }
        }
    }

    #[test]
    fn neighbouring_vehicles_differ_in_style_and_paint() {
        let mut rng = Pcg64::seed_from_u64(5);
        let vehicles: Vec<Vehicle> = (0..7)
            .map(|n| Vehicle::draw(n, [0.0, 0.0], 0.0, &mut rng))
            .collect();
        for pair in vehicles.windows(2) {
            assert_ne!(pair[0].style(), pair[1].style());
            assert_ne!(pair[0].paint, pair[1].paint);
        }
    }

    #[test]
    fn vehicle_axes_invert_the_placement() {
        let mut rng = Pcg64::seed_from_u64(1);
        let vehicle = Vehicle::draw(2, [10.0, 4.0], 2.1, &mut rng);
        let [x, y, _] = vehicle.center_world;
        let [fx, fy, _] = vehicle.forward_world;
        let ahead = Vec3A::new((x + 2.0 * fx) as f32, (y + 2.0 * fy) as f32, 0.5);
        let local = vehicle.vehicle_from_world(ahead);
        assert!(
            (local - Vec3A::new(2.0, 0.0, 0.5)).length() < 1e-4,
            "{local}"
        );
    }
}
