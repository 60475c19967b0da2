"""Finite torch tensors in the files of array_files."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, Mapping, Tuple

import numpy as np
import torch

from embodied_active_learning.files import FileReader
from embodied_active_learning.session.array_files import READER, read_finite_arrays, write_finite_arrays

Tensors = Dict[str, torch.Tensor]


def write_tensors(path: Path, kind: str, tensors: Tensors, facts: Mapping[str, Any]) -> None:
    """Write tensors and plain facts atomically. The tensors must not change meanwhile.

    Raises:
        SessionError: The disk failed, or a tensor is not finite; the previous file is kept, unless the message says
            that the new one was written.
    """
    write_finite_arrays(path, kind, {name: tensor.detach().cpu().numpy() for name, tensor in tensors.items()}, facts)


def read_tensors(path: Path, kind: str, reader: FileReader = READER) -> Tuple[Tensors, Dict[str, Any]]:
    """Read a file of write_tensors, like read_arrays. Values that are not finite are rejected as well."""
    arrays, facts = read_finite_arrays(path, kind, reader)
    for name, array in arrays.items():
        if array.dtype == np.uint64:  # not supported by the torch of Noetic
            raise reader.make_error(f"{path}:", f"{name} is {array.dtype}, which is not a tensor type")
    return {name: torch.from_numpy(array) for name, array in arrays.items()}, facts
