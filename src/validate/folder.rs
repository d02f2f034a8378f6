//! What lies in a dataset's folder beside frames and labels.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use rayon::prelude::*;

use super::{Finding, FindingKind};
use crate::dataset::{CompositeSet, CompositeStatistics, Split, StereoDataset, is_prepared};
use crate::error::{Error, Result};
use crate::files;

/// Files that are there while a folder is being filled.
const MARKERS: [&str; 2] = ["generating.toml", "importing.toml"];

/// What is wrong with the folder.
pub(super) fn check(dataset: &StereoDataset) -> Result<Vec<Finding>> {
    let folder = &dataset.folder;
    let mut findings: Vec<Finding> = MARKERS
        .iter()
        .filter(|name| folder.join(name).exists())
        .map(|name| {
            let reason = "is left over: the command that fills this folder has not finished";
            Finding::new(FindingKind::Leftover, *name, reason)
        })
        .collect();
    let stamps: BTreeSet<u64> = dataset.frames.iter().map(|frame| frame.row.stamp).collect();
    let frames = folder.join("frames");
    for name in names_in(&frames)? {
        if name.starts_with(files::TEMPORARY_PREFIX) {
            findings.push(leftover(&name, "is half-written"));
            continue;
        }
        let stem = Path::new(&name).file_stem().unwrap_or_default();
        let stem = stem.to_string_lossy();
        let digits = stem.rsplit('_').next().unwrap_or_default();
        let stamp: Option<u64> = digits.parse().ok();
        // Strangers with a side and a stamp are the reader's findings.
        let is_side = stem.starts_with("left_") || stem.starts_with("right_");
        if stamp.is_none() || (!is_side && stamp.is_some_and(|stamp| !stamps.contains(&stamp))) {
            findings.push(leftover(&name, "belongs to no frame"));
        } else if !dataset.info.stereo && stem.starts_with("right_") {
            findings.push(leftover(&name, "is a right one, and stereo = false"));
        }
    }
    findings.extend(composites(dataset));
    Ok(findings)
}

fn leftover(name: &str, reason: &str) -> Finding {
    Finding::new(FindingKind::Leftover, format!("frames/{name}"), reason)
}

/// Names in a folder, sorted.
fn names_in(folder: &Path) -> Result<BTreeSet<String>> {
    let entries = fs::read_dir(folder).map_err(Error::io("read", folder))?;
    entries
        .map(|entry| {
            let name = entry.map_err(Error::io("read", folder))?.file_name();
            Ok(name.to_string_lossy().into_owned())
        })
        .collect()
}

/// What is wrong with the composites, if there are any.
fn composites(dataset: &StereoDataset) -> Vec<Finding> {
    if !dataset.folder.join("composites").is_dir() {
        return Vec::new();
    }
    let whole = |reason: String| Finding::new(FindingKind::Composite, "composites", reason);
    let statistics = match CompositeStatistics::read(&dataset.folder) {
        Ok(statistics) => statistics,
        Err(error) => return vec![whole(error.to_string())],
    };
    let mut findings = Vec::new();
    if !is_prepared(dataset, statistics.kind, statistics.size) {
        let reason = "are not those of these labels, splits and images; `twinsight prepare` or the \
                      next training makes them anew";
        findings.push(whole(reason.to_owned()));
    }
    for split in Split::ALL {
        if statistics.counts.of(*split) == 0 {
            continue;
        }
        let set = match CompositeSet::open(&dataset.folder, *split) {
            Ok(set) => set,
            Err(error) => {
                findings.push(whole(error.to_string()));
                continue;
            }
        };
        findings.extend(set.problems.iter().map(|problem| {
            Finding::new(FindingKind::Composite, &problem.subject, &problem.reason)
        }));
        let broken: Vec<Finding> = set
            .items
            .par_iter()
            .filter_map(|item| {
                let error = item.load(set.statistics.size).err()?;
                let name = item.path.file_name().unwrap_or_default().to_string_lossy();
                let subject = format!("composites/{split}/{name}");
                Some(Finding::new(
                    FindingKind::Composite,
                    subject,
                    error.to_string(),
                ))
            })
            .collect();
        findings.extend(broken);
    }
    findings
}
