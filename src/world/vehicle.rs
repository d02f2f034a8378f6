//! The parametric car: styles, sizes and paints, and its place in the world.
//!
//! Vehicle axes: x forward, y left, z up, metres, the origin on the ground under the middle of the
//! car. The *vehicle's origin* of labels is the centre of its bounding box.

use std::sync::Arc;

use glam::Vec3A;
use rand::{Rng, RngExt as _};
use serde::{Deserialize, Serialize};

use super::assets::{Asset, AssetLibrary};
use super::body;
use super::mesh::Triangle;
use super::paint::Paint;

/// Body styles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
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
    /// A sedan with a sign on its roof.
    Taxi,
    /// Very short, with a tailgate.
    Compact,
    /// A long van with windows all around.
    Minibus,
    /// A van's cab with a box behind it.
    Truck,
}

impl BodyStyle {
    /// All of them.
    pub const ALL: [Self; 11] = [
        Self::Sedan,
        Self::Hatchback,
        Self::Estate,
        Self::Suv,
        Self::Van,
        Self::Pickup,
        Self::Coupe,
        Self::Taxi,
        Self::Compact,
        Self::Minibus,
        Self::Truck,
    ];

    /// Whether its sides are upright and its nose is blunt.
    pub(crate) const fn is_boxy(self) -> bool {
        matches!(self, Self::Van | Self::Minibus | Self::Truck)
    }

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
            Self::Taxi => "taxi",
            Self::Compact => "compact",
            Self::Minibus => "minibus",
            Self::Truck => "truck",
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
            BodyStyle::Taxi => shape([4.80, 1.85, 1.47], [0.17, 0.33, 2.85], [0.77, 0.97, 1.03], [0.25, 0.41, 0.71, 0.86]),
            BodyStyle::Compact => shape([3.60, 1.66, 1.52], [0.16, 0.29, 2.42], [0.80, 1.00, 1.02], [0.19, 0.36, 0.88, 0.975]),
            BodyStyle::Minibus => shape([5.70, 2.02, 2.48], [0.21, 0.35, 3.60], [1.02, 1.26, 1.30], [0.11, 0.22, 0.965, 0.99]),
            BodyStyle::Truck => shape([5.90, 2.02, 2.20], [0.24, 0.36, 3.60], [1.02, 1.24, 1.05], [0.12, 0.22, 0.275, 0.30]),
            BodyStyle::Coupe => shape([4.40, 1.85, 1.30], [0.14, 0.33, 2.60], [0.68, 0.88, 0.93], [0.30, 0.46, 0.63, 0.90]),
        }
    }

    /// The x of a part of the length.
    pub fn x(&self, part: f32) -> f32 {
        self.length * (0.5 - part)
    }

    /// Height of a truck's box.
    pub fn box_top(&self) -> f32 {
        self.height + 0.45
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

/// The body of a built-in vehicle.
#[derive(Debug, Clone)]
pub(crate) struct Bodywork {
    pub shape: Shape,
    /// Name of its paint.
    finish: Paint,
    /// Diffuse colour of its paint, and colour of the metal flakes in it.
    pub paint: Vec3A,
    pub flakes: Vec3A,
    /// Plates, lamps and trim vary with it.
    pub seed: u32,
}

/// What a vehicle is.
#[derive(Debug, Clone)]
pub(crate) enum Kind {
    /// One of the built-in bodies.
    BuiltIn(Box<Bodywork>),
    /// A model of the user's, by its name.
    Model(Arc<str>),
}

/// A vehicle, standing somewhere.
#[derive(Debug, Clone)]
pub struct Vehicle {
    pub(crate) kind: Kind,
    /// Centre of the bounding box, metres, world.
    pub center_world: [f64; 3],
    /// Unit vector of its forward direction, world.
    pub forward_world: [f64; 3],
    /// Length, width and height of its bounding box, metres.
    pub size_m: [f64; 3],
    pub(crate) triangles: Vec<Triangle>,
}

/// The bodies and paints that a scene may draw from.
#[derive(Debug, Clone)]
pub struct Wardrobe {
    /// Built-in bodies; may be empty where the user's own make up for it.
    pub bodies: Vec<BodyStyle>,
    /// Paints of the built-in bodies, at least one.
    pub paints: Vec<Paint>,
    /// The user's own vehicles and props.
    pub own: Option<OwnAssets>,
}

/// The user's vehicles and props that a scene may draw from.
#[derive(Debug, Clone)]
pub struct OwnAssets {
    /// All that there are.
    pub library: Arc<AssetLibrary>,
    /// Numbers of the vehicles to draw from, each as often as its weight says.
    pub(crate) vehicles: Vec<u16>,
    /// Metres of pavement for each prop.
    pub prop_spacing_m: f64,
}

impl Default for Wardrobe {
    /// Every built-in body and every paint.
    fn default() -> Self {
        Self {
            bodies: BodyStyle::ALL.to_vec(),
            paints: Paint::ALL.to_vec(),
            own: None,
        }
    }
}

/// The body that a vehicle of some number has.
#[derive(Debug, Clone, Copy)]
enum Body<'a> {
    BuiltIn(BodyStyle),
    Own(&'a Asset),
}

impl Wardrobe {
    fn own_vehicles(&self) -> &[u16] {
        self.own.as_ref().map_or(&[], |own| &own.vehicles)
    }

    /// How many bodies there are.
    fn count(&self) -> usize {
        self.bodies.len() + self.own_vehicles().len()
    }

    fn body(&self, number: u32) -> Body<'_> {
        let place = number as usize % self.count();
        match (self.bodies.get(place), &self.own) {
            (None, Some(own)) => {
                let number = own.vehicles[place - self.bodies.len()];
                Body::Own(own.library.asset(number))
            }
            (style, _) => Body::BuiltIn(style.copied().unwrap_or(BodyStyle::Sedan)),
        }
    }

    /// Half the length and the width to keep free for a vehicle of a number, metres.
    pub(crate) fn room_m(&self, number: u32) -> [f64; 2] {
        /// Those of a truck, the largest built-in body.
        const LARGEST_HALF_M: [f64; 2] = [3.15, 1.15];
        match self.body(number) {
            Body::BuiltIn(_) => LARGEST_HALF_M,
            Body::Own(asset) => {
                let [length, width, _] = asset.model.size_m;
                [length, width].map(|size| 0.5 * f64::from(size))
            }
        }
    }
}

