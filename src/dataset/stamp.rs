//! Frame numbers in tables: written as in file names, `00042`, so that tables join as text; read with
//! and without the zeros, and as the numbers that older versions wrote.

use std::num::ParseIntError;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize as _, Serializer};

use super::stamp_name;

#[allow(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde hands a reference to it"
)]
pub(crate) fn serialize<S: Serializer>(stamp: &u64, serializer: S) -> Result<S::Ok, S::Error> {
    stamp_name(*stamp).serialize(serializer)
}

pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "the number of a frame")]
    enum Stamp {
        Number(u64),
        Text(String),
    }
    match Stamp::deserialize(deserializer)? {
        Stamp::Number(stamp) => Ok(stamp),
        Stamp::Text(text) => text
            .trim()
            .parse()
            .map_err(|reason: ParseIntError| D::Error::custom(format!("frame {text:?}: {reason}"))),
    }
}

#[cfg(test)]
mod tests {
    use serde::{Deserialize, Serialize};

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Row {
        #[serde(with = "super")]
        frame: u64,
        id: u32,
    }

    #[test]
    fn a_stamp_is_written_with_zeros_and_read_with_and_without_them() {
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.serialize(Row { frame: 42, id: 7 }).unwrap();
        let text = String::from_utf8(writer.into_inner().unwrap()).unwrap();
        assert_eq!(text, "frame,id\n00042,7\n");
        for text in [text.as_str(), "frame,id\n42,7\n"] {
            let rows: Result<Vec<Row>, _> = csv::Reader::from_reader(text.as_bytes())
                .deserialize()
                .collect();
            assert_eq!(rows.unwrap(), [Row { frame: 42, id: 7 }]);
        }
        for text in [
            "{\"frame\": \"00042\", \"id\": 7}",
            "{\"frame\": 42, \"id\": 7}",
        ] {
            assert_eq!(
                serde_json::from_str::<Row>(text).unwrap(),
                Row { frame: 42, id: 7 }
            );
        }
        assert!(serde_json::from_str::<Row>("{\"frame\": \"x\", \"id\": 7}").is_err());
    }
}
