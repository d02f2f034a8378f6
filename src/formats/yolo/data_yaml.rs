//! `data.yaml`.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Map, Value};

use super::Extra;
use super::label::LineShape;
use crate::dataset::Split;
use crate::error::{Error, Result, yaml_problem};
use crate::files;

/// `data.yaml`, as far as it matters here.
#[derive(Debug)]
pub(super) struct DataYaml {
    /// Where the places begin.
    pub path: Option<String>,
    /// Folders, lists and images of each split.
    pub places: Vec<(Split, String)>,
    /// Class names by index.
    pub names: BTreeMap<u32, String>,
    /// Numbers behind the box of a line that are key points.
    pub keypoints: Option<Keypoints>,
    /// What this crate wrote.
    pub twinsight: Option<Extra>,
}

/// How many numbers key points have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Keypoints {
    /// So many.
    Numbers(usize),
    /// So many points of two or three numbers each.
    Points(usize),
}

impl DataYaml {
    /// Reads the file.
    pub fn read(path: &Path) -> Result<Self> {
        let text = files::read_text(path)?;
        Self::parse(&text).map_err(|problem| {
            Error::dataset(
                path,
                format!("is no data.yaml: {problem}"),
                "it needs `names` with the classes, and `train`, `val` or `test` with a folder of \
                 images",
            )
        })
    }

    /// Reads its text; the reason against it in words.
    pub fn parse(text: &str) -> Result<Self, String> {
        let tree: Value = serde_saphyr::from_str(text).map_err(|error| yaml_problem(&error))?;
        let Value::Object(tree) = tree else {
            return Err("it is not a table of names and values".to_owned());
        };
        let splits = [
            (Split::Train, "train"),
            (Split::Val, "val"),
            (Split::Val, "valid"),
            (Split::Test, "test"),
        ];
        let mut all = Vec::new();
        for (split, key) in splits {
            // Some write both of the two words for validation.
            let is_known = all.iter().any(|(known, _)| *known == split);
            if !is_known {
                all.extend(places(&tree, key)?.into_iter().map(|place| (split, place)));
            }
        }
        if all.is_empty() {
            return Err("it names no images".to_owned());
        }
        let twinsight = match tree.get("twinsight") {
            None | Some(Value::Null) => None,
            Some(extra) => Some(
                serde_json::from_value(extra.clone())
                    .map_err(|error| format!("twinsight: {error}"))?,
            ),
        };
        Ok(Self {
            path: tree.get("path").and_then(word),
            places: all,
            names: names(&tree)?,
            keypoints: keypoints(&tree)?,
            twinsight,
        })
    }

    /// Class names in the order of their indices, each once.
    pub fn class_names(&self) -> Vec<String> {
        let mut all: Vec<String> = Vec::new();
        for name in self.names.values() {
            // Merged datasets have one class under several numbers.
            if !all.contains(name) {
                all.push(name.clone());
            }
        }
        all
    }

    /// How lines of labels are read; `distance_column` is the user's word.
    pub fn line_shape(&self, distance_column: bool) -> LineShape {
        let said = self.twinsight.as_ref().is_some_and(|extra| extra.distance);
        LineShape {
            keypoints: self.keypoints,
            distance_column: distance_column || said,
        }
    }
}

/// A name, be it written as a number or truth.
fn word(value: &Value) -> Option<String> {
    match value {
        Value::String(text) => Some(text.clone()),
        Value::Number(number) => Some(number.to_string()),
        Value::Bool(is_true) => Some(is_true.to_string()),
        _ => None,
    }
}

/// One place or several.
fn places(tree: &Map<String, Value>, key: &str) -> Result<Vec<String>, String> {
    match tree.get(key) {
        None | Some(Value::Null) => Ok(Vec::new()),
        Some(Value::String(place)) if place.trim().is_empty() => Ok(Vec::new()),
        Some(Value::String(place)) => Ok(vec![place.clone()]),
        Some(Value::Array(places)) => places
            .iter()
            .map(|place| word(place).ok_or_else(|| format!("`{key}` holds more than paths")))
            .collect(),
        Some(_) => Err(format!("`{key}` is neither a path nor a list of paths")),
    }
}

/// Class names: a list, a table by index, or only their number.
fn names(tree: &Map<String, Value>) -> Result<BTreeMap<u32, String>, String> {
    let nameless = || "`names` holds more than names".to_owned();
    let names: BTreeMap<u32, String> = match tree.get("names") {
        Some(Value::Array(names)) => (0..)
            .zip(names)
            .map(|(index, name)| Ok((index, word(name).ok_or_else(nameless)?)))
            .collect::<Result<_, String>>()?,
        Some(Value::Object(names)) => names
            .iter()
            .map(|(index, name)| {
                let number = super::super::number::whole(index, "the index of a class");
                Ok((number?, word(name).ok_or_else(nameless)?))
            })
            .collect::<Result<_, String>>()?,
        None | Some(Value::Null) => match tree.get("nc").and_then(Value::as_u64) {
            Some(count @ 1..=10_000) => (0..count as u32)
                .map(|index| (index, format!("class_{index}")))
                .collect(),
            _ => return Err("it has no `names` of classes".to_owned()),
        },
        Some(_) => return Err("`names` is neither a list nor a table of classes".to_owned()),
    };
    if names.is_empty() {
        return Err("`names` is empty".to_owned());
    }
    Ok(names)
}

