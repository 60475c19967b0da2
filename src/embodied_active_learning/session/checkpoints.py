"""Checkpoints, from which training resumes exactly, and the final model."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

import torch

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.schema import build, required
from embodied_active_learning.session.array_files import READER
from embodied_active_learning.session.atomic import make_folder, remove_leftovers
from embodied_active_learning.session.paths import stays_inside
from embodied_active_learning.session.tensor_files import read_tensors, write_tensors

_NAME = re.compile(r"^checkpoint_(\d{9})\.safetensors$")


class Checkpoint(NamedTuple):
    """One state of the training."""

    path: Path
    updates: int
    tensors: Dict[str, torch.Tensor]
    counters: Dict[str, Any]
    observations: int  # that it was trained on
    refused: Tuple[str, ...] = ()  # errors of newer checkpoints that cannot be used


@dataclass(frozen=True)
class _Facts:
    """The facts of a checkpoint file."""

    updates: int = required("model updates", low=0)
    observations: int = required("stored observations", low=0)
    counters: Dict[str, Any] = required("counters of the training")  # noqa: RUF009


def save_checkpoint(
    folder: Path,
    updates: int,
    observations: int,
    tensors: Dict[str, torch.Tensor],
    counters: Dict[str, Any],
    keep: int = 2,
) -> Path:
    """Write a checkpoint and delete older ones.

    Args:
        folder: Folder of the checkpoints.
        updates: Number of model updates.
        observations: Number of observations.
        tensors: State of network and optimiser.
        counters: Plain data (numbers, texts, lists, dictionaries).
        keep: Number of checkpoints to keep, including the new one.

    Raises:
        SessionError: The disk failed, or a tensor is not finite; earlier checkpoints are kept.
    """
    folder = Path(folder)
    stays_inside(folder.parent, folder)
    make_folder(folder)
    remove_leftovers(folder)
    path = folder / f"checkpoint_{updates:09d}.safetensors"
    facts = {"updates": updates, "observations": observations, "counters": counters}
    write_tensors(path, "checkpoint", tensors, facts)
    stored = _newest_first(folder)
    # Checkpoints of more updates were written before a rollback.
    kept = stored[stored.index(path) :][:keep]
    for other in stored:
        if other not in kept:
            with suppress(OSError):  # the next call retries
                other.unlink()
    return path


def load_latest(folder: Path) -> Optional[Checkpoint]:
    """Return the newest intact checkpoint; None without checkpoints.

    Raises:
        CorruptFileError: All checkpoints are damaged or of another version.
    """
    refused: List[str] = []
    for path in _newest_first(stays_inside(Path(folder).parent, Path(folder))):
        try:
            tensors, stored = read_tensors(path, "checkpoint")
            facts = build(_Facts, stored, path, CorruptFileError, READER.remedy)
            READER.expect(path, stored, {"updates": int(path.stem.split("_")[1])})
            return Checkpoint(path, facts.updates, tensors, facts.counters, facts.observations, tuple(refused))
        except CorruptFileError as error:
            refused.append(str(error))
    if refused:
        raise CorruptFileError(f"no checkpoint in {folder} can be used: {'; '.join(refused)}")
    return None


def save_model(path: Path, tensors: Dict[str, torch.Tensor], metadata: Dict[str, Any]) -> None:
    """Write a model and plain facts about it. Raises SessionError like save_checkpoint."""
    write_tensors(Path(path), "model", tensors, metadata)


def load_model(path: Path) -> Tuple[Dict[str, torch.Tensor], Dict[str, Any]]:
    """Return the tensors of a model and the facts about it. Raises CorruptFileError naming the file and the field."""
    return read_tensors(Path(path), "model")


def _newest_first(folder: Path) -> List[Path]:
    return sorted((path for path in folder.glob("*") if _NAME.match(path.name)), reverse=True)
