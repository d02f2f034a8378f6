//! The detector's loss: boxes by complete IoU and distribution focal loss, classes by binary
//! cross entropy against soft targets.

use burn::tensor::activation::{log_sigmoid, log_softmax, sigmoid};
use burn::tensor::{Int, Tensor, TensorData};

use super::assign::{Positive, Predictions, Target, anchors_inside, assign};
use super::decode::{Anchors, expected_sides};
use super::head::{FlatOutput, REG_MAX};
use crate::error::{Error, Result};

/// Weights of the three terms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LossGains {
    /// Complete IoU.
    pub boxes: f64,
    /// Binary cross entropy.
    pub classes: f64,
    /// Distribution focal loss.
    pub distribution: f64,
}

impl Default for LossGains {
    fn default() -> Self {
        Self {
            boxes: 7.5,
            classes: 0.5,
            distribution: 1.5,
        }
    }
}

/// What one image holds.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ImageTargets {
    /// The vehicles to find.
    pub targets: Vec<Target>,
    /// Boxes (edges, pixels of the network's input) of what may be found or not.
    pub ignored: Vec<[f64; 4]>,
}

impl From<Vec<Target>> for ImageTargets {
    fn from(targets: Vec<Target>) -> Self {
        Self {
            targets,
            ignored: Vec::new(),
        }
    }
}

/// The loss of one batch.
#[derive(Debug, Clone)]
pub struct DetectionLoss {
    /// What to differentiate: the batch size times the sum of the terms, `[1]`.
    pub total: Tensor<1>,
    /// Gain-scaled box, class and distribution terms, each `[1]`, without the batch size.
    pub items: [Tensor<1>; 3],
    /// Positives per image.
    pub positives: Vec<Vec<Positive>>,
    /// Sum of all soft targets.
    pub weight_sum: f64,
}

/// Largest distance, in strides, that the distribution of a side can say.
const LARGEST_SIDE: f64 = (REG_MAX - 1) as f64 - 0.01;

