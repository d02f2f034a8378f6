//! Which of the vehicles found are wanted.

use super::vehicle::Pair;
use crate::detector::Detection;
use crate::error::{Error, Result};
use crate::geometry::{PixelBox, Polygon};

/// Which of the vehicles found are wanted; all of them by default.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct VehicleFilter {
    /// Only these classes, by name; all where it is empty.
    pub classes: Vec<String>,
    /// Only vehicles whose box in the left image has its centre in this region, pixels of the left
    /// image. A vehicle without a box there is judged by the one in the right image.
    pub region: Option<Polygon>,
    /// At most this many vehicles a pair, those of the highest scores.
    pub max_vehicles: Option<usize>,
}

impl VehicleFilter {
    /// The numbers of the wanted classes; None for all of them.
    ///
    /// # Errors
    /// A class that the networks do not know, or none of several wanted ones.
    pub(super) fn class_numbers(&self, known: &[String]) -> Result<Option<Vec<usize>>> {
        if self.max_vehicles == Some(0) {
            return Err(Error::value(
                "max_vehicles = 0",
                "would leave out everything",
                "give at least 1",
            ));
        }
        let number = |class: &String| {
            known.iter().position(|name| name == class).ok_or_else(|| {
                Error::value(
                    format!("class \"{class}\""),
                    "is unknown to this run",
                    format!("choose among {}", known.join(", ")),
                )
            })
        };
        let numbers: Vec<usize> = self.classes.iter().map(number).collect::<Result<_>>()?;
        Ok((!numbers.is_empty()).then_some(numbers))
    }

    fn holds(&self, box_pixel: &PixelBox) -> bool {
        self.region
            .as_ref()
            .is_none_or(|region| region.contains(box_pixel.center()))
    }

    /// Of these pairs the wanted ones, in their order.
    pub(super) fn pairs(&self, mut pairs: Vec<Pair>) -> Vec<Pair> {
        pairs.retain(|pair| self.holds(&pair.left.box_pixel));
        self.best(pairs, |pair| pair.score)
    }

    /// Of these detections of one image the wanted ones, in their order.
    pub(super) fn detections(&self, mut detections: Vec<Detection>) -> Vec<Detection> {
        detections.retain(|detection| self.holds(&detection.box_pixel));
        self.best(detections, |detection| detection.score)
    }

    /// Those of the highest scores; of equal ones the first.
    fn best<T>(&self, items: Vec<T>, score: impl Fn(&T) -> f32) -> Vec<T> {
        let most = self.max_vehicles.unwrap_or(usize::MAX);
        if items.len() <= most {
            return items;
        }
        let mut order: Vec<usize> = (0..items.len()).collect();
        order.sort_by(|&a, &b| score(&items[b]).total_cmp(&score(&items[a])));
        order.truncate(most);
        order.sort_unstable();
        let mut kept = order.into_iter().peekable();
        let is_kept = |i: usize, kept: &mut std::iter::Peekable<_>| kept.next_if_eq(&i).is_some();
        items
            .into_iter()
            .enumerate()
            .filter_map(|(i, item)| is_kept(i, &mut kept).then_some(item))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn detection(x: f64, score: f32) -> Detection {
        Detection {
            box_pixel: PixelBox::from_center([x, 50.0], 10.0, 10.0),
            score,
            class: 0,
        }
    }

    #[test]
    fn the_centre_of_the_box_decides_whether_it_is_in_the_region() {
        let filter = VehicleFilter {
            region: Some("0,0 100,0 100,100 0,100".parse().unwrap()),
            ..VehicleFilter::default()
        };
        let found = [detection(99.0, 0.5), detection(101.0, 0.9)];
        assert_eq!(filter.detections(found.to_vec()), found[..1]);
        assert_eq!(VehicleFilter::default().detections(found.to_vec()), found);
    }

    #[test]
    fn of_too_many_the_highest_scores_stay_in_their_order() {
        let found = [0.3, 0.9, 0.3, 0.7].map(|score| detection(f64::from(score), score));
        for (most, kept) in [
            (1, &[1][..]),
            (2, &[1, 3]),
            (3, &[0, 1, 3]),
            (9, &[0, 1, 2, 3]),
        ] {
            let filter = VehicleFilter {
                max_vehicles: Some(most),
                ..VehicleFilter::default()
            };
            let expected: Vec<Detection> = kept.iter().map(|&i: &usize| found[i]).collect();
            assert_eq!(
                filter.detections(found.to_vec()),
                expected,
                "at most {most}"
            );
        }
    }

    #[test]
    fn classes_are_known_by_name() {
        let known = ["car", "truck"].map(str::to_owned);
        let numbers = |classes: &[&str]| {
            let classes = classes.iter().map(|&class| class.to_owned()).collect();
            let filter = VehicleFilter {
                classes,
                ..VehicleFilter::default()
            };
            filter.class_numbers(&known)
        };
        assert_eq!(numbers(&[]).unwrap(), None);
        assert_eq!(numbers(&["truck", "car"]).unwrap(), Some(vec![1, 0]));
        let message = numbers(&["tank"]).unwrap_err().to_string();
        assert!(
            message.contains("tank") && message.contains("car, truck"),
            "{message}"
        );
        let none = VehicleFilter {
            max_vehicles: Some(0),
            ..VehicleFilter::default()
        };
        assert!(none.class_numbers(&known).is_err());
    }
}
