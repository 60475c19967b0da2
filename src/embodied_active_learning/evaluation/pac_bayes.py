"""The terms of the paper's PAC-Bayes bound for CVAEs (Sec. 3), for a trained model.

Lipschitz constants are estimated by the largest spectral norm of the Jacobian at the given observations, which is at
most the true constant. So the bound computed here is a lower estimate: if it is vacuous, the true bound is, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Tuple

import numpy as np
import torch

from embodied_active_learning.evaluation.ergodicity import Views
from embodied_active_learning.model.cvae import ConditionalVAE, float_images
from embodied_active_learning.workspace import Workspace

CONFIDENCE = 0.05
"""delta: the bound holds with probability 1 - delta."""
_POWER_ITERATIONS = 10
_PART = 32
Function = Callable[[torch.Tensor], torch.Tensor]


@dataclass(frozen=True)
class BoundTerms:
    """The measured risk and the terms of the bound, in the unit of the loss ||y - g(z, x)|| with pixels in [0, 1].

    Attributes:
        risk: Mean loss on other observations than the bound's.
        empirical: Mean loss on the bound's observations.
        kl: Sum of KL divergences between posterior and prior, divided by lambda.
        confidence: log(1 / delta) / lambda.
        continuity: K_phi K_theta (mean distance of states + mean distance of images).
        condition: K_theta times the mean distance of states, which conditioning adds, as it adds the mean distance of
            states in `continuity`.
        moment: Logarithm of the exponential moment under the prior, times n / lambda.
        encoder_lipschitz: Lower estimate of K_phi.
        decoder_lipschitz: Lower estimate of K_theta.
        trivial: Mean loss of the mean image, which uses neither state nor latent.
    """

    risk: float
    empirical: float
    kl: float
    confidence: float
    continuity: float
    condition: float
    moment: float
    encoder_lipschitz: float
    decoder_lipschitz: float
    trivial: float

    @property
    def bound(self) -> float:
        """The right side of the inequality."""
        return self.empirical + self.kl + self.confidence + self.continuity + self.condition + self.moment


def bound_terms(
    network: ConditionalVAE, workspace: Workspace, sample: Views, fresh: Views, seed: int, probes: int = 8
) -> BoundTerms:
    """Return the terms of the bound with lambda = n. Paper, Sec. 3, "CVAE PAC-Bayes Bounds".

    Args:
        network: The trained network.
        workspace: Normalises states.
        sample: The n observations of the bound, drawn independently.
        fresh: Independent observations of the same distribution, for the risk and for expectations.
        seed: Seed of latents drawn from the posterior and the prior.
        probes: Observations at which Jacobians are computed, and latents of the prior.
    """
    generator = torch.Generator().manual_seed(seed)
    states, images = _tensors(workspace, sample)
    other_states, other_images = _tensors(workspace, fresh)
    with torch.inference_mode():
        empirical, kl = _losses(network, states, images, generator)
        risk, _ = _losses(network, other_states, other_images, generator)
        moment = _moment(network, other_states[:_PART], other_images[:_PART], generator, probes)
        of_states = torch.cdist(states, other_states).mean()
        of_images = torch.cdist(images.flatten(1), other_images.flatten(1)).mean()
        trivial = (other_images - images.mean(0)).flatten(1).norm(dim=1).mean()
    encoder, decoder = lipschitz_estimates(network, states[:probes], images[:probes], generator)
    return BoundTerms(
        risk=float(risk.mean()),
        empirical=float(empirical.mean()),
        kl=float(kl.mean()),
        confidence=math.log(1.0 / CONFIDENCE) / len(states),
        continuity=encoder * decoder * float(of_states + of_images),
        condition=decoder * float(of_states),
        moment=moment,
        encoder_lipschitz=encoder,
        decoder_lipschitz=decoder,
        trivial=float(trivial),
    )


def lipschitz_estimates(
    network: ConditionalVAE, states: torch.Tensor, images: torch.Tensor, generator: torch.Generator
) -> Tuple[float, float]:
    """Return lower estimates of K_phi and K_theta: the largest Jacobian norm by state, image or latent.

    The distance of two arguments is the sum of the distances of their parts, so the norm of a Jacobian is the largest
    of the spectral norms of its blocks.

    Args:
        network: The trained network.
        states: (N, D) normalised.
        images: (N, 3, H, W) in [0, 1].
        generator: Start of the power iterations.
    """
    norms = [
        _block_norms(network, states[index : index + 1], images[index : index + 1], generator)
        for index in range(len(states))
    ]
    return max(encoder for encoder, _ in norms), max(decoder for _, decoder in norms)


def _block_norms(
    network: ConditionalVAE, state: torch.Tensor, image: torch.Tensor, generator: torch.Generator
) -> Tuple[float, float]:
    """Return the largest block norm of the Jacobians of encoder and decoder at one observation."""
    latent = _posterior(network, state, image)[0].detach()
    encoder = (
        spectral_norm(lambda y: torch.cat(_posterior(network, state, y)), image, generator),
        spectral_norm(lambda x: torch.cat(_posterior(network, x, image)), state, generator),
    )
    decoder = (
        spectral_norm(lambda z: network.decode(z, state)[0], latent, generator),
        spectral_norm(lambda x: network.decode(latent, x)[0], state, generator),
    )
    return max(encoder), max(decoder)


def spectral_norm(function: Function, point: torch.Tensor, generator: torch.Generator) -> float:
    """Return the spectral norm of a function's Jacobian at a point, by power iteration; approached from below."""
    direction = torch.randn(point.shape, generator=generator)
    norm = 0.0
    for _ in range(_POWER_ITERATIONS):
        direction = direction / direction.norm()
        _, image = torch.autograd.functional.jvp(function, point, direction)
        norm = float(image.norm())
        if norm == 0.0:
            return 0.0
        _, direction = torch.autograd.functional.vjp(function, point, image)
    return norm


