//! Named numbers and matrices of a calibration file.

use std::collections::BTreeMap;

use glam::{DMat3, DVec3};
use serde_json::Value;

use crate::error::{Error, Result};
use crate::geometry::Intrinsics;

/// Entries that should be 0 or 1 may differ from it by this, relative to the focal length.
const EXACT: f64 = 1e-6;

/// Skew of the pixels may be this part of the focal length.
const MOST_SKEW: f64 = 1e-3;

/// A finite number.
pub(crate) fn number(word: &str, name: &str) -> Result<f64> {
    let refused = |problem: &str| {
        Err(Error::value(
            format!("'{word}' in {name}"),
            problem,
            "write numbers like -12.5 or 7.2e+02",
        ))
    };
    match word.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(_) => refused("is not a finite number"),
        Err(_) => refused("is no number"),
    }
}

/// A matrix as a file has it, row by row.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Matrix {
    pub rows: usize,
    pub columns: usize,
    pub values: Vec<f64>,
}

impl Matrix {
    fn at(&self, row: usize, column: usize) -> f64 {
        self.values[row * self.columns + column]
    }

    fn refused<T>(&self, name: &str, expected: &str) -> Result<T> {
        Err(Error::value(
            name,
            format!("is {} x {}, not {expected}", self.rows, self.columns),
            "correct the file or calibrate again",
        ))
    }

    fn check_finite(&self, name: &str) -> Result<()> {
        if self.values.iter().all(|value| value.is_finite()) {
            return Ok(());
        }
        Err(Error::value(
            name,
            "has entries that are no finite numbers",
            "correct the file or calibrate again",
        ))
    }

    /// Focal lengths and principal point of a camera matrix 3 x 3 or a projection 3 x 4. `shift` is
    /// added to the principal point.
    pub fn intrinsics(&self, name: &str, shift: f64) -> Result<Intrinsics> {
        if self.rows != 3 || !(3..=4).contains(&self.columns) {
            return self.refused(name, "3 x 3 or 3 x 4");
        }
        self.check_finite(name)?;
        let at = |row, column| self.at(row, column);
        let (fx, fy) = (at(0, 0), at(1, 1));
        let refused = |problem: &str| {
            Err(Error::value(
                name,
                problem,
                "give the camera matrix in pixels: fx 0 cx, 0 fy cy, 0 0 1",
            ))
        };
        if fx == 0.0 || fy == 0.0 || at(2, 2) == 0.0 {
            return refused("is singular");
        }
        let is_zero = |value: f64, least: f64| value.abs() <= least * fx.abs().max(1.0);
        if !is_zero(at(0, 1), MOST_SKEW) {
            return refused("has skew, which no camera of today has");
        }
        let is_plain = is_zero(at(1, 0), EXACT)
            && at(2, 0).abs() <= EXACT
            && at(2, 1).abs() <= EXACT
            && (at(2, 2) - 1.0).abs() <= EXACT;
        if !is_plain {
            return refused("is no camera matrix");
        }
        Ok(Intrinsics {
            focal_x_px: fx,
            focal_y_px: fy,
            center_x_px: at(0, 2) + shift,
            center_y_px: at(1, 2) + shift,
        })
    }

    /// Where the camera of a projection `K [I | t]` stands: `t`, in the unit of the calibration.
    pub fn offset(&self, name: &str) -> Result<DVec3> {
        if (self.rows, self.columns) != (3, 4) {
            return self.refused(name, "3 x 4");
        }
        self.check_finite(name)?;
        let z = self.at(2, 3);
        let axis = |row: usize| (self.at(row, 3) - self.at(row, 2) * z) / self.at(row, row);
        Ok(DVec3::new(axis(0), axis(1), z))
    }

    /// A rotation: a matrix 3 x 3, or a vector whose direction is the axis and whose length the
    /// angle (Rodrigues).
    pub fn rotation(&self, name: &str) -> Result<DMat3> {
        self.check_finite(name)?;
        match (self.rows, self.columns) {
            (3, 3) => Ok(self.top_left()),
            (1, 3) | (3, 1) => {
                let vector = DVec3::new(self.values[0], self.values[1], self.values[2]);
                let angle = vector.length();
                if angle == 0.0 {
                    return Ok(DMat3::IDENTITY);
                }
                let axis = vector / angle;
                let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
                let turned = |v: DVec3| {
                    v * cosine + axis.cross(v) * sine + axis * (axis.dot(v) * (1.0 - cosine))
                };
                Ok(DMat3::from_cols(
                    turned(DVec3::X),
                    turned(DVec3::Y),
                    turned(DVec3::Z),
                ))
            }
            _ => self.refused(name, "3 x 3"),
        }
    }

