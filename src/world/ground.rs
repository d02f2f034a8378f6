//! What the ground looks like at a point: asphalt, markings, pavement, grass, squares.

use glam::Vec3A;

use super::layout::{Block, Layout, Nearest, PAVEMENT_M, Use};
use super::noise::{self, fractal, mix, smooth_step, stripe, stripes};

/// Reflectance of the ground at a point, averaged over the pixel's footprint.
pub(crate) fn albedo(layout: &Layout, x: f32, y: f32, footprint_m: f32) -> Vec3A {
    let across = [layout.nearest(0, x), layout.nearest(1, y)];
    let on_road = across.map(|near| near.offset.abs() < near.half_width);
    if on_road[0] || on_road[1] {
        return road(layout, [x, y], across, on_road, footprint_m);
    }
    match layout.block_at(x, y) {
        Some(block) => block_ground(block, x, y, footprint_m),
        None => grass(x, y, footprint_m, layout.seed),
    }
}

fn asphalt(x: f32, y: f32, footprint_m: f32, seed: u32) -> Vec3A {
    let large = fractal(x, y, 9.0, 2, footprint_m, seed);
    let fine = fractal(x, y, 0.9, 4, footprint_m, seed ^ 0x51);
    let mut level = 0.105 * (1.0 + 0.22 * large + 0.34 * fine);
    // Repaired patches: some cells of a coarse grid are darker or lighter, with sharp edges.
    let (cell_x, cell_y) = ((x / 3.7).floor(), (y / 2.3).floor());
    let patch = noise::hash(cell_x as i32, cell_y as i32, seed ^ 0x77);
    if patch.is_multiple_of(9) {
        level *= 0.72 + 0.4 * noise::unit(patch ^ 0x5bd1);
    }
    // Cracks follow the zero line of a noise field.
    let crack = (noise::value(x * 0.45, y * 0.45, seed ^ 0x31) - 0.5).abs();
    let crack_width_m = 0.012;
    let coverage = (crack_width_m / (crack_width_m + footprint_m)).min(1.0);
    if crack < 0.012 + footprint_m * 0.05 {
        level *= 1.0 - 0.6 * coverage;
    }
    Vec3A::new(1.0, 0.99, 0.97) * level
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
    if on_road[0] && on_road[1] {
        return surface;
    }
    // `side` runs across the road, `along` with it; the crossing road bounds the markings.
    let axis = usize::from(on_road[1]);
    let (side, along) = (across[axis].offset, at[1 - axis]);
    let half_width = across[axis].half_width;
    let to_crossing = across[1 - axis].offset.abs() - across[1 - axis].half_width;
    let lane = half_width * if half_width > 5.0 { 0.5 } else { 1.0 };

    // Tyres polish two tracks in each lane.
    let in_lane = side.abs() % lane;
    let track = stripe(in_lane, lane * 0.27, 0.28, footprint_m)
        + stripe(in_lane, lane * 0.73, 0.28, footprint_m);
    let oil = stripe(in_lane, lane * 0.5, 0.35, footprint_m);
    let mut color = surface * (1.0 - 0.13 * track - 0.08 * oil);

    let mut paint: f32 = 0.0;
    if to_crossing > 4.6 {
        let line = |at_side: f32| stripe(side, at_side, 0.07, footprint_m);
        if half_width > 5.0 {
            paint += line(-0.13) + line(0.13);
            let dashes = stripes(along, 9.0, 0.0, 3.5, footprint_m);
            paint += (line(-lane) + line(lane)) * dashes;
        } else {
            paint += line(0.0) * stripes(along, 6.0, 0.0, 3.0, footprint_m);
        }
        paint += line(0.3 - half_width) + line(half_width - 0.3);
        paint += stripe(to_crossing, 5.1, 0.22, footprint_m)
            * f32::from(u8::from(side.abs() < half_width - 0.4));
    } else if (0.7..3.9).contains(&to_crossing) {
        paint += stripes(side, 1.1, 0.3, 0.55, footprint_m);
    }
    let wear = 0.78 + 0.3 * fractal(x, y, 0.7, 3, footprint_m, layout.seed ^ 0x9);
    color += (Vec3A::new(0.62, 0.61, 0.57) - color) * (paint.min(1.0) * wear.clamp(0.0, 1.0));
    if let Some(cover) = manhole(at, layout.seed) {
        color = cover;
    }
    // Dirt gathers in the gutter.
    color * (1.0 - 0.35 * smooth_step(half_width - 0.45, half_width, side.abs()))
}

