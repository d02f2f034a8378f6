//! What the ground looks like at a point: asphalt, markings, pavement, grass, squares.

use glam::Vec3A;

use super::layout::{Block, Layout, Nearest, PAVEMENT_M, Use};
use super::noise::{self, fractal, mix, smooth_step, stripe, stripes};

/// Radius of the kerb at the corners of blocks, metres.
const CORNER_M: f32 = 4.5;

/// The ground at a point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Soil {
    /// Reflectance, averaged over the pixel's footprint.
    pub albedo: Vec3A,
    /// 1 where rain stays on top, 0 where it seeps away.
    pub paved: f32,
}

/// The ground at a point.
pub(crate) fn look(layout: &Layout, x: f32, y: f32, footprint_m: f32) -> Soil {
    let across = [layout.nearest(0, x), layout.nearest(1, y)];
    let on_road = across.map(|near| near.offset.abs() < near.half_width);
    let paved = |albedo: Vec3A| Soil { albedo, paved: 1.0 };
    if on_road[0] || on_road[1] {
        return paved(road(layout, [x, y], across, on_road, footprint_m));
    }
    let Some(block) = layout.block_at(x, y) else {
        return Soil {
            albedo: grass(x, y, footprint_m, layout.seed),
            paved: 0.0,
        };
    };
    let inside = inside(block, x, y);
    if inside < 0.0 {
        // The rounded corner of a crossing.
        let surface = asphalt(x, y, footprint_m, layout.seed);
        return paved(surface * (1.0 - 0.35 * smooth_step(0.45, 0.0, -inside)));
    }
    block_ground(block, inside, x, y, footprint_m)
}

/// How far inside a block's kerb a point lies, metres.
fn inside(block: &Block, x: f32, y: f32) -> f32 {
    let [dx, dy] = [(x, 0), (y, 1)].map(|(v, i)| {
        let half = 0.5 * (block.high[i] - block.low[i]);
        (v - 0.5 * (block.high[i] + block.low[i])).abs() - half + CORNER_M
    });
    let (ex, ey) = (dx.max(0.0), dy.max(0.0));
    CORNER_M - (ex * ex + ey * ey).sqrt() - dx.max(dy).min(0.0)
}

fn asphalt(x: f32, y: f32, footprint_m: f32, seed: u32) -> Vec3A {
    let large = fractal(x, y, 11.0, 2, footprint_m, seed);
    let fine = fractal(x, y, 0.55, 3, footprint_m, seed ^ 0x51);
    let mut level = 0.098 * (1.0 + 0.14 * large + 0.16 * fine);
    // Stones in the bitumen.
    let near = (1.3 - footprint_m / 0.03).clamp(0.0, 1.0);
    if near > 0.0 {
        let cell = [x, y].map(|v| (v * 45.0).floor() as i32);
        let stone = noise::unit(noise::hash(cell[0], cell[1], seed ^ 0x53));
        level *= 1.0 + 0.55 * near * (stone - 0.5);
    }
    // Repaired patches: some cells of a coarse grid are darker or lighter, with tarred seams.
    let (cell_x, cell_y) = ((x / 3.7).floor(), (y / 2.3).floor());
    let patch = noise::hash(cell_x as i32, cell_y as i32, seed ^ 0x77);
    if patch.is_multiple_of(13) {
        let (u, v) = (x - cell_x * 3.7, y - cell_y * 2.3);
        let size = [
            2.2 + 1.4 * noise::unit(patch ^ 0x1),
            1.2 + noise::unit(patch ^ 0x2),
        ];
        if u < size[0] && v < size[1] {
            level *= 0.70 + 0.42 * noise::unit(patch ^ 0x5bd1);
            let seam = u.min(size[0] - u).min(v).min(size[1] - v);
            level *= 1.0 - 0.5 * stripe(seam, 0.0, 0.035, footprint_m);
        }
    }
    level *= 1.0 - 0.62 * crack(x, y, footprint_m, seed);
    Vec3A::new(1.0, 0.99, 0.965) * level
}

