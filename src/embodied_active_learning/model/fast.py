"""The loss of objective.plain_loss, computed faster on CPUs: same value, same gradients."""

from __future__ import annotations

import torch

from embodied_active_learning.model.block_images import BlockImages
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.native.convolutions import NativeImages
from embodied_active_learning.model.native.kernels import Kernels
from embodied_active_learning.model.native.library import load_library
from embodied_active_learning.model.native.loss import NativeLoss
from embodied_active_learning.model.objective import HALF_LOG_TWO_PI, Arithmetic, Batch, Loss, kl_divergence


class FastLoss:
    """Stands in for plain_loss, with the same arguments.

    What touches pixels is left to `images`: the features of images, and the errors of decoded ones with their
    gradients taken at once, so that no reconstruction of the whole batch is ever in memory.
    """

    def __init__(self, images: BlockImages) -> None:
        self._images = images

    def __call__(self, network: ConditionalVAE, pair: Batch, noise: torch.Tensor, beta: float, gamma: float) -> Loss:
        """See plain_loss. Both halves of the pair are decoded as one batch."""
        size = len(noise)
        features = self._images.features(network, pair.images[:size])
        latent = network.encode_features(pair.states[:size], features, self._images.linear)
        sample = latent.mean + latent.std * noise
        log_std, features = network.decode_features(torch.cat((sample, sample)), pair.states, self._images.linear)
        half_precision = 0.5 * torch.exp(-2.0 * log_std)
        weights = torch.cat((log_std.new_full((size,), 1.0 / size), log_std.new_full((size,), gamma / size)))
        total, errors = self._images.weighted_errors(network, features, pair.images, weights * half_precision)
        kl = kl_divergence(latent)
        total = total + (weights * log_std).sum() + (1.0 + gamma) * HALF_LOG_TWO_PI + beta * kl
        terms = (errors * half_precision + log_std).detach() + HALF_LOG_TWO_PI
        return Loss(total, terms[:size].mean(), terms[size:].mean(), kl, latent.mean)


def fastest_loss(network: ConditionalVAE) -> Arithmetic:
    """The fastest way to compute the loss on this machine's CPU, with as many threads as torch has now."""
    threads = torch.get_num_threads()
    library, reason = load_library()
    if library is None:
        return Arithmetic(FastLoss(BlockImages(network)), f"torch alone, {threads} threads: {reason}", 1)
    images = NativeImages(network, Kernels(library))
    return Arithmetic(NativeLoss(images), f"{reason}, {threads} threads", 1, in_place=True)
