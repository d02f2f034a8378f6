//! Rays against the scene: what do they hit first, and is the way free?

use std::sync::Arc;

use glam::Vec3A;
use obvhs::BvhBuildParams;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::{Ray, RayHit};

use super::forest::Forest;
use super::openness::Openness;
use crate::world::mesh::{Surface, Triangle};
use crate::world::tree::Plant;
use crate::world::{AssetLibrary, Scene};

/// Barycentric coordinates may leave the triangle by this much, so that rays cannot slip through
/// between two triangles that share an edge.
const EDGE_TOLERANCE: f32 = 1e-5;
/// Hits nearer than this are taken for the surface that the ray started from, metres.
const NEAREST_M: f32 = 1e-3;

/// What a ray may hit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Object {
    Ground,
    City,
    /// A vehicle by its index in the scene.
    Vehicle(u16),
    /// A tree or bush, by its index in the forest.
    Plant(u32),
}

/// Where a ray hits.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hit {
    /// Distance along the ray, metres.
    pub t: f32,
    pub object: Object,
    /// Index into the stage's triangles; meaningless for the ground.
    pub triangle: u32,
}

/// A scene made ready for tracing.
pub struct Stage {
    pub(crate) scene: Scene,
    pub(crate) openness: Openness,
    /// City and vehicles together.
    all: Tree,
    /// What each triangle of `all` belongs to.
    objects: Vec<Object>,
    /// Each vehicle alone.
    vehicles: Vec<Tree>,
    forest: Forest,
}

impl std::fmt::Debug for Stage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Stage")
            .field("target", &self.scene.target().body_name())
            .field("vehicles", &self.vehicles.len())
            .field("triangles", &self.all.triangles.len())
            .finish_non_exhaustive()
    }
}

/// Triangles under a bounding volume hierarchy, in the order of its leaves.
pub(super) struct Tree {
    bvh: CwBvh,
    /// A corner and the two edges from it.
    edges: Vec<[Vec3A; 3]>,
    triangles: Vec<Triangle>,
    bounds: [Vec3A; 2],
    /// Knows the holes in models of the user's; None where no triangle has any.
    library: Option<Arc<AssetLibrary>>,
}

