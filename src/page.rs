//! Self-contained HTML pages: one file with pictures, charts and styles inside, which needs no
//! network and no scripts.

pub(crate) mod charts;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use minijinja::Environment;
use minijinja::value::Serde;
use serde::Serialize;

use crate::error::{Error, Result};

/// What all pages look like.
const STYLE: &str = include_str!("page/style.css");

/// Fills a template in; it finds the common style under the name `style`. What is filled in is
/// escaped unless the template says otherwise.
///
/// # Errors
/// A template that does not fit its content, which is a defect.
pub(crate) fn render(template: &str, content: &impl Serialize) -> Result<String> {
    let mut environment = Environment::new();
    environment.add_global("style", STYLE);
    // The name's ending makes the engine escape what it fills in.
    environment
        .render_named_str("page.html", template, Serde(content))
        .map_err(|error| Error::value("page", error.to_string(), "report this as a bug"))
}

/// Bytes as a page holds them.
pub(crate) fn base64(bytes: &[u8]) -> String {
    STANDARD.encode(bytes)
}
