"""Finite tensors in the files of array_files."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, Tuple

import numpy as np
import torch

from embodied_active_learning.errors import SessionError
from embodied_active_learning.files import FileReader
from embodied_active_learning.session.array_files import READER, read_arrays, write_arrays

Tensors = Dict[str, torch.Tensor]


def write_tensors(path: Path, kind: str, tensors: Tensors, facts: Dict[str, Any]) -> None:
    """Write tensors, which must not change meanwhile, and plain facts (numbers, texts, lists, dictionaries) atomically.

    Raises SessionError when the disk fails, or for tensors that are not finite: they would replace good ones.
    """
    _refuse_not_finite(tensors, SessionError, f"{path} was not written")
    write_arrays(path, kind, {name: tensor.detach().cpu().numpy() for name, tensor in tensors.items()}, facts)


def read_tensors(path: Path, kind: str, reader: FileReader = READER) -> Tuple[Tensors, Dict[str, Any]]:
    """Read what write_tensors wrote, as read_arrays does. Raises the reader's error, for what is not finite too."""
    arrays, facts = read_arrays(path, kind, reader)
    for name, array in arrays.items():
        if array.dtype == np.uint64:  # torch as of Noetic has no such type
            raise reader.refuse(f"{path}:", f"{name} is {array.dtype}, which no tensor of ours is")
    tensors = {name: torch.from_numpy(array) for name, array in arrays.items()}
    _refuse_not_finite(tensors, reader.error, str(path))
    return tensors, facts


def _refuse_not_finite(tensors: Tensors, error: type, subject: str) -> None:
    for name, tensor in tensors.items():
        # A sum is finite only if all its parts are, and takes a tenth of the time; that of large numbers may not be.
        if not (tensor.sum().isfinite() or tensor.isfinite().all()):
            raise error(f"{subject}: tensor {name} holds values that are not finite: go back to an earlier checkpoint")
