//! Charts as SVG pictures: lines, dots and bars over two axes.

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::error::{Error, Result};

/// Size of a chart, SVG units; the page scales it.
const SIZE: (u32, u32) = (480, 280);

/// Size of a square chart.
const SQUARE: (u32, u32) = (480, 460);

/// Names on an axis that have room beside each other.
const MOST_NAMES: usize = 8;

const INK: RGBColor = RGBColor(60, 60, 60);

/// Red, green, blue.
pub(crate) type Rgb = (u8, u8, u8);

/// Colours that are told apart with any colour vision (Okabe and Ito's).
pub(crate) const COLORS: [Rgb; 7] = [
    (0, 114, 178),
    (230, 159, 0),
    (0, 158, 115),
    (204, 121, 167),
    (213, 94, 0),
    (86, 180, 233),
    (120, 120, 120),
];

/// A colour as style sheets write it.
pub(crate) fn hex((red, green, blue): Rgb) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// The colour of the series with this number.
pub(crate) const fn color(series: usize) -> Rgb {
    COLORS[series % COLORS.len()]
}

/// An axis.
#[derive(Debug, Clone, Default)]
pub(crate) struct Axis {
    /// What it measures, with its unit.
    pub label: String,
    /// Both ends.
    pub range: [f64; 2],
    /// Names of the places 0.5, 1.5, ..; without them the axis has numbers.
    pub names: Vec<String>,
    /// Whether only whole numbers are shown: a short axis of counts has steps between them.
    pub whole: bool,
    /// Whether the values are decimal logarithms of what the numbers show.
    pub logarithmic: bool,
}

impl Axis {
    /// An axis of numbers.
    pub fn new(label: impl Into<String>, range: [f64; 2]) -> Self {
        Self {
            label: label.into(),
            range,
            ..Self::default()
        }
    }

    /// An axis of names.
    pub fn named(label: impl Into<String>, names: Vec<String>) -> Self {
        Self {
            label: label.into(),
            range: [0.0, names.len() as f64],
            names,
            ..Self::default()
        }
    }

    fn number(&self, value: f64) -> String {
        if self.whole && value.fract() != 0.0 {
            return String::new();
        }
        if self.logarithmic {
            let value = libm::pow(10.0, value);
            let decimals = (1.0 - libm::log10(value).floor()).clamp(0.0, 6.0) as usize;
            return format!("{value:.decimals$}");
        }
        format!("{}", (value * 1e3).round() / 1e3)
    }
}

/// Something drawn, x before y.
#[derive(Debug, Clone)]
pub(crate) enum Shape {
    /// A line through points.
    Line(Vec<[f64; 2]>),
    /// A thin grey line through points, for reference.
    Guide(Vec<[f64; 2]>),
    /// Single points.
    Dots(Vec<[f64; 2]>),
    /// Rectangles from one corner to the opposite one.
    Bars(Vec<[f64; 4]>),
    /// Vertical lines: x, lower and upper end.
    Bounds(Vec<[f64; 3]>),
    /// Horizontal lines: y, left and right end.
    Spans(Vec<[f64; 3]>),
}

/// Two axes and what is drawn over them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Figure {
    pub x: Axis,
    pub y: Axis,
    /// In the order of drawing.
    pub shapes: Vec<(Rgb, Shape)>,
    /// Whether it is as high as wide.
    pub square: bool,
}

impl Figure {
    /// The chart as SVG.
    ///
    /// # Errors
    /// A defect of the chart.
    pub fn svg(&self) -> Result<String> {
        let mut svg = String::new();
        self.draw(&mut svg).map_err(|error| {
            let name = format!("chart of '{}' over '{}'", self.y.label, self.x.label);
            Error::value(name, error.to_string(), "report this as a bug")
        })?;
        Ok(svg)
    }

