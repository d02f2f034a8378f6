//! JSON trees of calibration files.

use std::collections::BTreeMap;

use serde_json::Value;

use crate::error::{Error, Result, json_problem};

/// The tree of a JSON text.
pub(super) fn tree(text: &str) -> Result<Value> {
    serde_json::from_str(text)
        .map_err(|error| Error::value("JSON", json_problem(&error), "save the calibration again"))
}

/// Whether a text is a JSON table with these names in it, anywhere.
pub(super) fn has_names(text: &str, names: &[&str]) -> bool {
    text.trim_start().starts_with('{')
        && names
            .iter()
            .all(|name| text.contains(&format!("\"{name}\"")))
}

/// A value below others.
pub(super) fn at<'a>(tree: &'a Value, path: &[&str]) -> Option<&'a Value> {
    path.iter().try_fold(tree, |tree, name| tree.get(name))
}

/// A number, be it written as a text.
pub(super) fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Number(number) => number.as_f64(),
        Value::String(text) => text.trim().parse().ok(),
        _ => None,
    }
    .filter(|value| value.is_finite())
}

/// A number below others, which must be there.
pub(super) fn required(tree: &Value, path: &[&str]) -> Result<f64> {
    at(tree, path).and_then(number).ok_or_else(|| {
        Error::value(
            path.join("."),
            "is missing or no number",
            "save the calibration again",
        )
    })
}

/// All numbers of a list, and of lists in it.
pub(super) fn numbers(value: &Value) -> Option<Vec<f64>> {
    match value {
        Value::Array(items) => {
            let parts = items.iter().map(|item| match item {
                Value::Array(_) => numbers(item),
                item => Some(vec![number(item)?]),
            });
            Some(parts.collect::<Option<Vec<_>>>()?.concat())
        }
        _ => None,
    }
}

/// Every number of a tree under its names joined with dots, in lower case.
pub(super) fn flat(tree: &Value) -> BTreeMap<String, f64> {
    fn add(name: &str, value: &Value, all: &mut BTreeMap<String, f64>) {
        let joined = |member: &str| match name {
            "" => member.to_lowercase(),
            name => format!("{name}.{}", member.to_lowercase()),
        };
        match value {
            Value::Object(members) => {
                for (member, value) in members {
                    add(&joined(member), value, all);
                }
            }
            Value::Array(items) => {
                for (index, value) in items.iter().enumerate() {
                    add(&joined(&index.to_string()), value, all);
                }
            }
            value => {
                if let Some(number) = number(value) {
                    all.insert(name.to_owned(), number);
                }
            }
        }
    }
    let mut all = BTreeMap::new();
    add("", tree, &mut all);
    all
}
