//! Vehicles as rulers: how large their boxes are at a depth, and how far their centres lie behind
//! what stereo sees of them.
//!
//! A body is a cuboid with a shorter, narrower one on it, standing upright on level ground. Its
//! heading is unknown, and so, unless several vehicles betray it, is how far the camera looks down.

use crate::geometry::{Camera, PixelBox};

/// Headings that are tried, from a side view to a front or rear view.
pub(super) const HEADINGS: usize = 13;

/// Relative spread of a box's width around the body's: bodies of a kind differ, and their outlines
/// are rounded.
const WIDTH_SPREAD: f64 = 0.12;

/// Spread of a body's length as a part of it.
const LENGTH_SPREAD: f64 = 0.10;

/// Relative spread of a height that goes beyond a side border: more of the vehicle may be outside.
const CUT_SPREAD: f64 = 0.12;

/// Height of the lower cuboid as a part of the body's, and length of the upper one.
const CAR_BELT: f64 = 0.6;
const CAR_CABIN: f64 = 0.62;

/// The likelihood of a box that no body explains.
const UNEXPLAINED: f64 = 1e-5;

/// The surface that is matched lies this much of the way from the centre to where the faces of the
/// cuboid are seen: bodies are rounded and taper. On rendered traffic of training splits, 0.85 makes
/// distances 0.8 % too far, 0.65 is right.
const FACE_PART: f64 = 0.65;

/// A box edge within this of the image's border is cut off by it, pixels.
const BORDER_PX: f64 = 1.6;

/// A kind of vehicle: mean sizes, and how much heights differ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// How often vehicles are of this kind; shares of all bodies need not add up to 1.
    pub share: f64,
    /// Mean height, metres.
    pub height_m: f64,
    /// Standard deviation of the height, metres.
    pub height_std_m: f64,
    /// Width, metres.
    pub width_m: f64,
    /// Length, metres.
    pub length_m: f64,
    /// Whether its upper half is shorter than its lower one, as that of a car.
    pub has_cabin: bool,
}

impl Body {
    const CAR: Self = Self {
        share: 0.82,
        height_m: 1.52,
        height_std_m: 0.10,
        width_m: 1.70,
        length_m: 4.2,
        has_cabin: true,
    };
    const VAN: Self = Self {
        share: 0.11,
        height_m: 2.0,
        height_std_m: 0.25,
        width_m: 1.9,
        length_m: 4.9,
        has_cabin: false,
    };
    const TRUCK: Self = Self {
        share: 0.07,
        height_m: 3.2,
        height_std_m: 0.45,
        width_m: 2.5,
        length_m: 9.0,
        has_cabin: false,
    };
    const MOTORCYCLE: Self = Self {
        share: 0.01,
        height_m: 1.45,
        height_std_m: 0.2,
        width_m: 0.8,
        length_m: 2.1,
        has_cabin: false,
    };

    /// What is on streets: cars, vans, lorries and buses.
    pub const TRAFFIC: [Self; 3] = [Self::CAR, Self::VAN, Self::TRUCK];

    /// Bodies that a class name stands for, with a little room for what detectors take for it; those
    /// of traffic for other names.
    pub fn of_class(class: &str) -> Vec<Self> {
        let main = match class.to_ascii_lowercase().as_str() {
            "van" => Self::VAN,
            "truck" | "lorry" | "bus" | "tram" => Self::TRUCK,
            "motorcycle" | "motorbike" | "bicycle" | "cyclist" => Self::MOTORCYCLE,
            // Detectors and labels call vans and pickups cars.
            _ => return Self::TRAFFIC.to_vec(),
        };
        let mut bodies = Self::TRAFFIC.map(|body| Self {
            share: 0.2 * body.share,
            ..body
        });
        if bodies[2].height_m == main.height_m {
            // A small lorry is called a truck as well.
            bodies[1].share = 0.2;
        }
        let mut bodies = bodies.to_vec();
        bodies.push(Self { share: 0.8, ..main });
        bodies
    }
}

/// Which edges of a box are the image's or a nearer vehicle's, so that the vehicle may reach further.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Cut {
    /// The left or the right edge.
    pub sides: bool,
    /// The upper or the lower edge.
    pub ends: bool,
}

/// A box as angles: what the camera saw, without its pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SeenBox {
    /// Width and height at depth 1, metres.
    pub size: [f64; 2],
    /// Centre at depth 1, metres: right and down.
    pub center: [f64; 2],
    /// Relative noise of width and height.
    pub noise: [f64; 2],
    pub cut: Cut,
    /// Cosine of the angle between the ray and the camera's axis, seen from above.
    cos_azimuth: f64,
    /// Length of the ray for each metre of depth.
    pub ray: f64,
}

impl SeenBox {
    /// None for a box without extent.
    ///
    /// `noise` is the standard deviation of an edge's distance from another, as a part of it and in
    /// pixels.
    pub fn new(area: &PixelBox, camera: &Camera, noise: [f64; 2]) -> Option<Self> {
        if !area.is_valid() {
            return None;
        }
        let [x, y, _] = camera.camera_from_pixel(area.center());
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        let [part, px] = noise;
        let relative = |side: f64| libm::hypot(part, px / side);
        let size = [
            area.width() / camera.focal_x_px,
            area.height() / camera.focal_y_px,
        ];
        let finite = size.iter().chain(&[x, y]).all(|value| value.is_finite());
        finite.then_some(Self {
            size,
            center: [x, y],
            noise: [relative(area.width()), relative(area.height())],
            cut: Cut {
                sides: area.x_min < BORDER_PX || area.x_max > width - BORDER_PX,
                ends: area.y_min < BORDER_PX || area.y_max > height - BORDER_PX,
            },
            cos_azimuth: 1.0 / (1.0 + x * x).sqrt(),
            ray: (1.0 + x * x + y * y).sqrt(),
        })
    }
}

