//! The table of the formats that are read.

use std::path::Path;

use super::LoadOptions;
use super::cityscapes::Cityscapes;
use super::euroc::Euroc;
use super::kalibr::Kalibr;
use super::kitti::Kitti;
use super::lines::TwoLines;
use super::middlebury::Middlebury;
use super::oak::Oak;
use super::opencv::OpenCv;
use super::orb_slam::OrbSlam;
use super::realsense::RealSense;
use super::ros::Ros;
use super::settings::Settings;
use super::zed::Zed;
use crate::error::{Error, Result};
use crate::geometry::CalibrationParts;

/// A kind of calibration file. Its own file has everything that is to be known of it.
pub(super) trait Format: Sync {
    /// What people call it.
    fn name(&self) -> &'static str;

    /// The words by which it is known.
    fn sign(&self) -> &'static str;

    /// Whether a text is of this format, by what is in it.
    fn matches(&self, text: &str) -> bool;

    /// Whether a file of this name is meant to be of this format, whatever is in it.
    fn has_name(&self, _name: &Path) -> bool {
        false
    }

    /// Whether a calibration of this format comes in two files.
    fn takes_two(&self) -> bool {
        false
    }

    /// Reads one text, or where the format takes them two.
    fn parse(&self, texts: &[&str], options: &LoadOptions) -> Result<CalibrationParts>;
}

/// Every format. Of several that match, the first is taken: those that ask for more come first.
const FORMATS: [&dyn Format; 13] = [
    &Kitti,
    &Zed,
    &Middlebury,
    &TwoLines,
    &Cityscapes,
    &Oak,
    &RealSense,
    &OrbSlam,
    &Euroc,
    &Kalibr,
    &Ros,
    &OpenCv,
    &Settings,
];

/// A format of the table, for people.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KnownFormat {
    /// What people call it.
    pub name: &'static str,
    /// The words by which it is known.
    pub sign: &'static str,
}

/// The formats that are read.
pub fn known() -> impl Iterator<Item = KnownFormat> {
    FORMATS.iter().map(|format| KnownFormat {
        name: format.name(),
        sign: format.sign(),
    })
}

/// The formats in one line, for a remedy.
pub(super) fn known_list() -> String {
    let formats: Vec<String> = known()
        .map(|format| format!("{} ({})", format.name, format.sign))
        .collect();
    format!(
        "known are {}; docs/formats.md has an example of each",
        formats.join(", ")
    )
}

/// Reads the texts of one or two files, with their names where they have any.
pub(super) fn parse(
    texts: &[&str],
    paths: &[&Path],
    options: &LoadOptions,
) -> Result<CalibrationParts> {
    let of = |text: &str| FORMATS.iter().find(|format| format.matches(text));
    let of_name = |path: &&Path| FORMATS.iter().find(|format| format.has_name(path));
    match texts {
        [text] if text.trim().is_empty() => {
            Err(Error::value("content", "the file is empty", known_list()))
        }
        [text] => match of(text).or_else(|| paths.first().and_then(of_name)) {
            Some(format) => format.parse(&[text], options),
            None => Err(unknown(text)),
        },
        [one, other] => {
            let both = [of(one), of(other)];
            let taken = both.into_iter().flatten().find(|format| format.takes_two());
            match (both, taken) {
                ([Some(a), Some(b)], Some(format)) if a.takes_two() && b.takes_two() => {
                    format.parse(&[one, other], options)
                }
                _ => Err(Error::value(
                    "two files",
                    "only YAML calibrations come in two",
                    "give intrinsics.yml and extrinsics.yml, left.yaml and right.yaml, two \
                     sensor.yaml, or one file",
                )),
            }
        }
        _ => Err(Error::value(
            format!("{} files", texts.len()),
            "a calibration has one or two",
            "give one or two files",
        )),
    }
}

/// The error of a text that no format knows, with what it looks like.
fn unknown(text: &str) -> Error {
    let lines = || {
        let lines = text.lines().map(str::trim);
        lines.filter(|line| !line.is_empty() && !line.starts_with(['#', ';']))
    };
    let first = lines().next().unwrap_or_default();
    if first.is_empty() {
        return Error::value("content", "the file is empty", known_list());
    }
    if first.starts_with('<') {
        return Error::value(
            "content",
            "is XML",
            format!(
                "save it with OpenCV's FileStorage under a name that ends in .yml; {}",
                known_list()
            ),
        );
    }
    let shown = |words: Vec<&str>| -> String {
        const SHOWN: usize = 6;
        let more = if words.len() > SHOWN { ", ..." } else { "" };
        let words: Vec<&str> = words.into_iter().take(SHOWN).collect();
        words.join(", ") + more
    };
    let is_section = |line: &&str| line.starts_with('[') && line.ends_with(']');
    let sections: Vec<&str> = lines()
        .filter(is_section)
        .map(|line| line.trim_matches(['[', ']']))
        .collect();
    let keys: Vec<&str> = lines()
        .filter_map(|line| Some(line.split_once('=')?.0.trim()))
        .collect();
    let looks = if let Ok(serde_json::Value::Object(members)) = serde_json::from_str(text) {
        let names = members.keys().map(String::as_str).collect();
        format!("JSON with {}", shown(names))
    } else if !sections.is_empty() {
        format!("an INI file with the sections {}", shown(sections))
    } else if !keys.is_empty() {
        format!("settings of {}", shown(keys))
    } else {
        const LONGEST: usize = 40;
        let begin: String = first.chars().take(LONGEST).collect();
        format!("a text that begins with \"{begin}\"")
    };
    Error::value(
        "content",
        format!("is no calibration that is known; it looks like {looks}"),
        known_list(),
    )
}
