//! A picture of the rows that features are off, before and after what was found.

use std::collections::BTreeMap;

use plotters::prelude::*;

use super::fit::RectificationFit;
use super::matching::FeatureMatch;
use crate::error::{Error, Result};
use crate::geometry::StereoRig;

/// Parts of the image, along x and y, with an arrow each.
const CELLS: [u32; 2] = [32, 12];

/// Fewest matches that an arrow stands for.
const LEAST: usize = 3;

/// Width of the picture, SVG units.
const WIDTH: u32 = 960;

/// Room for a panel's words, SVG units.
const WORDS: u32 = 110;

/// Lower than it should be, and higher: told apart with any colour vision.
const COLORS: [RGBColor; 2] = [RGBColor(213, 94, 0), RGBColor(0, 114, 178)];

const INK: RGBColor = RGBColor(60, 60, 60);

/// Draws vertical disparities over the image as SVG: above as they are, below what remains of them.
/// Arrows show the median of a part of the image, enlarged.
///
/// # Errors
/// A defect of the drawing.
pub fn rows_picture(
    matches: &[FeatureMatch],
    fit: &RectificationFit,
    rig: &StereoRig,
) -> Result<String> {
    let panels = [
        (
            "before",
            arrows(matches, rig, |of| fit.rows_px(of)),
            fit.sigma_before_px,
        ),
        (
            "after",
            arrows(matches, rig, |of| fit.residual_px(of)),
            fit.sigma_px,
        ),
    ];
    let largest = panels
        .iter()
        .flat_map(|(_, arrows, _)| arrows)
        .map(|arrow| arrow[2].abs())
        .fold(0.0, f64::max);
    // The longest arrow is as long as two parts of the image are high.
    let room = 2.0 * f64::from(rig.left.height) / f64::from(CELLS[1]);
    let enlarged = (room / largest.max(1e-3)).min(1000.0).floor().max(1.0);
    let mut svg = String::new();
    draw(&mut svg, &panels, enlarged, rig).map_err(|error| {
        Error::value("picture of rows", error.to_string(), "report this as a bug")
    })?;
    Ok(svg)
}

/// Middle of each part of the image and the median of its matches, pixels.
fn arrows(
    matches: &[FeatureMatch],
    rig: &StereoRig,
    value: impl Fn(&FeatureMatch) -> f64,
) -> Vec<[f64; 3]> {
    let size = [rig.left.width, rig.left.height].map(f64::from);
    let mut cells: BTreeMap<[u32; 2], Vec<[f64; 3]>> = BTreeMap::new();
    for of in matches {
        let cell = [0, 1].map(|i| {
            let part = (of.left[i] / size[i] * f64::from(CELLS[i])) as u32;
            part.min(CELLS[i] - 1)
        });
        let [x, y] = of.left;
        cells.entry(cell).or_default().push([x, y, value(of)]);
    }
    cells
        .into_values()
        .filter(|values| values.len() >= LEAST)
        .map(|values| {
            [0, 1, 2].map(|i| {
                let mut column: Vec<f64> = values.iter().map(|value| value[i]).collect();
                let middle = column.len() / 2;
                *column.select_nth_unstable_by(middle, f64::total_cmp).1
            })
        })
        .collect()
}

type Panel = (&'static str, Vec<[f64; 3]>, f64);

fn draw(
    svg: &mut String,
    panels: &[Panel; 2],
    enlarged: f64,
    rig: &StereoRig,
) -> Result<(), Box<dyn std::error::Error>> {
    let (width, height) = (f64::from(rig.left.width), f64::from(rig.left.height));
    let panel_height = (f64::from(WIDTH) * height / width) as u32 + WORDS;
    let root = SVGBackend::with_string(svg, (WIDTH, 2 * panel_height)).into_drawing_area();
    root.fill(&WHITE)?;
    for (area, (name, arrows, sigma_px)) in root.split_evenly((2, 1)).iter().zip(panels) {
        let caption = format!(
            "{name}: rows in the right image lower (orange) or higher (blue) than in the left, \
             x {enlarged}; spread {sigma_px:.2} px"
        );
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .caption(caption, ("sans-serif", 17).into_font().color(&INK))
            .x_label_area_size(34)
            .y_label_area_size(48)
            // Rows count downwards.
            .build_cartesian_2d(0.0..width, height..0.0)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(RGBColor(232, 232, 232))
            .axis_style(INK)
            .x_desc("column, px")
            .y_desc("row, px")
            .label_style(("sans-serif", 14).into_font().color(&INK))
            .x_label_formatter(&|value| format!("{value:.0}"))
            .y_label_formatter(&|value| format!("{value:.0}"))
            .draw()?;
        chart.draw_series(arrows.iter().map(|[x, y, off]| {
            let color = COLORS[usize::from(*off < 0.0)];
            let ends = vec![(*x, *y), (*x, *y + off * enlarged)];
            PathElement::new(ends, color.stroke_width(2))
        }))?;
        chart.draw_series(arrows.iter().map(|[x, y, off]| {
            let color = COLORS[usize::from(*off < 0.0)];
            Circle::new((*x, *y + off * enlarged), 3, color.filled())
        }))?;
    }
    root.present()?;
    Ok(())
}
