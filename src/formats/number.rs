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

/// Reads a whole number of zero or more, be it written as `2.0` or `2e0`; the reason names the field.
pub(super) fn whole(text: &str, name: &str) -> Result<u32, String> {
    if let Ok(value) = text.parse() {
        return Ok(value);
    }
    let value = finite(text, name)?;
    if value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value) {
        return Ok(value as u32);
    }
    Err(format!(
        "'{text}' is not a value for {name}: not a whole number from 0"
    ))
}
