"""Quality of the model: active units, and reconstruction with and without the right latent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import torch

from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.inference import Inference
from embodied_active_learning.model.loss import Batch
from embodied_active_learning.model.verdict import ReconstructionErrors

ACTIVE_VARIANCE = 0.01
"""Variance of a latent's mean above which the unit is active, as usual in the literature (Burda et al., 2016)."""


@dataclass(frozen=True)
class Evaluation:
    """The model on a random subset of the observations. Errors are mean squared errors of pixels in [0, 1].

    mse_own: each image decoded from its own latent; mse_shuffled: from another image's; mse_none: from z = 0.
    """

    update: int
    observations: int
    active_units: int
    mse_own: float
    mse_shuffled: float
    mse_none: float
    log_std_min: float
    log_std_max: float

    @property
    def errors(self) -> ReconstructionErrors:
        """The three errors."""
        return ReconstructionErrors(self.mse_own, self.mse_shuffled, self.mse_none)


def active_units(latent_means: torch.Tensor) -> int:
    """Return the number of latents whose mean has an unbiased variance above ACTIVE_VARIANCE. Paper, Eq. 31.

    latent_means: (B, L).
    """
    return int((latent_means.var(dim=0, unbiased=True) > ACTIVE_VARIANCE).sum())


def reconstruction_error(network: ConditionalVAE, inference: Inference, latents: torch.Tensor, subset: Batch) -> float:
    """Return the mean squared error of the subset's images decoded from latents (N, L) at the subset's states."""
    _, features = network.decode_features(latents, subset.states, inference.linear)
    return float(inference.errors(network, features, subset.images).double().mean())


def reconstruction_errors(
    network: ConditionalVAE, inference: Inference, latents: torch.Tensor, subset: Batch
) -> ReconstructionErrors:
    """Return the errors with the subset's own latents (N, L), with those of its previous image, and with z = 0."""
    alternatives = latents, latents.roll(1, dims=0), torch.zeros_like(latents)
    return ReconstructionErrors(*(reconstruction_error(network, inference, used, subset) for used in alternatives))


def evaluate_model(network: ConditionalVAE, inference: Inference, subset: Batch) -> Tuple[int, ReconstructionErrors]:
    """Return the active units and the reconstruction errors of an Evaluation."""
    features = inference.encode(network, subset.images)
    latents = network.encode_features(subset.states, features, inference.linear).mean
    return active_units(latents), reconstruction_errors(network, inference, latents, subset)
