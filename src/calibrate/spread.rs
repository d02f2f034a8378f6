//! Standard errors of a robust fit to features that are not independent of each other.
//!
//! Features of one part of the image share what the model does not know of the lenses, those of one
//! frame share its scene. Both are clusters, and the sums of the scores over clusters say how the
//! solution would scatter (Cameron, Gelbach, Miller: "Robust inference with multiway clustering",
//! 2011). On top of that comes what matching itself does wrong alike in all frames.

use std::collections::BTreeMap;

use super::linear::{Cholesky, Matrix, add_outer, sandwich};

/// Fewest frames that tell how frames differ.
const LEAST_FRAMES: usize = 10;

/// Variances may be smaller than those of independent parts of frames by this factor: chance.
const CHANCE: f64 = 0.8;

/// What a row of a fit has to do with its covariance: its part of the gradient of the logarithmic
/// likelihood, its frame and the part of the image that it lies in.
#[derive(Debug, Clone, Copy)]
pub(super) struct Score<const N: usize> {
    pub score: [f64; N],
    /// The score that matching's own error, alike in one part of the image, would add.
    pub bias: [f64; N],
    pub frame: u32,
    pub cell: usize,
}

/// The covariance of parameters. `bread` is the inverse of the information that they rest on,
/// `prior` the part of the information that no row has brought.
pub(super) fn covariance<const N: usize>(
    scores: &[Score<N>],
    bread: &Matrix<N>,
    prior: &Matrix<N>,
) -> Matrix<N> {
    let own = |score: &Score<N>| score.score;
    let (places, _) = spread(scores, |score| (0, score.cell), own);
    let (parts, _) = spread(scores, |score| (score.frame, score.cell), own);
    let (frames, count) = spread(scores, |score| (score.frame, 0), own);
    let (biases, _) = spread(scores, |score| (0, score.cell), |score| score.bias);
    let of = |spread: &dyn Fn(usize, usize) -> f64| -> Matrix<N> {
        let sum = |i: usize, j: usize| prior[i][j] + biases[i][j] + spread(i, j);
        let with_prior = std::array::from_fn(|i| std::array::from_fn(|j| sum(i, j)));
        sandwich(bread, &with_prior)
    };
    let single = of(&|i, j| parts[i][j]);
    let mut candidates = Vec::new();
    if count >= LEAST_FRAMES {
        candidates.push(of(&|i, j| places[i][j] + frames[i][j] - parts[i][j]));
    }
    candidates.push(of(&|i, j| places[i][j]));
    // Nothing is known better than if every part of every frame were independent.
    let is_possible = |covariance: &Matrix<N>| {
        Cholesky::new(covariance).is_some()
            && (0..N).all(|i| covariance[i][i] >= CHANCE * single[i][i])
    };
    let chosen = candidates.into_iter().find(is_possible);
    chosen.unwrap_or_else(|| of(&|i, j| places[i][j] + parts[i][j]))
}

/// The sum over clusters of the outer products of their scores' sums, and the number of clusters.
fn spread<const N: usize, K: Ord>(
    scores: &[Score<N>],
    key: impl Fn(&Score<N>) -> K,
    part: impl Fn(&Score<N>) -> [f64; N],
) -> (Matrix<N>, usize) {
    let mut sums: BTreeMap<K, [f64; N]> = BTreeMap::new();
    for score in scores {
        let sum = sums.entry(key(score)).or_insert([0.0; N]);
        for (sum, score) in sum.iter_mut().zip(part(score)) {
            *sum += score;
        }
    }
    let count = sums.len();
    // The parameters have followed the clusters by as many as there are of them.
    let free = count.saturating_sub(N).max(1) as f64;
    let mut spread = [[0.0; N]; N];
    for sum in sums.values() {
        add_outer(&mut spread, sum, count as f64 / free);
    }
    (spread, count)
}
