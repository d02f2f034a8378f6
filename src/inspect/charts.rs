//! Histograms as SVG pictures.

use plotters::prelude::*;

use super::summary::{SplitSummary, Summary};
use crate::dataset::Split;
use crate::error::{Error, Result};

/// Size of a chart, SVG units; the page scales it.
const SIZE: (u32, u32) = (480, 240);

/// Bars of a histogram, about.
const BINS: f64 = 16.0;

/// A histogram with its title.
pub(super) struct Chart {
    pub title: &'static str,
    pub svg: String,
}

/// Colours of the splits: told apart with any colour vision (Okabe and Ito's).
pub(super) const fn color(split: Split) -> (u8, u8, u8) {
    match split {
        Split::Train => (0, 114, 178),
        Split::Val => (230, 159, 0),
        Split::Test => (0, 158, 115),
    }
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
            let svg = histogram(&sets, unit).map_err(|error| {
                Error::value(format!("chart '{title}'"), error, "report this as a bug")
            })?;
            charts.push(Chart { title, svg });
        }
    }
    Ok(charts)
}

/// Width of a bin: 1, 2 or 5 times a power of ten.
fn step(range: f64) -> f64 {
    let rough = (range / BINS).max(1e-3);
    let power = libm::pow(10.0, libm::floor(libm::log10(rough)));
    let factor = [1.0, 2.0, 5.0]
        .into_iter()
        .find(|factor| factor * power >= rough * 0.999);
    factor.unwrap_or(10.0) * power
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

fn histogram(sets: &[(Split, &[f64])], unit: &str) -> Result<String, String> {
    let values = || sets.iter().flat_map(|(_, values)| values.iter().copied());
    let least = values().fold(f64::INFINITY, f64::min);
    let most = values().fold(f64::NEG_INFINITY, f64::max);
    let step = step(most - least);
    let low = (least / step).floor() * step;
    let bins = (((most - low) / step).floor() as usize + 1).max(1);
    let high = low + step * bins as f64;
    let counted: Vec<(Split, Vec<usize>)> = sets
        .iter()
        .map(|(split, values)| (*split, counts(values, low, step, bins)))
        .collect();
    let highest = counted.iter().flat_map(|(_, counts)| counts).max().copied();
    let top = highest.unwrap_or(1).max(1) as f64 * 1.05;
    let mut svg = String::new();
    draw(&mut svg, &counted, unit, [low, high, step, top]).map_err(|error| error.to_string())?;
    Ok(svg)
}

fn draw(
    svg: &mut String,
    counted: &[(Split, Vec<usize>)],
    unit: &str,
    [low, high, step, top]: [f64; 4],
) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    let ink = RGBColor(60, 60, 60);
    let style = ("sans-serif", 13).into_font().color(&ink);
    let mut chart = ChartBuilder::on(&root)
        .margin(6)
        .margin_right(14)
        .x_label_area_size(36)
        .y_label_area_size(44)
        .build_cartesian_2d(low..high, 0.0..top)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(RGBColor(225, 225, 225))
        .axis_style(ink)
        .x_labels(8)
        .y_labels(5)
        .x_desc(unit)
        .label_style(style.clone())
        .axis_desc_style(style)
        .x_label_formatter(&|value| format!("{}", (value * 1e3).round() / 1e3))
        // Counts are whole; a short axis has steps between them.
        .y_label_formatter(&|value| {
            if value.fract() == 0.0 {
                format!("{value:.0}")
            } else {
                String::new()
            }
        })
        .draw()?;
    // The bars of a bin stand beside each other in the middle nine tenths.
    let width = 0.9 * step / counted.len() as f64;
    for (place, (split, counts)) in counted.iter().enumerate() {
        let (red, green, blue) = color(*split);
        let fill = RGBColor(red, green, blue).filled();
        let bars = counts.iter().enumerate().filter(|(_, count)| **count > 0);
        chart.draw_series(bars.map(|(bin, count)| {
            let left = low + step * (bin as f64 + 0.05) + width * place as f64;
            Rectangle::new([(left, 0.0), (left + width, *count as f64)], fill)
        }))?;
    }
    root.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_are_round_numbers_and_hold_every_value() {
        for (range, expected) in [
            (50.0, 5.0),
            (16.0, 1.0),
            (1.0, 0.1),
            (360.0, 50.0),
            (0.0, 0.001),
        ] {
            assert!(
                (step(range) - expected).abs() < 1e-9,
                "{range}: {}",
                step(range)
            );
        }
        let values: Vec<f64> = (0..100).map(|i| f64::from(i) * 0.37).collect();
        assert_eq!(counts(&values, 0.0, 5.0, 8).iter().sum::<usize>(), 100);
    }

    #[test]
    fn one_value_makes_a_chart() {
        let svg = histogram(&[(Split::Train, &[7.0]), (Split::Val, &[])], "metres").unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("metres") && svg.contains("#0072B2"));
    }
}