impl Tree {
    /// `library` has the models of the triangles that are of one.
    pub fn new(triangles: &[Triangle], library: Option<&Arc<AssetLibrary>>) -> Self {
        let library = library.filter(|library| {
            triangles.iter().any(|triangle| match triangle.surface {
                Surface::Model(model, part) => library.model(model).has_holes(part),
                _ => false,
            })
        });
        let bare: Vec<obvhs::triangle::Triangle> = triangles
            .iter()
            .map(|t| obvhs::triangle::Triangle {
                v0: t.vertices[0],
                v1: t.vertices[1],
                v2: t.vertices[2],
            })
            .collect();
        let bvh = build_cwbvh_from_tris(
            &bare,
            BvhBuildParams::slow_build(),
            &mut std::time::Duration::ZERO.clone(),
        );
        let triangles: Vec<Triangle> = bvh
            .primitive_indices
            .iter()
            .map(|&index| triangles[index as usize])
            .collect();
        let edges = triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.vertices;
                [a, b - a, c - a]
            })
            .collect();
        let corners = triangles.iter().flat_map(|t| t.vertices);
        let bounds = corners.fold([Vec3A::INFINITY, Vec3A::NEG_INFINITY], |[low, high], v| {
            [low.min(v), high.max(v)]
        });
        Self {
            bvh,
            edges,
            triangles,
            bounds,
            library: library.cloned(),
        }
    }

    /// Distance to a triangle, infinite where the ray misses it.
    #[inline]
    fn intersect(&self, ray: &Ray, index: usize) -> f32 {
        let [corner, edge_1, edge_2] = self.edges[index];
        let p = ray.direction.cross(edge_2);
        let scale = 1.0 / edge_1.dot(p);
        let s = ray.origin - corner;
        let u = s.dot(p) * scale;
        let q = s.cross(edge_1);
        let v = ray.direction.dot(q) * scale;
        let t = edge_2.dot(q) * scale;
        // A ray in the triangle's plane divides by zero; every comparison with NaN is false.
        let inside = u >= -EDGE_TOLERANCE && v >= -EDGE_TOLERANCE && u + v <= 1.0 + EDGE_TOLERANCE;
        if inside && t >= ray.tmin && (self.library.is_none() || self.is_solid(index, [u, v])) {
            t
        } else {
            f32::INFINITY
        }
    }

    /// Whether a point of a triangle is no hole of a model.
    fn is_solid(&self, index: usize, weights: [f32; 2]) -> bool {
        match (self.triangles[index].surface, &self.library) {
            (Surface::Model(model, part), Some(library)) => {
                library.model(model).is_solid(part, weights)
            }
            _ => true,
        }
    }

    /// Distance and triangle that a ray hits first.
    pub fn nearest(&self, origin: Vec3A, direction: Vec3A, limit: f32) -> Option<(f32, u32)> {
        let ray = Ray::new(origin, direction, NEAREST_M, limit);
        if !self.is_near(&ray) {
            return None;
        }
        let mut hit = RayHit::none();
        self.bvh
            .ray_traverse(ray, &mut hit, |ray, index| self.intersect(ray, index))
            .then_some((hit.t, hit.primitive_id))
    }

    /// A triangle by its place in the hierarchy.
    pub fn triangle(&self, index: u32) -> &Triangle {
        &self.triangles[index as usize]
    }

    /// Corners of the box around all triangles.
    pub fn bounds(&self) -> [Vec3A; 2] {
        self.bounds
    }

    /// Whether a ray may pass through the box: a quick test for small things in a large scene.
    fn is_near(&self, ray: &Ray) -> bool {
        let [a, b] = self
            .bounds
            .map(|corner| (corner - ray.origin) * ray.inv_direction);
        let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
        enter <= leave && leave >= 0.0 && enter <= ray.tmax
    }

    /// Whether a ray hits nothing within `limit`.
    pub fn is_free(&self, origin: Vec3A, direction: Vec3A, limit: f32) -> bool {
        let ray = Ray::new(origin, direction, NEAREST_M, limit);
        if !self.is_near(&ray) {
            return true;
        }
        self.bvh
            .ray_traverse_miss(ray, |ray, index| self.intersect(ray, index))
    }
}

