"""The trained network of a session, and the little that the figures ask of it."""

from __future__ import annotations

from pathlib import Path
from typing import Dict, Optional, Tuple

import numpy as np
import torch

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.model.checkpoint import network_weights
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.session.checkpoints import load_latest, load_model
from embodied_active_learning.session.session import Session

_CHUNK = 8192


def load_network(session: Session) -> Optional[ConditionalVAE]:
    """The final model, or that of the newest checkpoint while there is none; None when nothing was trained yet.

    Raises CorruptFileError when the file is damaged or belongs to another configuration.
    """
    if session.paths.model.exists():
        tensors, _ = load_model(session.paths.model)
        return _build(session.config, tensors, session.paths.model)
    checkpoint = load_latest(session.paths.checkpoints)
    if checkpoint is None:
        return None
    return _build(session.config, network_weights(checkpoint.tensors), checkpoint.path)


def encode(network: ConditionalVAE, states: np.ndarray, images: np.ndarray) -> torch.Tensor:
    """Mean latents of images (N, H, W, 3) uint8 taken at normalised states (N, D). -> (N, L)."""
    with torch.inference_mode():
        return network.encode(torch.from_numpy(states), torch.from_numpy(np.ascontiguousarray(images))).mean


def decode(network: ConditionalVAE, latents: torch.Tensor, states: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Images predicted at normalised states (N, D). -> (N, H, W, 3) in [0, 1], and their standard deviation (N,)."""
    with torch.inference_mode():
        means, log_std = network.decode(latents, torch.from_numpy(states))
        return means.clamp(0.0, 1.0).permute(0, 2, 3, 1).numpy(), log_std.exp().numpy()


def mean_log_std(network: ConditionalVAE, latents: torch.Tensor, states: np.ndarray) -> np.ndarray:
    """Log standard deviation predicted at normalised states (S, D), averaged over latents (N, L). -> (S,)."""
    parts = torch.from_numpy(np.ascontiguousarray(states, dtype=np.float32)).split(_CHUNK)
    with torch.inference_mode():
        means = [torch.stack([network.log_std(latent, part) for latent in latents]).mean(dim=0) for part in parts]
        return torch.cat(means).numpy()


def _build(config: Config, weights: Dict[str, torch.Tensor], path: Path) -> ConditionalVAE:
    network = ConditionalVAE((config.camera.height, config.camera.width), config.workspace.box().size, config.model)
    try:
        network.load_state_dict(weights)
    except RuntimeError as error:
        raise CorruptFileError(f"{path} does not fit the session's camera and model settings: {error}") from error
    return network.eval().requires_grad_(False)
