//! Names of presets, and the folders that commands use when none is given.

use std::path::{Path, PathBuf};

use clap::builder::PossibleValuesParser;
use twinsight::generate::GenerateConfig;

/// What is used when neither a preset nor a configuration is given.
pub const DEFAULT: &str = "quick";

/// The preset names. A preset means a dataset and a training of the same name, so that training
/// can make the dataset that it was meant for.
pub fn names() -> PossibleValuesParser {
    PossibleValuesParser::new(GenerateConfig::PRESETS)
}

/// What a run or dataset is called after: the configuration file, or else the preset.
pub fn title(preset: &str, config: Option<&Path>) -> PathBuf {
    match config.and_then(Path::file_stem) {
        Some(stem) => PathBuf::from(stem),
        None => PathBuf::from(preset),
    }
}
