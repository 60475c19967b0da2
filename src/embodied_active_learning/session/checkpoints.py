"""Checkpoints from which training goes on as if nothing had happened, and the final model."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

import torch

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.files import FileReader
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
    refused: Tuple[str, ...] = ()  # why newer checkpoints could not be used


def save_checkpoint(
    folder: Path, updates: int, tensors: Dict[str, torch.Tensor], counters: Dict[str, Any], keep: int = 2
) -> Path:
    """Write the checkpoint of that many updates; of the others stay the `keep` - 1 before it.

    Counters are plain: numbers, texts, lists, dictionaries. Raises SessionError when the disk fails or a tensor is not
    finite; the earlier checkpoints are kept then.
    """
    folder = Path(folder)
    stays_inside(folder.parent, folder)
    make_folder(folder)
    remove_leftovers(folder)
    path = folder / f"checkpoint_{updates:09d}.safetensors"
    write_tensors(path, "checkpoint", tensors, {"updates": updates, "counters": counters})
    stored = _newest_first(folder)
    # Later ones are left from before training went back to an earlier checkpoint: they were refused.
    kept = stored[stored.index(path) :][:keep]
    for other in stored:
        if other not in kept:
            with suppress(OSError):  # what resists is left to the next time
                other.unlink()
    return path


def load_latest(folder: Path) -> Optional[Checkpoint]:
    """The newest checkpoint that is whole, and why newer ones were refused; None when there are none.

    Raises CorruptFileError when there are checkpoints but none can be used.
    """
    refused: List[str] = []
    for path in _newest_first(stays_inside(Path(folder).parent, Path(folder))):
        try:
            tensors, facts = read_tensors(path, "checkpoint")
            READER.expect_types(path, facts, {"updates": (int,), "counters": (dict,)})
            READER.expect(path, facts, {"updates": int(_NAME.match(path.name).group(1))})
            return Checkpoint(path, facts["updates"], tensors, facts["counters"], tuple(refused))
        except CorruptFileError as error:
            refused.append(str(error))
    if refused:
        raise CorruptFileError(f"no checkpoint in {folder} can be used: {'; '.join(refused)}")
    return None


def save_model(path: Path, tensors: Dict[str, torch.Tensor], metadata: Dict[str, Any]) -> None:
    """Write a model and plain facts about it. Raises SessionError as save_checkpoint does."""
    write_tensors(Path(path), "model", tensors, metadata)


def load_model(path: Path, reader: FileReader = READER) -> Tuple[Dict[str, torch.Tensor], Dict[str, Any]]:
    """The tensors of a model and the facts about it. Raises CorruptFileError naming the file and the field."""
    return read_tensors(Path(path), "model", reader)


def _newest_first(folder: Path) -> List[Path]:
    return sorted((path for path in folder.glob("*") if _NAME.match(path.name)), reverse=True)