    /// Rotation and translation of a matrix 4 x 4.
    pub fn transform(&self, name: &str) -> Result<(DMat3, DVec3)> {
        if (self.rows, self.columns) != (4, 4) {
            return self.refused(name, "4 x 4");
        }
        self.check_finite(name)?;
        let translation = DVec3::new(self.at(0, 3), self.at(1, 3), self.at(2, 3));
        Ok((self.top_left(), translation))
    }

    fn top_left(&self) -> DMat3 {
        let column = |i| DVec3::new(self.at(0, i), self.at(1, i), self.at(2, i));
        DMat3::from_cols(column(0), column(1), column(2))
    }

    /// Three numbers in a row or a column.
    pub fn vector(&self, name: &str) -> Result<DVec3> {
        self.check_finite(name)?;
        match self.values[..] {
            [x, y, z] => Ok(DVec3::new(x, y, z)),
            _ => self.refused(name, "3 x 1"),
        }
    }
}

/// What one name of a file stands for.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Entry {
    Numbers(Matrix),
    Text(String),
}

/// The entries of a file. Names are compared without case, `_`, `-`, `.` and blanks; those of entries
/// within entries are joined.
#[derive(Debug, Clone, Default)]
pub(super) struct Entries {
    /// By plain name: the name as the file has it, and the entry.
    by_name: BTreeMap<String, (String, Entry)>,
}

/// A name as it is compared.
fn plain(name: &str) -> String {
    name.chars()
        .filter(char::is_ascii_alphanumeric)
        .map(|c| c.to_ascii_lowercase())
        .collect()
}

impl Entries {
    /// Collects the entries of a file's tree.
    pub fn of(tree: &Value) -> Result<Self> {
        let mut entries = Self::default();
        entries.add("", tree)?;
        Ok(entries)
    }

    fn add(&mut self, name: &str, value: &Value) -> Result<()> {
        let entry = match value {
            Value::Object(members) => {
                let Some(matrix) = matrix(name, members)? else {
                    return self.add_members(name, members);
                };
                Entry::Numbers(matrix)
            }
            Value::Array(items) => match list(items) {
                Some(matrix) => Entry::Numbers(matrix),
                None => return Ok(()),
            },
            Value::String(text) => Entry::Text(text.clone()),
            Value::Number(_) | Value::Null => Entry::Numbers(Matrix {
                rows: 1,
                columns: 1,
                values: vec![float(value)],
            }),
            Value::Bool(is_true) => Entry::Text(is_true.to_string()),
        };
        let key = plain(name);
        if let Some((other, _)) = self.by_name.get(&key) {
            return Err(Error::value(
                name,
                format!("is there twice, also as {other}"),
                "leave one of them",
            ));
        }
        self.by_name.insert(key, (name.to_owned(), entry));
        Ok(())
    }

    fn add_members(&mut self, name: &str, members: &serde_json::Map<String, Value>) -> Result<()> {
        for (member, value) in members {
            let joined = if name.is_empty() {
                member.clone()
            } else {
                format!("{name}.{member}")
            };
            self.add(&joined, value)?;
        }
        // A camera's numbers one by one, as programs print them.
        let joined = |member: &str| match name {
            "" => member.to_owned(),
            name => format!("{name}.{member}"),
        };
        for (member, values) in [
            ("intrinsics", single_numbers(members, &FOCAL_AND_CENTER)),
            ("distortion", single_numbers(members, &LENS)),
        ] {
            let name = joined(member);
            if let Some(values) = values {
                let matrix = Matrix {
                    rows: 1,
                    columns: values.len(),
                    values,
                };
                let entry = (name.clone(), Entry::Numbers(matrix));
                self.by_name.entry(plain(&name)).or_insert(entry);
            }
        }
        Ok(())
    }

    /// Takes in another file's entries; its own entries win.
    pub fn join(&mut self, other: Self) {
        for (key, value) in other.by_name {
            self.by_name.entry(key).or_insert(value);
        }
    }

    /// The same with a word before every name.
    pub fn prefixed(self, prefix: &str) -> Self {
        let renamed = self
            .by_name
            .into_iter()
            .map(|(key, value)| (format!("{prefix}{key}"), value));
        Self {
            by_name: renamed.collect(),
        }
    }

