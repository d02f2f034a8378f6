//! Which split an imported frame belongs to.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use super::draft::DraftFrame;
use crate::dataset::{Problem, Split, choose_validation};
use crate::error::{Error, Result};
use crate::files;

/// Columns that may name the frame.
const NAME_COLUMNS: [&str; 5] = ["id", "name", "file", "image", "stamp"];

/// Columns that may name what must stay in one split.
const GROUP_COLUMNS: [&str; 5] = ["drive", "raw_drive", "scene", "sequence", "group"];

/// How frames are divided.
///
/// What the source itself says comes first, then the table, then chance.
#[derive(Debug, Clone, PartialEq)]
pub struct SplitSettings {
    /// A CSV file with a column that names the frame (id, name, file, image or stamp) and a column
    /// that names its group (drive, `raw_drive`, scene, sequence or group), its split, or both.
    pub table: Option<PathBuf>,
    /// Part of the frames that validates where nothing else decides.
    pub val_fraction: f64,
    /// Chance follows from it.
    pub seed: u64,
}

impl Default for SplitSettings {
    fn default() -> Self {
        Self {
            table: None,
            val_fraction: 0.2,
            seed: 1,
        }
    }
}

/// What the table says of a frame.
struct Entry {
    split: Option<Split>,
    group: Option<String>,
}

/// Gives every frame its split, and a scene number where groups are known. Frames that the table
/// does not list come back as problems and are taken out.
pub(super) fn divide(
    frames: &mut Vec<DraftFrame>,
    settings: &SplitSettings,
) -> Result<Vec<Problem>> {
    if !(0.0..1.0).contains(&settings.val_fraction) {
        return Err(Error::value(
            format!("val fraction = {}", settings.val_fraction),
            "is not a part of the frames",
            "give a number from 0 to below 1",
        ));
    }
    let problems = match &settings.table {
        Some(_) => follow_table(frames, settings)?,
        None => Vec::new(),
    };
    // Scenes without a number of their own stand alone.
    let mut scenes: BTreeMap<(Option<u32>, usize), Vec<usize>> = BTreeMap::new();
    for (index, frame) in frames.iter().enumerate() {
        if frame.split.is_none() {
            let key = match frame.row.scene {
                Some(scene) => (Some(scene), 0),
                None => (None, index),
            };
            scenes.entry(key).or_default().push(index);
        }
    }
    // A single scene cannot be divided; training needs it.
    if settings.val_fraction > 0.0 && scenes.len() > 1 {
        let groups = scenes.into_values().collect();
        for index in choose_validation(groups, settings.val_fraction, settings.seed) {
            frames[index].split = Some(Split::Val);
        }
    }
    for frame in frames.iter_mut() {
        frame.row.split = frame.split.unwrap_or(Split::Train);
    }
    Ok(problems)
}

/// Takes splits and groups from the table.
fn follow_table(frames: &mut Vec<DraftFrame>, settings: &SplitSettings) -> Result<Vec<Problem>> {
    let table = read_table(settings)?;
    let entry_of = |frame: &DraftFrame| {
        frame
            .names()
            .into_iter()
            .find_map(|name| table.get(without_zeros(&name)))
    };
    let groups: BTreeSet<&str> = table
        .values()
        .filter_map(|entry| entry.group.as_deref())
        .collect();
    let numbers: BTreeMap<&str, u32> = groups.into_iter().zip(1..).collect();
    let mut problems = Vec::new();
    frames.retain_mut(|frame| {
        let Some(entry) = entry_of(frame) else {
            problems.push(Problem {
                subject: frame.name.clone(),
                reason: "is not listed in the table of splits".to_owned(),
            });
            return false;
        };
        frame.split = entry.split.or(frame.split);
        if let Some(group) = &entry.group {
            frame.row.scene = numbers.get(group.as_str()).copied();
        }
        true
    });
    Ok(problems)
}

/// Tables write `42` where files are called `000042`.
fn without_zeros(name: &str) -> &str {
    let short = name.trim_start_matches('0');
    if short.is_empty() { "0" } else { short }
}

fn read_table(settings: &SplitSettings) -> Result<BTreeMap<String, Entry>> {
    let Some(path) = &settings.table else {
        return Ok(BTreeMap::new());
    };
    let text = files::read_text(path)?;
    let unusable = |problem: String| {
        Error::dataset(
            path,
            problem,
            "give a CSV file with a column id and a column drive or split",
        )
    };
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_reader(text.as_bytes());
    let header = reader
        .headers()
        .map_err(|error| unusable(error.to_string()))?
        .clone();
    let column = |names: &[&str]| {
        let find = |name| header.iter().position(|column| column == name);
        names.iter().copied().find_map(find)
    };
    let name_column =
        column(&NAME_COLUMNS).ok_or_else(|| unusable("names no frames".to_owned()))?;
    let (group_column, split_column) = (column(&GROUP_COLUMNS), column(&["split"]));
    if group_column.is_none() && split_column.is_none() {
        return Err(unusable("has neither groups nor splits".to_owned()));
    }
    let mut table = BTreeMap::new();
    for record in reader.records() {
        let record = record.map_err(|error| unusable(error.to_string()))?;
        let filled = |column: Option<usize>| record.get(column?).filter(|text| !text.is_empty());
        let split = filled(split_column)
            .map(str::parse::<Split>)
            .transpose()
            .map_err(unusable)?;
        let entry = Entry {
            split,
            group: filled(group_column).map(str::to_owned),
        };
        let name = record.get(name_column).unwrap_or_default();
        table.insert(without_zeros(name).to_owned(), entry);
    }
    Ok(table)
}
