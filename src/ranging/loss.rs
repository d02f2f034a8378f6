//! The paper's loss: the larger of squared error and squared relative error.

use burn::tensor::Tensor;

/// The loss of one batch, all `[1]`.
#[derive(Debug, Clone)]
pub struct RangingLoss {
    /// `max(MSE, MSRE)`; only the larger one has gradient.
    pub total: Tensor<1>,
    /// Mean squared error, square metres.
    pub mse: Tensor<1>,
    /// Mean squared relative error, square percent.
    pub msre: Tensor<1>,
}

/// `L = max(MSE, MSRE)`, `MSRE = mean(((p - t) / t * 100)^2)` (paper, equations 3 to 5).
///
/// # Shapes
/// - `predicted_m`, `target_m`: `[batch, 1]`, metres
pub fn ranging_loss(predicted_m: Tensor<2>, target_m: Tensor<2>) -> RangingLoss {
    let error = predicted_m - target_m.clone();
    let mse = error.clone().square().mean();
    let msre = (error / target_m).mul_scalar(100.0).square().mean();
    RangingLoss {
        total: mse.clone().max_pair(msre.clone()),
        mse,
        msre,
    }
}