    fn draw(&self, svg: &mut String) -> Result<(), Box<dyn std::error::Error>> {
        let size = if self.square { SQUARE } else { SIZE };
        let root = SVGBackend::with_string(svg, size).into_drawing_area();
        let style = ("sans-serif", 15).into_font().color(&INK);
        let [x_range, y_range] = [&self.x, &self.y].map(|axis| {
            let [low, high] = axis.range;
            // An axis must have a length.
            low..high.max(low + 1e-9)
        });
        let mut chart = ChartBuilder::on(&root)
            .margin(6)
            .margin_right(14)
            .x_label_area_size(42)
            .y_label_area_size(if self.y.names.is_empty() { 58 } else { 100 })
            .build_cartesian_2d(x_range, y_range)?;
        let names = self.x.names.len();
        chart
            .configure_mesh()
            .disable_x_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(RGBColor(225, 225, 225))
            .axis_style(INK)
            .x_labels(if names > 0 { 0 } else { 8 })
            .y_labels(if self.y.names.is_empty() { 6 } else { 0 })
            .x_desc(&self.x.label)
            .y_desc(&self.y.label)
            .label_style(style.clone())
            .axis_desc_style(style.clone())
            .x_label_formatter(&|value| self.x.number(*value))
            .y_label_formatter(&|value| self.y.number(*value))
            .draw()?;
        let every = names.div_ceil(MOST_NAMES).max(1);
        let centered = TextStyle::from(("sans-serif", 13).into_font())
            .color(&INK)
            .pos(Pos::new(HPos::Center, VPos::Top));
        for (place, name) in self.x.names.iter().enumerate().step_by(every) {
            let (x, y) = chart.backend_coord(&(place as f64 + 0.5, self.y.range[0]));
            root.draw(&Text::new(name.clone(), (x, y + 6), &centered))?;
        }
        let before = TextStyle::from(("sans-serif", 13).into_font())
            .color(&INK)
            .pos(Pos::new(HPos::Right, VPos::Center));
        for (place, name) in self.y.names.iter().enumerate() {
            let (x, y) = chart.backend_coord(&(self.x.range[0], place as f64 + 0.5));
            root.draw(&Text::new(name.clone(), (x - 6, y), &before))?;
        }
        for (color, shape) in &self.shapes {
            draw_shape(&mut chart, *color, shape)?;
        }
        root.present()?;
        Ok(())
    }
}

type Plane<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

fn draw_shape(
    chart: &mut Plane,
    (red, green, blue): Rgb,
    shape: &Shape,
) -> Result<(), Box<dyn std::error::Error>> {
    let color = RGBColor(red, green, blue);
    let points = |points: &[[f64; 2]]| -> Vec<(f64, f64)> {
        let finite = points
            .iter()
            .filter(|point| point.iter().all(|v| v.is_finite()));
        finite.map(|[x, y]| (*x, *y)).collect()
    };
    match shape {
        Shape::Line(line) => {
            chart.draw_series(LineSeries::new(points(line), color.stroke_width(2)))?;
        }
        Shape::Guide(line) => {
            let grey = RGBColor(150, 150, 150).stroke_width(1);
            chart.draw_series(LineSeries::new(points(line), grey))?;
        }
        Shape::Dots(dots) => {
            let fill = color.mix(0.6).filled();
            chart.draw_series(points(dots).into_iter().map(|at| Circle::new(at, 3, fill)))?;
        }
        Shape::Bars(bars) => {
            let corners = bars.iter().map(|[x0, y0, x1, y1]| [(*x0, *y0), (*x1, *y1)]);
            chart.draw_series(corners.map(|corners| Rectangle::new(corners, color.filled())))?;
        }
        Shape::Bounds(bounds) => {
            let ends = bounds
                .iter()
                .map(|[x, low, high]| vec![(*x, *low), (*x, *high)]);
            chart.draw_series(ends.map(|ends| PathElement::new(ends, INK.stroke_width(1))))?;
        }
        Shape::Spans(spans) => {
            let ends = spans
                .iter()
                .map(|[y, low, high]| vec![(*low, *y), (*high, *y)]);
            chart.draw_series(ends.map(|ends| PathElement::new(ends, INK.stroke_width(1))))?;
        }
    }
    Ok(())
}