/// Share of the pixel that a crack covers: cracks follow the zero line of a noise field.
fn crack(x: f32, y: f32, footprint_m: f32, seed: u32) -> f32 {
    const SCALE: f32 = 0.33;
    const HALF_WIDTH_M: f32 = 0.011;
    const STEP: f32 = 0.12;
    let bend = 0.5 * noise::value(x * 1.9, y * 1.9, seed ^ 0x33);
    let field = |x: f32, y: f32| noise::value(x * SCALE + bend, y * SCALE, seed ^ 0x31) - 0.5;
    let here = field(x, y);
    if here.abs() > 0.06 || footprint_m > 0.25 {
        return 0.0;
    }
    // The distance to the line is the field over its slope.
    let [dx, dy] = [field(x + STEP, y) - here, field(x, y + STEP) - here];
    let slope = (dx * dx + dy * dy).sqrt() / STEP;
    if slope < 0.02 {
        return 0.0;
    }
    // Only some parts of the line are broken open.
    let broken = smooth_step(0.45, 0.6, noise::value(x * 0.13, y * 0.13, seed ^ 0x35));
    stripe(here / slope, 0.0, HALF_WIDTH_M, footprint_m) * broken
}

fn road(
    layout: &Layout,
    at: [f32; 2],
    across: [Nearest; 2],
    on_road: [bool; 2],
    footprint_m: f32,
) -> Vec3A {
    let [x, y] = at;
    let surface = asphalt(x, y, footprint_m, layout.seed);
    let mut color = surface;
    if !(on_road[0] && on_road[1]) {
        // `side` runs across the road, `along` with it; the crossing road bounds the markings.
        let axis = usize::from(on_road[1]);
        let lane = Lane::new(axis, across, at[1 - axis]);
        color *= lane.wear(footprint_m);
        let (paint, tint) = lane.paint(layout.seed, footprint_m);
        if paint > 0.0 {
            let wear = 0.74 + 0.34 * fractal(x, y, 0.6, 3, footprint_m, layout.seed ^ 0x9);
            color += (tint - color) * (paint.min(1.0) * wear.clamp(0.0, 1.0));
        }
        // Dirt gathers in the gutter.
        let edge = lane.half_width - lane.side.abs();
        color *= 1.0 - 0.38 * smooth_step(0.45, 0.0, edge);
    }
    if let Some(cover) = manhole(at, layout.seed, footprint_m) {
        color = cover;
    }
    color
}

/// A place on a road between crossings.
struct Lane {
    /// Offset from the road's middle, metres, and where it is along the road.
    side: f32,
    along: f32,
    half_width: f32,
    width_m: f32,
    /// Distance to the crossing road's kerb.
    to_crossing: f32,
    /// Whether traffic on this side drives towards the crossing; it keeps to the right.
    approaching: bool,
}

impl Lane {
    fn new(axis: usize, across: [Nearest; 2], along: f32) -> Self {
        let [road, crossing] = [across[axis], across[1 - axis]];
        let half_width = road.half_width;
        let forth = if axis == 0 { road.offset } else { -road.offset };
        Self {
            side: road.offset,
            along,
            half_width,
            width_m: half_width * if half_width > 5.0 { 0.5 } else { 1.0 },
            to_crossing: crossing.offset.abs() - crossing.half_width,
            approaching: forth * crossing.offset < 0.0,
        }
    }

    /// Tyres polish two tracks in each lane, oil drips between them, braking blackens the tracks.
    fn wear(&self, footprint_m: f32) -> f32 {
        let lane = self.width_m;
        let in_lane = self.side.abs() % lane;
        let track = stripe(in_lane, lane * 0.27, 0.30, footprint_m)
            + stripe(in_lane, lane * 0.73, 0.30, footprint_m);
        let oil = stripe(in_lane, lane * 0.5, 0.32, footprint_m);
        let braking = if self.approaching {
            smooth_step(26.0, 6.0, self.to_crossing)
        } else {
            0.0
        };
        1.0 - (0.09 + 0.12 * braking) * track - 0.07 * (1.0 + braking) * oil
    }

