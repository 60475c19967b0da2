"""Tensors in one safetensors file whose checksum covers names, shapes, bytes and metadata. No pickle, ever."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Dict, Tuple

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.session.atomic import write_bytes

VERSION = "1"
Tensors = Dict[str, torch.Tensor]


def write_tensors(path: Path, kind: str, tensors: Tensors, facts: Dict[str, Any]) -> None:
    """Write tensors and plain facts (numbers, texts, lists, dictionaries) atomically.

    Raises SessionError when the disk fails, or for tensors that are not finite: they would replace good ones.
    """
    # A copy, because safetensors refuses tensors that are views of one buffer, and training goes on meanwhile.
    copies = {name: tensor.detach().to("cpu", copy=True).contiguous() for name, tensor in tensors.items()}
    _refuse_not_finite(copies, SessionError, f"{path} was not written")
    text = json.dumps(facts, sort_keys=True, allow_nan=False)
    header = {"format": _format(kind), "version": VERSION, "facts": text, "sha256": _digest(copies, text)}
    write_bytes(path, save(copies, metadata=header))


def read_tensors(path: Path, kind: str) -> Tuple[Tensors, Dict[str, Any]]:
    """Read what write_tensors wrote. Raises CorruptFileError naming the file, the field and the remedy."""
    try:
        with safe_open(str(path), framework="pt") as stored:
            header = stored.metadata() or {}
            _expect(path, header, "format", _format(kind))
            _expect(path, header, "version", VERSION)
            tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118 - not a mapping
    except FileNotFoundError as error:
        raise CorruptFileError(f"{path} is missing: train first, or choose another session") from error
    except (SafetensorError, OSError, ValueError) as error:
        raise CorruptFileError(f"{path} is no whole safetensors file ({error}): {_REMEDY}") from error
    text = header.get("facts", "")
    _expect(path, header, "sha256", _digest(tensors, text))
    _refuse_not_finite(tensors, CorruptFileError, str(path))
    return tensors, json.loads(text)


_REMEDY = "restore the file, or train again"


def _format(kind: str) -> str:
    return f"embodied_active_learning/{kind}"


def _digest(tensors: Tensors, text: str) -> str:
    """SHA-256 over everything that is read back."""
    digest = hashlib.sha256(text.encode("utf-8"))
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(json.dumps([name, str(tensor.dtype), list(tensor.shape)]).encode("utf-8"))
        digest.update(tensor.contiguous().reshape(-1).view(torch.uint8).numpy())
    return digest.hexdigest()


def _refuse_not_finite(tensors: Tensors, error: type, subject: str) -> None:
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise error(f"{subject}: tensor {name} holds values that are not finite: go back to an earlier checkpoint")


def _expect(path: Path, header: Dict[str, str], field: str, expected: str) -> None:
    found = header.get(field)
    if found != expected:
        raise CorruptFileError(f"{path}: {field} is {found!r}, expected {expected!r}: {_REMEDY}")
