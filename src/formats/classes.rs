//! Which foreign classes become which of ours.

use std::str::FromStr;

/// Our classes, each with the foreign names that stand for it.
///
/// Written `car=Car+Van+Truck,walker=Pedestrian`; a name alone stands for itself. Foreign names
/// are compared exactly first, then without regard to capitals.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClassMap {
    entries: Vec<(String, Vec<String>)>,
}

impl ClassMap {
    /// Every foreign class under its own name.
    pub fn identity(names: impl IntoIterator<Item = String>) -> Self {
        let entries = names.into_iter().map(|name| (name.clone(), vec![name]));
        Self {
            entries: entries.collect(),
        }
    }

    /// One class of ours for all these foreign ones.
    pub fn merged(ours: &str, foreign: &[&str]) -> Self {
        let foreign = foreign.iter().map(|&name| name.to_owned()).collect();
        Self {
            entries: vec![(ours.to_owned(), foreign)],
        }
    }

    /// Our class names, as `dataset.toml` lists them.
    pub fn names(&self) -> Vec<String> {
        self.entries.iter().map(|(name, _)| name.clone()).collect()
    }

    /// Index of our class for a foreign name; none where it was not asked for.
    pub fn index_of(&self, foreign: &str) -> Option<u32> {
        let position = |alike: &dyn Fn(&str) -> bool| {
            let has = |names: &Vec<String>| names.iter().any(|name| alike(name));
            self.entries.iter().position(|(_, names)| has(names))
        };
        position(&|name| name == foreign)
            .or_else(|| position(&|name| name.eq_ignore_ascii_case(foreign)))
            .map(|index| index as u32)
    }

    /// The foreign names that are asked for and do not occur among `present`.
    pub fn absent(&self, present: &[String]) -> Vec<String> {
        let asked = self.entries.iter().flat_map(|(_, names)| names);
        let is_there = |name: &str| present.iter().any(|p| p.eq_ignore_ascii_case(name));
        asked.filter(|name| !is_there(name)).cloned().collect()
    }
}

impl FromStr for ClassMap {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut entries: Vec<(String, Vec<String>)> = Vec::new();
        for part in text.split(',') {
            let (ours, foreign) = part.split_once('=').unwrap_or((part, part));
            let ours = ours.trim().to_owned();
            let foreign: Vec<_> = foreign.split('+').map(|n| n.trim().to_owned()).collect();
            if ours.is_empty() || foreign.iter().any(String::is_empty) {
                return Err(format!(
                    "'{part}' names no class; write it like car=Car+Van,walker=Pedestrian"
                ));
            }
            if entries.iter().any(|(name, _)| *name == ours) {
                return Err(format!("the class '{ours}' is given twice"));
            }
            if let Some(name) = foreign
                .iter()
                .find(|name| entries.iter().any(|(_, names)| names.contains(name)))
            {
                return Err(format!("'{name}' is given to two classes"));
            }
            entries.push((ours, foreign));
        }
        Ok(Self { entries })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn foreign_names_become_ours_exactly_first_and_then_without_capitals() {
        let map: ClassMap = "car=Car+Van, bus,CAR2=CAR".parse().unwrap();
        assert_eq!(map.names(), ["car", "bus", "CAR2"]);
        let indices = ["Car", "Van", "bus", "BUS", "CAR", "Tram"].map(|name| map.index_of(name));
        assert_eq!(indices, [Some(0), Some(0), Some(1), Some(1), Some(2), None]);
        assert_eq!(map.absent(&["car".to_owned(), "bus".to_owned()]), ["Van"]);
    }

    #[test]
    fn nameless_and_doubled_classes_are_refused() {
        for text in [
            "",
            "car=",
            "=Car",
            "car,,bus",
            "car=Car,car=Van",
            "a=Car,b=Car",
        ] {
            assert!(text.parse::<ClassMap>().is_err(), "{text} is no class map");
        }
    }
}