/// A body with a heading, before a camera that looks down by an angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stance {
    /// Probability before anything is seen.
    pub share: f64,
    /// Extent across the line of sight, metres.
    across_m: f64,
    /// Depth and downward offsets from the centre to the points that can be the highest and the
    /// lowest in the image, metres.
    tops: [[f64; 2]; 4],
    bottoms: [[f64; 2]; 2],
    /// Standard deviation of the height that is seen, metres.
    height_std_m: f64,
    /// From the surface that is matched to the centre, along the depth, metres.
    pub extent_m: f64,
}

impl Stance {
    /// All headings of all bodies for a camera that looks down by `pitch`, radians, and a box.
    pub fn all(bodies: &[Body], pitch: f64, seen: &SeenBox) -> Vec<Self> {
        let total: f64 = bodies.iter().map(|body| body.share).sum();
        let mut stances = Vec::with_capacity(bodies.len() * HEADINGS);
        for body in bodies {
            for i in 0..HEADINGS {
                let heading = (i as f64 + 0.5) / HEADINGS as f64 * std::f64::consts::FRAC_PI_2;
                let share = body.share / total / HEADINGS as f64;
                stances.push(Self::new(body, heading, pitch, seen, share));
            }
        }
        stances
    }

    fn new(body: &Body, heading: f64, pitch: f64, seen: &SeenBox, share: f64) -> Self {
        let (sin_h, cos_h) = libm::sincos(heading);
        let (sin_p, cos_p) = libm::sincos(pitch);
        let (sin_e, cos_e) = libm::sincos(pitch + libm::atan(seen.center[1]));
        let height = body.height_m;
        let across = body.length_m * cos_h + body.width_m * sin_h;
        let along = body.length_m * sin_h + body.width_m * cos_h;
        let (belt, cabin) = if body.has_cabin {
            ((CAR_BELT - 0.5) * height, CAR_CABIN)
        } else {
            (0.5 * height, 1.0)
        };
        // A point `back` metres behind and `up` metres above the centre, in the camera's depth and
        // downward axes.
        let point = |back: f64, up: f64| {
            let ahead = back * seen.cos_azimuth;
            [ahead * cos_p - up * sin_p, -ahead * sin_p - up * cos_p]
        };
        let half = 0.5 * along;
        let roof = half * cabin;
        let of_height = body.height_std_m * cos_e;
        let of_length = LENGTH_SPREAD * along * sin_e.abs();
        // Mean way to the visible near face and roof, each with the area that is seen of it.
        let reach = height * along / (2.0 * (height * cos_e + along * sin_e.abs()));
        Self {
            share,
            across_m: across / seen.cos_azimuth,
            tops: [
                point(-half, belt),
                point(half, belt),
                point(-roof, 0.5 * height),
                point(roof, 0.5 * height),
            ],
            bottoms: [point(-half, -0.5 * height), point(half, -0.5 * height)],
            height_std_m: libm::hypot(of_height, of_length),
            extent_m: FACE_PART * reach / seen.ray,
        }
    }

    /// Likelihood of a box of this vehicle with its centre at a depth, metres: scale-free, about 1
    /// where everything fits.
    pub fn fits(&self, seen: &SeenBox, z_m: f64) -> [f64; 2] {
        let down = seen.center[1] * z_m;
        let row = |[behind, below]: [f64; 2]| (down + below) / (z_m + behind).max(0.3 * z_m);
        let top = self
            .tops
            .iter()
            .fold(f64::INFINITY, |least, &point| least.min(row(point)));
        let bottom = self
            .bottoms
            .iter()
            .fold(f64::NEG_INFINITY, |most, &point| most.max(row(point)));
        let height = bottom - top;
        let height_noise = if seen.cut.sides {
            seen.noise[1].max(CUT_SPREAD)
        } else {
            seen.noise[1]
        };
        let spread = libm::hypot(self.height_std_m / (height * z_m), height_noise);
        let width = self.across_m / z_m;
        let width_spread = libm::hypot(WIDTH_SPREAD, seen.noise[0]);
        [
            fit(seen.size[0], width, width_spread, seen.cut.sides),
            fit(seen.size[1], height, spread, seen.cut.ends),
        ]
    }
}

/// How well a side that is seen fits the one that is expected. Of one that is cut off, all but a
/// larger one fits.
fn fit(seen: f64, expected: f64, spread: f64, cut: bool) -> f64 {
    let off = (seen - expected) / (spread * expected);
    if cut {
        return if off < 0.0 {
            1.0
        } else {
            libm::exp(-0.5 * off * off)
        };
    }
    0.1 / spread * libm::exp(-0.5 * off * off)
}

/// The likelihood of a box with room for what no body explains.
pub(super) fn with_unexplained(likelihood: f64) -> f64 {
    likelihood + UNEXPLAINED
}
