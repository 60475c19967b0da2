"""The loss of Paper, Eq. 30, on the compiled kernels, with its gradient written out.

Between the layers, activations are columns (width, B): the order in which the kernels read and write them. Autograd is
not used because its bookkeeping and its copies keep one thread busy for as long as a layer takes two.

Order of computation: encoder_forward (images -> features), _Perceptron.forward (features -> latents), sampling,
_Perceptron.forward (latents -> decoder features and log std), reconstruct (decode, compare, and return), then the
backward passes in reverse order. Gradients of weights are products that are computed last, to fill idle threads.
"""

from __future__ import annotations

from typing import Any, Callable, List, Optional, Tuple

import torch
from torch import nn

from embodied_active_learning.model.cvae import ConditionalVAE, clamp_mask, clamped, latent_gaussian
from embodied_active_learning.model.loss import (
    HALF_LOG_TWO_PI,
    Batch,
    LossTerms,
    kl_divergence,
    total_loss,
)
from embodied_active_learning.model.native.bindings import Kernels
from embodied_active_learning.model.native.convolutions import FactorPair, NativeConvolutions


class NativeLoss:
    """Replaces PlainLoss on the CPU: same value and gradient, in single precision."""

    def __init__(self, network: ConditionalVAE, kernels: Kernels, description: str) -> None:
        self.convolutions = NativeConvolutions(network, kernels)
        self.description = f"{description}, {self.convolutions.threads} threads"
        self.torch_threads = 1

    @torch.no_grad()
    def compute_gradients(
        self,
        network: ConditionalVAE,
        pair: Batch,
        noise: torch.Tensor,
        beta: float,
        gamma: float,
        join: Callable[[], None] = lambda: None,
    ) -> LossTerms:
        """See LossFunction."""
        # Forward: images and states of the first half -> latents -> both halves decoded.
        convolutions, size, width = self.convolutions, len(noise), network.feature_size
        encoder, decoder = (_Perceptron(part, convolutions) for part in (network.encoder, network.decoder))
        rows = torch.empty((size, width + network.state_size))
        columns = torch.empty(rows.shape[::-1])
        rows[:, width:], columns[width:] = pair.states[:size], pair.states[:size].t()
        saved = convolutions.encoder_forward(network, pair.images[:size], rows[:, :width], columns[:width])
        join()
        latent = _Latent(encoder.forward(columns), noise.t())
        samples = torch.cat((latent.sample, latent.sample), dim=1)
        decoded = decoder.forward(torch.cat((samples, pair.states.t())))
        # Loss at the decoder's outputs (row 0: log std, the others: image features), and its gradient there.
        gradient, log_std = torch.empty_like(decoded), clamped(decoded[0])
        weights = _error_weights(log_std, gamma)
        transposes = decoder.transpose_inputs, lambda: encoder.transpose_inputs(rows)
        images = convolutions.reconstruct(network, decoded[1:], pair.images, weights, gradient[1:], transposes)
        gradient[0] = _log_std_gradient(images.errors, log_std, gamma) * clamp_mask(decoded[0])
        # Backward: decoder -> latents, where both halves' gradients add up -> encoder.
        at_decoder_inputs = decoder.backward(gradient)
        at_samples = at_decoder_inputs[:, : network.latent_size].unflatten(0, (2, size)).sum(0).t()
        at_encoder_inputs = encoder.backward(latent.backward(at_samples, beta))
        # Gradients of weights and biases, in the order of network.parameters(). Those that can wait are computed
        # beside the image encoder's.
        deferred = _Deferred(images.gradients), _Deferred(encoder.bias_gradients), _Deferred(decoder.bias_gradients)
        factors = [*encoder.weight_gradient_factors, *decoder.weight_gradient_factors]
        image_encoder = convolutions.encoder_backward(saved, at_encoder_inputs[:, :width], factors, deferred)
        (image_decoder, *biases), sums = zip(*(job.result for job in deferred))
        linear = zip(image_encoder.products, [bias for part in biases for bias in part])
        gradients = [*image_encoder.gradients, *(part for layer in linear for part in layer), *image_decoder]
        for parameter, part in zip(network.parameters(), gradients):
            parameter.grad = part
        halves = _reconstruction_terms(images.errors, log_std)
        kl = kl_divergence(latent.gaussian)
        total = total_loss(halves[0], halves[1], kl, beta, gamma)
        return LossTerms(total, halves[0], halves[1], kl, latent.gaussian.mean, image_encoder.sum + sum(sums))


