//! The tables of an evaluation, and their files: each as CSV and as JSON.

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::Evaluation;
use super::detections::{ClassRow, CocoRow, ConfusionRow, CurveRow};
use super::distances::{DifferenceRow, DistanceRow};
use super::examples::ExampleRow;
use super::latency::LatencyRow;
use super::protocol::Protocol;
use super::reliability::{ReliabilityRow, SpreadRow};
use super::vehicles::{Boxes, FalseVehicle, VehicleRow};
use crate::dataset::Split;
use crate::error::{Error, Result};
use crate::files;
use crate::pipeline::PredictOptions;

/// Every table of an evaluation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tables {
    /// Each labelled vehicle with what was estimated of it.
    pub vehicles: Vec<VehicleRow>,
    /// Each vehicle that the pipeline made up.
    pub false_vehicles: Vec<FalseVehicle>,
    /// Distance errors by boxes, method and group.
    pub distance: Vec<DistanceRow>,
    /// The network against the baselines.
    pub differences: Vec<DifferenceRow>,
    /// The detector by class.
    pub detection: Vec<ClassRow>,
    /// Precision, recall and F1 over the confidence.
    pub detection_curves: Vec<CurveRow>,
    /// The COCO evaluation.
    pub coco: Vec<CocoRow>,
    /// What intervals hold, by their probability.
    pub reliability: Vec<ReliabilityRow>,
    /// Errors by predicted spread.
    pub spread: Vec<SpreadRow>,
    /// The confusion matrix.
    pub confusion: Vec<ConfusionRow>,
    /// Time by stage.
    pub latency: Vec<LatencyRow>,
    /// The paper's test, where the split holds any of its kind of frames.
    pub protocol: Option<Protocol>,
    /// Pictures.
    pub examples: Vec<ExampleRow>,
}

impl Tables {
    /// Leaves out the rows of a pipeline that a run without one of its networks does not have.
    pub(super) fn leave_out_pipeline(&mut self) {
        self.distance.retain(|row| row.boxes == Boxes::True);
        if let Some(protocol) = &mut self.protocol {
            protocol.rows.retain(|row| row.boxes == Boxes::True);
            protocol.methods.retain(|row| row.boxes == Boxes::True);
        }
    }
}

/// A run's folder of evaluations.
const EVALUATIONS: &str = "evaluation";

/// The figures that are not a table.
const FIGURES: &str = "evaluation.json";

/// Where an evaluation is written unless somebody says otherwise: `<run>/evaluation/<dataset>-<split>`
/// and what is not as usual, such as `quick-val-detect-0.30`: another comparison replaces nothing.
pub(super) fn default_folder(
    run: Option<&Path>,
    data: &Path,
    split: Split,
    options: &PredictOptions,
) -> PathBuf {
    let data = data.canonicalize().unwrap_or_else(|_| data.to_path_buf());
    let name = data.file_name().unwrap_or_default().to_string_lossy();
    let usual = PredictOptions::default();
    let mut folder = format!("{name}-{split}");
    if options.pairing_mode != usual.pairing_mode {
        folder.push('-');
        folder += options.pairing_mode.word();
    }
    if options.confidence != usual.confidence {
        let short = format!("{:.2}", options.confidence);
        folder.push('-');
        folder += &match short.parse::<f32>() {
            Ok(parsed) if options.confidence == parsed => short,
            _ => options.confidence.to_string(),
        };
    }
    if options.ranger != usual.ranger {
        folder.push('-');
        folder += options.ranger.word();
    }
    run.unwrap_or(Path::new("")).join(EVALUATIONS).join(folder)
}

