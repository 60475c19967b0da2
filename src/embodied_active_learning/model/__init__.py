"""The paper's model, a conditional variational autoencoder (CVAE), and its online training.

From image to gradient, one update of `learner.Learner.update`:

1. `batches.BatchReader.read` reads two mini-batches from the observation store.
2. `loss_weights.LossWeights` gives beta and gamma.
3. `loss.LossFunction.compute_gradients` runs the forward and backward pass and fills each parameter's .grad:
   `loss.PlainLoss` states the equations and uses autograd (reference, GPU); `native.loss.NativeLoss` computes the
   same on compiled kernels (CPU).
4. `optimiser.Optimiser.step` applies Adam.
5. `replicas.Replicas.refresh` copies the weights for the planner's queries.

`cvae` is the network, `inference` its forward passes without gradients, `metrics` the quality measures, `verdict`
judges a run by them, `learner_state` is what a checkpoint holds, `build` chooses device and implementation,
`trained_model` serves fingerprinting and identification.
"""