def _reconstruction_terms(errors: torch.Tensor, log_std: torch.Tensor) -> torch.Tensor:
    """Negative log likelihoods (2,) of both halves from the mean squared errors (2 B,) and log std (2 B,)."""
    terms = 0.5 * errors * torch.exp(-2.0 * log_std) + log_std
    return terms.unflatten(0, (2, len(terms) // 2)).mean(dim=1) + HALF_LOG_TWO_PI


def _error_weights(log_std: torch.Tensor, gamma: float) -> torch.Tensor:
    """D loss / d mean squared error (2 B,): 1 / (2 std^2 B), in the second half times gamma."""
    weights = 0.5 * torch.exp(-2.0 * log_std) / (len(log_std) // 2)
    weights[len(weights) // 2 :] *= gamma
    return weights


def _log_std_gradient(errors: torch.Tensor, log_std: torch.Tensor, gamma: float) -> torch.Tensor:
    """D loss / d log std (2 B,): (1 - error / std^2) / B, in the second half times gamma."""
    gradient = (1.0 - errors * torch.exp(-2.0 * log_std)) / (len(log_std) // 2)
    gradient[len(gradient) // 2 :] *= gamma
    return gradient


class _Deferred:
    """A computation whose result is needed later, run as a job."""

    def __init__(self, compute: Callable[[], Any]) -> None:
        self._compute = compute
        self.result: Any = None

    def __call__(self) -> None:
        self.result = self._compute()


class _Latent:
    """The encoder's outputs (2 L, B) as a Gaussian, and a sample (L, B) of it made from standard normal noise."""

    def __init__(self, outputs: torch.Tensor, noise: torch.Tensor) -> None:
        self.gaussian = latent_gaussian(outputs.t())
        self.sample = (self.gaussian.mean + self.gaussian.std * noise.t()).t()
        self._outputs, self._noise = outputs, noise

    def backward(self, at_sample: torch.Tensor, beta: float) -> torch.Tensor:
        """Return the gradient (2 L, B) at the outputs from that at the sample (L, B) and beta times the KL's."""
        gradient = torch.empty_like(self._outputs)
        at_mean, at_log_variance = gradient.chunk(2)
        weight = beta / at_sample.shape[1]
        mean, log_variance, std = (part.t() for part in (*self.gaussian, self.gaussian.std))
        at_mean[:] = at_sample + weight * mean
        at_log_variance[:] = 0.5 * (at_sample * self._noise * std + weight * (log_variance.exp() - 1.0))
        at_log_variance *= clamp_mask(self._outputs.chunk(2)[1])
        return gradient


class _Perceptron:
    """Linear layers with ReLU in between, for one forward and one backward pass.

    The backward pass computes the gradients at the inputs only and keeps the factors of the weights' gradients.
    """

    def __init__(self, layers: nn.Sequential, convolutions: NativeConvolutions) -> None:
        self._layers = [layer for layer in layers if isinstance(layer, nn.Linear)]
        self._matmul = convolutions.matmul
        self._inputs: List[torch.Tensor] = []
        self._input_rows: List[torch.Tensor] = []
        self._gradients: List[torch.Tensor] = []

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Inputs (I, B) -> outputs (O, B)."""
        for layer in self._layers:
            if self._inputs:
                inputs.relu_()
            self._inputs.append(inputs)
            inputs = self._matmul(layer.weight, inputs).add_(layer.bias[:, None])
        return inputs

    def transpose_inputs(self, first: Optional[torch.Tensor] = None) -> None:
        """Save each layer's inputs as rows (B, I) for the backward pass; first: the first layer's, if available."""
        known = [] if first is None else [first]
        self._input_rows = known + [inputs.t().contiguous() for inputs in self._inputs[len(known) :]]

    def backward(self, gradient: torch.Tensor) -> torch.Tensor:
        """Gradient (O, B) at the outputs -> gradient (B, I) at the inputs."""
        gradient = gradient.t()
        for layer, rows in zip(self._layers[::-1], self._input_rows[::-1]):
            self._gradients.insert(0, gradient)
            gradient = self._matmul(gradient, layer.weight)
            if rows is not self._input_rows[0]:
                gradient *= rows.sign()  # the mask of the ReLU, whose outputs are not negative
        return gradient

    @property
    def weight_gradient_factors(self) -> List[FactorPair]:
        """Matrices whose product is the gradient of each layer's weight; available after backward."""
        return [(gradient.t(), rows) for gradient, rows in zip(self._gradients, self._input_rows)]

    def bias_gradients(self) -> Tuple[List[torch.Tensor], torch.Tensor]:
        """Return the gradient of each layer's bias, and the sum of all their elements; available after backward."""
        gradients = [gradient.sum(0) for gradient in self._gradients]
        return gradients, torch.cat(gradients).sum()
