"""The loss that the network is trained on, written plainly: the reference for every faster way to compute it."""

from __future__ import annotations

import math
from typing import Callable, NamedTuple, Optional, Sequence

import torch
from torch import nn

from embodied_active_learning.model.cvae import ConditionalVAE, LatentGaussian, float_images

HALF_LOG_TWO_PI = 0.5 * math.log(2.0 * math.pi)


Images = Sequence[torch.Tensor]
"""B images (H, W, 3) uint8: one tensor (B, H, W, 3), or each where it is stored."""


class Batch(NamedTuple):
    """A mini-batch of observations: states (B, D) normalised float, and images.

    The images are one tensor (B, H, W, 3), unless they were asked for in place.
    """

    states: torch.Tensor
    images: Images


class Loss(NamedTuple):
    """The loss, its terms (scalars, before weighting) and the latent means (B, L) they were computed with.

    gradients: of the loss by each of the network's parameters, contiguous, and the sum of all their elements, where
    they were taken along with it; otherwise autograd takes them.
    """

    total: torch.Tensor
    reconstruction: torch.Tensor
    conditional_reconstruction: torch.Tensor
    kl: torch.Tensor
    latent_means: torch.Tensor
    gradients: Optional[Sequence[torch.Tensor]] = None
    gradient_sum: Optional[torch.Tensor] = None

    def hand_over_gradients(self, network: nn.Module) -> None:
        """Give each parameter its gradient, in place of the one that it had."""
        if self.gradients is None:
            # Which leaves each gradient in its parameter's order in memory, as the optimiser takes for granted.
            network.zero_grad(set_to_none=True)
            self.total.backward()
        else:
            for parameter, gradient in zip(network.parameters(), self.gradients):
                parameter.grad = gradient


class Arithmetic(NamedTuple):
    """A way to compute the loss, what it runs on and why, and the threads that torch itself should have beside it.

    torch's threads spin for a while after their work, on cores that others need: 1 where others do the work.
    in_place: whether it takes the images of a batch where they are stored, without a copy of all, and `settle`, to be
    called when it needs other weights than the image encoder's.
    """

    loss: Callable[..., Loss]
    description: str
    torch_threads: int
    in_place: bool = False


def negative_log_likelihood(images: torch.Tensor, means: torch.Tensor, log_std: torch.Tensor) -> torch.Tensor:
    """-log N(y; mean, std^2) averaged over batch, channels and pixels: a scalar.

    mean of (y - mean)^2 / (2 std^2) + log std + log(2 pi) / 2. images, means: (B, 3, H, W), log_std: (B,).
    """
    squared_error = (images - means).square().mean(dim=(1, 2, 3))
    return (0.5 * squared_error * torch.exp(-2.0 * log_std) + log_std).mean() + HALF_LOG_TWO_PI


def kl_divergence(latent: LatentGaussian) -> torch.Tensor:
    """KL(q(z | x, y) || N(0, I)), summed over latents, averaged over the batch: a scalar.

    -1/2 sum_l (1 + log_variance_l - mean_l^2 - variance_l).
    """
    terms = 1.0 + latent.log_variance - latent.mean.square() - latent.log_variance.exp()
    return -0.5 * terms.sum(dim=1).mean()


def weigh(
    reconstruction: torch.Tensor, conditional: torch.Tensor, latent: LatentGaussian, beta: float, gamma: float
) -> Loss:
    """L = RC + beta KL + gamma RC_cond, to be minimised (paper, Sec. 4, loss formulation, with its sign turned)."""
    kl = kl_divergence(latent)
    total = reconstruction + beta * kl + gamma * conditional
    return Loss(total, reconstruction, conditional, kl, latent.mean)


def error_weights(log_std: torch.Tensor, gamma: float) -> torch.Tensor:
    """Weights (2 B,) in the loss of the mean squared errors of a pair's images, first half and second.

    log_std: (2 B,). Averaged over a half, an error counts 1 / (2 std^2), and in the second half gamma times that.
    """
    weights = 0.5 * torch.exp(-2.0 * log_std) / (len(log_std) // 2)
    weights[len(weights) // 2 :] *= gamma
    return weights


def log_std_slopes(errors: torch.Tensor, log_std: torch.Tensor, gamma: float) -> torch.Tensor:
    """Gradient (2 B,) of pair_loss by log_std: (1 - error / std^2) / B, and in the second half gamma times that."""
    slopes = (1.0 - errors * torch.exp(-2.0 * log_std)) / (len(log_std) // 2)
    slopes[len(slopes) // 2 :] *= gamma
    return slopes


def pair_loss(errors: torch.Tensor, log_std: torch.Tensor, latent: LatentGaussian, beta: float, gamma: float) -> Loss:
    """The loss of a pair from the mean squared errors (2 B,) and log std (2 B,) of its decoded images."""
    terms = 0.5 * errors * torch.exp(-2.0 * log_std) + log_std
    halves = terms.unflatten(0, (2, len(terms) // 2)).mean(dim=1) + HALF_LOG_TWO_PI
    return weigh(halves[0], halves[1], latent, beta, gamma)


def plain_loss(network: ConditionalVAE, pair: Batch, noise: torch.Tensor, beta: float, gamma: float) -> Loss:
    """The loss of a batch (first B rows of the pair) and a second, independent one (last B rows), paired by position.

    noise: (B, L) standard normal. The conditional term decodes the same z_i, encoded from (x_i, y_i), at the other
    batch's state and compares it with the other batch's image: what the decoder should say where it cannot know
    (paper, Sec. 4, loss formulation, hatted quantities).
    """
    size = len(noise)
    latent = network.encode(pair.states[:size], pair.images[:size])
    sample = latent.mean + latent.std * noise
    terms = []
    for half in (slice(None, size), slice(size, None)):
        means, log_std = network.decode(sample, pair.states[half])
        terms.append(negative_log_likelihood(float_images(pair.images[half], means.dtype), means, log_std))
    return weigh(terms[0], terms[1], latent, beta, gamma)
