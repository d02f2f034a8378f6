//! One scene: a city with vehicles in it.

use std::sync::Arc;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::assets::AssetLibrary;
use super::city::City;
use super::layout::Layout;
use super::noise::derive_seed;
use super::props;
use super::traffic;
use super::vehicle::{Vehicle, Wardrobe};

/// Keeps the random numbers of scenes apart from those of other uses of the same seed.
const SCENE_STREAM: u64 = 1;
/// Those of the vehicles around the target: how many there are changes nothing else.
const TRAFFIC_STREAM: u64 = 6;
/// Those of the user's props.
const PROPS_STREAM: u64 = 8;

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
    /// The user's models, where some may stand here.
    pub(crate) library: Option<Arc<AssetLibrary>>,
}

impl Scene {
    /// The scene of this number with one vehicle.
    ///
    /// `reach_m` is how far from the vehicle a camera may be. Scenes of one seed have different
    /// cities, and neighbouring ones different vehicle styles and paints.
    pub fn draw(seed: u64, number: u32, reach_m: f64) -> Self {
        Self::draw_alone(seed, number, reach_m, &Wardrobe::default())
    }

    fn draw_alone(seed: u64, number: u32, reach_m: f64, wardrobe: &Wardrobe) -> Self {
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
        let vehicle = Vehicle::draw(number, wardrobe, at, heading, &mut rng);
        let city = City::draw(reach_m, at.map(|v| v as f32), layout, &mut rng);
        Self {
            vehicles: vec![vehicle],
            compass_deg: rng.random_range(0.0..360.0),
            city,
            library: wardrobe.own.as_ref().map(|own| Arc::clone(&own.library)),
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
        let wardrobe = Wardrobe::default();
        Self::draw_dressed(seed, number, reach_m, vehicles, radius_m, &wardrobe)
    }

    /// [`Scene::draw_with_traffic`] with bodies and paints of a wardrobe only, and with its props.
    pub fn draw_dressed(
        seed: u64,
        number: u32,
        reach_m: f64,
        vehicles: u32,
        radius_m: f64,
        wardrobe: &Wardrobe,
    ) -> Self {
        let mut scene = Self::draw_alone(seed, number, reach_m, wardrobe);
        if let Some(own) = &wardrobe.own {
            let seed = derive_seed(seed, PROPS_STREAM, u64::from(number));
            let [x, y, _] = scene.target().center_world.map(|v| v as f32);
            props::furnish(
                &mut scene.city,
                own,
                [x, y],
                &mut Pcg64::seed_from_u64(seed),
            );
        }
        let stream_seed = derive_seed(seed, TRAFFIC_STREAM, u64::from(number));
        let mut rng = Pcg64::seed_from_u64(stream_seed);
        let others = traffic::surround(
            scene.target(),
            traffic::Crowd {
                first_number: number + 1,
                count: vehicles.saturating_sub(1),
                radius_m,
                wardrobe,
            },
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
        assert_ne!(a.target().body_name(), c.target().body_name());
    }

    #[test]
    fn no_building_stands_on_the_vehicle() {
        for number in 0..6 {
            let scene = Scene::draw(9, number, 60.0);
            assert!(!scene.in_building(scene.target().center_world, 3.0));
        }
    }

    #[test]
    fn held_out_bodies_and_paints_never_appear() {
        use crate::world::{BodyStyle, Paint};
        let bodies = [BodyStyle::Taxi, BodyStyle::Truck, BodyStyle::Compact];
        let paints = [Paint::Red, Paint::Navy];
        let wardrobe = Wardrobe {
            bodies: bodies.to_vec(),
            paints: paints.to_vec(),
            own: None,
        };
        for number in 0..8 {
            let scene = Scene::draw_dressed(2, number, 60.0, 6, 30.0, &wardrobe);
            for vehicle in &scene.vehicles {
                assert!(bodies.iter().any(|body| body.name() == vehicle.body_name()));
                assert!(paints.contains(&vehicle.paint_name().unwrap()));
            }
        }
    }
}
