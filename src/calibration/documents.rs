//! The documents of a YAML file, and the trees of those.

use super::entries::Entries;
use super::named::{MATRIX, PROJECTION, is_one_camera};
use crate::error::{Error, Result, yaml_problem};

/// Of more documents in a file the rest is not looked at.
const MOST_DOCUMENTS: usize = 64;

/// What the documents of a file say. Messages that were printed again and again are one, and what
/// broke off after the first is left out.
pub(super) fn documents_of(text: &str) -> Result<Vec<Entries>> {
    let mut found: Vec<Entries> = Vec::new();
    for document in documents(text) {
        let entries = tree(&document).and_then(|tree| Entries::of(&tree));
        let entries = match entries {
            Ok(entries) => entries,
            Err(_) if !found.is_empty() => break,
            Err(error) => return Err(error),
        };
        let numbers = |entries: &Entries| {
            [&MATRIX[..], &PROJECTION].map(|names| {
                let found = entries.numbers(names);
                found.map(|(_, matrix)| matrix.clone())
            })
        };
        let is_repeated = |known: &Entries| {
            let own = numbers(&entries);
            // One that broke off has not all of them.
            let mut both = own.iter().zip(numbers(known));
            own.iter().any(Option::is_some)
                && both.all(|(own, known)| own.is_none() || *own == known)
        };
        if !found.iter().any(is_repeated) {
            found.push(entries);
        }
    }
    // A message that broke off may still be a document, of no camera.
    if found.iter().any(is_one_camera) {
        found.retain(is_one_camera);
    }
    if found.is_empty() {
        found.push(Entries::default());
    }
    Ok(found)
}

/// The documents that lines of `---` divide, each with empty lines in place of those before it, so
/// that errors name the file's own lines. OpenCV's directive, `%YAML:1.0`, is none of YAML's and is
/// left out.
fn documents(text: &str) -> Vec<String> {
    let mut documents = Vec::new();
    let mut current = String::new();
    let mut has_content = false;
    for (line_number, line) in text.lines().enumerate() {
        let rest = line.strip_prefix("---");
        let ends = rest.is_some_and(|rest| rest.is_empty() || rest.starts_with([' ', '#']));
        if ends && has_content {
            let next = "\n".repeat(line_number + 1);
            documents.push(std::mem::replace(&mut current, next));
            has_content = false;
            continue;
        }
        if !ends && !line.starts_with('%') {
            current.push_str(line);
            has_content |= !line.trim().is_empty() && !line.trim_start().starts_with('#');
        }
        current.push('\n');
        if documents.len() > MOST_DOCUMENTS {
            break;
        }
    }
    if has_content {
        documents.push(current);
    }
    documents
}

/// The tree of a YAML text of one document.
pub(super) fn tree(text: &str) -> Result<serde_json::Value> {
    let body = documents(text).into_iter().next().unwrap_or_default();
    serde_saphyr::from_str(&body).map_err(|error| {
        Error::value(
            "YAML",
            yaml_problem(&error),
            "correct the file, or save it again with OpenCV's FileStorage",
        )
    })
}
