//! One scene: a city with vehicles in it.

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::city::City;
use super::layout::Layout;
use super::noise::derive_seed;
use super::traffic;
use super::vehicle::Vehicle;

/// Keeps the random numbers of scenes apart from those of other uses of the same seed.
const SCENE_STREAM: u64 = 1;
/// Those of the vehicles around the target: how many there are changes nothing else.
const TRAFFIC_STREAM: u64 = 6;

/// A city with vehicles on its roads.
///
/// World axes: x and y along the roads, z up, metres, the ground at z = 0.
#[derive(Debug)]
pub struct Scene {
    /// The vehicles, never none; the first is the target that cameras are pointed at.
    pub vehicles: Vec<Vehicle>,
    /// Turns the compass, and with it the sun, against the streets, degrees.
    pub compass_deg: f32,
    pub(crate) city: City,
}

impl Scene {
    /// The scene of this number with one vehicle.
    ///
    /// `reach_m` is how far from the vehicle a camera may be. Scenes of one seed have different
    /// cities, and neighbouring ones different vehicle styles and paints.
    pub fn draw(seed: u64, number: u32, reach_m: f64) -> Self {
        let mut rng = Pcg64::seed_from_u64(derive_seed(seed, SCENE_STREAM, u64::from(number)));
        // The view goes on behind the vehicle: without blocks there it would end in a plain.
        let reach_m = reach_m as f32 + 150.0;
        let layout = Layout::draw(reach_m, &mut rng);
        let lane = layout.nearest(0, 0.0).half_width * 0.5;
        let offset = lane * if rng.random_bool(0.7) { 0.5 } else { 1.5 };
        let along = rng.random_range(-14.0..14.0_f64);
        // Traffic keeps to the right.
        let forth = rng.random_bool(0.5);
        let at = [f64::from(if forth { offset } else { -offset }), along];
        let quarter_turn = std::f64::consts::FRAC_PI_2 * if forth { 1.0 } else { -1.0 };
        let heading = quarter_turn + rng.random_range(-5.0..5.0_f64).to_radians();
        let vehicle = Vehicle::draw(number, at, heading, &mut rng);
        let city = City::draw(reach_m, at.map(|v| v as f32), layout, &mut rng);
        Self {
            vehicles: vec![vehicle],
            compass_deg: rng.random_range(0.0..360.0),
            city,
        }
    }

    /// The scene of this number, with up to `vehicles` of them in all: fewer where the roads have no
    /// room. The others stand within about `radius_m` of the target and differ from one another in
    /// style and paint.
    ///
    /// City, target and compass are those of [`Scene::draw`].
    pub fn draw_with_traffic(
        seed: u64,
        number: u32,
        reach_m: f64,
        vehicles: u32,
        radius_m: f64,
    ) -> Self {
        let mut scene = Self::draw(seed, number, reach_m);
        let stream_seed = derive_seed(seed, TRAFFIC_STREAM, u64::from(number));
        let mut rng = Pcg64::seed_from_u64(stream_seed);
        let others = traffic::surround(
            scene.target(),
            number + 1,
            vehicles.saturating_sub(1),
            radius_m,
            &scene.city,
            &mut rng,
        );
        scene.vehicles.extend(others);
        scene
    }

    /// The vehicle that cameras are pointed at.
    pub fn target(&self) -> &Vehicle {
        &self.vehicles[0]
    }

    /// Whether a point lies in a building or less than `margin_m` from one.
    pub fn in_building(&self, point_world: [f64; 3], margin_m: f64) -> bool {
        self.city.in_building(point_world, margin_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_and_number_give_the_same_scene_and_others_do_not() {
        let [a, b, c] =
            [(3, 0), (3, 0), (3, 1)].map(|(seed, number)| Scene::draw(seed, number, 60.0));
        let corners = |s: &Scene| -> Vec<[f32; 3]> {
            s.city
                .mesh
                .triangles
                .iter()
                .map(|t| t.vertices[0].to_array())
                .collect()
        };
        assert_eq!(corners(&a), corners(&b));
        assert_ne!(corners(&a), corners(&c));
        assert_ne!(a.target().style(), c.target().style());
    }

    #[test]
    fn no_building_stands_on_the_vehicle() {
        for number in 0..6 {
            let scene = Scene::draw(9, number, 60.0);
            assert!(!scene.in_building(scene.target().center_world, 3.0));
        }
    }
}
