"""The loss on the compiled kernels, with all its gradients taken along with it.

Between the layers an observation is a column, (width, B): what the kernels leave behind and take up, in the order that
they have it in. Gradients are written out: autograd's bookkeeping, and the copies that it makes to be safe, keep one
thread busy for as long as a layer takes two.
"""

from __future__ import annotations

from typing import Any, Callable, List, Optional, Tuple

import torch
from torch import nn

from embodied_active_learning.model.cvae import ConditionalVAE, is_within_limits, latent_gaussian, limited
from embodied_active_learning.model.native.convolutions import NativeImages, Pair
from embodied_active_learning.model.objective import Batch, Loss, error_weights, log_std_slopes, pair_loss


class NativeLoss:
    """Stands in for plain_loss, with the same arguments, in single precision."""

    def __init__(self, images: NativeImages) -> None:
        self._images = images

    def __call__(
        self,
        network: ConditionalVAE,
        pair: Batch,
        noise: torch.Tensor,
        beta: float,
        gamma: float,
        settle: Callable[[], None] = lambda: None,
    ) -> Loss:
        """See plain_loss. settle: called before other weights than the image encoder's are read."""
        with torch.no_grad():
            images, size, width = self._images, len(noise), network.feature_size
            encoder, decoder = (_Perceptron(part, images) for part in (network.encoder, network.decoder))
            rows = torch.empty((size, width + network.state_size))
            columns = torch.empty(rows.shape[::-1])
            rows[:, width:], columns[width:] = pair.states[:size], pair.states[:size].t()
            seen = images.look(network, pair.images[:size], rows[:, :width], columns[:width])
            settle()
            latent = _Latent(encoder.run(columns), noise.t())
            sampled = torch.cat((latent.sample, latent.sample), dim=1)
            decoded = decoder.run(torch.cat((sampled, pair.states.t())))
            slopes, log_std = torch.empty_like(decoded), limited(decoded[0])
            weights = error_weights(log_std, gamma)
            turn = decoder.turn_inputs, lambda: encoder.turn_inputs(rows)
            errors = images.reconstruct(network, decoded[1:], pair.images, weights, slopes[1:], turn)
            slopes[0] = log_std_slopes(errors.each, log_std, gamma) * is_within_limits(decoded[0])
            below = decoder.run_back(slopes)
            of_sample = below[:, : network.latent_size].unflatten(0, (2, size)).sum(0).t()
            below = encoder.run_back(latent.slopes(of_sample, beta))
            later = [
                _Later(lambda: pair_loss(errors.each, log_std, latent.gaussian, beta, gamma)),
                _Later(errors.gradients),
                _Later(encoder.bias_gradients),
                _Later(decoder.bias_gradients),
            ]
            back = images.look_back(seen, below[:, :width], [*encoder.pairs, *decoder.pairs], later)
            loss, *others = (one.result for one in later)
            (of_images, *of_biases), sums = zip(*others)
            of_layers = zip(back.products, [bias for biases in of_biases for bias in biases])
            gradients = [*back.gradients, *(part for both in of_layers for part in both), *of_images]
        return loss._replace(gradients=gradients, gradient_sum=back.sum + sum(sums))


class _Later:
    """Something that nobody waits for yet, made when it is called."""

    def __init__(self, make: Callable[[], Any]) -> None:
        self._make = make
        self.result: Any = None

    def __call__(self) -> None:
        self.result = self._make()


class _Latent:
    """An encoder's outputs (2 L, B) as a Gaussian, and a sample (L, B) of it made from standard normal noise."""

    def __init__(self, outputs: torch.Tensor, noise: torch.Tensor) -> None:
        self.gaussian = latent_gaussian(outputs.t())
        self.sample = (self.gaussian.mean + self.gaussian.std * noise.t()).t()
        self._outputs, self._noise = outputs, noise

    def slopes(self, of_sample: torch.Tensor, beta: float) -> torch.Tensor:
        """From d loss / d sample (L, B) that of the outputs (2 L, B), with beta times that of the KL divergence."""
        slopes = torch.empty_like(self._outputs)
        of_mean, of_log_variance = slopes.chunk(2)
        weight = beta / of_sample.shape[1]
        mean, log_variance, std = (part.t() for part in (*self.gaussian, self.gaussian.std))
        of_mean[:] = of_sample + weight * mean
        of_log_variance[:] = 0.5 * (of_sample * self._noise * std + weight * (log_variance.exp() - 1.0))
        of_log_variance *= is_within_limits(self._outputs.chunk(2)[1])
        return slopes


class _Perceptron:
    """Fully connected layers with ReLU between them: there, and back once.

    Nobody waits for the gradients of weights and biases: run_back leaves behind what they are made of.
    """

    def __init__(self, layers: nn.Sequential, images: NativeImages) -> None:
        self._layers = [layer for layer in layers if isinstance(layer, nn.Linear)]
        self._product = images.product
        self._inputs: List[torch.Tensor] = []
        self._rows: List[torch.Tensor] = []
        self._slopes: List[torch.Tensor] = []

    def run(self, inputs: torch.Tensor) -> torch.Tensor:
        """Inputs (I, B) -> outputs (O, B)."""
        for layer in self._layers:
            if self._inputs:
                inputs.relu_()
            self._inputs.append(inputs)
            inputs = self._product(layer.weight, inputs).add_(layer.bias[:, None])
        return inputs

    def turn_inputs(self, first: Optional[torch.Tensor] = None) -> None:
        """What run_back needs of each layer's inputs, (B, I). first: of the first layer, where it is at hand."""
        known = [] if first is None else [first]
        self._rows = known + [inputs.t().contiguous() for inputs in self._inputs[len(known) :]]

    def run_back(self, slopes: torch.Tensor) -> torch.Tensor:
        """Slopes (O, B) at the outputs -> those at the inputs, (B, I)."""
        slopes = slopes.t()
        for layer, rows in zip(self._layers[::-1], self._rows[::-1]):
            self._slopes.insert(0, slopes)
            slopes = self._product(slopes, layer.weight)
            if rows is not self._rows[0]:
                slopes *= rows.sign()  # 0 or 1: no number behind a ReLU is negative
        return slopes

    @property
    def pairs(self) -> List[Pair]:
        """Once it was run back: what the gradient of each layer's weight is the product of."""
        return [(slopes.t(), rows) for slopes, rows in zip(self._slopes, self._rows)]

    def bias_gradients(self) -> Tuple[List[torch.Tensor], torch.Tensor]:
        """Once it was run back: the gradient of each layer's bias, and the sum of all their elements."""
        gradients = [slopes.sum(0) for slopes in self._slopes]
        return gradients, torch.cat(gradients).sum()
