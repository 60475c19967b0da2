"""Arrays in one safetensors file whose checksum covers names, shapes, bytes and metadata. No pickle, ever."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Dict, Mapping, Tuple

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.session.atomic import write_bytes

VERSION = "1"
REMEDY = "restore the file, or train again"
Arrays = Dict[str, np.ndarray]


def write_arrays(path: Path, kind: str, arrays: Mapping[str, np.ndarray], facts: Mapping[str, Any]) -> None:
    """Write arrays and plain facts (numbers, texts, lists, dictionaries) atomically.

    Raises SessionError when the disk fails; what was there before is kept then.
    """
    whole = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    text = json.dumps(facts, sort_keys=True, allow_nan=False)
    header = {"format": _format(kind), "version": VERSION, "facts": text, "sha256": _digest(whole, text)}
    write_bytes(path, save(whole, metadata=header))


def read_arrays(path: Path, kind: str) -> Tuple[Arrays, Dict[str, Any]]:
    """Read what write_arrays wrote. Raises CorruptFileError naming the file, the field and the remedy."""
    try:
        with safe_open(str(path), framework="np") as stored:
            header = stored.metadata() or {}
            _expect(path, header, "format", _format(kind))
            _expect(path, header, "version", VERSION)
            arrays = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118 - not a mapping
    except FileNotFoundError as error:
        raise CorruptFileError(f"{path} is missing: train first, or choose another session") from error
    except (SafetensorError, OSError, ValueError, TypeError) as error:
        raise CorruptFileError(f"{path} is no whole safetensors file ({error}): {REMEDY}") from error
    text = header.get("facts", "")
    _expect(path, header, "sha256", _digest(arrays, text))
    return arrays, json.loads(text)


def _format(kind: str) -> str:
    return f"embodied_active_learning/{kind}"


def _digest(arrays: Mapping[str, np.ndarray], text: str) -> str:
    """SHA-256 over everything that is read back."""
    digest = hashlib.sha256(text.encode("utf-8"))
    for name in sorted(arrays):
        array = arrays[name]
        # Types as torch calls them, so that what earlier versions wrote stays readable.
        digest.update(json.dumps([name, f"torch.{array.dtype}", list(array.shape)]).encode("utf-8"))
        digest.update(np.asarray(array, order="C").reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


def _expect(path: Path, header: Mapping[str, str], field: str, expected: str) -> None:
    found = header.get(field)
    if found != expected:
        raise CorruptFileError(f"{path}: {field} is {found!r}, expected {expected!r}: {REMEDY}")
