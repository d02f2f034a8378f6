//! Rays against planted copies of a few templates.
//!
//! A hierarchy over the copies' bounding boxes leads to the copies near a ray; each is then tested
//! in its template's own axes, so thousands of leaves take memory once a template, not once a tree.

use glam::Vec3A;
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh;
use obvhs::ray::{Ray, RayHit};

use super::trace::Tree;
use crate::world::mesh::Triangle;
use crate::world::tree::{Plant, templates};

/// All trees and bushes of a city.
pub(super) struct Forest {
    /// Shared by all cities: they are the same in every one.
    templates: &'static [Tree],
    plants: Vec<Plant>,
    /// None without plants.
    bvh: Option<CwBvh>,
}

impl Forest {
    pub fn new(plants: &[Plant]) -> Self {
        static TEMPLATES: std::sync::OnceLock<Vec<Tree>> = std::sync::OnceLock::new();
        let templates = TEMPLATES.get_or_init(|| {
            templates()
                .iter()
                .map(|m| Tree::new(&m.triangles, None))
                .collect()
        });
        let boxes: Vec<Aabb> = plants
            .iter()
            .map(|plant| bounds(plant, &templates[usize::from(plant.template)]))
            .collect();
        let bvh = (!boxes.is_empty()).then(|| {
            build_cwbvh(
                &boxes,
                BvhBuildParams::medium_build(),
                &mut std::time::Duration::ZERO.clone(),
            )
        });
        // In the order of the hierarchy's leaves.
        let plants = bvh.as_ref().map_or_else(Vec::new, |bvh| {
            bvh.primitive_indices
                .iter()
                .map(|&index| plants[index as usize])
                .collect()
        });
        Self {
            templates,
            plants,
            bvh,
        }
    }

    /// Distance, plant and triangle of the template that a ray hits first.
    pub fn nearest(&self, origin: Vec3A, direction: Vec3A, limit: f32) -> Option<(f32, u32, u32)> {
        let bvh = self.bvh.as_ref()?;
        let mut found = None;
        let mut nearest = limit;
        let mut hit = RayHit::none();
        bvh.ray_traverse(
            Ray::new(origin, direction, 0.0, limit),
            &mut hit,
            |_, index| {
                let plant = &self.plants[index];
                let [from, to] = local(plant, origin, direction);
                let tree = &self.templates[usize::from(plant.template)];
                let Some((t, triangle)) = tree.nearest(from, to, nearest / plant.scale) else {
                    return f32::INFINITY;
                };
                let t = t * plant.scale;
                if t < nearest {
                    nearest = t;
                    found = Some((t, index as u32, triangle));
                }
                t
            },
        );
        found
    }

    /// Whether no plant stands within `limit` metres along a ray.
    pub fn is_free(&self, origin: Vec3A, direction: Vec3A, limit: f32) -> bool {
        let Some(bvh) = self.bvh.as_ref() else {
            return true;
        };
        bvh.ray_traverse_miss(Ray::new(origin, direction, 0.0, limit), |_, index| {
            let plant = &self.plants[index];
            let [from, to] = local(plant, origin, direction);
            let tree = &self.templates[usize::from(plant.template)];
            if tree.is_free(from, to, limit / plant.scale) {
                f32::INFINITY
            } else {
                0.0
            }
        })
    }

    /// The box around each plant: lowest and highest corner.
    pub fn bounds(&self) -> impl Iterator<Item = [Vec3A; 2]> {
        self.plants.iter().map(|plant| {
            let around = bounds(plant, &self.templates[usize::from(plant.template)]);
            [around.min, around.max]
        })
    }

    pub fn plant(&self, index: u32) -> &Plant {
        &self.plants[index as usize]
    }

    pub fn triangle(&self, plant: u32, triangle: u32) -> &Triangle {
        let template = usize::from(self.plant(plant).template);
        self.templates[template].triangle(triangle)
    }
}

fn local(plant: &Plant, origin: Vec3A, direction: Vec3A) -> [Vec3A; 2] {
    [
        plant.template_from_world(origin - plant.foot) / plant.scale,
        plant.template_from_world(direction),
    ]
}

fn bounds(plant: &Plant, tree: &Tree) -> Aabb {
    let [low, high] = tree.bounds();
    let reach = low.abs().max(high.abs());
    let round = (reach.x * reach.x + reach.y * reach.y).sqrt() * plant.scale;
    let [bottom, top] = [low.z, high.z].map(|z| z * plant.scale);
    Aabb {
        min: plant.foot + Vec3A::new(-round, -round, bottom),
        max: plant.foot + Vec3A::new(round, round, top),
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn a_ray_meets_a_planted_tree_where_it_meets_its_template() {
        let mut rng = Pcg64::seed_from_u64(4);
        let foot = Vec3A::new(30.0, -12.0, 0.0);
        let plant = Plant::new(0, foot, 10.5, 20.0, &mut rng);
        let forest = Forest::new(&[plant]);
        let mut hits = 0;
        for i in 0..40_u8 {
            let origin = foot + Vec3A::new(-9.0, 3.0 - f32::from(i) * 0.15, 6.5);
            let direction = Vec3A::new(1.0, 0.01, 0.05).normalize();
            let [from, to] = local(&plant, origin, direction);
            let single = forest.templates[0].nearest(from, to, f32::INFINITY);
            let planted = forest.nearest(origin, direction, f32::INFINITY);
            assert_eq!(
                single.map(|(t, _)| t * plant.scale),
                planted.map(|(t, ..)| t)
            );
            assert_eq!(forest.is_free(origin, direction, 100.0), planted.is_none());
            hits += u32::from(planted.is_some());
        }
        assert!(hits > 10, "{hits}");
    }
}