/// Computes the loss of a batch against the targets of each image.
///
/// An anchor in an ignored box that learns no target has no loss: whether it finds something there
/// is its own affair.
///
/// # Errors
/// Predictions that cannot be read back from the device.
pub fn detection_loss(
    output: &FlatOutput,
    targets: &[ImageTargets],
    anchors: &Anchors,
    gains: LossGains,
) -> Result<DetectionLoss> {
    let device = output.boxes.device();
    let [batch, classes, count] = output.scores.dims();
    let positives = assign_batch(output, targets, anchors)?;

    // Soft class targets, [batch, classes, anchors], and the positives' rows.
    let mut class_targets = vec![0.0_f32; batch * classes * count];
    let mut rows = Vec::new();
    let mut weights = Vec::new();
    let mut points = Vec::new();
    let mut boxes = Vec::new();
    let mut bins = Vec::new();
    let mut weight_sum = 0.0;
    for (image, (positives, targets)) in positives.iter().zip(targets).enumerate() {
        for positive in positives {
            let target = &targets.targets[positive.target];
            let anchor = positive.anchor;
            class_targets[(image * classes + target.class) * count + anchor] =
                positive.weight as f32;
            weight_sum += positive.weight;
            rows.push((image * count + anchor) as i64);
            weights.push(positive.weight as f32);
            let stride = f64::from(anchors.strides[anchor]);
            let [x, y] = anchors.points_grid[anchor].map(f64::from);
            let edges = target.box_letterbox.map(|edge| edge / stride);
            points.extend([x as f32, y as f32]);
            boxes.extend(edges.map(|edge| edge as f32));
            for side in [x - edges[0], y - edges[1], edges[2] - x, edges[3] - y] {
                let side = side.clamp(0.0, LARGEST_SIDE);
                let low = side.floor();
                let mut side_bins = [0.0_f32; REG_MAX];
                side_bins[low as usize] = (low + 1.0 - side) as f32;
                side_bins[low as usize + 1] = (side - low) as f32;
                bins.extend(side_bins);
            }
        }
    }
    let normalizer = 1.0 / weight_sum.max(1.0);

    // Cross entropy with logits x and targets t: x (1 - t) - log sigmoid(x).
    let scores = output.scores.clone();
    let class_targets = Tensor::<3>::from_data(
        TensorData::new(class_targets, [batch, classes, count]),
        &device,
    );
    let cross_entropy = scores.clone() * (-class_targets + 1.0) - log_sigmoid(scores);
    let cross_entropy = match class_mask(targets, &positives, anchors, classes) {
        Some(mask) => {
            let shape = [batch, classes, count];
            cross_entropy * Tensor::from_data(TensorData::new(mask, shape), &device)
        }
        None => cross_entropy,
    };
    let class_item = cross_entropy.sum().mul_scalar(normalizer * gains.classes);

    let (box_item, distribution_item) = if rows.is_empty() {
        // Zero, but part of the graph, so that every parameter has a gradient.
        let zero = output.boxes.clone().sum().mul_scalar(0.0);
        (zero.clone(), zero)
    } else {
        let number = rows.len();
        let rows = Tensor::<1, Int>::from_data(TensorData::new(rows, [number]), &device);
        let weights = Tensor::<1>::from_data(TensorData::new(weights, [number]), &device);
        let points = Tensor::<2>::from_data(TensorData::new(points, [number, 2]), &device);
        let boxes = Tensor::<2>::from_data(TensorData::new(boxes, [number, 4]), &device);
        let bins = Tensor::<3>::from_data(TensorData::new(bins, [number, 4, REG_MAX]), &device);
        let logits = output
            .boxes
            .clone()
            .swap_dims(1, 2)
            .reshape([batch * count, 4 * REG_MAX])
            .select(0, rows)
            .reshape([number, 4, REG_MAX]);
        let log_probabilities = log_softmax(logits, 2); // [positives, 4, bins]
        let focal = (bins * log_probabilities.clone())
            .sum_dim(2)
            .mean_dim(1)
            .reshape([number])
            .neg();
        let numbers: Vec<f32> = (0..REG_MAX as u16).map(f32::from).collect();
        let numbers = Tensor::<3>::from_data(TensorData::new(numbers, [1, 1, REG_MAX]), &device);
        let sides = (log_probabilities.exp() * numbers)
            .sum_dim(2)
            .reshape([number, 4]);
        let low = points.clone() - sides.clone().narrow(1, 0, 2);
        let high = points + sides.narrow(1, 2, 2);
        let overlap = complete_iou(&low, &high, &boxes); // [positives]
        let box_item = ((-overlap + 1.0) * weights.clone()).sum();
        let focal_item = (focal * weights).sum();
        (
            box_item.mul_scalar(normalizer * gains.boxes),
            focal_item.mul_scalar(normalizer * gains.distribution),
        )
    };
    let total = (box_item.clone() + class_item.clone() + distribution_item.clone())
        .mul_scalar(batch as f64);
    Ok(DetectionLoss {
        total,
        items: [
            box_item.detach(),
            class_item.detach(),
            distribution_item.detach(),
        ],
        positives,
        weight_sum,
    })
}

/// 0 where an anchor lies in an ignored box and learns no target, 1 elsewhere,
/// `[batch, classes, anchors]`; None where nothing is ignored.
fn class_mask(
    targets: &[ImageTargets],
    positives: &[Vec<Positive>],
    anchors: &Anchors,
    classes: usize,
) -> Option<Vec<f32>> {
    if targets.iter().all(|image| image.ignored.is_empty()) {
        return None;
    }
    let count = anchors.len();
    let mut mask = Vec::with_capacity(targets.len() * classes * count);
    for (image, positives) in targets.iter().zip(positives) {
        let mut of_image = vec![1.0; count];
        for &area in &image.ignored {
            for anchor in anchors_inside(area, anchors) {
                of_image[anchor] = 0.0;
            }
        }
        for positive in positives {
            of_image[positive.anchor] = 1.0;
        }
        for _ in 0..classes {
            mask.extend_from_slice(&of_image);
        }
    }
    Some(mask)
}

/// Reads the predictions back (the step's one synchronisation) and assigns each image's anchors.
fn assign_batch(
    output: &FlatOutput,
    targets: &[ImageTargets],
    anchors: &Anchors,
) -> Result<Vec<Vec<Positive>>> {
    let [batch, classes, count] = output.scores.dims();
    let read = |tensor: Tensor<3>| {
        tensor.try_into_vec_as::<f32>().map_err(|source| {
            Error::training(
                format!("cannot read the predictions back from the device: {source}"),
                "try a smaller batch or another device",
            )
        })
    };
    let sides = read(expected_sides(output.boxes.clone().without_autodiff()))?;
    let scores = read(sigmoid(output.scores.clone().without_autodiff()))?;
    Ok((0..batch)
        .map(|image| {
            let predictions = Predictions {
                sides_grid: &sides[image * 4 * count..][..4 * count],
                scores: &scores[image * classes * count..][..classes * count],
            };
            assign(predictions, &targets[image].targets, anchors)
        })
        .collect())
}

