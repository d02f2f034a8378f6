//! Numbers out of foreign text files.

/// Reads a finite number; the reason names the field.
pub(super) fn finite(text: &str, name: &str) -> Result<f64, String> {
    let value: f64 = text
        .parse()
        .map_err(|error| format!("'{text}' is not a value for {name}: {error}"))?;
    if value.is_finite() {
        return Ok(value);
    }
    Err(format!("{name} is {value}"))
}

/// Reads a whole number of zero or more; the reason names the field.
pub(super) fn whole(text: &str, name: &str) -> Result<u32, String> {
    text.parse()
        .map_err(|error| format!("'{text}' is not a value for {name}: {error}"))
}