impl Vehicle {
    /// A vehicle of the given number: numbers that differ by less than the number of bodies differ in
    /// style, and by less than that of paints in paint.
    ///
    /// It stands at `(x, y)` on the ground and heads `heading` radians from the world's x axis.
    pub(crate) fn draw(
        number: u32,
        wardrobe: &Wardrobe,
        at: [f64; 2],
        heading: f64,
        rng: &mut impl Rng,
    ) -> Self {
        let paints = &wardrobe.paints;
        // Drawn for every body, so that one of the user's leaves the city as it is.
        let [length, width, height] = [(); 3].map(|()| rng.random_range(0.95..1.05_f32));
        let shade = rng.random_range(0.85..1.15_f32);
        let seed = rng.random();
        let style = match wardrobe.body(number) {
            Body::BuiltIn(style) => style,
            Body::Own(asset) => {
                let kind = Kind::Model(asset.name.as_str().into());
                return Self::place(kind, &asset.model.triangles, at, heading);
            }
        };
        let mut shape = Shape::of(style);
        shape.length *= length;
        shape.wheelbase *= length;
        shape.width *= width;
        shape.height *= height;
        // Steps of one visit every paint before one repeats; the shift after each round of styles
        // keeps style and paint from pairing up.
        let place = number as usize;
        let paint = paints[(place + place / wardrobe.count() + 3) % paints.len()];
        let [color, flakes] = paint
            .colors()
            .map(|c| (Vec3A::from_array(c) * shade).min(Vec3A::splat(0.80)));
        let mesh = body::build(&shape);
        let kind = Kind::BuiltIn(Box::new(Bodywork {
            shape,
            finish: paint,
            paint: color,
            flakes,
            seed,
        }));
        Self::place(kind, &mesh.triangles, at, heading)
    }

