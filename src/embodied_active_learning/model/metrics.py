"""What the training is judged by: active units, and reconstruction with and without the right latent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict

import torch

from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.inference import InferenceImages
from embodied_active_learning.model.objective import Batch


@dataclass(frozen=True)
class Evaluation:
    """The model on a fixed subset of the observations. Errors are mean squared errors of pixels in [0, 1].

    mse_own: each image from its own latent; mse_shuffled: from another's; mse_none: from the prior's mean, z = 0.
    """

    update: int
    observations: int
    active_units: int
    mse_own: float
    mse_shuffled: float
    mse_none: float
    log_std_min: float
    log_std_max: float


def active_units(latent_means: torch.Tensor, threshold: float) -> int:
    """Number of latents whose mean varies by more than the threshold (paper, Sec. 4, active units).

    What varies is the unbiased variance over the batch. latent_means: (B, L).
    """
    return int((latent_means.var(dim=0, unbiased=True) > threshold).sum())


def reconstruction_error(
    network: ConditionalVAE, images: InferenceImages, latents: torch.Tensor, subset: Batch
) -> float:
    """Mean squared error of the subset's images decoded from latents (N, L) at the subset's states."""
    _, features = network.decode_features(latents, subset.states, images.linear)
    return float(images.errors(network, features, subset.images).double().mean())


def evaluate_model(
    network: ConditionalVAE, images: InferenceImages, subset: Batch, threshold: float
) -> Dict[str, float]:
    """Active units and the three reconstruction errors of an Evaluation, by its field names."""
    features = images.features(network, subset.images)
    latents = network.encode_features(subset.states, features, images.linear).mean
    return {
        "active_units": active_units(latents, threshold),
        "mse_own": reconstruction_error(network, images, latents, subset),
        "mse_shuffled": reconstruction_error(network, images, latents.roll(1, dims=0), subset),
        "mse_none": reconstruction_error(network, images, torch.zeros_like(latents), subset),
    }
