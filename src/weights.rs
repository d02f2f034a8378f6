//! Weights as safetensors: names, shapes and a header that says what the network is.
//!
//! Tensors are stored under the names and in the layout that PyTorch users know
//! (`model.0.conv.weight`, `[outputs, inputs]`), so other programs can read them. Files are only
//! ever parsed as safetensors; nothing in them is executed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Tensor, TensorData};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::{Error, Result};
use crate::files;

/// The metadata entry that holds the typed header as JSON.
const HEADER: &str = "twinsight";

/// The tensors of a network by name, with the file they came from.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StateDict {
    /// Where it was read; empty for one taken from a network.
    pub path: PathBuf,
    /// Shape and values of every tensor.
    pub tensors: BTreeMap<String, (Vec<usize>, Vec<f32>)>,
    /// The file's metadata.
    pub metadata: BTreeMap<String, String>,
}

impl StateDict {
    /// Takes the tensors of a module; `name` turns a module path into a tensor's name.
    pub fn of<M: Module>(module: &M, name: fn(&str) -> String) -> Self {
        struct Collect {
            path: Vec<String>,
            name: fn(&str) -> String,
            tensors: BTreeMap<String, (Vec<usize>, Vec<f32>)>,
        }
        impl ModuleVisitor for Collect {
            fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
                let tensor = param.val();
                let shape = tensor.dims().to_vec();
                // A parameter is always readable as 32-bit floats.
                if let Ok(values) = tensor.without_autodiff().try_into_vec_as::<f32>() {
                    self.tensors
                        .insert((self.name)(&self.path.join(".")), (shape, values));
                }
            }
            fn enter_module(&mut self, name: &str, _: &str) {
                self.path.push(name.to_owned());
            }
            fn exit_module(&mut self, _: &str, _: &str) {
                self.path.pop();
            }
        }
        let mut collect = Collect {
            path: Vec::new(),
            name,
            tensors: BTreeMap::new(),
        };
        // A network in training keeps its latest running statistics aside; its copy has them.
        module.valid().visit(&mut collect);
        Self {
            tensors: collect.tensors,
            ..Self::default()
        }
    }

    /// Adds a typed header.
    ///
    /// # Errors
    /// A header that is not representable as JSON.
    pub fn with_header(mut self, header: &impl Serialize) -> Result<Self> {
        let json = serde_json::to_string(header).map_err(|source| {
            Error::value(
                "weights header",
                source.to_string(),
                "report this as a defect",
            )
        })?;
        self.metadata.insert(HEADER.to_owned(), json);
        Ok(self)
    }

    /// The typed header, if the file has one.
    ///
    /// # Errors
    /// A header that is not the one asked for.
    pub fn header<H: DeserializeOwned>(&self) -> Result<Option<H>> {
        self.metadata
            .get(HEADER)
            .map(|json| {
                serde_json::from_str(json).map_err(|source| {
                    Error::weights(
                        &self.path,
                        format!("its header is not that of this network: {source}"),
                        "give the weights file that `train` wrote for this network",
                    )
                })
            })
            .transpose()
    }

    /// Writes the file: to a temporary name first, then renamed.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let bytes: Vec<(&String, &[usize], Vec<u8>)> = self
            .tensors
            .iter()
            .map(|(name, (shape, values))| {
                (
                    name,
                    &shape[..],
                    values
                        .iter()
                        .flat_map(|value| value.to_le_bytes())
                        .collect(),
                )
            })
            .collect();
        let defect = |source: safetensors::SafeTensorError| {
            Error::weights(
                path,
                format!("cannot be encoded: {source}"),
                "report this as a defect",
            )
        };
        let views = bytes
            .iter()
            .map(|(name, shape, bytes)| {
                let view = TensorView::new(Dtype::F32, shape.to_vec(), bytes).map_err(defect)?;
                Ok((name.as_str(), view))
            })
            .collect::<Result<Vec<_>>>()?;
        let metadata = self.metadata.clone().into_iter().collect();
        let file = safetensors::serialize(views, Some(metadata)).map_err(defect)?;
        files::write_atomically(path, &file)
    }

    /// Reads a file; half-precision tensors are widened, integers left out.
    ///
    /// # Errors
    /// A file that is missing, truncated or not safetensors, or holds numbers that are not finite.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(Error::io("read", path))?;
        let broken = |source: safetensors::SafeTensorError| {
            let remedy = if is_pickled(path, &bytes) {
                "PyTorch's own files are pickled, which is never executed here: export the state \
                 dict to safetensors first"
            } else {
                "the file is truncated or not a safetensors file: train again or restore a copy"
            };
            Error::weights(path, format!("cannot be read ({source})"), remedy)
        };
        let file = SafeTensors::deserialize(&bytes).map_err(broken)?;
        let (_, metadata) = SafeTensors::read_metadata(&bytes).map_err(broken)?;
        let mut tensors = BTreeMap::new();
        for (name, view) in file.iter() {
            let data = view.data();
            let values: Vec<f32> = match view.dtype() {
                Dtype::F32 => chunks(data, f32::from_le_bytes),
                Dtype::F64 => chunks(data, |bytes| f64::from_le_bytes(bytes) as f32),
                Dtype::F16 => chunks(data, |bytes| {
                    burn::tensor::f16::from_le_bytes(bytes).to_f32()
                }),
                Dtype::BF16 => chunks(data, |bytes| {
                    burn::tensor::bf16::from_le_bytes(bytes).to_f32()
                }),
                _ => continue,
            };
            if let Some(value) = values.iter().find(|value| !value.is_finite()) {
                return Err(Error::weights(
                    path,
                    format!("holds numbers that are not finite, such as {value} in tensor {name}"),
                    "the training that wrote it went astray: give weights of an earlier epoch, or \
                     train again with a lower learning rate",
                ));
            }
            tensors.insert(name.to_owned(), (view.shape().to_vec(), values));
        }
        let metadata = metadata
            .metadata()
            .clone()
            .unwrap_or_default()
            .into_iter()
            .collect();
        Ok(Self {
            path: path.to_path_buf(),
            tensors,
            metadata,
        })
    }

    /// Takes off what programs put before the names of a network that they hold as a part: `model.`,
    /// `module.`, `ema.` and several of them. `known` is the name of a tensor that the network must
    /// have; where it is there under its own name, nothing changes. Of a file with several networks
    /// the averaged one (`ema.`) is taken, the others are dropped.
    #[must_use]
    pub fn without_prefix(mut self, known: &str) -> Self {
        if self.tensors.contains_key(known) {
            return self;
        }
        let prefixes = self.tensors.keys().filter_map(|name| {
            let prefix = name.strip_suffix(known)?;
            prefix.ends_with('.').then(|| prefix.to_owned())
        });
        // False before true: an averaged one first, then the shortest.
        let best = prefixes.min_by_key(|prefix| (!prefix.contains("ema"), prefix.len()));
        let Some(prefix) = best else {
            return self;
        };
        let tensors = std::mem::take(&mut self.tensors);
        self.tensors = tensors
            .into_iter()
            .filter_map(|(name, tensor)| Some((name.strip_prefix(&prefix)?.to_owned(), tensor)))
            .collect();
        self
    }

    /// Puts the tensors into a module of the same structure.
    ///
    /// # Errors
    /// Names every missing, unexpected and mis-shaped tensor; the module is then lost, not half
    /// loaded.
    pub fn apply<M: Module>(&self, module: M, name: fn(&str) -> String) -> Result<M> {
        let mut apply = Apply {
            path: Vec::new(),
            name,
            tensors: &self.tensors,
            used: Vec::new(),
            problems: Vec::new(),
        };
        let module = module.map(&mut apply);
        let Apply {
            mut used,
            mut problems,
            ..
        } = apply;
        used.sort();
        problems.extend(
            self.tensors
                .keys()
                .filter(|name| used.binary_search(name).is_err())
                .map(|name| format!("unexpected tensor {name}")),
        );
        if problems.is_empty() {
            return Ok(module);
        }
        let shown = 5;
        let more = problems.len().saturating_sub(shown);
        problems.truncate(shown);
        let more = if more > 0 {
            format!(" and {more} more")
        } else {
            String::new()
        };
        Err(Error::weights(
            &self.path,
            format!("does not fit this network: {}{more}", problems.join("; ")),
            "give the weights of this network, scale and class count",
        ))
    }
}