impl Stage {
    /// Prepares a scene.
    pub fn new(mut scene: Scene) -> Self {
        // The trees keep the triangles in an order of their own.
        let mut triangles = std::mem::take(&mut scene.city.mesh.triangles);
        let mut objects = vec![Object::City; triangles.len()];
        let mut vehicles = Vec::with_capacity(scene.vehicles.len());
        for (index, vehicle) in (0_u16..).zip(&mut scene.vehicles) {
            let own = std::mem::take(&mut vehicle.triangles);
            objects.resize(objects.len() + own.len(), Object::Vehicle(index));
            triangles.extend_from_slice(&own);
            vehicles.push(Tree::new(&own, scene.library.as_ref()));
        }
        let all = Tree::new(&triangles, scene.library.as_ref());
        let objects = all
            .bvh
            .primitive_indices
            .iter()
            .map(|&index| objects[index as usize])
            .collect();
        let forest = Forest::new(&scene.city.plants);
        let [x, y, _] = scene.target().center_world.map(|v| v as f32);
        Self {
            openness: Openness::new(&scene.city, [x, y]),
            scene,
            all,
            objects,
            vehicles,
            forest,
        }
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Whether a drone fits here: nothing within `clearance_m` in fourteen directions.
    pub(crate) fn has_room(&self, position_world: [f64; 3], clearance_m: f64) -> bool {
        let origin = Vec3A::from_array(position_world.map(|v| v as f32));
        let sides = [Vec3A::X, Vec3A::Y, Vec3A::Z].into_iter();
        let corners = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)]
            .map(|(x, y)| Vec3A::new(x, y, 1.0).normalize());
        sides
            .chain(corners)
            .flat_map(|direction| [direction, -direction])
            .all(|direction| self.is_free_until(origin, direction, clearance_m as f32))
    }

    /// What a ray hits first; None is the sky.
    pub(crate) fn nearest(&self, origin: Vec3A, direction: Vec3A) -> Option<Hit> {
        let ground = -origin.z / direction.z;
        let mut limit = f32::INFINITY;
        let mut nearest = None;
        if ground > NEAREST_M {
            limit = ground;
            nearest = Some(Hit {
                t: ground,
                object: Object::Ground,
                triangle: 0,
            });
        }
        if let Some((t, triangle)) = self.all.nearest(origin, direction, limit) {
            limit = t;
            nearest = Some(Hit {
                t,
                object: self.objects[triangle as usize],
                triangle,
            });
        }
        if let Some((t, plant, triangle)) = self.forest.nearest(origin, direction, limit) {
            nearest = Some(Hit {
                t,
                object: Object::Plant(plant),
                triangle,
            });
        }
        nearest
    }

    /// A plant by its index.
    pub(crate) fn plant(&self, index: u32) -> &Plant {
        self.forest.plant(index)
    }

    /// One vehicle alone: distance along the ray, if it hits.
    pub(crate) fn vehicle_distance(
        &self,
        vehicle: usize,
        origin: Vec3A,
        direction: Vec3A,
    ) -> Option<f32> {
        self.vehicles[vehicle]
            .nearest(origin, direction, f32::INFINITY)
            .map(|(t, _)| t)
    }

    /// Whether nothing but the ground stands within `limit` metres along a ray.
    pub(crate) fn is_free_until(&self, origin: Vec3A, direction: Vec3A, limit: f32) -> bool {
        self.all.is_free(origin, direction, limit) && self.forest.is_free(origin, direction, limit)
    }

    /// Whether nothing at all stands in the way, however far.
    pub(crate) fn is_free(&self, origin: Vec3A, direction: Vec3A) -> bool {
        self.is_free_until(origin, direction, f32::INFINITY)
    }

    /// The triangle that was hit, a plant's in the axes of its template; None for the ground.
    pub(crate) fn triangle(&self, hit: &Hit) -> Option<&Triangle> {
        match hit.object {
            Object::Ground => None,
            Object::City | Object::Vehicle(_) => Some(&self.all.triangles[hit.triangle as usize]),
            Object::Plant(plant) => Some(self.forest.triangle(plant, hit.triangle)),
        }
    }

    /// All triangles of city and vehicles, metres, world.
    pub(super) fn triangles(&self) -> impl Iterator<Item = (Object, &Triangle)> {
        self.objects.iter().copied().zip(&self.all.triangles)
    }

    /// The boxes around trees and bushes: lowest and highest corner, metres, world.
    pub(super) fn plant_bounds(&self) -> impl Iterator<Item = (Object, [Vec3A; 2])> {
        let plants = (0_u32..).map(Object::Plant);
        plants.zip(self.forest.bounds())
    }

    /// The triangles of one vehicle, metres, world.
    pub(crate) fn vehicle_triangles(&self, vehicle: usize) -> &[Triangle] {
        &self.vehicles[vehicle].triangles
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_hit_agrees_with_testing_every_triangle() {
        let stage = Stage::new(Scene::draw_with_traffic(4, 0, 40.0, 4, 25.0));
        let origin = Vec3A::new(12.0, -9.0, 11.0);
        for i in 0..200_u16 {
            let [a, b] = [f32::from(i) * 0.031 - 3.1, f32::from(i * 7 % 200) * 0.006];
            let direction = Vec3A::new(libm::cosf(a), libm::sinf(a), -b).normalize();
            let ray = Ray::new(origin, direction, NEAREST_M, f32::INFINITY);
            let slow = (0..stage.all.edges.len())
                .map(|index| stage.all.intersect(&ray, index))
                .fold(f32::INFINITY, f32::min);
            let fast = stage.all.nearest(origin, direction, f32::INFINITY);
            assert_eq!(fast.map_or(f32::INFINITY, |(t, _)| t), slow);
            assert_eq!(
                stage.all.is_free(origin, direction, f32::INFINITY),
                fast.is_none()
            );
        }
    }
}
