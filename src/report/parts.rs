//! What the template fills in.

use serde::Serialize;

use crate::error::Result;
pub(crate) use crate::evaluate::{number, percent};
use crate::page::charts::{Figure, Rgb, hex};

/// The whole page.
#[derive(Serialize)]
pub(crate) struct Page {
    pub title: String,
    pub facts: Vec<[String; 2]>,
    pub missing: Vec<String>,
    pub sections: Vec<Section>,
}

/// A part of the page with its own heading.
#[derive(Serialize, Default)]
pub(crate) struct Section {
    pub title: String,
    pub notes: Vec<String>,
    pub blocks: Vec<Block>,
}

/// Something in a section.
#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub(crate) enum Block {
    /// A heading.
    Heading { text: String },
    /// Rows under a header.
    Table(Table),
    /// Charts beside each other.
    Charts { charts: Vec<Chart> },
    /// Pictures beside each other.
    Pictures {
        title: String,
        pictures: Vec<Picture>,
        source: String,
    },
    /// A text file, folded away.
    Text {
        title: String,
        text: String,
        source: String,
    },
}

/// A table, and where its numbers come from.
#[derive(Serialize)]
pub(crate) struct Table {
    pub title: String,
    pub header: Vec<String>,
    pub rows: Vec<Vec<String>>,
    /// The first so many columns are words, the others numbers.
    pub words: usize,
    pub note: String,
    pub source: String,
    /// Folded away until somebody wants it.
    pub folded: bool,
}

/// A chart, and where its numbers come from.
#[derive(Serialize)]
pub(crate) struct Chart {
    pub title: String,
    pub svg: String,
    pub legend: Vec<LegendEntry>,
    pub source: String,
}

/// A colour and what it stands for.
#[derive(Serialize)]
pub(crate) struct LegendEntry {
    pub color: String,
    pub name: String,
}

/// A picture.
#[derive(Serialize)]
pub(crate) struct Picture {
    pub caption: String,
    pub jpeg: String,
}

impl Section {
    /// Without content.
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            ..Self::default()
        }
    }

    /// Adds a heading.
    pub fn heading(&mut self, text: &str) {
        self.blocks.push(Block::Heading {
            text: text.to_owned(),
        });
    }

    /// Adds a table unless it has no rows.
    pub fn table(&mut self, table: Table) {
        if !table.rows.is_empty() {
            self.blocks.push(Block::Table(table));
        }
    }

    /// Adds charts unless there are none.
    pub fn charts(&mut self, charts: Vec<Chart>) {
        if !charts.is_empty() {
            self.blocks.push(Block::Charts { charts });
        }
    }
}

impl Table {
    /// A table that is shown at once.
    pub fn new(title: &str, header: &[&str], source: impl Into<String>) -> Self {
        Self {
            title: title.to_owned(),
            header: header.iter().map(|&text| text.to_owned()).collect(),
            rows: Vec::new(),
            words: 1,
            note: String::new(),
            source: source.into(),
            folded: false,
        }
    }
}

impl Chart {
    /// Draws a figure.
    ///
    /// # Errors
    /// A defect of the figure.
    pub fn new(
        title: impl Into<String>,
        figure: &Figure,
        legend: &[(Rgb, String)],
        source: impl Into<String>,
    ) -> Result<Self> {
        let entry = |(color, name): &(Rgb, String)| LegendEntry {
            color: hex(*color),
            name: name.clone(),
        };
        Ok(Self {
            title: title.into(),
            svg: figure.svg()?,
            legend: legend.iter().map(entry).collect(),
            source: source.into(),
        })
    }
}

/// A number with its bounds.
pub(crate) fn bounded(
    value: Option<f64>,
    [low, high]: [Option<f64>; 2],
    decimals: usize,
) -> String {
    let text = number(value, decimals);
    match (low, high) {
        (Some(low), Some(high)) => format!("{text} [{low:.decimals$}, {high:.decimals$}]"),
        _ => text,
    }
}
