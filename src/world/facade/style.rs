//! Types of building: materials, windows and what goes with them.

use glam::Vec3A;
use rand::{Rng, RngExt as _};

/// Everything about a building but its size.
#[expect(
    clippy::struct_excessive_bools,
    reason = "each is a part that a building has or lacks, in any combination"
)]
#[derive(Debug, Clone, Copy)]
pub(crate) struct Style {
    pub(super) wall: Vec3A,
    /// Surrounds, ledges and the ground floor.
    pub(super) stone: Vec3A,
    pub(super) frame: Vec3A,
    pub(super) roof: Vec3A,
    /// What the glass lets be seen of itself.
    pub(super) tint: Vec3A,
    pub(super) texture: WallTexture,
    /// Height of the ground floor and of those above.
    pub ground_m: f32,
    pub floor_m: f32,
    pub(super) bay_m: f32,
    /// Part of a bay's width, and of a floor's height, that is window.
    pub(super) window: [f32; 2],
    /// How deep the glass lies behind the wall.
    pub(super) recess_m: f32,
    /// Panes beside each other in a window.
    pub(super) panes: f32,
    pub(super) ledge: bool,
    pub(super) shutters: bool,
    pub(super) surround: bool,
    /// Shops along the street.
    pub shops: bool,
    /// Balconies in front of some windows.
    pub balconies: bool,
    pub seed: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WallTexture {
    Plaster,
    Brick,
    Panels,
    Curtain,
}

const WALLS: [[f32; 3]; 14] = [
    [0.50, 0.44, 0.34],
    [0.56, 0.53, 0.47],
    [0.36, 0.22, 0.15],
    [0.31, 0.145, 0.10],
    [0.25, 0.245, 0.24],
    [0.58, 0.46, 0.28],
    [0.22, 0.105, 0.08],
    [0.62, 0.60, 0.56],
    [0.35, 0.37, 0.39],
    [0.46, 0.31, 0.22],
    [0.31, 0.36, 0.33],
    [0.60, 0.54, 0.43],
    [0.52, 0.34, 0.26],
    [0.40, 0.42, 0.47],
];
const SHOP_COLORS: [[f32; 3]; 8] = [
    [0.30, 0.02, 0.02],
    [0.02, 0.10, 0.06],
    [0.02, 0.05, 0.20],
    [0.03, 0.03, 0.03],
    [0.42, 0.38, 0.30],
    [0.45, 0.20, 0.02],
    [0.03, 0.16, 0.20],
    [0.20, 0.10, 0.05],
];

/// The colour of a shop by its number.
pub(crate) fn shop_color(number: u32) -> Vec3A {
    Vec3A::from_array(SHOP_COLORS[number as usize % SHOP_COLORS.len()])
}

impl Style {
    /// A random style for a building of this height.
    pub fn draw(height: f32, ridge: f32, rng: &mut impl Rng) -> Self {
        let tall = height > 15.0;
        let texture = match rng.random_range(0..10_u32) {
            0..4 => WallTexture::Plaster,
            4..7 => WallTexture::Brick,
            7..9 if tall => WallTexture::Curtain,
            _ => WallTexture::Panels,
        };
        let wall = match texture {
            WallTexture::Brick => WALLS[[2, 3, 6, 9][rng.random_range(0..4_usize)]],
            WallTexture::Curtain => WALLS[[4, 8, 13, 7][rng.random_range(0..4_usize)]],
            _ => WALLS[rng.random_range(0..WALLS.len())],
        };
        let roofs: [[f32; 3]; 4] = if ridge > 0.0 {
            [
                [0.30, 0.11, 0.065],
                [0.20, 0.085, 0.06],
                [0.11, 0.11, 0.115],
                [0.17, 0.125, 0.095],
            ]
        } else {
            [
                [0.22, 0.215, 0.20],
                [0.30, 0.29, 0.27],
                [0.12, 0.12, 0.125],
                [0.26, 0.23, 0.19],
            ]
        };
        let tints = [
            [0.020, 0.026, 0.030],
            [0.012, 0.030, 0.034],
            [0.030, 0.028, 0.022],
            [0.016, 0.020, 0.034],
        ];
        let curtain = texture == WallTexture::Curtain;
        let ribbon = texture == WallTexture::Panels && tall && rng.random_bool(0.5);
        let window = if curtain {
            [0.95, rng.random_range(0.70..0.92_f32)]
        } else if ribbon {
            [0.97, rng.random_range(0.42..0.55_f32)]
        } else {
            [
                rng.random_range(0.34..0.60_f32),
                rng.random_range(0.46..0.62_f32),
            ]
        };
        let shops = ridge == 0.0 && height > 7.0 && rng.random_bool(0.6);
        Self {
            wall: Vec3A::from_array(wall) * rng.random_range(0.82..1.12_f32),
            stone: Vec3A::from_array(
                [[0.52, 0.49, 0.43], [0.40, 0.38, 0.35], [0.58, 0.56, 0.53]]
                    [rng.random_range(0..3_usize)],
            ),
            frame: Vec3A::splat([0.62, 0.05, 0.20][rng.random_range(0..3_usize)]),
            roof: Vec3A::from_array(roofs[rng.random_range(0..4_usize)]),
            tint: Vec3A::from_array(tints[rng.random_range(0..4_usize)]),
            texture,
            ground_m: if shops {
                rng.random_range(3.9..4.6_f32)
            } else {
                3.3
            },
            floor_m: rng.random_range(2.9..3.6_f32),
            bay_m: if curtain || ribbon {
                rng.random_range(1.3..2.2_f32)
            } else {
                rng.random_range(2.2..3.8_f32)
            },
            window,
            recess_m: if curtain {
                0.06
            } else {
                rng.random_range(0.12..0.28_f32)
            },
            panes: if curtain || ribbon { 1.0 } else { 2.0 },
            ledge: texture == WallTexture::Plaster && rng.random_bool(0.6),
            shutters: texture == WallTexture::Plaster && !tall && rng.random_bool(0.4),
            surround: texture == WallTexture::Brick || rng.random_bool(0.3),
            shops,
            balconies: !curtain && !ribbon && ridge == 0.0 && rng.random_bool(0.35),
            seed: rng.random(),
        }
    }
}
