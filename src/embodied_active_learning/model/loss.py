"""The training objective (Paper, Eq. 30) and its reference implementation, which autograd differentiates."""

from __future__ import annotations

import math
from typing import Callable, NamedTuple, Protocol, Sequence

import torch

from embodied_active_learning.model.cvae import ConditionalVAE, LatentGaussian, float_images

HALF_LOG_TWO_PI = 0.5 * math.log(2.0 * math.pi)

Images = Sequence[torch.Tensor]
"""B images (H, W, 3) uint8: one tensor (B, H, W, 3), or a list of images wherever they are stored."""


class Batch(NamedTuple):
    """Observations: states (B, D), normalised float32, and B images."""

    states: torch.Tensor
    images: Images


class LossTerms(NamedTuple):
    """The loss, its unweighted terms (scalars), the latent means (B, L), and the sum of all elements of the gradient.

    The sum is finite only if the whole gradient is.
    """

    total: torch.Tensor
    reconstruction: torch.Tensor
    conditional_reconstruction: torch.Tensor
    kl: torch.Tensor
    latent_means: torch.Tensor
    gradient_sum: torch.Tensor


class LossFunction(Protocol):
    """Computes the loss of Paper, Eq. 30, and its gradient.

    Attributes:
        description: The implementation, for the log.
        torch_threads: Threads that torch should use besides it; idle ones would spin on cores that others need.
    """

    description: str
    torch_threads: int

    def compute_gradients(
        self,
        network: ConditionalVAE,
        pair: Batch,
        noise: torch.Tensor,
        beta: float,
        gamma: float,
        join: Callable[[], None],
    ) -> LossTerms:
        """Compute the loss of a pair of batches and store its gradient in each parameter's .grad.

        Args:
            pair: 2 B observations. The first B are (x, y), encoded and reconstructed; the last B are (x^, y^), paired
                with the first by position.
            noise: (B, L) standard normal, for sampling the latents.
            beta: Weight of the KL divergence.
            gamma: Weight of the conditional reconstruction.
            join: Waits for the optimiser's last step; called before any weight but the image encoder's is read.
        """
        ...


def negative_log_likelihood(images: torch.Tensor, means: torch.Tensor, log_std: torch.Tensor) -> torch.Tensor:
    """Return -log N(y; mean, std^2) averaged over batch, channels and pixels: a scalar. Paper, Eq. 30, first term.

    Mean of (y - mean)^2 / (2 std^2) + log std + log(2 pi) / 2. images, means: (B, 3, H, W) in [0, 1]; log_std: (B,).
    """
    squared_error = (images - means).square().mean(dim=(1, 2, 3))
    return (0.5 * squared_error * torch.exp(-2.0 * log_std) + log_std).mean() + HALF_LOG_TWO_PI


def kl_divergence(latent: LatentGaussian) -> torch.Tensor:
    """Return KL(q(z | x, y) || N(0, I)), summed over latents, averaged over the batch: a scalar. Paper, Eq. 30.

    -1/2 sum_l (1 + log_variance_l - mean_l^2 - variance_l).
    """
    terms = 1.0 + latent.log_variance - latent.mean.square() - latent.log_variance.exp()
    return -0.5 * terms.sum(dim=1).mean()


def total_loss(
    reconstruction: torch.Tensor, conditional: torch.Tensor, kl: torch.Tensor, beta: float, gamma: float
) -> torch.Tensor:
    """Return -L of Paper, Eq. 30, which is minimised: reconstruction + beta KL + gamma conditional reconstruction."""
    return reconstruction + beta * kl + gamma * conditional


class PlainLoss:
    """The loss as the equations state it, differentiated by autograd: the reference, and the choice on a GPU."""

    def __init__(self, description: str) -> None:
        self.description = description
        self.torch_threads = torch.get_num_threads()

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
        join()
        network.zero_grad(set_to_none=True)
        terms = plain_loss(network, pair, noise, beta, gamma)
        terms.total.backward()
        gradients = [parameter.grad.sum() for parameter in network.parameters() if parameter.grad is not None]
        detached = LossTerms(*map(torch.Tensor.detach, terms))
        return detached._replace(gradient_sum=torch.stack(gradients).sum())


def plain_loss(network: ConditionalVAE, pair: Batch, noise: torch.Tensor, beta: float, gamma: float) -> LossTerms:
    """Return the loss of a pair of batches (see LossFunction), without gradients.

    Both reconstructions decode the same z_i ~ q(z | x_i, y_i): the first at x_i, compared with y_i, the conditional one
    at the other batch's state x^_i, compared with y^_i.
    """
    size = len(noise)
    images = pair.images if isinstance(pair.images, torch.Tensor) else torch.stack(list(pair.images))
    latent = network.encode(pair.states[:size], images[:size])
    sample = latent.mean + latent.std * noise
    reconstruction, conditional = (
        _reconstruction(network, sample, pair.states[half], images[half])
        for half in (slice(None, size), slice(size, None))
    )
    kl = kl_divergence(latent)
    total = total_loss(reconstruction, conditional, kl, beta, gamma)
    return LossTerms(total, reconstruction, conditional, kl, latent.mean, torch.zeros(()))


def _reconstruction(
    network: ConditionalVAE, latents: torch.Tensor, states: torch.Tensor, images: torch.Tensor
) -> torch.Tensor:
    means, log_std = network.decode(latents, states)
    return negative_log_likelihood(float_images(images, means.dtype), means, log_std)