/// The evaluations of a run, by name.
///
/// # Errors
/// A folder that cannot be read.
pub fn evaluations(run: &Path) -> Result<Vec<PathBuf>> {
    let folder = run.join(EVALUATIONS);
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let entries = std::fs::read_dir(&folder).map_err(Error::io("read", &folder))?;
    let mut found = Vec::new();
    for entry in entries {
        let path = entry.map_err(Error::io("read", &folder))?.path();
        if path.join(FIGURES).is_file() {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// Writes an evaluation into a folder, which is created where it is missing; files of an earlier
/// one are replaced or removed.
///
/// # Errors
/// A file that cannot be written.
pub(super) fn write(folder: &Path, evaluation: &Evaluation) -> Result<()> {
    files::create_folder(folder)?;
    let tables = &evaluation.tables;
    write_table(folder, "vehicles", &tables.vehicles)?;
    write_table(folder, "false_vehicles", &tables.false_vehicles)?;
    write_table(folder, "distance", &tables.distance)?;
    write_table(folder, "differences", &tables.differences)?;
    write_table(folder, "reliability", &tables.reliability)?;
    write_table(folder, "spread", &tables.spread)?;
    write_table(folder, "detection", &tables.detection)?;
    write_table(folder, "detection_curves", &tables.detection_curves)?;
    write_table(folder, "coco", &tables.coco)?;
    write_table(folder, "confusion", &tables.confusion)?;
    write_table(folder, "latency", &tables.latency)?;
    write_table(folder, "examples", &tables.examples)?;
    let protocol = tables.protocol.as_ref();
    write_table(folder, "protocol", protocol.map_or(&[], |p| &p.rows))?;
    write_table(
        folder,
        "protocol_methods",
        protocol.map_or(&[], |p| &p.methods),
    )?;
    write_table(
        folder,
        "protocol_missing",
        protocol.map_or(&[], |p| &p.missing),
    )?;
    // Last: a folder with it is complete.
    write_json(&folder.join(FIGURES), evaluation)
}

/// One table as CSV and JSON; one without rows has no files.
pub(crate) fn write_table<R: Serialize>(folder: &Path, name: &str, rows: &[R]) -> Result<()> {
    let csv_path = folder.join(format!("{name}.csv"));
    let json_path = folder.join(format!("{name}.json"));
    if rows.is_empty() {
        for path in [csv_path, json_path] {
            if path.exists() {
                std::fs::remove_file(&path).map_err(Error::io("remove", &path))?;
            }
        }
        return Ok(());
    }
    let defect = |reason: String| {
        Error::value(
            csv_path.display().to_string(),
            reason,
            "report this as a defect",
        )
    };
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer
            .serialize(row)
            .map_err(|error| defect(error.to_string()))?;
    }
    let bytes = writer
        .into_inner()
        .map_err(|error| defect(error.to_string()))?;
    files::write_atomically(&csv_path, &bytes)?;
    write_json(&json_path, rows)
}

/// A value as JSON.
pub(crate) fn write_json<T: Serialize + ?Sized>(path: &Path, value: &T) -> Result<()> {
    let mut json = serde_json::to_vec_pretty(value).map_err(|source| {
        Error::value(
            path.display().to_string(),
            source.to_string(),
            "report this as a defect",
        )
    })?;
    json.push(b'\n');
    files::write_atomically(path, &json)
}

/// Reads the evaluation that was written into a folder, its tables included.
///
/// # Errors
/// A file that cannot be read, or that another version wrote.
pub fn read(folder: &Path) -> Result<Evaluation> {
    let mut evaluation: Evaluation = read_json(&folder.join(FIGURES))?;
    let protocol_rows = read_table(folder, "protocol")?;
    evaluation.tables = Tables {
        vehicles: read_table(folder, "vehicles")?,
        false_vehicles: read_table(folder, "false_vehicles")?,
        distance: read_table(folder, "distance")?,
        differences: read_table(folder, "differences")?,
        reliability: read_table(folder, "reliability")?,
        spread: read_table(folder, "spread")?,
        detection: read_table(folder, "detection")?,
        detection_curves: read_table(folder, "detection_curves")?,
        coco: read_table(folder, "coco")?,
        confusion: read_table(folder, "confusion")?,
        latency: read_table(folder, "latency")?,
        examples: read_table(folder, "examples")?,
        protocol: None,
    };
    if !protocol_rows.is_empty() {
        let missing: Vec<_> = read_table(folder, "protocol_missing")?;
        evaluation.tables.protocol = Some(Protocol {
            rows: protocol_rows,
            methods: read_table(folder, "protocol_methods")?,
            missing,
            ..evaluation.protocol.clone().unwrap_or_default()
        });
    }
    Ok(evaluation)
}

/// A table's rows; none where there is no such file.
pub(crate) fn read_table<R: DeserializeOwned>(folder: &Path, name: &str) -> Result<Vec<R>> {
    let path = folder.join(format!("{name}.json"));
    if !path.exists() {
        return Ok(Vec::new());
    }
    read_json(&path)
}

fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    serde_json::from_str(&files::read_text(path)?).map_err(|source| {
        Error::value(
            path.display().to_string(),
            format!("is no evaluation of this version: {source}"),
            "run `twinsight evaluate` again",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pairing::PairingMode;

    #[test]
    fn what_is_not_as_usual_stands_in_the_name_of_the_folder() {
        let usual = PredictOptions::default();
        let name = |options: PredictOptions| {
            let folder = default_folder(
                Some(Path::new("r")),
                Path::new("x/quick"),
                Split::Val,
                &options,
            );
            assert_eq!(folder.parent(), Some(Path::new("r/evaluation")));
            folder.file_name().unwrap().to_string_lossy().into_owned()
        };
        assert_eq!(name(usual), "quick-val");
        let detect = PredictOptions {
            pairing_mode: PairingMode::Detect,
            ..usual
        };
        assert_eq!(name(detect), "quick-val-detect");
        for (confidence, expected) in [(0.3, "0.30"), (0.0001, "0.0001"), (0.125, "0.125")] {
            let options = PredictOptions {
                confidence,
                ..detect
            };
            assert_eq!(name(options), format!("quick-val-detect-{expected}"));
            let options = PredictOptions {
                confidence,
                ..usual
            };
            assert_eq!(name(options), format!("quick-val-{expected}"));
        }
    }
}
