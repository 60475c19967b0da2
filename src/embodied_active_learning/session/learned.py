"""The newest model of a session."""

from __future__ import annotations

from typing import Dict, NamedTuple, Optional

import torch

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.model.checkpoint import network_weights
from embodied_active_learning.model.learned import LearnedModel
from embodied_active_learning.session.checkpoints import load_latest, load_model
from embodied_active_learning.session.session import Session


class Trained(NamedTuple):
    """A model, the weights it is made of, and how long it has learned."""

    model: LearnedModel
    weights: Dict[str, torch.Tensor]
    updates: int


def load_trained(session: Session) -> Optional[Trained]:
    """The final model, or that of the newest checkpoint while there is none; None when nothing was learned yet.

    Raises CorruptFileError when the file is damaged or belongs to another configuration.
    """
    path = session.paths.model
    if path.exists():
        weights, facts = load_model(path)
        updates = facts.get("updates")
        if type(updates) is not int:
            raise CorruptFileError(f"{path}: updates is {updates!r}, expected a number: train again")
    else:
        checkpoint = load_latest(session.paths.checkpoints)
        if checkpoint is None:
            return None
        path, updates, weights = checkpoint.path, checkpoint.updates, network_weights(checkpoint.tensors)
    if updates == 0:
        return None
    try:
        return Trained(LearnedModel(session.config, weights), weights, updates)
    except RuntimeError as error:
        raise CorruptFileError(f"{path} does not fit the session's camera and model settings: {error}") from error