    /// The numbers under the first of these plain names, and the name in the file.
    pub fn numbers<S: AsRef<str>>(&self, names: &[S]) -> Option<(&str, &Matrix)> {
        names
            .iter()
            .find_map(|name| match self.by_name.get(name.as_ref()) {
                Some((name, Entry::Numbers(matrix))) => Some((name.as_str(), matrix)),
                _ => None,
            })
    }

    /// All texts, with their names in the file.
    pub fn texts(&self) -> impl Iterator<Item = (&str, &str)> {
        self.by_name
            .values()
            .filter_map(|(name, entry)| match entry {
                Entry::Text(text) => Some((name.as_str(), text.as_str())),
                Entry::Numbers(_) => None,
            })
    }

    /// The names as the file has them.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.by_name.values().map(|(name, _)| name.as_str())
    }
}

/// Names of focal lengths and principal point.
const FOCAL_AND_CENTER: [&[&str]; 4] =
    [&["fx"], &["fy"], &["cx", "ppx", "u0"], &["cy", "ppy", "v0"]];

/// Names of coefficients of a lens, OpenCV's order.
const LENS: [&[&str]; 5] = [&["k1"], &["k2"], &["p1"], &["p2"], &["k3"]];

/// Numbers that stand one by one under these names; none unless the first four are there.
fn single_numbers(members: &serde_json::Map<String, Value>, names: &[&[&str]]) -> Option<Vec<f64>> {
    let value = |names: &&[&str]| names.iter().find_map(|name| members.get(*name)?.as_f64());
    let values: Vec<f64> = names.iter().map_while(value).collect();
    (values.len() >= 4).then_some(values)
}

/// Whether a value stands for a number, be it none that is finite: YAML's `.nan`, `.inf` and nothing.
fn is_number(value: &Value) -> bool {
    match value {
        Value::Number(_) | Value::Null => true,
        Value::String(text) => {
            let word = text.trim_start_matches(['+', '-']).to_ascii_lowercase();
            word == ".nan" || word == ".inf"
        }
        _ => false,
    }
}

/// A number; not a number for all that are not finite.
fn float(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

/// OpenCV's and ROS' form, `rows`, `cols` and `data`, or that of OpenCV 5, `sizes` and `data`.
fn matrix(name: &str, members: &serde_json::Map<String, Value>) -> Result<Option<Matrix>> {
    let Some(data) = members.get("data") else {
        return Ok(None);
    };
    let refused = |problem: String| {
        Err(Error::value(
            name,
            problem,
            "write rows, cols and data of that many numbers",
        ))
    };
    let sides = match (
        members.get("rows"),
        members.get("cols"),
        members.get("sizes"),
    ) {
        (Some(rows), Some(columns), _) => [rows.as_u64(), columns.as_u64()],
        (_, _, Some(Value::Array(sizes))) => match &sizes[..] {
            [columns] => [Some(1), columns.as_u64()],
            [rows, columns] => [rows.as_u64(), columns.as_u64()],
            _ => return refused("has more than two dimensions".to_owned()),
        },
        _ => return Ok(None),
    };
    let [Some(rows), Some(columns)] = sides else {
        return refused("its rows and cols are no whole numbers".to_owned());
    };
    let Value::Array(items) = data else {
        return refused("its data is no list".to_owned());
    };
    if rows.checked_mul(columns) != Some(items.len() as u64) {
        return refused(format!(
            "has {} numbers, not {rows} x {columns}",
            items.len()
        ));
    }
    if let Some(other) = items.iter().find(|item| !is_number(item)) {
        return refused(format!("has {other} among its numbers"));
    }
    Ok(Some(Matrix {
        rows: rows as usize,
        columns: columns as usize,
        values: items.iter().map(float).collect(),
    }))
}

/// A list of numbers, or of such lists of equal length.
fn list(items: &[Value]) -> Option<Matrix> {
    let numbers = |items: &[Value]| -> Option<Vec<f64>> {
        let all = items.iter().all(is_number);
        all.then(|| items.iter().map(float).collect())
    };
    if let Some(values) = numbers(items) {
        return Some(Matrix {
            rows: 1,
            columns: values.len(),
            values,
        });
    }
    let rows: Vec<Vec<f64>> = items
        .iter()
        .map(|item| numbers(item.as_array()?))
        .collect::<Option<_>>()?;
    let columns = rows.first()?.len();
    rows.iter().all(|row| row.len() == columns).then(|| Matrix {
        rows: rows.len(),
        columns,
        values: rows.concat(),
    })
}