/// Complete IoU of predicted (`low`, `high` corners) and target boxes (edges), differentiable in
/// the prediction; the aspect term's factor carries no gradient.
///
/// # Shapes
/// - `low`, `high`: `[boxes, 2]`, `target`: `[boxes, 4]`
/// - output: `[boxes]`
fn complete_iou(low: &Tensor<2>, high: &Tensor<2>, target: &Tensor<2>) -> Tensor<1> {
    const EPS: f64 = 1e-7;
    let [number, _] = low.dims();
    let column =
        |tensor: &Tensor<2>, index: usize| tensor.clone().narrow(1, index, 1).reshape([number]);
    let (x1, y1, x2, y2) = (
        column(low, 0),
        column(low, 1),
        column(high, 0),
        column(high, 1),
    );
    let [tx1, ty1, tx2, ty2] = [0, 1, 2, 3].map(|index| column(target, index));
    let (w, h) = (x2.clone() - x1.clone(), y2.clone() - y1.clone() + EPS);
    let (tw, th) = (tx2.clone() - tx1.clone(), ty2.clone() - ty1.clone() + EPS);
    let overlap_w =
        (x2.clone().min_pair(tx2.clone()) - x1.clone().max_pair(tx1.clone())).clamp_min(0.0);
    let overlap_h =
        (y2.clone().min_pair(ty2.clone()) - y1.clone().max_pair(ty1.clone())).clamp_min(0.0);
    let intersection = overlap_w * overlap_h;
    let union = w.clone() * h.clone() + tw.clone() * th.clone() - intersection.clone() + EPS;
    let iou = intersection / union;
    let enclosing_w = x2.clone().max_pair(tx2.clone()) - x1.clone().min_pair(tx1.clone());
    let enclosing_h = y2.clone().max_pair(ty2.clone()) - y1.clone().min_pair(ty1.clone());
    let diagonal = enclosing_w.square() + enclosing_h.square() + EPS;
    let dx = tx1 + tx2 - x1 - x2;
    let dy = ty1 + ty2 - y1 - y2;
    let center = (dx.square() + dy.square()).mul_scalar(0.25);
    let angle = (tw / th).atan() - (w / h).atan();
    let v = angle
        .square()
        .mul_scalar(4.0 / std::f64::consts::PI.powi(2));
    let alpha = (v.clone() / (v.clone() - iou.clone() + (1.0 + EPS))).detach();
    iou - center / diagonal - alpha * v
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;

    const SIDE: usize = 64;

    fn class_item(targets: ImageTargets) -> f64 {
        let device = Device::flex();
        let anchors = Anchors::new(SIDE, SIDE);
        let count = anchors.len();
        let values: Vec<f32> = (0..4 * REG_MAX * count)
            .map(|i| (i % 7) as f32 * 0.1)
            .collect();
        let output = FlatOutput {
            boxes: Tensor::from_data(TensorData::new(values, [1, 4 * REG_MAX, count]), &device),
            scores: Tensor::zeros([1, 1, count], &device),
        };
        let loss = detection_loss(&output, &[targets], &anchors, LossGains::default()).unwrap();
        loss.items[1].clone().into_scalar::<f64>()
    }

    #[test]
    fn anchors_in_ignored_boxes_have_no_loss_and_the_others_all_of_theirs() {
        let nothing = class_item(ImageTargets::default());
        let side = SIDE as f64;
        let ignoring = |ignored: [f64; 4]| {
            class_item(ImageTargets {
                targets: Vec::new(),
                ignored: vec![ignored],
            })
        };
        assert!(ignoring([0.0, 0.0, side, side]).abs() < 1e-6);
        // Half of the image holds half of the anchors, all of them with the same score.
        let half = ignoring([0.0, 0.0, side / 2.0, side]);
        assert!((half / nothing - 0.5).abs() < 1e-5, "{half} of {nothing}");
    }

    #[test]
    fn a_target_is_learnt_though_it_stands_in_an_ignored_box() {
        let side = SIDE as f64;
        let target = Target {
            class: 0,
            box_letterbox: [16.0, 16.0, 40.0, 40.0],
        };
        let alone = ImageTargets::from(vec![target]);
        let among = ImageTargets {
            ignored: vec![[0.0, 0.0, side, side]],
            ..alone.clone()
        };
        let (alone, among) = (class_item(alone), class_item(among));
        assert!(among > 0.0 && among < alone, "{among} {alone}");
    }
}
