//! How gradients flow through the kernels, on any backend.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend};

use super::epilogue::Activation;
use super::extension::{ConvGeometry, KernelBackend, activate};
use super::pool::TwinInput;

impl<B: KernelBackend, C: CheckpointStrategy> KernelBackend for Autodiff<B, C> {
    fn conv2d_plain(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        geometry: ConvGeometry,
    ) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct Conv;

        impl<B: KernelBackend> Backward<B, 2> for Conv {
            type State = (FloatTensor<B>, FloatTensor<B>, ConvGeometry);

            fn backward(
                self,
                ops: Ops<Self::State, 2>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let [node_input, node_weight] = ops.parents;
                let grad = grads.consume::<B>(&ops.node);
                let (input, weight, geometry) = ops.state;
                if let Some(node) = node_input {
                    let input_grad =
                        B::conv2d_input_grad(input.clone(), weight.clone(), grad.clone(), geometry);
                    grads.register::<B>(node.id, input_grad);
                }
                if let Some(node) = node_weight {
                    grads.register::<B>(
                        node.id,
                        B::conv2d_weight_grad(input, weight, grad, geometry),
                    );
                }
            }
        }

        match Conv
            .prepare::<C>([input.node(), weight.node()])
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => {
                let (input, weight) = (input.into_primitive(), weight.into_primitive());
                let output = B::conv2d_plain(input.clone(), weight.clone(), geometry);
                prep.finish((input, weight, geometry), output)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::conv2d_plain(
                input.into_primitive(),
                weight.into_primitive(),
                geometry,
            )),
        }
    }

    fn conv2d_bias_act(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        geometry: ConvGeometry,
        activation: Activation,
    ) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct ConvBias;

        impl<B: KernelBackend> Backward<B, 3> for ConvBias {
            type State = (FloatTensor<B>, FloatTensor<B>, ConvGeometry);

            fn backward(
                self,
                ops: Ops<Self::State, 3>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let [node_input, node_weight, node_bias] = ops.parents;
                let grad = grads.consume::<B>(&ops.node);
                let (input, weight, geometry) = ops.state;
                if let Some(node) = node_bias {
                    grads.register::<B>(node.id, B::channel_sum(grad.clone()));
                }
                if let Some(node) = node_input {
                    let input_grad =
                        B::conv2d_input_grad(input.clone(), weight.clone(), grad.clone(), geometry);
                    grads.register::<B>(node.id, input_grad);
                }
                if let Some(node) = node_weight {
                    grads.register::<B>(
                        node.id,
                        B::conv2d_weight_grad(input, weight, grad, geometry),
                    );
                }
            }
        }

        let output = match ConvBias
            .prepare::<C>([input.node(), weight.node(), bias.node()])
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => {
                let (input, weight) = (input.into_primitive(), weight.into_primitive());
                let output = B::conv2d_bias_act(
                    input.clone(),
                    weight.clone(),
                    bias.into_primitive(),
                    geometry,
                    Activation::None,
                );
                prep.finish((input, weight, geometry), output)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::conv2d_bias_act(
                input.into_primitive(),
                weight.into_primitive(),
                bias.into_primitive(),
                geometry,
                Activation::None,
            )),
        };
        activate::<Self>(output, activation)
    }

    fn batch_norm_act(
        input: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        epsilon: f32,
        activation: Activation,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        #[derive(Debug)]
        struct NormAct;

        impl<B: KernelBackend> Backward<B, 3> for NormAct {
            /// Input, gamma, beta, mean, variance.
            type State = ([FloatTensor<B>; 5], f32, Activation);

            fn backward(
                self,
                ops: Ops<Self::State, 3>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let grad = grads.consume::<B>(&ops.node);
                let ([input, gamma, beta, mean, variance], epsilon, activation) = ops.state;
                let (input_grad, gamma_grad, beta_grad) = B::batch_norm_act_grad(
                    input, gamma, beta, mean, variance, grad, epsilon, activation,
                );
                for (node, grad) in ops
                    .parents
                    .into_iter()
                    .zip([input_grad, gamma_grad, beta_grad])
                {
                    if let Some(node) = node {
                        grads.register::<B>(node.id, grad);
                    }
                }
            }
        }

        let prepared = NormAct
            .prepare::<C>([input.node(), gamma.node(), beta.node()])
            .compute_bound()
            .stateful();
        #[allow(
            clippy::redundant_closure_for_method_calls,
            reason = "the method's type is not exported"
        )]
        let [input, gamma, beta] = [input, gamma, beta].map(|tensor| tensor.into_primitive());
        let (output, mean, variance) = B::batch_norm_act(
            input.clone(),
            gamma.clone(),
            beta.clone(),
            epsilon,
            activation,
        );
        let output = match prepared {
            OpsKind::Tracked(prep) => {
                let state = [input, gamma, beta, mean.clone(), variance.clone()];
                prep.finish((state, epsilon, activation), output)
            }
            OpsKind::UnTracked(prep) => prep.finish(output),
        };
        (
            output,
            <Self as AutodiffBackend>::from_inner(mean),
            <Self as AutodiffBackend>::from_inner(variance),
        )
    }

    fn double(input: FloatTensor<Self>) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct Double;

        impl<B: KernelBackend> Backward<B, 1> for Double {
            type State = ();

            fn backward(
                self,
                ops: Ops<Self::State, 1>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let grad = grads.consume::<B>(&ops.node);
                if let [Some(node)] = ops.parents {
                    grads.register::<B>(node.id, B::double_grad(grad));
                }
            }
        }

        match Double
            .prepare::<C>([input.node()])
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => prep.finish((), B::double(input.into_primitive())),
            OpsKind::UnTracked(prep) => prep.finish(B::double(input.into_primitive())),
        }
    }

    fn twin_pool(input: FloatTensor<Self>, kind: TwinInput) -> FloatTensor<Self> {
        #[derive(Debug)]
        struct TwinPool;

        impl<B: KernelBackend> Backward<B, 1> for TwinPool {
            type State = (FloatTensor<B>, TwinInput);

            fn backward(
                self,
                ops: Ops<Self::State, 1>,
                grads: &mut Gradients,
                _: &mut Checkpointer,
            ) {
                let grad = grads.consume::<B>(&ops.node);
                let (input, kind) = ops.state;
                if let [Some(node)] = ops.parents {
                    grads.register::<B>(node.id, B::twin_pool_grad(input, grad, kind));
                }
            }
        }

        match TwinPool
            .prepare::<C>([input.node()])
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => {
                let input = input.into_primitive();
                prep.finish((input.clone(), kind), B::twin_pool(input, kind))
            }
            OpsKind::UnTracked(prep) => prep.finish(B::twin_pool(input.into_primitive(), kind)),
        }
    }
}
