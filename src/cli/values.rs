//! Values as people type them on the command line, and commands as they are shown to people.

use std::path::Path;
use std::str::FromStr;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use twinsight::dataset::{BoxKind, Split, StereoDataset};
use twinsight::pairing::PairingMode;
use twinsight::pipeline::SingleSided;
use twinsight::ranging::RangerKind;
use twinsight::sources::Layout;

/// An image size, `WIDTHxHEIGHT`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImageSize {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
}

impl FromStr for ImageSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text
            .split_once(['x', 'X'])
            .and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
        match numbers {
            Some((width, height)) => Ok(Self { width, height }),
            None => Err("is not width x height in pixels; write it like 640x360".to_owned()),
        }
    }
}

/// A share between 0 and 1.
pub fn share<T: FromStr + PartialOrd + From<u8>>(text: &str) -> Result<T, String> {
    match text.parse() {
        Ok(value) if (T::from(0)..=T::from(1)).contains(&value) => Ok(value),
        _ => Err("is no number from 0 to 1".to_owned()),
    }
}

/// A finite number, 0 or above.
pub fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(value),
        _ => Err("is no number of 0 or above".to_owned()),
    }
}

/// A finite number above 0.
pub fn above_zero(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("is no number above 0".to_owned()),
    }
}

/// `fused` or `paper`.
pub fn ranger() -> impl TypedValueParser<Value = RangerKind> {
    PossibleValuesParser::new(RangerKind::ALL.map(RangerKind::word))
        .try_map(|word| word.parse::<RangerKind>())
}

/// `sphere` or `tight`.
pub fn box_kind() -> impl TypedValueParser<Value = BoxKind> {
    PossibleValuesParser::new(["sphere", "tight"]).try_map(|word| word.parse::<BoxKind>())
}

/// The kind of box that people look at: the exact one where the dataset has it.
pub fn shown_kind(dataset: &StereoDataset) -> BoxKind {
    if dataset.info.label_kinds.contains(&BoxKind::Tight) {
        BoxKind::Tight
    } else {
        BoxKind::Sphere
    }
}

/// The splits that networks are judged by: `val` or `test`.
pub fn split() -> impl TypedValueParser<Value = Split> {
    PossibleValuesParser::new(["val", "test"]).try_map(|word| word.parse::<Split>())
}

/// `detect` or `search`.
pub fn pairing_mode() -> impl TypedValueParser<Value = PairingMode> {
    PossibleValuesParser::new(PairingMode::ALL.map(PairingMode::word))
        .try_map(|word| word.parse::<PairingMode>())
}

/// `drop`, `search` or `keep`.
pub fn single_sided() -> impl TypedValueParser<Value = SingleSided> {
    PossibleValuesParser::new(SingleSided::ALL.map(SingleSided::word))
        .try_map(|word| word.parse::<SingleSided>())
}

/// `side-by-side` or `top-bottom`.
pub fn layout() -> impl TypedValueParser<Value = Layout> {
    PossibleValuesParser::new(Layout::ALL.map(Layout::word)).try_map(|word| word.parse::<Layout>())
}

/// A path as it is typed in a shell.
pub fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_alphanumeric() || "_./\\:-+=,@%".contains(c);
    if !text.is_empty() && text.chars().all(plain) {
        return text;
    }
    if cfg!(windows) {
        return format!("\"{text}\"");
    }
    format!("'{}'", text.replace('\'', r"'\''"))
}

/// This program as it was called, to be shown in the next command.
pub fn program() -> String {
    match std::env::args_os().next() {
        Some(name) => quoted(Path::new(&name)),
        None => "twinsight".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_width_by_height() {
        let size: ImageSize = "640x360".parse().unwrap();
        assert_eq!((size.width, size.height), (640, 360));
        for text in ["640", "x", "640x", "-1x5", "6.5x3", "640x360x2", ""] {
            assert!(text.parse::<ImageSize>().is_err(), "{text} is no size");
        }
    }

    #[test]
    fn shares_are_numbers_from_zero_to_one() {
        assert_eq!(share("0.25"), Ok(0.25_f32));
        assert_eq!(share("0.7"), Ok(0.7_f64));
        for text in ["1.5", "-0.1", "NaN", "many"] {
            assert!(share::<f32>(text).is_err(), "{text} is no share");
        }
    }

    #[cfg(unix)]
    #[test]
    fn paths_with_blanks_and_quotes_are_quoted() {
        assert_eq!(quoted(Path::new("runs/a-1.b")), "runs/a-1.b");
        assert_eq!(quoted(Path::new("my runs")), "'my runs'");
        assert_eq!(quoted(Path::new("it's")), r"'it'\''s'");
    }
}
