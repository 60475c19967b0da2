"""The newest model of a session."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, NamedTuple, Optional

import torch

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.files import FileReader
from embodied_active_learning.model.learner_state import network_weights
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.schema import build, required
from embodied_active_learning.session.checkpoints import load_latest, load_model
from embodied_active_learning.session.session import Session

_READER = FileReader(CorruptFileError, "train again")


class SessionModel(NamedTuple):
    """A model, its weights, and the number of updates behind them."""

    model: TrainedModel
    weights: Dict[str, torch.Tensor]
    updates: int


@dataclass(frozen=True)
class _Facts:
    """The facts of model.safetensors."""

    updates: int = required("model updates", low=0)
    observations: int = required("observations", low=0)


def load_session_model(session: Session) -> Optional[SessionModel]:
    """Return the final model of a session, or that of the newest checkpoint; None before the first update.

    Raises:
        CorruptFileError: The file is damaged, or belongs to another configuration.
    """
    path = session.paths.model
    if os.path.lexists(path):
        weights, stored = load_model(path)
        updates = build(_Facts, stored, path, CorruptFileError, _READER.remedy).updates
    else:
        checkpoint = load_latest(session.paths.checkpoints)
        if checkpoint is None:
            return None
        path, updates, weights = checkpoint.path, checkpoint.updates, network_weights(checkpoint.tensors)
    if updates == 0:
        return None
    return SessionModel(_model(path, session.config, weights), weights, updates)


def _model(path: Path, config: Config, weights: Dict[str, torch.Tensor]) -> TrainedModel:
    for name, tensor in weights.items():
        if tensor.dtype != torch.float32:
            raise _READER.make_error(f"{path}:", f"{name} is {tensor.dtype}, expected {torch.float32}")
    try:
        return TrainedModel(config, weights)
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise _READER.make_error(path, f"does not fit the session's camera and model settings ({reason})") from error