    /// Share of the pixel that is road paint, and its colour.
    fn paint(&self, seed: u32, footprint_m: f32) -> (f32, Vec3A) {
        const WHITE: Vec3A = Vec3A::new(0.60, 0.59, 0.56);
        const YELLOW: Vec3A = Vec3A::new(0.52, 0.36, 0.06);
        let Self {
            side,
            along,
            half_width,
            width_m,
            to_crossing,
            ..
        } = *self;
        if to_crossing < 4.6 {
            let zebra = if (0.9..4.1).contains(&to_crossing) && side.abs() < half_width - 0.3 {
                stripes(side, 1.05, 0.28, 0.52, footprint_m)
            } else {
                0.0
            };
            return (zebra, WHITE);
        }
        let line = |at_side: f32| stripe(side, at_side, 0.07, footprint_m);
        let stop = if self.approaching && side.abs() < half_width - 0.3 {
            stripe(to_crossing, 5.2, 0.22, footprint_m)
        } else {
            0.0
        };
        let middle = if half_width > 5.0 {
            line(-0.13) + line(0.13)
        } else {
            line(0.0) * stripes(along, 6.0, 0.0, 3.0, footprint_m)
        };
        let tint = if seed.is_multiple_of(3) {
            YELLOW
        } else {
            WHITE
        };
        if middle > 0.0 {
            return (middle, tint);
        }
        let mut paint = stop;
        if half_width > 5.0 {
            // Solid before the crossing, dashed elsewhere.
            let dashes = if to_crossing < 22.0 {
                1.0
            } else {
                stripes(along, 9.0, 0.0, 3.5, footprint_m)
            };
            paint += (line(-width_m) + line(width_m)) * dashes;
        }
        if !seed.is_multiple_of(4) {
            paint += line(0.35 - half_width) + line(half_width - 0.35);
        }
        if self.approaching && (8.0..13.5).contains(&to_crossing) {
            paint += self.arrow(footprint_m);
        }
        (paint, WHITE)
    }

    /// An arrow in the middle of the lane towards the crossing.
    fn arrow(&self, footprint_m: f32) -> f32 {
        let off = self.side.abs() % self.width_m - self.width_m * 0.5;
        let ahead = self.to_crossing - 8.0;
        if ahead < 1.7 {
            stripe(off, 0.0, 0.42 * ahead / 1.7, footprint_m)
        } else if ahead < 5.0 {
            stripe(off, 0.0, 0.075, footprint_m)
        } else {
            0.0
        }
    }
}

/// The colour of the manhole cover or drain at a point, if there is one.
fn manhole([x, y]: [f32; 2], seed: u32, footprint_m: f32) -> Option<Vec3A> {
    const CELL_M: f32 = 9.0;
    let cell = [x, y].map(|v| (v / CELL_M).floor());
    let draw = noise::hash(cell[0] as i32, cell[1] as i32, seed ^ 0x4d);
    if !draw.is_multiple_of(4) {
        return None;
    }
    let center =
        [draw >> 8, draw >> 16].map(|bits| CELL_M * (0.2 + 0.6 * f32::from(bits as u8) / 255.0));
    let [dx, dy] = [
        x - cell[0] * CELL_M - center[0],
        y - cell[1] * CELL_M - center[1],
    ];
    let apart = (dx * dx + dy * dy).sqrt();
    let ribs = stripes(dx + dy, 0.09, 0.0, 0.045, footprint_m);
    (apart < 0.38).then(|| {
        if apart > 0.33 {
            Vec3A::splat(0.13)
        } else {
            Vec3A::new(0.062, 0.058, 0.054) * (0.75 + 0.5 * ribs)
        }
    })
}

fn block_ground(block: &Block, inside: f32, x: f32, y: f32, footprint_m: f32) -> Soil {
    let paved = |albedo: Vec3A| Soil { albedo, paved: 1.0 };
    let soft = |albedo: Vec3A| Soil { albedo, paved: 0.0 };
    let edge = (x - block.low[0])
        .min(block.high[0] - x)
        .min((y - block.low[1]).min(block.high[1] - y));
    if edge < PAVEMENT_M || inside < PAVEMENT_M * 0.5 {
        return paved(pavement(block, inside, x, y, footprint_m));
    }
    let seed = block.seed;
    match block.usage {
        Use::Park => park(block, x, y, footprint_m),
        Use::Houses => soft(grass(x, y, footprint_m, seed)),
        Use::Plaza => paved(square(x, y, footprint_m, seed)),
        Use::Parking => {
            let bay = stripes(x, 2.6, 0.0, 0.12, footprint_m);
            let row = stripes(y, 11.0, 0.0, 5.2, footprint_m);
            let paint = bay * row + stripes(y, 11.0, 2.5, 0.12, footprint_m);
            let surface = asphalt(x, y, footprint_m, seed);
            paved(surface + (Vec3A::splat(0.52) - surface) * (0.75 * paint.min(1.0)))
        }
        Use::Built => {
            let grain = fractal(x, y, 1.5, 4, footprint_m, seed);
            let joints = stripes(x, 1.2, 0.0, 0.02, footprint_m).max(stripes(
                y,
                1.2,
                0.0,
                0.02,
                footprint_m,
            ));
            let tone = Vec3A::new(0.21, 0.20, 0.185);
            paved(tone * (1.0 + 0.22 * grain) * (1.0 - 0.4 * joints))
        }
    }
}

