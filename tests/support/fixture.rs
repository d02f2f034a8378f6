//! Reads fixture files and compares numbers with them. Panics where a test should fail.

use std::path::PathBuf;

use safetensors::{Dtype, SafeTensors};
use serde_json::Value;

/// Path of a file in `tests/fixtures`.
pub fn fixture_path(file: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures")
        .join(file)
}

/// One safetensors file of `tests/fixtures`, held in memory.
pub struct Fixture {
    name: String,
    bytes: Vec<u8>,
}

impl Fixture {
    /// Reads `tests/fixtures/<name>.safetensors`.
    pub fn load(name: &str) -> Self {
        let path = fixture_path(&format!("{name}.safetensors"));
        let bytes =
            std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        Self {
            name: name.to_owned(),
            bytes,
        }
    }

    /// Names of all tensors, sorted.
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = self
            .tensors()
            .names()
            .into_iter()
            .map(ToString::to_string)
            .collect();
        names.sort();
        names
    }

    /// Names of the tensors that begin with `prefix`, sorted, without it.
    pub fn names_after(&self, prefix: &str) -> Vec<String> {
        self.names()
            .iter()
            .filter_map(|name| name.strip_prefix(prefix).map(ToOwned::to_owned))
            .collect()
    }

    /// Whether a tensor of this name exists.
    pub fn has(&self, tensor: &str) -> bool {
        self.tensors().tensor(tensor).is_ok()
    }

    /// Shape and elements of a float32 tensor.
    pub fn f32(&self, tensor: &str) -> (Vec<usize>, Vec<f32>) {
        self.read(tensor, Dtype::F32, f32::from_le_bytes)
    }

    /// Shape and elements of a float64 tensor.
    pub fn f64(&self, tensor: &str) -> (Vec<usize>, Vec<f64>) {
        self.read(tensor, Dtype::F64, f64::from_le_bytes)
    }

    /// Shape and elements of an int64 tensor.
    pub fn i64(&self, tensor: &str) -> (Vec<usize>, Vec<i64>) {
        self.read(tensor, Dtype::I64, i64::from_le_bytes)
    }

    /// Shape and elements of a uint8 tensor.
    pub fn u8(&self, tensor: &str) -> (Vec<usize>, Vec<u8>) {
        self.read(tensor, Dtype::U8, u8::from_le_bytes)
    }

    /// The elements of a float32 or float64 tensor as f64.
    pub fn values(&self, tensor: &str) -> Vec<f64> {
        if self.view(tensor).dtype() == Dtype::F64 {
            self.f64(tensor).1
        } else {
            self.f32(tensor).1.into_iter().map(f64::from).collect()
        }
    }

    /// The only element of a float tensor.
    pub fn scalar(&self, tensor: &str) -> f64 {
        let values = self.values(tensor);
        assert_eq!(values.len(), 1, "{}: {tensor} is no scalar", self.name);
        values[0]
    }

    /// A metadata entry: JSON where it is JSON, otherwise its text.
    pub fn meta(&self, key: &str) -> Option<Value> {
        let (_, header) = SafeTensors::read_metadata(&self.bytes)
            .unwrap_or_else(|error| panic!("{}: {error}", self.name));
        let text = header.metadata().as_ref()?.get(key)?.clone();
        Some(serde_json::from_str(&text).unwrap_or(Value::String(text)))
    }

    /// A metadata entry that is a word.
    pub fn meta_text(&self, key: &str) -> String {
        match self.meta(key) {
            Some(Value::String(text)) => text,
            Some(other) => other.to_string(),
            None => panic!("{}: no metadata {key}", self.name),
        }
    }

    /// A metadata entry that is a number; None where it is missing.
    pub fn meta_number(&self, key: &str) -> Option<f64> {
        self.meta(key)?.as_f64()
    }

    /// A metadata entry that is a list of texts, such as parameter names.
    pub fn meta_texts(&self, key: &str) -> Vec<String> {
        self.meta_list(key, |v| v.as_str().map(ToOwned::to_owned))
    }

    /// A metadata entry that is a list of whole numbers, such as a shape.
    pub fn meta_sizes(&self, key: &str) -> Vec<usize> {
        self.meta_list(key, |v| v.as_u64().map(|n| n as usize))
    }

    fn meta_list<T>(&self, key: &str, item: impl Fn(&Value) -> Option<T>) -> Vec<T> {
        self.meta(key)
            .and_then(|value| value.as_array()?.iter().map(item).collect())
            .unwrap_or_else(|| panic!("{}: metadata {key} is no such list", self.name))
    }

    fn tensors(&self) -> SafeTensors<'_> {
        SafeTensors::deserialize(&self.bytes)
            .unwrap_or_else(|error| panic!("{}: {error}", self.name))
    }

    fn view(&self, tensor: &str) -> safetensors::tensor::TensorView<'_> {
        self.tensors()
            .tensor(tensor)
            .unwrap_or_else(|error| panic!("{}: {tensor}: {error}", self.name))
    }

    fn read<T, const N: usize>(
        &self,
        tensor: &str,
        dtype: Dtype,
        decode: impl Fn([u8; N]) -> T,
    ) -> (Vec<usize>, Vec<T>) {
        let view = self.view(tensor);
        assert_eq!(view.dtype(), dtype, "{}: {tensor}", self.name);
        let (elements, rest) = view.data().as_chunks::<N>();
        assert!(rest.is_empty());
        (
            view.shape().to_vec(),
            elements.iter().map(|&bytes| decode(bytes)).collect(),
        )
    }
}

/// Fails unless `max|actual - expected| <= tolerance * max|expected|`.
#[track_caller]
pub fn assert_close<A, E>(actual: &[A], expected: &[E], tolerance: f64, what: &str)
where
    A: Copy + Into<f64>,
    E: Copy + Into<f64>,
{
    let largest = expected.iter().map(|&e| e.into().abs()).fold(0.0, f64::max);
    assert_abs(actual, expected, tolerance * largest, what);
}

/// Fails unless `max|actual - expected| <= tolerance`.
#[track_caller]
pub fn assert_abs<A, E>(actual: &[A], expected: &[E], tolerance: f64, what: &str)
where
    A: Copy + Into<f64>,
    E: Copy + Into<f64>,
{
    assert_eq!(actual.len(), expected.len(), "{what}: number of elements");
    for (i, (&a, &e)) in actual.iter().zip(expected).enumerate() {
        let (a, e): (f64, f64) = (a.into(), e.into());
        // Written so that NaN fails.
        let near = (a - e).abs() <= tolerance;
        assert!(
            near,
            "{what}: element {i} is {a}, expected {e} within {tolerance:e}"
        );
    }
}
