//! Vehicles by what they have in common: distance, sun, view, size of the box, class.

use serde::{Deserialize, Serialize};

use super::vehicles::{FalseVehicle, VehicleRow};
use crate::dataset::View;
use crate::page::charts::round_step;
use crate::world::Sun;

/// Distance bins, about.
const BINS: f64 = 10.0;

/// Upper ends of the box sizes, pixels; the last size has none.
const BOX_ENDS_PX: [f64; 5] = [16.0, 32.0, 64.0, 128.0, 256.0];

/// What vehicles are grouped by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Grouping {
    /// Not at all.
    All,
    /// True distance.
    Distance,
    /// The frame's sun.
    Sun,
    /// Side from which the vehicle is seen.
    View,
    /// Longer side of the labelled box.
    Box,
    /// Class.
    Class,
}

impl Grouping {
    /// Every one.
    pub const ALL: [Self; 6] = [
        Self::All,
        Self::Distance,
        Self::Sun,
        Self::View,
        Self::Box,
        Self::Class,
    ];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Distance => "distance",
            Self::Sun => "sun",
            Self::View => "view",
            Self::Box => "box",
            Self::Class => "class",
        }
    }
}

/// Place in the order of groups, and name.
pub(crate) type Key = (usize, String);

/// The group of whatever nobody knows the group of.
fn unknown() -> Key {
    (usize::MAX, "unknown".to_owned())
}

/// Divides vehicles; distances into bins that are round numbers of metres.
pub(crate) struct Groups {
    step_m: f64,
}

impl Groups {
    /// Bins for the true distances of these vehicles.
    pub fn new(vehicles: &[VehicleRow]) -> Self {
        let distances = || vehicles.iter().map(|v| v.distance_m);
        let most = distances().fold(0.0, f64::max);
        let least = distances().fold(most, f64::min);
        // Vehicles that are all at about one distance are told apart by nothing finer.
        let apart = most - least;
        let span = if apart < most / BINS { most } else { apart };
        Self {
            step_m: round_step(span / BINS),
        }
    }

    /// The group of a vehicle.
    pub fn of(&self, grouping: Grouping, vehicle: &VehicleRow) -> Key {
        match grouping {
            Grouping::All => (0, "all".to_owned()),
            Grouping::Distance => self.bin(vehicle.distance_m),
            Grouping::Sun => sun(vehicle.sun.as_deref()),
            Grouping::View => vehicle.view.map_or_else(unknown, |view| {
                let place = VIEWS
                    .iter()
                    .position(|(of, _)| *of == view)
                    .unwrap_or_default();
                (place, VIEWS[place].1.to_owned())
            }),
            Grouping::Box => box_size(vehicle.box_px),
            Grouping::Class => (0, vehicle.class.clone()),
        }
    }

    /// The group of a vehicle that is not there, by what was seen of it; None where such vehicles
    /// have no group.
    pub fn of_false(&self, grouping: Grouping, vehicle: &FalseVehicle) -> Option<Key> {
        match grouping {
            Grouping::All => Some((0, "all".to_owned())),
            Grouping::Distance => Some(self.bin(vehicle.estimated_m)),
            Grouping::Sun => Some(sun(vehicle.sun.as_deref())),
            Grouping::View => None,
            Grouping::Box => {
                let (width, height) =
                    (vehicle.x_max - vehicle.x_min, vehicle.y_max - vehicle.y_min);
                Some(box_size(width.max(height)))
            }
            Grouping::Class => Some((0, vehicle.class.clone())),
        }
    }

    fn bin(&self, distance_m: f64) -> Key {
        let bin = (distance_m / self.step_m).floor().max(0.0);
        // A multiple of a tenth is not exactly one in binary.
        let end = |bin: f64| (bin * self.step_m * 1e6).round() / 1e6;
        let name = format!("{}-{} m", end(bin), end(bin + 1.0));
        (bin as usize, name)
    }
}

const VIEWS: [(View, &str); 4] = [
    (View::Front, "front"),
    (View::Side, "side"),
    (View::Rear, "rear"),
    (View::Other, "other"),
];

/// Suns in the order of the day, then others.
fn sun(name: Option<&str>) -> Key {
    name.map_or_else(unknown, |name| {
        let place = Sun::ALL.iter().position(|sun| sun.name() == name);
        (place.unwrap_or(Sun::ALL.len()), name.to_owned())
    })
}

fn box_size(side_px: f64) -> Key {
    let place = BOX_ENDS_PX.iter().filter(|&&end| side_px >= end).count();
    let name = match place {
        0 => format!("below {} px", BOX_ENDS_PX[0]),
        place if place == BOX_ENDS_PX.len() => format!("{} px and more", BOX_ENDS_PX[place - 1]),
        place => format!("{}-{} px", BOX_ENDS_PX[place - 1], BOX_ENDS_PX[place]),
    };
    (place, name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_and_sizes_are_named_by_round_numbers_and_stand_in_order() {
        let groups = Groups { step_m: 5.0 };
        assert_eq!(groups.bin(17.3), (3, "15-20 m".to_owned()));
        assert_eq!(groups.bin(20.0), (4, "20-25 m".to_owned()));
        assert_eq!(groups.bin(-3.0).1, "0-5 m");
        assert_eq!(box_size(3.0).1, "below 16 px");
        assert_eq!(box_size(16.0), (1, "16-32 px".to_owned()));
        assert_eq!(box_size(999.0), (5, "256 px and more".to_owned()));
    }

    #[test]
    fn bins_of_a_fraction_of_a_metre_have_short_names() {
        let groups = Groups { step_m: 0.1 };
        assert_eq!(groups.bin(12.4181).1, "12.4-12.5 m");
        assert_eq!(groups.bin(0.35).1, "0.3-0.4 m");
    }

    #[test]
    fn suns_follow_the_day_and_the_unknown_comes_last() {
        assert!(sun(Some("sunrise")) < sun(Some("noon")) && sun(Some("noon")) < sun(Some("dusk")));
        assert!(sun(Some("dusk")) < sun(None));
    }
}