fn pavement(block: &Block, inside: f32, x: f32, y: f32, footprint_m: f32) -> Vec3A {
    if inside < 0.22 {
        let joints = stripes(x + y, 1.0, 0.0, 0.02, footprint_m);
        let edge = mix(0.14, 0.40, smooth_step(0.02, 0.06, inside));
        return Vec3A::splat(edge * (1.0 - 0.5 * joints));
    }
    let size_m = if block.seed.is_multiple_of(3) {
        0.4
    } else {
        0.6
    };
    let joints =
        stripes(x, size_m, 0.0, 0.03, footprint_m).max(stripes(y, size_m, 0.0, 0.03, footprint_m));
    let slab = noise::unit(noise::hash(
        (x / size_m).floor() as i32,
        (y / size_m).floor() as i32,
        block.seed,
    )) - 0.5;
    let slab = slab * (1.4 - footprint_m / size_m).clamp(0.0, 1.0);
    let stains = fractal(x, y, 3.0, 4, footprint_m, block.seed);
    let base = [
        Vec3A::new(0.255, 0.247, 0.232),
        Vec3A::new(0.205, 0.202, 0.199),
        Vec3A::new(0.265, 0.222, 0.185),
    ][(block.seed >> 4) as usize % 3];
    // Chewing gum and other spots.
    let near = (1.2 - footprint_m / 0.05).clamp(0.0, 1.0);
    let spot = if near > 0.0 {
        let cell = noise::hash(
            (x * 9.0).floor() as i32,
            (y * 9.0).floor() as i32,
            block.seed,
        );
        f32::from(u8::from(cell.is_multiple_of(41))) * near
    } else {
        0.0
    };
    let grain = fractal(x, y, 0.25, 2, footprint_m, block.seed ^ 0x1d);
    base * ((1.0 + 0.20 * slab + 0.16 * stains + 0.10 * grain)
        * (1.0 - 0.45 * joints)
        * (1.0 - 0.3 * spot))
}

fn grass(x: f32, y: f32, footprint_m: f32, seed: u32) -> Vec3A {
    let large = fractal(x, y, 14.0, 3, footprint_m, seed);
    let fine = fractal(x, y, 0.5, 3, footprint_m, seed ^ 0x2f);
    let dry = (0.5 + 0.9 * large).clamp(0.0, 1.0);
    let tone =
        Vec3A::new(0.050, 0.088, 0.026) * (1.0 - dry) + Vec3A::new(0.115, 0.118, 0.048) * dry;
    // Blades throw shade on each other.
    let blades = if footprint_m < 0.08 {
        let cell = noise::hash(
            (x * 28.0).floor() as i32,
            (y * 28.0).floor() as i32,
            seed ^ 0x6b,
        );
        (noise::unit(cell) - 0.5) * (1.2 - footprint_m / 0.07).clamp(0.0, 1.0)
    } else {
        0.0
    };
    tone * (1.0 + 0.45 * fine + 0.6 * blades)
}

fn park(block: &Block, x: f32, y: f32, footprint_m: f32) -> Soil {
    let [middle_x, middle_y] = [0, 1].map(|i| f32::midpoint(block.low[i], block.high[i]));
    // Two paths that cross in the middle; bent so that they do not run along a pixel row.
    let bend = 2.0 * noise::value(x * 0.06, y * 0.06, block.seed);
    let (dx, dy) = (x - middle_x + bend, y - middle_y - bend);
    let on_path = ((dx - dy).abs() < 1.9) || ((dx + dy).abs() < 1.9) || (dx * dx + dy * dy < 42.0);
    if on_path {
        let grain = fractal(x, y, 1.1, 4, footprint_m, block.seed);
        Soil {
            albedo: Vec3A::new(0.30, 0.25, 0.185) * (1.0 + 0.3 * grain),
            paved: 0.4,
        }
    } else {
        Soil {
            albedo: grass(x, y, footprint_m, block.seed),
            paved: 0.0,
        }
    }
}

fn square(x: f32, y: f32, footprint_m: f32, seed: u32) -> Vec3A {
    let checks = (stripes(x, 6.0, 0.0, 3.0, footprint_m) - 0.5)
        * (stripes(y, 6.0, 0.0, 3.0, footprint_m) - 0.5);
    let joints =
        stripes(x, 0.75, 0.0, 0.03, footprint_m).max(stripes(y, 0.75, 0.0, 0.03, footprint_m));
    let stains = fractal(x, y, 2.4, 4, footprint_m, seed);
    Vec3A::new(0.29, 0.265, 0.24) * (1.0 + 0.4 * checks + 0.18 * stains) * (1.0 - 0.4 * joints)
}
