//! The dataset's text files, line by line: label lines, `frames.csv` and file names.
//!
//! Knows what one line says, not whether the lines of a frame agree with each other or with the
//! images: that is the [reader](super::reader)'s business.

use std::fmt::{self, Write as _};
use std::path::Path;
use std::str::{FromStr, SplitWhitespace};

use super::{BoxKind, FrameRow, Label, Problem, Split, View};
use crate::error::{Error, Result};
use crate::geometry::PixelBox;

/// The header of `frames.csv`.
pub const FRAMES_HEADER: [&str; 8] = [
    "stamp",
    "split",
    "scene",
    "sun",
    "view",
    "azimuth_deg",
    "elevation_deg",
    "distance_m",
];

/// First line of the label files that this crate writes.
pub const LABEL_HEADER: &str =
    "# id class x_min y_min x_max y_max center_x center_y distance_m kind visible ignored\n";

/// Last word of a label line that is neither learnt from nor judged.
const IGNORED: &str = "ignored";

/// Stands in a label line for a distance that nobody knows.
const UNKNOWN: &str = "-";

/// A stamp as it stands in file names: at least five digits, `00042`.
pub fn stamp_name(stamp: u64) -> String {
    format!("{stamp:05}")
}

/// Decimals that text files keep. A ten-thousandth of a pixel of disparity is 5 mm at 200 m with
/// the paper's rig, far below what a label is good for, and short lines are easy to read.
const DECIMALS_SCALE: f64 = 1e4;

/// The shortest text of a number rounded to four decimals; integers have no decimal point.
pub(super) fn short(value: f64) -> f64 {
    // The sum turns -0 into 0.
    (value * DECIMALS_SCALE).round() / DECIMALS_SCALE + 0.0
}

impl Label {
    /// The label as a line of a label file, without the line's end.
    ///
    /// Numbers are rounded to four decimals, so a label whose numbers have no more comes back
    /// unchanged from [`Label::parse_line`].
    pub fn to_line(&self) -> String {
        let PixelBox {
            x_min,
            y_min,
            x_max,
            y_max,
        } = self.box_pixel;
        let mut line = format!("{} {}", self.id, self.class);
        let [center_x, center_y] = self.center_pixel;
        for value in [x_min, y_min, x_max, y_max, center_x, center_y] {
            // Writing to a String cannot fail.
            write!(line, " {}", short(value)).ok();
        }
        match self.distance_m {
            Some(distance_m) => write!(line, " {}", short(distance_m)).ok(),
            None => write!(line, " {UNKNOWN}").ok(),
        };
        write!(line, " {}", self.kind).ok();
        if let Some(visible) = self.visible {
            write!(line, " {}", short(visible)).ok();
        }
        if self.ignored {
            line.push(' ');
            line.push_str(IGNORED);
        }
        line
    }

    /// Reads a line of a label file; `None` for an empty line or a comment.
    ///
    /// # Errors
    /// The reason, in words without the file's name: a missing, surplus or unreadable field, or a
    /// value that [`Label::check`] refuses.
    pub fn parse_line(line: &str) -> Result<Option<Self>, String> {
        let line = line.split('#').next().unwrap_or_default();
        let mut fields = line.split_whitespace();
        if fields.clone().next().is_none() {
            return Ok(None);
        }
        let id = field(&mut fields, "id")?;
        let class = field(&mut fields, "class")?;
        let box_pixel = PixelBox::new(
            field(&mut fields, "x_min")?,
            field(&mut fields, "y_min")?,
            field(&mut fields, "x_max")?,
            field(&mut fields, "y_max")?,
        );
        let center_pixel = [
            field(&mut fields, "center_x")?,
            field(&mut fields, "center_y")?,
        ];
        let distance_m = if fields.clone().next() == Some(UNKNOWN) {
            fields.next();
            None
        } else {
            Some(field(&mut fields, "distance_m")?)
        };
        let kind = field(&mut fields, "kind")?;
        let visible = match fields.clone().next() {
            None | Some(IGNORED) => None,
            Some(_) => Some(field(&mut fields, "visible")?),
        };
        let ignored = fields.clone().next() == Some(IGNORED);
        if let Some(surplus) = fields.nth(usize::from(ignored)) {
            return Err(format!(
                "a surplus field '{surplus}' at the end: after 'kind' may stand the visible \
                 fraction and the word '{IGNORED}'"
            ));
        }
        let label = Self {
            id,
            class,
            box_pixel,
            center_pixel,
            distance_m,
            kind,
            visible,
            ignored,
        };
        label.check()?;
        Ok(Some(label))
    }

