//! Values as COCO's many writers put them.

use std::borrow::Cow;
use std::fmt;

use serde::de::{IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A number that may be one of an image, annotation or category: written as a number, a number with
/// `.0`, or a text.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Id(String);

impl Id {
    pub fn number(value: u64) -> Self {
        Self(value.to_string())
    }
}

impl fmt::Display for Id {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

impl Serialize for Id {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0.parse::<u64>() {
            Ok(number) => serializer.serialize_u64(number),
            Err(_) => serializer.serialize_str(&self.0),
        }
    }
}

impl<'de> Deserialize<'de> for Id {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = Scalar::deserialize(deserializer)?;
        // `7`, `7.0`, `"7"` and `"7.0"` are the same image's.
        let of_number = |value: f64| {
            let is_whole = value.fract() == 0.0 && value.abs() < 9e15;
            is_whole.then(|| format!("{value:.0}"))
        };
        match value {
            Scalar::Number(value) => Ok(Self(of_number(value).unwrap_or(value.to_string()))),
            Scalar::Whole(value) => Ok(Self(value)),
            Scalar::Text(text) => {
                let number = text.trim().parse::<f64>().ok().and_then(of_number);
                // Only what says nothing but a number: `007` may be another name than `7`.
                let plain = text.contains('.') && !text.starts_with('0');
                Ok(Self(number.filter(|_| plain).unwrap_or(text)))
            }
            Scalar::Nothing => Err(serde::de::Error::custom("an id is missing or is no number")),
        }
    }
}

/// A number that may be missing: null and what is no number count as missing.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Number(pub Option<f64>);

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self(match Scalar::deserialize(deserializer)? {
            Scalar::Number(value) => Some(value),
            Scalar::Whole(text) | Scalar::Text(text) => text.trim().parse().ok(),
            Scalar::Nothing => None,
        }))
    }
}

/// A plain value; truths are 0 and 1, lists and tables are nothing.
#[derive(Debug)]
enum Scalar {
    Number(f64),
    /// A whole number, with all its digits.
    Whole(String),
    Text(String),
    Nothing,
}

impl<'de> Deserialize<'de> for Scalar {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ScalarVisitor;
        impl<'de> Visitor<'de> for ScalarVisitor {
            type Value = Scalar;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a number or a text")
            }

            fn visit_bool<E>(self, is_true: bool) -> Result<Scalar, E> {
                Ok(Scalar::Whole(u8::from(is_true).to_string()))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Scalar, E> {
                Ok(Scalar::Whole(value.to_string()))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Scalar, E> {
                Ok(Scalar::Whole(value.to_string()))
            }

            fn visit_f64<E>(self, value: f64) -> Result<Scalar, E> {
                Ok(Scalar::Number(value))
            }

            fn visit_str<E>(self, text: &str) -> Result<Scalar, E> {
                Ok(Scalar::Text(text.to_owned()))
            }

            fn visit_unit<E>(self) -> Result<Scalar, E> {
                Ok(Scalar::Nothing)
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Scalar, A::Error> {
                while items.next_element::<IgnoredAny>()?.is_some() {}
                Ok(Scalar::Nothing)
            }

            fn visit_map<A: MapAccess<'de>>(self, mut items: A) -> Result<Scalar, A::Error> {
                while items.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
                Ok(Scalar::Nothing)
            }
        }
        deserializer.deserialize_any(ScalarVisitor)
    }
}

/// JSON in which Python's `NaN`, `Infinity` and `-Infinity`, which JSON does not have, are null.
pub(super) fn without_nan(text: &str) -> Cow<'_, str> {
    if !text.contains("NaN") && !text.contains("Infinity") {
        return Cow::Borrowed(text);
    }
    let mut clean = String::with_capacity(text.len());
    let mut rest = text;
    let mut is_text = false;
    while let Some(first) = rest.chars().next() {
        if is_text && first == '\\' {
            // The character behind it is no end of the text.
            let length = 1 + rest[1..].chars().next().map_or(0, char::len_utf8);
            clean.push_str(&rest[..length]);
            rest = &rest[length..];
            continue;
        }
        let word = ["NaN", "-Infinity", "Infinity"]
            .iter()
            .find(|word| !is_text && rest.starts_with(**word));
        if let Some(word) = word {
            clean.push_str("null");
            rest = &rest[word.len()..];
            continue;
        }
        is_text ^= first == '"';
        clean.push(first);
        rest = &rest[first.len_utf8()..];
    }
    Cow::Owned(clean)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_the_same_as_numbers_floats_and_texts() {
        let id = |text: &str| serde_json::from_str::<Id>(text).map(|id| id.to_string());
        for text in ["7", "7.0", "\"7\"", "\"7.0\"", "7e0"] {
            assert_eq!(id(text).unwrap(), "7", "{text}");
        }
        for (text, expected) in [
            ("\"a.b\"", "a.b"),
            ("\"007\"", "007"),
            ("-1", "-1"),
            ("18446744073709551615", "18446744073709551615"),
            ("7.5", "7.5"),
            ("true", "1"),
        ] {
            assert_eq!(id(text).unwrap(), expected);
        }
        for text in ["null", "[1]", "{\"a\": 1}"] {
            assert!(id(text).is_err(), "{text}");
        }
        let written = serde_json::to_string(&[Id::number(7), Id("x".to_owned())]);
        assert_eq!(written.unwrap(), "[7,\"x\"]");
    }

    #[test]
    fn numbers_may_be_missing_in_every_way() {
        for (text, expected) in [
            ("7", Some(7.0)),
            ("7.5", Some(7.5)),
            ("\"7.5\"", Some(7.5)),
            ("true", Some(1.0)),
            ("null", None),
            ("\"wide\"", None),
            ("[1, [2]]", None),
        ] {
            let number: Number = serde_json::from_str(text).unwrap();
            assert_eq!(number.0, expected, "{text}");
        }
    }

    #[test]
    fn numbers_that_json_does_not_have_are_null_outside_of_texts() {
        for (text, expected) in [
            (
                "{\"a\": NaN, \"b\": -Infinity}",
                "{\"a\": null, \"b\": null}",
            ),
            (
                "[Infinity, \"NaN \\\" NaN\", NaN]",
                "[null, \"NaN \\\" NaN\", null]",
            ),
            ("\"größe \\\\\" NaN", "\"größe \\\\\" null"),
            ("\"NaN\\", "\"NaN\\"),
            ("[1]", "[1]"),
        ] {
            assert_eq!(without_nan(text), expected);
        }
    }
}
