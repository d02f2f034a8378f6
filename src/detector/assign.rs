//! Task-aligned assignment: which anchor points learn which target, and how strongly.
//!
//! Runs on the host in double precision, without gradient: its inputs are one read-back of the
//! predicted boxes and scores, its cost is targets times anchors.

use super::decode::Anchors;

/// Anchors that a target may keep.
const TOP_K: usize = 10;
/// Exponent of the overlap in the alignment metric; the score's is one half.
const OVERLAP_EXPONENT: i32 = 6;
/// Targets with a side shorter than this (the second level's stride) are enlarged when looking
/// for anchors, so that small ones are not missed between cell centres.
const SIDE_FLOOR_PX: f64 = 16.0;
const EPSILON: f64 = 1e-9;

/// A target box of one image, edges in pixels of the network's input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Class index.
    pub class: usize,
    /// `x_min`, `y_min`, `x_max`, `y_max`.
    pub box_letterbox: [f64; 4],
}

/// An anchor point that learns a target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Positive {
    /// Index of the anchor point.
    pub anchor: usize,
    /// Index of the target within its image.
    pub target: usize,
    /// Soft class target, 0..1; also the weight of the box terms.
    pub weight: f64,
}

/// Predictions of one image.
#[derive(Debug, Clone, Copy)]
pub struct Predictions<'a> {
    /// `[4, anchors]`: left, top, right, bottom distances in units of the stride.
    pub sides_grid: &'a [f32],
    /// `[classes, anchors]`: class probabilities.
    pub scores: &'a [f32],
}

impl Predictions<'_> {
    /// The box of an anchor, pixels of the network's input.
    fn box_letterbox(&self, anchors: &Anchors, anchor: usize) -> [f64; 4] {
        let count = anchors.len();
        let [x, y] = anchors.points_grid[anchor].map(f64::from);
        let stride = f64::from(anchors.strides[anchor]);
        let side = |index: usize| f64::from(self.sides_grid[index * count + anchor]);
        [x - side(0), y - side(1), x + side(2), y + side(3)].map(|edge| edge * stride)
    }
}

/// Assigns anchor points to targets; positives come in the order of their anchors.
pub fn assign(predictions: Predictions, targets: &[Target], anchors: &Anchors) -> Vec<Positive> {
    let count = anchors.len();
    let rows: Vec<Vec<Alignment>> = targets
        .iter()
        .map(|target| align(predictions, target, anchors))
        .collect();
    // Which target each anchor is given to: one that kept it, or on conflict the best overlap.
    let mut keepers: Vec<Vec<usize>> = vec![Vec::new(); count];
    for (index, row) in rows.iter().enumerate() {
        for anchor in top_anchors(row, count) {
            keepers[anchor].push(index);
        }
    }
    let overlap =
        |target: usize, anchor: usize| find(&rows[target], anchor).map_or(0.0, |a| a.overlap);
    let mut positives = Vec::new();
    for (anchor, keepers) in keepers.iter().enumerate() {
        let target = match keepers[..] {
            [] => continue,
            [only] => only,
            _ => (0..targets.len()).fold(0, |best, target| {
                if overlap(target, anchor) > overlap(best, anchor) {
                    target
                } else {
                    best
                }
            }),
        };
        positives.push((anchor, target));
    }
    // Scale each target's metrics so that its best anchor has its best overlap as class target.
    let mut best = vec![[0.0_f64; 2]; targets.len()];
    for &(anchor, target) in &positives {
        if let Some(alignment) = find(&rows[target], anchor) {
            best[target][0] = best[target][0].max(alignment.metric);
            best[target][1] = best[target][1].max(alignment.overlap);
        }
    }
    positives
        .into_iter()
        .map(|(anchor, target)| {
            let metric = find(&rows[target], anchor).map_or(0.0, |alignment| alignment.metric);
            let [best_metric, best_overlap] = best[target];
            Positive {
                anchor,
                target,
                weight: metric * best_overlap / (best_metric + EPSILON),
            }
        })
        .collect()
}

/// How well a candidate anchor predicts a target.
#[derive(Debug, Clone, Copy)]
struct Alignment {
    anchor: usize,
    overlap: f64,
    metric: f64,
}

fn find(row: &[Alignment], anchor: usize) -> Option<&Alignment> {
    row.binary_search_by_key(&anchor, |alignment| alignment.anchor)
        .ok()
        .map(|index| &row[index])
}

/// The candidates of a target in the order of their anchors.
fn align(predictions: Predictions, target: &Target, anchors: &Anchors) -> Vec<Alignment> {
    let count = anchors.len();
    anchors_inside(target.box_letterbox, anchors)
        .map(|anchor| {
            let predicted = predictions.box_letterbox(anchors, anchor);
            let overlap = complete_iou(target.box_letterbox, predicted).max(0.0);
            let score = f64::from(predictions.scores[target.class * count + anchor]);
            let metric = score.sqrt() * overlap.powi(OVERLAP_EXPONENT);
            Alignment {
                anchor,
                overlap,
                metric,
            }
        })
        .collect()
}