    /// Checks what can be checked without the image and the other labels.
    ///
    /// # Errors
    /// The reason in words: a number that is not finite, an empty or inverted box, a distance that
    /// is not positive, a visible fraction outside 0 to 1.
    pub fn check(&self) -> Result<(), String> {
        let id = self.id;
        let PixelBox {
            x_min,
            y_min,
            x_max,
            y_max,
        } = self.box_pixel;
        let numbers = [
            x_min,
            y_min,
            x_max,
            y_max,
            self.center_pixel[0],
            self.center_pixel[1],
        ];
        if let Some(value) = numbers.iter().find(|value| !value.is_finite()) {
            return Err(format!("vehicle {id}: a coordinate is {value}"));
        }
        if !self.box_pixel.is_valid() {
            return Err(format!(
                "vehicle {id}: the box {x_min} {y_min} {x_max} {y_max} is empty or inverted"
            ));
        }
        if let Some(distance_m) = self.distance_m
            && !(distance_m.is_finite() && distance_m > 0.0)
        {
            return Err(format!("vehicle {id}: the distance is {distance_m} m"));
        }
        match self.visible {
            Some(visible) if !(0.0..=1.0).contains(&visible) => Err(format!(
                "vehicle {id}: the visible fraction is {visible}, not 0 to 1"
            )),
            _ => Ok(()),
        }
    }
}

/// The next field of a label line.
fn field<T: FromStr<Err: fmt::Display>>(
    fields: &mut SplitWhitespace<'_>,
    name: &str,
) -> Result<T, String> {
    let text = fields
        .next()
        .ok_or_else(|| format!("the field '{name}' is missing"))?;
    text.parse()
        .map_err(|error: T::Err| format!("'{text}' is not a value for '{name}': {error}"))
}

/// A whole label file: a comment that names the fields, then one line a label.
pub fn label_file_text(labels: &[Label]) -> String {
    let mut text = LABEL_HEADER.to_owned();
    for label in labels {
        text.push_str(&label.to_line());
        text.push('\n');
    }
    text
}

/// The text of `frames.csv`; numbers are rounded to four decimals, unknown values are empty.
pub fn frames_csv_text(rows: &[FrameRow]) -> String {
    let mut text = FRAMES_HEADER.join(",");
    text.push('\n');
    let number = |value: Option<f64>| value.map(|v| short(v).to_string()).unwrap_or_default();
    for row in rows {
        let fields = [
            stamp_name(row.stamp),
            row.split.to_string(),
            row.scene.map(|scene| scene.to_string()).unwrap_or_default(),
            row.sun.as_deref().map(quoted).unwrap_or_default(),
            row.view.map(|view| view.to_string()).unwrap_or_default(),
            number(row.azimuth_deg),
            number(row.elevation_deg),
            number(row.distance_m),
        ];
        text.push_str(&fields.join(","));
        text.push('\n');
    }
    text
}

/// A CSV field, in quotes where its content would break the line.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

/// Writes `frames.csv` at `path`, in the order of `rows`.
///
/// # Errors
/// [`Error::Io`] when the file cannot be written.
pub fn write_frames_csv(path: impl AsRef<Path>, rows: &[FrameRow]) -> Result<()> {
    crate::files::write_atomically(path, frames_csv_text(rows).as_bytes())
}

