//! Names of the detector's tensors, and loading of state dicts from elsewhere.

use burn::tensor::Device;

use super::{Scale, Yolo11, Yolo11Config};
use crate::error::{Error, Result};
use crate::weights::StateDict;

/// A tensor that every detector has, and whose shape says how many classes there are.
const CLASS_WEIGHT: &str = "model.23.cv3.0.2.weight";

/// What [`load_detector`] had to do beyond copying.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LoadReport {
    /// Classes in the file.
    pub classes_in_file: usize,
    /// The last class convolutions start afresh, because the file has another number of classes.
    pub classes_reset: bool,
    /// The file's batch normalisation was already merged into the convolutions.
    pub folded: bool,
}

/// The published name of the tensor at a module path: `layer2.cv1.bn.gamma` is
/// `model.2.cv1.bn.weight`.
pub fn tensor_name(path: &str) -> String {
    let mut parts = Vec::new();
    for part in path.split('.') {
        match part {
            "bottlenecks" | "c3ks" => parts.push("m".to_owned()),
            "gamma" => parts.push("weight".to_owned()),
            "beta" => parts.push("bias".to_owned()),
            // In the head the blocks and the last convolution are numbered alike.
            "blocks" => {}
            "out" => parts.push("2".to_owned()),
            _ => match part.strip_prefix("layer") {
                Some(number) => parts.extend(["model".to_owned(), number.to_owned()]),
                None => parts.push(part.to_owned()),
            },
        }
    }
    parts.join(".")
}

/// Builds a detector from a state dict in the published names.
///
/// A prefix of all names (`model.`, `module.`, `ema.`) is taken off.
/// Entries that hold no trained numbers (`num_batches_tracked`, the constant bins) are ignored.
/// The width of the class branch is taken from the file. When the file was trained for another
/// number of classes, the last class convolutions start afresh and the report says so.
///
/// # Errors
/// Names every tensor that is missing, unexpected or mis-shaped.
pub fn load_detector(
    state: &StateDict,
    scale: Scale,
    classes: usize,
    device: &Device,
) -> Result<(Yolo11, LoadReport)> {
    let mut state = state.clone().without_prefix(CLASS_WEIGHT);
    state.tensors.retain(|name, _| {
        !name.ends_with("num_batches_tracked") && !name.ends_with("dfl.conv.weight")
    });
    let class_shape = state
        .tensors
        .get(CLASS_WEIGHT)
        .map(|(shape, _)| shape.clone());
    let Some([classes_in_file, width, 1, 1]) = class_shape.as_deref() else {
        return Err(Error::weights(
            &state.path,
            format!("holds no YOLO11 detector: tensor {CLASS_WEIGHT} is missing or mis-shaped"),
            "give a state dict with the published names, or weights that `train` wrote",
        ));
    };
    let folded = !state.tensors.keys().any(|name| name.contains(".bn."));
    let mut config = Yolo11Config::new(scale, *classes_in_file);
    config.class_width = Some(*width);
    let fresh = config.init(device);
    let fresh = if folded { fresh.folded() } else { fresh };
    let mut detector = state.apply(fresh, tensor_name)?;
    if folded {
        // Pack the weights that came from the file.
        detector = detector.folded();
    }
    let classes_reset = *classes_in_file != classes;
    if classes_reset {
        detector.layer23.reset_classes(classes, device);
    }
    let report = LoadReport {
        classes_in_file: *classes_in_file,
        classes_reset,
        folded,
    };
    Ok((detector, report))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn module_paths_become_the_published_names() {
        for (path, name) in [
            ("layer0.conv.weight", "model.0.conv.weight"),
            (
                "layer2.bottlenecks.0.cv1.bn.gamma",
                "model.2.m.0.cv1.bn.weight",
            ),
            (
                "layer6.c3ks.1.m.0.cv2.bn.running_var",
                "model.6.m.1.m.0.cv2.bn.running_var",
            ),
            ("layer10.m.0.ffn.1.bn.beta", "model.10.m.0.ffn.1.bn.bias"),
            (
                "layer23.cv2.1.blocks.0.conv.weight",
                "model.23.cv2.1.0.conv.weight",
            ),
            (
                "layer23.cv3.2.blocks.1.0.conv.weight",
                "model.23.cv3.2.1.0.conv.weight",
            ),
            ("layer23.cv3.2.out.bias", "model.23.cv3.2.2.bias"),
        ] {
            assert_eq!(tensor_name(path), name);
        }
    }
}