/// Whether a file looks like one of PyTorch's own: by its name, or as a zip archive or pickle begins.
fn is_pickled(path: &Path, bytes: &[u8]) -> bool {
    const ENDINGS: [&str; 5] = ["pt", "pth", "ckpt", "pkl", "bin"];
    let ending = path.extension().unwrap_or_default();
    bytes.starts_with(b"PK")
        || bytes.first() == Some(&0x80)
        || ENDINGS
            .iter()
            .any(|known| ending.eq_ignore_ascii_case(known))
}

fn chunks<const N: usize>(data: &[u8], convert: impl Fn([u8; N]) -> f32) -> Vec<f32> {
    let (values, _) = data.as_chunks::<N>();
    values.iter().map(|bytes| convert(*bytes)).collect()
}

/// Replaces every parameter by the tensor of its name.
struct Apply<'a> {
    path: Vec<String>,
    name: fn(&str) -> String,
    tensors: &'a BTreeMap<String, (Vec<usize>, Vec<f32>)>,
    used: Vec<String>,
    problems: Vec<String>,
}

impl ModuleMapper for Apply<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let name = (self.name)(&self.path.join("."));
        let Some((shape, values)) = self.tensors.get(&name) else {
            self.problems.push(format!("missing tensor {name}"));
            return param;
        };
        self.used.push(name.clone());
        let expected = param.lazy_shape().dims::<D>();
        if shape[..] != expected {
            self.problems.push(format!(
                "tensor {name} has shape {shape:?} instead of {expected:?}"
            ));
            return param;
        }
        param.map(|tensor| {
            let data = TensorData::new(values.clone(), expected);
            let loaded = Tensor::from_data(data, &tensor.device());
            loaded.set_require_grad(tensor.is_require_grad())
        })
    }

    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dict(names: &[&str]) -> StateDict {
        let tensor = |name: &&str| ((*name).to_owned(), (vec![1], vec![0.5]));
        StateDict {
            tensors: names.iter().map(tensor).collect(),
            ..StateDict::default()
        }
    }

    #[test]
    fn what_programs_put_before_all_names_is_taken_off() {
        let known = "model.23.out.weight";
        let plain = ["model.0.conv.weight", known];
        for prefix in [
            "",
            "model.",
            "module.",
            "ema.",
            "module.model.",
            "state_dict.ema.",
        ] {
            let names = plain.map(|name| format!("{prefix}{name}"));
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            let found = dict(&names).without_prefix(known);
            assert_eq!(found, dict(&plain), "{prefix}");
        }
        let both = [
            "model.model.0.conv.weight",
            "model.model.23.out.weight",
            "ema.model.0.conv.weight",
            "ema.model.23.out.weight",
            "epoch",
        ];
        assert_eq!(dict(&both).without_prefix(known), dict(&plain));
        // Another network stays as it is, and is refused by its own names.
        for names in [&["backbone.0.weight"][..], &["xmodel.23.out.weight"], &[]] {
            assert_eq!(dict(names).without_prefix(known), dict(names));
        }
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused_by_the_name_of_their_tensor() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("best.safetensors");
        for value in [f32::NAN, f32::INFINITY] {
            let mut weights = dict(&["model.0.conv.weight"]);
            let tensor = (vec![2], vec![0.5, value]);
            weights.tensors.insert("model.1.bias".to_owned(), tensor);
            weights.save(&path).unwrap();
            let message = StateDict::load(&path).unwrap_err().to_string();
            for words in ["best.safetensors", "model.1.bias", "not finite"] {
                assert!(message.contains(words), "{message}");
            }
        }
    }
}