/// Groups of bars beside each other, one group at each name: corners for [`Shape::Bars`] of the
/// series with number `series` of `count`. Places without a value stay empty.
pub(crate) fn grouped_bars(values: &[Option<f64>], series: usize, count: usize) -> Vec<[f64; 4]> {
    let width = 0.84 / count as f64;
    let bars = values.iter().enumerate().filter_map(|(place, value)| {
        let left = place as f64 + 0.08 + width * series as f64;
        Some([left, 0.0, left + width, (*value)?])
    });
    bars.collect()
}

/// The x of the middle of a bar of [`grouped_bars`].
pub(crate) fn bar_middle(place: usize, series: usize, count: usize) -> f64 {
    place as f64 + 0.08 + 0.84 * (series as f64 + 0.5) / count as f64
}

/// The least round number that is about as large: 1, 2 or 5 times a power of ten.
pub(crate) fn round_step(rough: f64) -> f64 {
    let rough = rough.max(1e-3);
    let power = libm::pow(10.0, libm::floor(libm::log10(rough)));
    let factor = [1.0, 2.0, 5.0]
        .into_iter()
        .find(|factor| factor * power >= rough * 0.999);
    factor.unwrap_or(10.0) * power
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_round_numbers() {
        for (rough, expected) in [
            (3.125, 5.0),
            (1.0, 1.0),
            (22.5, 50.0),
            (0.0, 0.001),
            (0.07, 0.1),
        ] {
            assert!((round_step(rough) - expected).abs() < 1e-9, "{rough}");
        }
    }

    #[test]
    fn a_figure_has_its_names_its_numbers_and_its_colours() {
        let figure = Figure {
            x: Axis::named("sun", vec!["noon".to_owned(), "dusk".to_owned()]),
            y: Axis::new("error, m", [0.0, 4.0]),
            shapes: vec![
                (
                    color(0),
                    Shape::Bars(grouped_bars(&[Some(3.0), None], 0, 1)),
                ),
                (
                    color(1),
                    Shape::Line(vec![[0.0, 1.0], [1.0, f64::NAN], [2.0, 2.0]]),
                ),
            ],
            square: false,
        };
        let svg = figure.svg().unwrap();
        for text in ["<svg", "noon", "dusk", "error, m", "#0072B2", "#E69F00"] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(!svg.contains("NaN"));
    }

    #[test]
    fn lying_bars_have_their_names_before_the_axis() {
        let figure = Figure {
            x: Axis::new("error, m", [0.0, 4.0]),
            y: Axis::named("", vec!["first".to_owned(), "second".to_owned()]),
            shapes: vec![
                (color(0), Shape::Bars(vec![[0.0, 0.1, 3.0, 0.9]])),
                (color(0), Shape::Spans(vec![[0.5, 2.0, 4.0]])),
            ],
            square: false,
        };
        let svg = figure.svg().unwrap();
        for text in ["first", "second", "error, m", "#0072B2"] {
            assert!(svg.contains(text), "{text}");
        }
    }

    #[test]
    fn figures_without_extent_or_content_can_be_drawn() {
        let figure = Figure {
            x: Axis::new("x", [3.0, 3.0]),
            ..Figure::default()
        };
        assert!(figure.svg().unwrap().starts_with("<svg"));
    }

    #[test]
    fn axes_of_counts_show_whole_numbers_alone() {
        let axis = Axis {
            whole: true,
            ..Axis::default()
        };
        assert_eq!([0.0, 0.5, 2.0].map(|v| axis.number(v)), ["0", "", "2"]);
    }

    #[test]
    fn logarithmic_axes_show_what_they_measure() {
        let axis = Axis {
            logarithmic: true,
            ..Axis::default()
        };
        assert_eq!(
            [-2.0, 0.0, 1.5, 3.0].map(|v| axis.number(v)),
            ["0.010", "1.0", "32", "1000"]
        );
    }
}
