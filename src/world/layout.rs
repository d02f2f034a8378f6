//! The city's plan: straight roads in two directions and the blocks between them.

use rand::{Rng, RngExt as _};

/// Width of the pavement along a block's edge, metres.
pub(crate) const PAVEMENT_M: f32 = 3.2;

/// A straight road across the whole city.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Road {
    /// Where its middle crosses the other axis, metres.
    pub center: f32,
    /// Half its width from kerb to kerb, metres.
    pub half_width: f32,
}

/// What a block is used for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Use {
    /// Blocks of flats and offices.
    Built,
    /// Houses with gardens.
    Houses,
    /// Grass, paths and trees.
    Park,
    /// A paved square.
    Plaza,
    /// Empty parking bays.
    Parking,
}

/// A block between four roads.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Block {
    /// Corner with the lowest coordinates, at the kerb.
    pub low: [f32; 2],
    /// Corner with the highest coordinates, at the kerb.
    pub high: [f32; 2],
    /// What it is used for.
    pub usage: Use,
    /// Varies its textures.
    pub seed: u32,
}

/// The plan of a city.
#[derive(Debug)]
pub(crate) struct Layout {
    /// Roads across the x axis (each runs along y) and across the y axis, sorted by position.
    pub roads: [Vec<Road>; 2],
    blocks: Vec<Block>,
    /// Varies the textures of roads.
    pub seed: u32,
}

/// Where a point lies against the roads of one direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Nearest {
    /// Distance from its middle, signed, metres.
    pub offset: f32,
    /// Half its width, metres.
    pub half_width: f32,
}

impl Layout {
    /// A city that reaches at least `reach_m` from the origin, where a wide road crosses the x axis.
    pub fn draw(reach_m: f32, rng: &mut impl Rng) -> Self {
        let mut line = |first_half_width: f32| {
            let mut roads = vec![Road {
                center: 0.0,
                half_width: first_half_width,
            }];
            for direction in [-1.0, 1.0] {
                let mut center = 0.0;
                while center < reach_m {
                    center += rng.random_range(58.0..92.0_f32);
                    let half_width = if rng.random_bool(0.3) { 6.6 } else { 3.9 };
                    roads.push(Road {
                        center: direction * center,
                        half_width,
                    });
                }
            }
            roads.sort_by(|a, b| a.center.total_cmp(&b.center));
            roads
        };
        let mut roads = [line(6.6), line(3.9)];
        // The second direction is shifted so that the origin is not always on a crossing.
        let shift = rng.random_range(-38.0..38.0_f32);
        for road in &mut roads[1] {
            road.center += shift;
        }
        let mut blocks = Vec::new();
        for x in roads[0].windows(2) {
            for y in roads[1].windows(2) {
                let low = [x[0].center + x[0].half_width, y[0].center + y[0].half_width];
                let high = [x[1].center - x[1].half_width, y[1].center - y[1].half_width];
                let usage = match rng.random_range(0..100_u32) {
                    0..52 => Use::Built,
                    52..72 => Use::Houses,
                    72..84 => Use::Park,
                    84..92 => Use::Plaza,
                    _ => Use::Parking,
                };
                blocks.push(Block {
                    low,
                    high,
                    usage,
                    seed: rng.random(),
                });
            }
        }
        Self {
            roads,
            blocks,
            seed: rng.random(),
        }
    }

    /// The road of one direction that is nearest to a coordinate.
    pub fn nearest(&self, axis: usize, coordinate: f32) -> Nearest {
        let roads = &self.roads[axis];
        let above = roads
            .partition_point(|road| road.center < coordinate)
            .min(roads.len() - 1);
        let below = above.saturating_sub(1);
        let gap = |i: usize| (coordinate - roads[i].center).abs() - roads[i].half_width;
        let index = if gap(below) < gap(above) {
            below
        } else {
            above
        };
        let Road { center, half_width } = roads[index];
        Nearest {
            offset: coordinate - center,
            half_width,
        }
    }

    /// The blocks, row by row.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// Mutable access for the scene, which decides what stands around the vehicle.
    pub fn blocks_mut(&mut self) -> &mut [Block] {
        &mut self.blocks
    }

    /// The block at a point that is not on a road; None outside the city.
    pub fn block_at(&self, x: f32, y: f32) -> Option<&Block> {
        let cell = |axis: usize, coordinate: f32| {
            let roads = &self.roads[axis];
            let above = roads.partition_point(|road| road.center < coordinate);
            (above > 0 && above < roads.len()).then(|| above - 1)
        };
        let (column, row) = (cell(0, x)?, cell(1, y)?);
        self.blocks.get(column * (self.roads[1].len() - 1) + row)
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn every_point_is_on_a_road_or_in_the_block_around_it() {
        let layout = Layout::draw(200.0, &mut Pcg64::seed_from_u64(3));
        for i in 0..60_u8 {
            for j in 0..60_u8 {
                let [x, y] = [i, j].map(|k| -190.0 + f32::from(k) * 6.37);
                let [near_x, near_y] = [layout.nearest(0, x), layout.nearest(1, y)];
                let on_road = [near_x, near_y]
                    .iter()
                    .any(|n| n.offset.abs() <= n.half_width);
                let block = layout.block_at(x, y).unwrap();
                let inside = x >= block.low[0]
                    && x <= block.high[0]
                    && y >= block.low[1]
                    && y <= block.high[1];
                assert_eq!(on_road, !inside, "at {x}, {y}");
            }
        }
    }
}
