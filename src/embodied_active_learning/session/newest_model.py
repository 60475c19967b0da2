"""The newest model of a session."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Dict, NamedTuple, Optional

import torch

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.files import FileReader
from embodied_active_learning.model.checkpoint import network_weights
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.session.checkpoints import load_latest, load_model
from embodied_active_learning.session.session import Session

_READER = FileReader(CorruptFileError, "train again")


class Trained(NamedTuple):
    """A model, the weights it is made of, and how long it has learned."""

    model: TrainedModel
    weights: Dict[str, torch.Tensor]
    updates: int


def load_newest_model(session: Session) -> Optional[Trained]:
    """The final model, or that of the newest checkpoint while there is none; None when nothing was learned yet.

    Raises CorruptFileError when the file is damaged or belongs to another configuration.
    """
    path = session.paths.model
    if os.path.lexists(path):
        weights, facts = load_model(path)
        _READER.expect_types(path, facts, {"updates": (int,), "observations": (int,)})
        updates = facts["updates"]
    else:
        checkpoint = load_latest(session.paths.checkpoints)
        if checkpoint is None:
            return None
        path, updates, weights = checkpoint.path, checkpoint.updates, network_weights(checkpoint.tensors)
    if updates == 0:
        return None
    return Trained(_model(path, session.config, weights), weights, updates)


def _model(path: Path, config: Config, weights: Dict[str, torch.Tensor]) -> TrainedModel:
    """The model of a configuration with these weights. Raises CorruptFileError when they do not fit."""
    for name, tensor in weights.items():
        if tensor.dtype != torch.float32:
            raise _READER.refuse(f"{path}:", f"{name} is {tensor.dtype}, expected {torch.float32}")
    try:
        return TrainedModel(config, weights)
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise _READER.refuse(path, f"does not fit the session's camera and model settings ({reason})") from error
