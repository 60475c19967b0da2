"""The loss on the compiled kernels, with all its gradients taken along with it.

Between the layers an observation is a column, (width, B): what the kernels leave behind and take up, in the order that
they have it in. Autograd is left the few numbers between encoder and decoder; its bookkeeping, and the copies that it
makes to be safe, cost as much as a layer.
"""

from __future__ import annotations

from typing import Any, List, Optional, Tuple

import torch
from torch import nn
from torch.autograd.function import once_differentiable

from embodied_active_learning.model.cvae import ConditionalVAE, latent_gaussian, limited
from embodied_active_learning.model.native import NativeImages
from embodied_active_learning.model.objective import Batch, Loss, error_weights, pair_loss


class NativeLoss:
    """Stands in for plain_loss, with the same arguments, in single precision."""

    def __init__(self, images: NativeImages) -> None:
        self._images = images

    def __call__(self, network: ConditionalVAE, pair: Batch, noise: torch.Tensor, beta: float, gamma: float) -> Loss:
        """See plain_loss."""
        with torch.no_grad():
            loss, gradients = self._differentiate(network, pair, noise, beta, gamma)
        total = _Differentiated.apply(loss.total, gradients, *network.parameters())
        return loss._replace(total=total)

    def _differentiate(
        self, network: ConditionalVAE, pair: Batch, noise: torch.Tensor, beta: float, gamma: float
    ) -> Tuple[Loss, List[torch.Tensor]]:
        """The loss, and its gradients in the order of the network's parameters."""
        images, size, width = self._images, len(noise), network.feature_size
        encoder, decoder = (_Perceptron(part, images) for part in (network.encoder, network.decoder))
        rows = torch.empty((size, width + network.state_size))
        columns = torch.empty(rows.shape[::-1])
        rows[:, width:], columns[width:] = pair.states[:size], pair.states[:size].t()
        seen = images.look(network, pair.images[:size], rows[:, :width], columns[:width])
        encoded = encoder.run(columns).requires_grad_()
        with torch.enable_grad():
            latent = latent_gaussian(encoded.t())
            sample = latent.mean + latent.std * noise
        sampled = sample.detach().t()
        decoded = decoder.run(torch.cat((torch.cat((sampled, sampled), dim=1), pair.states.t())))
        raw_log_std, slopes = decoded[0].clone().requires_grad_(), torch.empty_like(decoded)
        with torch.enable_grad():
            log_std = limited(raw_log_std)
        weights = error_weights(log_std.detach(), gamma)
        errors = images.reconstruct(network, decoded[1:], pair.images, weights, slopes[1:])
        with torch.enable_grad():
            loss = pair_loss(errors.each, log_std, latent, beta, gamma)
        (slopes[0],) = torch.autograd.grad(loss.total, raw_log_std, retain_graph=True)
        below, of_decoder = decoder.run_back(slopes)
        of_sample = below[:, : network.latent_size].unflatten(0, (2, size)).sum(0)
        (slopes,) = torch.autograd.grad((loss.total, sample), encoded, (None, of_sample))
        below, of_encoder = encoder.run_back(slopes, rows)
        of_image_encoder = images.look_back(seen, below[:, :width])
        loss = Loss(*(term.detach() for term in loss))
        return loss, [*of_image_encoder, *of_encoder, *of_decoder, *errors.gradients]


class _Perceptron:
    """Fully connected layers with ReLU between them: there, and back once."""

    def __init__(self, layers: nn.Sequential, images: NativeImages) -> None:
        self._layers = [layer for layer in layers if isinstance(layer, nn.Linear)]
        self._multiply = images.multiply
        self._inputs: List[torch.Tensor] = []

    def run(self, inputs: torch.Tensor) -> torch.Tensor:
        """Inputs (I, B) -> outputs (O, B)."""
        for layer in self._layers:
            if self._inputs:
                inputs.relu_()
            self._inputs.append(inputs)
            inputs = self._multiply(layer.weight, inputs).add_(layer.bias[:, None])
        return inputs

    def run_back(
        self, slopes: torch.Tensor, first_rows: Optional[torch.Tensor] = None
    ) -> Tuple[torch.Tensor, List[torch.Tensor]]:
        """Slopes (O, B) at the outputs -> those at the inputs, (B, I), and gradients of weights and biases, in order.

        first_rows: the inputs once more, (B, I), where they are at hand.
        """
        slopes, gradients = slopes.t(), []
        for index, layer in reversed(list(enumerate(self._layers))):
            given = first_rows if index == 0 else None
            rows = self._inputs[index].t().contiguous() if given is None else given
            gradients = [self._multiply(slopes.t(), rows), slopes.sum(0), *gradients]
            slopes = self._multiply(slopes, layer.weight)
            if index:
                slopes.masked_fill_(rows <= 0.0, 0.0)
        return slopes, gradients


class _Differentiated(torch.autograd.Function):
    """A loss whose gradients are known: hands them to the parameters when they are asked for."""

    @staticmethod
    def forward(
        ctx: Any, loss: torch.Tensor, gradients: List[torch.Tensor], *_parameters: torch.Tensor
    ) -> torch.Tensor:
        ctx.gradients = gradients
        return loss.clone()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: torch.Tensor) -> Tuple[Optional[torch.Tensor], ...]:
        # Handed over rather than shared, or each parameter would take a copy.
        gradients, ctx.gradients = ctx.gradients, None
        if gradients is None:
            raise RuntimeError("gradients of the compiled loss can be taken once: they are given away")
        if float(upstream) != 1.0:
            gradients = [upstream * gradient for gradient in gradients]
        return (None, None, *gradients)
