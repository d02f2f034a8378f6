//! The page: one HTML file with everything in it.

use serde::Serialize;

use super::charts;
use super::samples::{Row, Sample, Samples};
use super::summary::Summary;
use crate::dataset::{BoxKind, StereoDataset};
use crate::error::Result;
use crate::imaging::jpeg_bytes;
use crate::page::{self, charts::hex};

/// The page without its content.
const TEMPLATE: &str = include_str!("page.html");

/// What the template fills in.
#[derive(Serialize)]
struct Page<'a> {
    name: String,
    facts: Vec<[String; 2]>,
    left_out: Vec<String>,
    splits: Vec<SplitRow>,
    charts: Vec<ChartPart>,
    rows: Vec<RowPart<'a>>,
    pairs: Vec<SamplePart<'a>>,
}

#[derive(Serialize)]
struct SplitRow {
    name: String,
    color: String,
    numbers: [usize; 6],
}

#[derive(Serialize)]
struct ChartPart {
    title: &'static str,
    svg: String,
}

#[derive(Serialize)]
struct RowPart<'a> {
    title: &'a str,
    samples: Vec<SamplePart<'a>>,
}

#[derive(Serialize)]
struct SamplePart<'a> {
    caption: &'a str,
    jpeg: String,
    width: u32,
    height: u32,
}

/// The whole page as text.
pub(super) fn render(
    dataset: &StereoDataset,
    kind: BoxKind,
    summary: &Summary,
    samples: &Samples,
) -> Result<String> {
    let splits = summary.splits.iter().map(|split| SplitRow {
        name: split.split.to_string(),
        color: hex(charts::color(split.split)),
        numbers: [
            split.frames,
            split.images,
            split.scenes,
            split.vehicles,
            split.pairs,
            split.ignored,
        ],
    });
    let charts = charts::all(summary)?.into_iter().map(|chart| ChartPart {
        title: chart.title,
        svg: chart.svg,
    });
    let folder = &dataset.folder;
    let name = folder.canonicalize().unwrap_or_else(|_| folder.clone());
    let name = name.file_name().unwrap_or_default().to_string_lossy();
    let page = Page {
        name: name.into_owned(),
        facts: facts(dataset, kind),
        left_out: dataset.problems.iter().map(ToString::to_string).collect(),
        splits: splits.collect(),
        charts: charts.collect(),
        rows: samples.rows.iter().map(row_part).collect::<Result<_>>()?,
        pairs: samples
            .pairs
            .iter()
            .map(sample_part)
            .collect::<Result<_>>()?,
    };
    page::render(TEMPLATE, &page)
}

fn facts(dataset: &StereoDataset, kind: BoxKind) -> Vec<[String; 2]> {
    let rig = dataset.rig();
    let camera = &rig.left;
    let fact = |name: &str, value: String| [name.to_owned(), value];
    let mut facts = vec![
        fact("images", format!("{} x {} px", camera.width, camera.height)),
        fact("classes", dataset.classes().join(", ")),
        fact("boxes shown", kind.to_string()),
    ];
    if dataset.info.stereo {
        facts.push(fact("baseline", format!("{:.4} m", rig.baseline_m)));
        facts.push(fact("focal length", format!("{:.1} px", rig.focal_px())));
        let [near, far] = [10.0, 100.0].map(|z_m| rig.disparity_px(z_m));
        facts.push(fact(
            "disparity",
            format!("{near:.1} px at 10 m, {far:.2} px at 100 m"),
        ));
    } else {
        facts.push(fact(
            "stereo",
            "no: single images, for detectors".to_owned(),
        ));
    }
    let made_by = &dataset.info.made_by;
    for key in ["program", "version", "source"] {
        if let Some(value) = made_by.get(key).and_then(toml::Value::as_str) {
            facts.push(fact(key, value.to_owned()));
        }
    }
    facts
}

fn row_part(row: &Row) -> Result<RowPart<'_>> {
    Ok(RowPart {
        title: &row.title,
        samples: row.samples.iter().map(sample_part).collect::<Result<_>>()?,
    })
}

fn sample_part(sample: &Sample) -> Result<SamplePart<'_>> {
    Ok(SamplePart {
        caption: &sample.caption,
        jpeg: page::base64(&jpeg_bytes(&sample.caption, &sample.picture)?),
        width: sample.picture.width(),
        height: sample.picture.height(),
    })
}