/// The anchor points in a box (edges, pixels of the network's input), which is enlarged where it
/// is small.
pub(super) fn anchors_inside(
    [x_min, y_min, x_max, y_max]: [f64; 4],
    anchors: &Anchors,
) -> impl Iterator<Item = usize> {
    let grow_x = (SIDE_FLOOR_PX - (x_max - x_min)).max(0.0) / 2.0;
    let grow_y = (SIDE_FLOOR_PX - (y_max - y_min)).max(0.0) / 2.0;
    (0..anchors.len()).filter(move |&anchor| {
        let stride = f64::from(anchors.strides[anchor]);
        let [x, y] = anchors.points_grid[anchor].map(|v| f64::from(v) * stride);
        [
            x - (x_min - grow_x),
            y - (y_min - grow_y),
            x_max + grow_x - x,
            y_max + grow_y - y,
        ]
        .iter()
        .all(|&edge| edge > EPSILON)
    })
}

/// The candidates among the [`TOP_K`] anchors with the largest metric; anchors that are not
/// candidates have metric zero and ties go to the lowest index.
fn top_anchors(row: &[Alignment], count: usize) -> Vec<usize> {
    let mut order: Vec<&Alignment> = row.iter().filter(|a| a.metric > 0.0).collect();
    order.sort_by(|a, b| b.metric.total_cmp(&a.metric).then(a.anchor.cmp(&b.anchor)));
    let mut kept: Vec<usize> = order.iter().take(TOP_K).map(|a| a.anchor).collect();
    // Places that are left go to the first anchors of metric zero; only candidates stay.
    let mut places = TOP_K - kept.len();
    for anchor in 0..count {
        if places == 0 {
            break;
        }
        let candidate = find(row, anchor);
        if candidate.is_none_or(|a| a.metric <= 0.0 || a.metric.is_nan()) {
            places -= 1;
            if candidate.is_some() {
                kept.push(anchor);
            }
        }
    }
    kept
}

/// Complete IoU of two boxes (edges): overlap, less centre distance and aspect difference.
pub fn complete_iou(a: [f64; 4], b: [f64; 4]) -> f64 {
    const EPS: f64 = 1e-7;
    let (aw, ah) = (a[2] - a[0], a[3] - a[1] + EPS);
    let (bw, bh) = (b[2] - b[0], b[3] - b[1] + EPS);
    let intersection =
        (a[2].min(b[2]) - a[0].max(b[0])).max(0.0) * (a[3].min(b[3]) - a[1].max(b[1])).max(0.0);
    let iou = intersection / (aw * ah + bw * bh - intersection + EPS);
    let enclosing_w = a[2].max(b[2]) - a[0].min(b[0]);
    let enclosing_h = a[3].max(b[3]) - a[1].min(b[1]);
    let diagonal = enclosing_w * enclosing_w + enclosing_h * enclosing_h + EPS;
    let dx = b[0] + b[2] - a[0] - a[2];
    let dy = b[1] + b[3] - a[1] - a[3];
    let center = (dx * dx + dy * dy) / 4.0;
    let angle = (bw / bh).atan() - (aw / ah).atan();
    let v = 4.0 / std::f64::consts::PI.powi(2) * angle * angle;
    let alpha = v / (1.0 - iou + v + EPS);
    iou - center / diagonal - alpha * v
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn complete_iou_of_a_box_with_itself_is_one() {
        let a = [3.0, 4.0, 30.0, 44.0];
        assert!((complete_iou(a, a) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn no_targets_give_no_positives() {
        let anchors = Anchors::new(32, 32);
        let sides = vec![1.0; 4 * anchors.len()];
        let scores = vec![0.5; anchors.len()];
        let predictions = Predictions {
            sides_grid: &sides,
            scores: &scores,
        };
        assert!(assign(predictions, &[], &anchors).is_empty());
    }

    #[test]
    fn the_best_anchor_of_a_target_gets_its_overlap_as_weight() {
        let anchors = Anchors::new(64, 64);
        let sides = vec![1.5; 4 * anchors.len()];
        let scores = vec![0.3; anchors.len()];
        let predictions = Predictions {
            sides_grid: &sides,
            scores: &scores,
        };
        let target = Target {
            class: 0,
            box_letterbox: [8.0, 8.0, 33.0, 31.0],
        };
        let positives = assign(predictions, &[target], &anchors);
        let overlap = |p: &Positive| {
            complete_iou(
                target.box_letterbox,
                predictions.box_letterbox(&anchors, p.anchor),
            )
        };
        let best = positives.iter().map(overlap).fold(0.0, f64::max);
        let largest = positives.iter().map(|p| p.weight).fold(0.0, f64::max);
        assert!((best - largest).abs() < 1e-6);
        assert!(positives.len() <= 10);
    }
}
