//! Networks filled by the number formula, their inputs, and what a test reads from them.

use std::collections::BTreeMap;

use burn::module::{Flag, Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use twinsight::detector::assign::Target;
use twinsight::detector::loss::ImageTargets;
use twinsight::detector::weights::tensor_name;
use twinsight::detector::{Scale, Yolo11, Yolo11Config};
use twinsight::weights::StateDict;

use super::fixture::Fixture;
use super::formula::{self, Fill};

/// Fills every parameter and statistic of a module by the number formula.
pub fn fill<M: Module>(module: M, fill: &Fill, name: fn(&str) -> String) -> M {
    let mut state = StateDict::of(&module, name);
    assert!(!state.tensors.is_empty());
    for (name, (shape, values)) in &mut state.tensors {
        *values = fill.parameter(name, shape);
    }
    state.apply(module, name).unwrap()
}

/// The detector that a fixture describes, filled.
pub fn detector(fixture: &Fixture, device: &Device) -> Yolo11 {
    let letter = fixture.meta_text("scale");
    let scale = Scale::ALL
        .into_iter()
        .find(|scale| scale.letter() == letter);
    let classes = fixture.meta_number("nc").unwrap() as usize;
    let detector = Yolo11Config::new(scale.unwrap(), classes).init(device);
    fill(detector, &Fill::from_fixture(fixture), tensor_name)
}

/// The pictures that a fixture's detector looks at.
pub fn detector_input(fixture: &Fixture, device: &Device) -> Tensor<4> {
    let shape: [usize; 4] = fixture.meta_sizes("input_shape").try_into().unwrap();
    let key = fixture.meta_text("image_key");
    let pixels = formula::image_batch(&key, shape[0], shape[2], shape[3]);
    Tensor::from_data(TensorData::new(pixels, shape), device)
}

/// Batch size, height and width of a fixture's pictures.
pub type Extent = [usize; 3];

/// The targets of every image, in pixels.
pub fn targets(fixture: &Fixture, [batch, height, width]: Extent) -> Vec<ImageTargets> {
    let mut targets = vec![ImageTargets::default(); batch];
    let rows = fixture.values("in.targets");
    let (rows, _) = rows.as_chunks::<6>();
    for &[image, class, cx, cy, w, h] in rows {
        let (width, height) = (width as f64, height as f64);
        targets[image as usize].targets.push(Target {
            class: class as usize,
            box_letterbox: [
                (cx - w / 2.0) * width,
                (cy - h / 2.0) * height,
                (cx + w / 2.0) * width,
                (cy + h / 2.0) * height,
            ],
        });
    }
    targets
}

/// A float32 tensor of a fixture on a device.
pub fn tensor<const D: usize>(fixture: &Fixture, name: &str, device: &Device) -> Tensor<D> {
    let (shape, values) = fixture.f32(name);
    let shape: [usize; D] = shape.try_into().unwrap();
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// All elements, row-major.
pub fn values<const D: usize>(tensor: &Tensor<D>) -> Vec<f32> {
    let tensor = tensor.clone().without_autodiff();
    tensor.try_into_vec_as::<f32>().unwrap()
}

/// A tensor's summary.
pub fn summary<const D: usize>(tensor: &Tensor<D>) -> Vec<f64> {
    formula::summary(&values(tensor))
}

/// Puts every batch normalisation of a module into evaluation state, on a training device too.
pub fn freeze_normalisation<M: Module>(module: M) -> M {
    struct Freeze;
    impl ModuleMapper for Freeze {
        fn map_flag(&mut self, flag: Param<Flag>) -> Param<Flag> {
            flag.with_value(false)
        }
    }
    module.map(&mut Freeze)
}

/// The gradient of every trained parameter of a module by name.
pub fn gradients<M: Module>(
    module: &M,
    gradients: &Gradients,
    name: fn(&str) -> String,
) -> BTreeMap<String, Vec<f32>> {
    struct Collect<'a> {
        path: Vec<String>,
        name: fn(&str) -> String,
        gradients: &'a Gradients,
        found: BTreeMap<String, Vec<f32>>,
    }
    impl ModuleVisitor for Collect<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let tensor = param.val();
            if !tensor.is_require_grad() {
                return;
            }
            let name = (self.name)(&self.path.join("."));
            let gradient = tensor.grad(self.gradients);
            let gradient = gradient.unwrap_or_else(|| panic!("{name} has no gradient"));
            self.found.insert(name, values(&gradient));
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
        gradients,
        found: BTreeMap::new(),
    };
    module.visit(&mut collect);
    collect.found
}

/// Length of a vector.
pub fn norm(values: &[f32]) -> f64 {
    values
        .iter()
        .map(|&v| f64::from(v).powi(2))
        .sum::<f64>()
        .sqrt()
}