    fn place(kind: Kind, triangles: &[Triangle], at: [f64; 2], heading: f64) -> Self {
        let (mut low, mut high) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        for vertex in triangles.iter().flat_map(|t| t.vertices) {
            low = low.min(vertex);
            high = high.max(vertex);
        }
        let middle = (low + high) * 0.5;
        let [sin, cos] = [libm::sin(heading), libm::cos(heading)];
        let forward_world = [cos, sin, 0.0];
        // The mesh is symmetric from side to side, and its middle is where the caller wants it.
        let center_world = [at[0], at[1], f64::from(middle.z)];
        let offset = Vec3A::new(middle.x, middle.y, 0.0);
        let centred = triangles.iter().map(|t| Triangle {
            vertices: t.vertices.map(|v| v - offset),
            ..*t
        });
        let triangles = placed(centred, at, heading).collect();
        let size_m = (high - low).to_array().map(f64::from);
        Self {
            kind,
            center_world,
            forward_world,
            size_m,
            triangles,
        }
    }

    /// Name of its body in files.
    pub fn body_name(&self) -> &str {
        match &self.kind {
            Kind::BuiltIn(bodywork) => bodywork.shape.style.name(),
            Kind::Model(name) => name,
        }
    }

    /// Its paint; None for a model of the user's.
    pub fn paint_name(&self) -> Option<Paint> {
        match &self.kind {
            Kind::BuiltIn(bodywork) => Some(bodywork.finish),
            Kind::Model(_) => None,
        }
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

/// Triangles turned by `heading` radians about the origin and put at a place on the ground.
pub(crate) fn placed<T: std::borrow::Borrow<Triangle>>(
    triangles: impl IntoIterator<Item = T>,
    at: [f64; 2],
    heading: f64,
) -> impl Iterator<Item = Triangle> {
    let [sin, cos] = [libm::sin(heading), libm::cos(heading)];
    let rotate = move |v: Vec3A| {
        let (x, y) = (f64::from(v.x), f64::from(v.y));
        Vec3A::new((x * cos - y * sin) as f32, (x * sin + y * cos) as f32, v.z)
    };
    let base = Vec3A::new(at[0] as f32, at[1] as f32, 0.0);
    triangles.into_iter().map(move |triangle| {
        let t = triangle.borrow();
        Triangle {
            vertices: t.vertices.map(|v| rotate(v) + base),
            normals: t.normals.map(rotate),
            ..*t
        }
    })
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn every_style_fills_a_box_of_about_its_size_around_its_centre() {
        let mut rng = Pcg64::seed_from_u64(5);
        for number in 0..11 {
            let vehicle = Vehicle::draw(number, &Wardrobe::default(), [3.0, -2.0], 0.7, &mut rng);
            let [length, width, height] = vehicle.size_m;
            assert!((3.3..6.3).contains(&length), "{length}");
            assert!((1.5..2.5).contains(&width), "{width}");
            assert!((1.1..2.9).contains(&height), "{height}");
            let reach = vehicle.radius_sphere_m();
            for vertex in vehicle.triangles.iter().flat_map(|t| t.vertices) {
                let apart: f64 = (0..3)
                    .map(|i| (f64::from(vertex[i]) - vehicle.center_world[i]).powi(2))
                    .sum();
                assert!(apart.sqrt() <= reach + 1e-4);
                assert!(vertex.z >= -1e-6);
            }
            let heights = vehicle.triangles.iter().flat_map(|t| t.vertices);
            let lowest = heights.map(|v| v.z).fold(f32::INFINITY, f32::min);
            assert!(lowest < 1e-3, "wheels hang {lowest} m over the ground");
        }
    }

    #[test]
    fn neighbouring_vehicles_differ_in_style_and_paint() {
        let mut rng = Pcg64::seed_from_u64(5);
        let vehicles: Vec<Vehicle> = (0..11)
            .map(|n| Vehicle::draw(n, &Wardrobe::default(), [0.0, 0.0], 0.0, &mut rng))
            .collect();
        for pair in vehicles.windows(2) {
            assert_ne!(pair[0].body_name(), pair[1].body_name());
            assert_ne!(pair[0].paint_name(), pair[1].paint_name());
        }
    }

    #[test]
    fn vehicle_axes_invert_the_placement() {
        let mut rng = Pcg64::seed_from_u64(1);
        let vehicle = Vehicle::draw(2, &Wardrobe::default(), [10.0, 4.0], 2.1, &mut rng);
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