def _tensors(workspace: Workspace, views: Views) -> Tuple[torch.Tensor, torch.Tensor]:
    """Return normalised states (N, D) and images (N, 3, H, W) in [0, 1]."""
    states = torch.from_numpy(workspace.normalise(views.states).astype(np.float32))
    return states, float_images(torch.from_numpy(views.images)).contiguous()


def _posterior(
    network: ConditionalVAE, states: torch.Tensor, images: torch.Tensor
) -> Tuple[torch.Tensor, torch.Tensor]:
    latent = network.encode_features(states, network.image_encoder(images).flatten(1))
    return latent.mean, latent.std


def _losses(
    network: ConditionalVAE, states: torch.Tensor, images: torch.Tensor, generator: torch.Generator
) -> Tuple[torch.Tensor, torch.Tensor]:
    """Return the loss (N,) with one latent drawn from each posterior, and the KL divergence (N,) from the prior."""
    losses, divergences = [], []
    for x, y in zip(states.split(_PART), images.split(_PART)):
        mean, std = _posterior(network, x, y)
        latents = mean + std * torch.randn(mean.shape, generator=generator)
        losses.append((y - network.decode(latents, x)[0]).flatten(1).norm(dim=1))
        divergences.append(0.5 * (mean**2 + std**2 - 2.0 * std.log() - 1.0).sum(1))
    return torch.cat(losses), torch.cat(divergences)


def _moment(
    network: ConditionalVAE, states: torch.Tensor, images: torch.Tensor, generator: torch.Generator, count: int
) -> float:
    """Return log E_z E_(x, y) exp(E loss(z, x', y') - loss(z, x, y)) under the prior, with lambda = n."""
    exponents = []
    for latent in torch.randn((count, network.latent_size), generator=generator):
        decoded = network.decode(latent.expand(len(states), -1), states)[0]
        losses = (images - decoded).flatten(1).norm(dim=1)
        exponents.append(losses.mean() - losses)
    pooled = torch.cat(exponents)
    return float(torch.logsumexp(pooled, 0) - math.log(len(pooled)))