/// `kpt_shape: [points, numbers of each]`, or the partners of mirrored points, which only data with
/// key points has.
fn keypoints(tree: &Map<String, Value>) -> Result<Option<Keypoints>, String> {
    match tree.get("kpt_shape") {
        None | Some(Value::Null) => {}
        Some(Value::Array(shape)) => {
            let sides: Option<Vec<u64>> = shape.iter().map(Value::as_u64).collect();
            return match sides.as_deref() {
                Some(&[points @ 1..=10_000, numbers @ 2..=3]) => {
                    Ok(Some(Keypoints::Numbers((points * numbers) as usize)))
                }
                _ => Err("`kpt_shape` is not like [17, 3]".to_owned()),
            };
        }
        Some(_) => return Err("`kpt_shape` is not like [17, 3]".to_owned()),
    }
    Ok(match tree.get("flip_idx") {
        Some(Value::Array(partners)) if !partners.is_empty() => {
            Some(Keypoints::Points(partners.len()))
        }
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_come_as_lists_tables_numbers_and_counts() {
        let names = |text: &str| {
            let yaml = DataYaml::parse(&format!("train: images\n{text}\n")).unwrap();
            yaml.names.into_iter().collect::<Vec<_>>()
        };
        let expected = |names: &[&str]| -> Vec<(u32, String)> {
            (0..).zip(names.iter().map(|&n| n.to_owned())).collect()
        };
        assert_eq!(names("names: [car, 'a bus']"), expected(&["car", "a bus"]));
        assert_eq!(names("names: {0: car, 1: bus}"), expected(&["car", "bus"]));
        assert_eq!(names("names:\n  '0': car\n  1: 7"), expected(&["car", "7"]));
        assert_eq!(names("names: [0, 1, true]"), expected(&["0", "1", "true"]));
        assert_eq!(names("nc: 2"), expected(&["class_0", "class_1"]));
    }

    #[test]
    fn key_points_are_known_by_their_shape_or_their_partners() {
        let keypoints = |text: &str| {
            let text = format!("train: images\nnames: [car]\n{text}\n");
            DataYaml::parse(&text).map(|yaml| yaml.keypoints)
        };
        assert_eq!(
            keypoints("kpt_shape: [4, 2]"),
            Ok(Some(Keypoints::Numbers(8)))
        );
        assert_eq!(
            keypoints("flip_idx: [1, 0]"),
            Ok(Some(Keypoints::Points(2)))
        );
        assert_eq!(keypoints(""), Ok(None));
        for wrong in ["kpt_shape: 4", "kpt_shape: [4]", "kpt_shape: [4, 9]"] {
            assert!(keypoints(wrong).unwrap_err().contains("kpt_shape"));
        }
    }

    #[test]
    fn what_is_wrong_is_said_in_the_words_of_the_file() {
        for (text, why) in [
            ("- a\n- b\n", "not a table"),
            ("train: [\n", "line"),
            ("names: [car]\n", "names no images"),
            ("names: 7\ntrain: images\n", "`names` is neither"),
            ("names: [[a]]\ntrain: images\n", "`names` holds more"),
            ("names: {x: a}\ntrain: images\n", "'x'"),
            ("names: [car]\ntrain: {a: b}\n", "`train` is neither"),
            (
                "names: [car]\ntrain: images\n---\nnames: [bus]\n",
                "document",
            ),
            ("train: images\n", "no `names`"),
        ] {
            let problem = DataYaml::parse(text).unwrap_err();
            assert!(problem.contains(why), "{text}: {problem}");
            for word in ["untagged", "from_str", "serde", "variant"] {
                assert!(!problem.contains(word), "{problem}");
            }
        }
    }

    #[test]
    fn damaged_files_are_refused_or_read_and_nothing_else() {
        let seeds: [&[u8]; 3] = [
            b"path: .\ntrain: images/train\nval: [images/val, more]\nkpt_shape: [4, 2]\nnames:\n  0: car\n  1: traffic light\n",
            b"train: ../train/images\nval: ../valid/images\nnc: 2\nnames: ['car', 7]\nroboflow: {license: x}\n",
            b"train: a\nnames: [car]\ntwinsight: {kind: sphere, distance: true, rig: {width: 64, height: 36, baseline_m: 0.8, hfov_deg: 90.0}}\n",
        ];
        crate::mutate::damaged(&seeds, |bytes| {
            match DataYaml::parse(&String::from_utf8_lossy(bytes)) {
                Ok(yaml) => assert!(!yaml.names.is_empty() && !yaml.places.is_empty()),
                Err(problem) => assert!(!problem.is_empty() && !problem.contains("from_str")),
            }
        });
    }
}
