//! Histograms of a dataset.

use super::summary::{SplitSummary, Summary};
use crate::dataset::Split;
use crate::error::Result;
use crate::page::charts::{self, Axis, Figure, Rgb, Shape};

/// Bars of a histogram, about.
const BINS: f64 = 16.0;

/// A histogram with its title.
pub(super) struct Chart {
    pub title: &'static str,
    pub svg: String,
}

/// Colours of the splits.
pub(super) const fn color(split: Split) -> Rgb {
    charts::color(match split {
        Split::Train => 0,
        Split::Val => 1,
        Split::Test => 2,
    })
}

/// Every histogram for which there are values.
pub(super) fn all(summary: &Summary) -> Result<Vec<Chart>> {
    type Values = fn(&SplitSummary) -> &[f64];
    let kinds: [(&'static str, &str, Values); 5] = [
        ("Distance of vehicles", "metres", |s| &s.distances_m),
        ("Longer side of boxes", "pixels", |s| &s.box_sides_px),
        ("Visible part of vehicles", "fraction", |s| &s.visible),
        ("Azimuth of the rig, 0 in front", "degrees", |s| {
            &s.azimuths_deg
        }),
        ("Elevation of the rig", "degrees", |s| &s.elevations_deg),
    ];
    let mut charts = Vec::new();
    for (title, unit, values) in kinds {
        let sets: Vec<(Split, &[f64])> = summary
            .splits
            .iter()
            .map(|s| (s.split, values(s)))
            .collect();
        if sets.iter().any(|(_, values)| !values.is_empty()) {
            let svg = histogram(&sets, unit)?;
            charts.push(Chart { title, svg });
        }
    }
    Ok(charts)
}

/// Counts per bin, from the bin that starts at `low`.
fn counts(values: &[f64], low: f64, step: f64, bins: usize) -> Vec<usize> {
    let mut counts = vec![0; bins];
    for value in values {
        let bin = ((value - low) / step) as usize;
        counts[bin.min(bins - 1)] += 1;
    }
    counts
}

fn histogram(sets: &[(Split, &[f64])], unit: &str) -> Result<String> {
    let values = || sets.iter().flat_map(|(_, values)| values.iter().copied());
    let least = values().fold(f64::INFINITY, f64::min);
    let most = values().fold(f64::NEG_INFINITY, f64::max);
    let step = charts::round_step((most - least) / BINS);
    let low = (least / step).floor() * step;
    let bins = (((most - low) / step).floor() as usize + 1).max(1);
    let counted: Vec<(Split, Vec<usize>)> = sets
        .iter()
        .map(|(split, values)| (*split, counts(values, low, step, bins)))
        .collect();
    let highest = counted.iter().flat_map(|(_, counts)| counts).max().copied();
    // The bars of a bin stand beside each other in the middle nine tenths.
    let width = 0.9 * step / counted.len() as f64;
    let shapes = counted.iter().enumerate().map(|(place, (split, counts))| {
        let bars = counts.iter().enumerate().filter(|(_, count)| **count > 0);
        let bars = bars.map(|(bin, count)| {
            let left = low + step * (bin as f64 + 0.05) + width * place as f64;
            [left, 0.0, left + width, *count as f64]
        });
        (color(*split), Shape::Bars(bars.collect()))
    });
    Figure {
        x: Axis::new(unit, [low, low + step * bins as f64]),
        y: Axis {
            whole: true,
            ..Axis::new("", [0.0, highest.unwrap_or(1).max(1) as f64 * 1.05])
        },
        shapes: shapes.collect(),
        square: false,
    }
    .svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_hold_every_value() {
        let values: Vec<f64> = (0..100).map(|i| f64::from(i) * 0.37).collect();
        assert_eq!(counts(&values, 0.0, 5.0, 8).iter().sum::<usize>(), 100);
    }

    #[test]
    fn one_value_makes_a_chart() {
        let svg = histogram(&[(Split::Train, &[7.0]), (Split::Val, &[])], "metres").unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("metres") && svg.contains("#0072B2"));
    }
}
