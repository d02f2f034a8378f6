//! The settings of the runs, and what differs between them.

use std::collections::BTreeMap;

use serde_json::Value;

use super::load::Run;
use super::parts::{Block, Section, Table};

/// The settings of every run; of several runs first those that differ.
pub(super) fn section(runs: &[Run]) -> Section {
    let mut section = Section::new("Settings");
    if runs.len() > 1 {
        section.table(differing(runs));
    }
    for run in runs {
        section.blocks.push(Block::Text {
            title: run.name.clone(),
            text: run.config.clone(),
            source: run.file("config.json"),
        });
    }
    section
}

fn differing(runs: &[Run]) -> Table {
    let mut header = vec!["setting"];
    header.extend(runs.iter().map(|run| run.name.as_str()));
    let sources: Vec<String> = runs.iter().map(|run| run.file("config.json")).collect();
    let mut table = Table::new("Settings that differ", &header, sources.join(", "));
    table.words = header.len();
    let settings: Vec<BTreeMap<String, String>> = runs
        .iter()
        .map(|run| {
            let mut settings = BTreeMap::new();
            // Shown below as it is where it is no JSON.
            let value = serde_json::from_str(&run.config).unwrap_or(Value::Null);
            flatten("", &value, &mut settings);
            settings
        })
        .collect();
    let mut names: Vec<&String> = settings.iter().flat_map(BTreeMap::keys).collect();
    names.sort_unstable();
    names.dedup();
    for name in names {
        let values: Vec<Option<&String>> = settings.iter().map(|of| of.get(name)).collect();
        if values.iter().any(|value| *value != values[0]) {
            let text = |value: Option<&String>| value.map_or_else(|| "-".to_owned(), Clone::clone);
            let mut row = vec![name.clone()];
            row.extend(values.into_iter().map(text));
            table.rows.push(row);
        }
    }
    table
}

/// Every single value under its name with those of the objects that it is in.
fn flatten(name: &str, value: &Value, settings: &mut BTreeMap<String, String>) {
    match value {
        Value::Object(values) => {
            for (key, value) in values {
                let name = if name.is_empty() {
                    key.clone()
                } else {
                    format!("{name}.{key}")
                };
                flatten(&name, value, settings);
            }
        }
        Value::String(text) => {
            settings.insert(name.to_owned(), text.clone());
        }
        value => {
            settings.insert(name.to_owned(), value.to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_named_with_the_tables_that_they_are_in() {
        let value = serde_json::json!({"a": {"b": 1, "c": [2, 3]}, "d": "x"});
        let mut settings = BTreeMap::new();
        flatten("", &value, &mut settings);
        let expected = [("a.b", "1"), ("a.c", "[2,3]"), ("d", "x")];
        assert!(
            settings
                .iter()
                .map(|(k, v)| (k.as_str(), v.as_str()))
                .eq(expected)
        );
    }
}