/// Reads `frames.csv`: the usable rows, and what is wrong with each other one, by line.
///
/// Columns may stand in any order; further columns are ignored.
///
/// # Errors
/// The file cannot be read, or lacks the columns `stamp` and `split`.
pub fn read_frames_csv(path: impl AsRef<Path>) -> Result<(Vec<FrameRow>, Vec<Problem>)> {
    let path = path.as_ref();
    let text = crate::files::read_text(path)?;
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_reader(text.as_bytes());
    let remedy = format!("its first line must be {}", FRAMES_HEADER.join(","));
    let header = reader
        .headers()
        .map_err(|error| Error::dataset(path, error.to_string(), remedy.clone()))?
        .clone();
    for name in ["stamp", "split"] {
        if !header.iter().any(|column| column == name) {
            return Err(Error::dataset(
                path,
                format!("has no column '{name}'"),
                remedy,
            ));
        }
    }
    let mut rows = Vec::new();
    let mut problems = Vec::new();
    for record in reader.records() {
        let parsed = match &record {
            Ok(record) => record
                .deserialize::<FrameRow>(Some(&header))
                .map_err(|error| reason_of(&error, &header))
                .and_then(|row| check_row(&row).map(|()| row)),
            Err(error) => Err(reason_of(error, &header)),
        };
        match parsed {
            Ok(row) => rows.push(row),
            Err(reason) => {
                let position = match &record {
                    Ok(record) => record.position().cloned(),
                    Err(error) => error.position().cloned(),
                };
                let line = position.map_or(0, |position| position.line());
                problems.push(Problem {
                    subject: format!("frames.csv line {line}"),
                    reason,
                });
            }
        }
    }
    Ok((rows, problems))
}

/// The reason alone: the line's number is kept apart from it.
fn reason_of(error: &csv::Error, header: &csv::StringRecord) -> String {
    match error.kind() {
        csv::ErrorKind::Deserialize { err, .. } => {
            let column = err.field().and_then(|index| header.get(index as usize));
            match column {
                Some(name) => format!("column '{name}': {}", err.kind()),
                None => err.kind().to_string(),
            }
        }
        csv::ErrorKind::UnequalLengths {
            expected_len, len, ..
        } => {
            format!("has {len} fields where the header has {expected_len}")
        }
        _ => error.to_string(),
    }
}

/// Refuses numbers that no frame can have.
fn check_row(row: &FrameRow) -> Result<(), String> {
    for (name, value) in [
        ("azimuth_deg", row.azimuth_deg),
        ("elevation_deg", row.elevation_deg),
        ("distance_m", row.distance_m),
    ] {
        if let Some(value) = value.filter(|value| !value.is_finite()) {
            return Err(format!("{name} is {value}"));
        }
    }
    match row.distance_m {
        Some(distance_m) if distance_m <= 0.0 => Err(format!("distance_m is {distance_m}")),
        _ => Ok(()),
    }
}

/// Gives an enum of the format its words, for printing and for parsing.
macro_rules! words {
    ($($type:ident { $($variant:ident = $word:literal),+ })+) => {$(
        impl $type {
            /// All values, in the order of their declaration.
            pub const ALL: &[Self] = &[$(Self::$variant),+];

            /// The word that stands for it in files.
            pub const fn word(self) -> &'static str {
                match self {
                    $(Self::$variant => $word),+
                }
            }
        }

        impl fmt::Display for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(self.word())
            }
        }

        impl FromStr for $type {
            type Err = String;

            fn from_str(word: &str) -> Result<Self, String> {
                Self::ALL
                    .iter()
                    .copied()
                    .find(|value| value.word() == word)
                    .ok_or_else(|| {
                        let words = Self::ALL.iter().map(|value| value.word());
                        format!("'{word}' is none of {}", words.collect::<Vec<_>>().join(", "))
                    })
            }
        }
    )+};
}

words! {
    Split { Train = "train", Val = "val", Test = "test" }
    BoxKind { Sphere = "sphere", Tight = "tight" }
    View { Front = "front", Side = "side", Rear = "rear", Other = "other" }
}

#[cfg(test)]
mod tests;