/// The colour of the manhole cover at a point, if there is one.
fn manhole([x, y]: [f32; 2], seed: u32) -> Option<Vec3A> {
    const CELL_M: f32 = 7.0;
    let cell = [x, y].map(|v| (v / CELL_M).floor());
    let draw = noise::hash(cell[0] as i32, cell[1] as i32, seed ^ 0x4d);
    if !draw.is_multiple_of(5) {
        return None;
    }
    let center =
        [draw >> 8, draw >> 16].map(|bits| CELL_M * (0.2 + 0.6 * f32::from(bits as u8) / 255.0));
    let [dx, dy] = [
        x - cell[0] * CELL_M - center[0],
        y - cell[1] * CELL_M - center[1],
    ];
    let apart = (dx * dx + dy * dy).sqrt();
    (apart < 0.36).then(|| Vec3A::splat(if apart > 0.30 { 0.13 } else { 0.045 }))
}

fn block_ground(block: &Block, x: f32, y: f32, footprint_m: f32) -> Vec3A {
    let inside = (x - block.low[0])
        .min(block.high[0] - x)
        .min((y - block.low[1]).min(block.high[1] - y));
    if inside < PAVEMENT_M {
        return pavement(block, inside, x, y, footprint_m);
    }
    let seed = block.seed;
    match block.usage {
        Use::Park => park(block, x, y, footprint_m),
        Use::Houses => grass(x, y, footprint_m, seed),
        Use::Plaza => square(x, y, footprint_m, seed),
        Use::Parking => {
            let bay = stripes(x, 2.6, 0.0, 0.12, footprint_m);
            let row = stripes(y, 11.0, 0.0, 5.2, footprint_m);
            let paint = bay * row + stripes(y, 11.0, 2.5, 0.12, footprint_m);
            let surface = asphalt(x, y, footprint_m, seed);
            surface + (Vec3A::splat(0.55) - surface) * (0.75 * paint.min(1.0))
        }
        Use::Built => {
            let grain = fractal(x, y, 1.5, 4, footprint_m, seed);
            Vec3A::new(0.24, 0.225, 0.20) * (1.0 + 0.35 * grain)
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
        Vec3A::new(0.27, 0.262, 0.245),
        Vec3A::new(0.22, 0.216, 0.212),
        Vec3A::new(0.28, 0.235, 0.195),
    ][(block.seed >> 4) as usize % 3];
    base * (1.0 + 0.28 * slab + 0.26 * stains) * (1.0 - 0.45 * joints)
}

fn grass(x: f32, y: f32, footprint_m: f32, seed: u32) -> Vec3A {
    let large = fractal(x, y, 14.0, 3, footprint_m, seed);
    let fine = fractal(x, y, 0.5, 3, footprint_m, seed ^ 0x2f);
    let dry = (0.5 + 0.9 * large).clamp(0.0, 1.0);
    let tone = Vec3A::new(0.055, 0.105, 0.03) * (1.0 - dry) + Vec3A::new(0.135, 0.135, 0.055) * dry;
    tone * (1.0 + 0.55 * fine)
}

fn park(block: &Block, x: f32, y: f32, footprint_m: f32) -> Vec3A {
    let [middle_x, middle_y] = [0, 1].map(|i| f32::midpoint(block.low[i], block.high[i]));
    // Two paths that cross in the middle; bent so that they do not run along a pixel row.
    let bend = 2.0 * noise::value(x * 0.06, y * 0.06, block.seed);
    let (dx, dy) = (x - middle_x + bend, y - middle_y - bend);
    let on_path = ((dx - dy).abs() < 1.9) || ((dx + dy).abs() < 1.9) || (dx * dx + dy * dy < 42.0);
    if on_path {
        let grain = fractal(x, y, 1.1, 4, footprint_m, block.seed);
        Vec3A::new(0.36, 0.30, 0.215) * (1.0 + 0.3 * grain)
    } else {
        grass(x, y, footprint_m, block.seed)
    }
}

fn square(x: f32, y: f32, footprint_m: f32, seed: u32) -> Vec3A {
    let checks = (stripes(x, 6.0, 0.0, 3.0, footprint_m) - 0.5)
        * (stripes(y, 6.0, 0.0, 3.0, footprint_m) - 0.5);
    let joints =
        stripes(x, 0.75, 0.0, 0.03, footprint_m).max(stripes(y, 0.75, 0.0, 0.03, footprint_m));
    let stains = fractal(x, y, 2.4, 4, footprint_m, seed);
    Vec3A::new(0.34, 0.31, 0.28) * (1.0 + 0.6 * checks + 0.22 * stains) * (1.0 - 0.4 * joints)
}
