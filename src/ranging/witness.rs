//! A learnt witness of one vehicle's size, for the posterior over its distance.

/// What a learnt head says of one vehicle's size and extent along the line of sight.
///
/// Both are Gaussian statements with an honest spread: where the head was not trained for what it
/// sees, the spreads are wide.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SizeWitness {
    /// Mean of the natural logarithm of the box's metric size at the depth of the vehicle's centre:
    /// `ln(z * sqrt(w_px * h_px) / focal_px)`, `z` in metres, the left box's sides in pixels.
    pub log_size_mean: f64,
    /// Standard deviation of that logarithm.
    pub log_size_std: f64,
    /// Mean of how far the centre lies behind the surface that stereo measures, along z, metres:
    /// centre depth `z` less `f * B / d`, with `d` the disparity that matching the visible pixels
    /// would give.
    pub extent_mean_m: f64,
    /// Standard deviation of that way, metres.
    pub extent_std_m: f64,
    /// How little the head was trained for what it sees: 0 for pictures and vehicles like the trained
    /// ones, 1 for others, of which it knows nothing. The standard deviations are widened by it.
    pub unknown: f64,
}

impl SizeWitness {
    /// Whether the head knows more of this vehicle than what vehicles are like in general: one that
    /// does not is to be left out for that.
    pub fn is_known(&self) -> bool {
        self.unknown < 0.5
    }
}
