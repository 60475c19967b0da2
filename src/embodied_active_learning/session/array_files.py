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
from embodied_active_learning.files import FileReader, open_plain
from embodied_active_learning.session.atomic import write_bytes

VERSION = "1"
READER = FileReader(CorruptFileError, "restore the file, or train again", limit=2**32)
_LARGEST_HEADER = 2**22  # bytes
_LENGTH_BYTES = 8
# What the package stores.
_TYPES = tuple(map(np.dtype, (np.float32, np.float64, np.uint8, np.int32, np.int64, np.uint64, np.bool_)))
Arrays = Dict[str, np.ndarray]


def write_arrays(path: Path, kind: str, arrays: Mapping[str, np.ndarray], facts: Mapping[str, Any]) -> None:
    """Write arrays and plain facts (numbers, texts, lists, dictionaries) atomically.

    Raises SessionError when the disk fails; what was there before is kept then.
    """
    whole = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    text = json.dumps(facts, sort_keys=True, allow_nan=False)
    header = {"format": _format(kind), "version": VERSION, "facts": text, "sha256": _digest(whole, text)}
    write_bytes(path, save(whole, metadata=header))


def read_arrays(path: Path, kind: str, reader: FileReader = READER) -> Tuple[Arrays, Dict[str, Any]]:
    """Read what write_arrays wrote: the arrays and the facts.

    reader: how large the file may be, and the remedy. Raises its error naming the file, the field and the remedy.
    """
    _check_header(path, reader)
    try:
        with safe_open(str(path), framework="np") as stored:
            header = stored.metadata() or {}
            reader.expect(path, header, {"format": _format(kind), "version": VERSION})
            arrays = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118 - not a mapping
    # The last three come of types that numpy does not know.
    except (SafetensorError, OSError, ValueError, TypeError, AttributeError, LookupError) as error:
        raise reader.refuse(path, f"is no whole safetensors file ({error})") from error
    for name, array in arrays.items():
        if array.dtype not in _TYPES:
            expected = ", ".join(map(str, _TYPES))
            raise reader.refuse(f"{path}:", f"{name} is {array.dtype}, expected one of {expected}")
    text = header.get("facts", "")
    reader.expect(path, header, {"sha256": _digest(arrays, text)})
    return arrays, reader.parse_json(f"{path}: facts", text)


def _check_header(path: Path, reader: FileReader) -> None:
    """Refuse a header that is larger than any of ours, or than the file: 8 bytes say its length, then it follows."""
    size = reader.check(path)
    with open_plain(path, follow=reader.follow) as stream:
        length = int.from_bytes(stream.read(_LENGTH_BYTES), "little")
    if not 0 < length <= min(_LARGEST_HEADER, size - _LENGTH_BYTES):
        complaint = f"is no whole safetensors file (of its {size} bytes the header is said to be {length})"
        raise reader.refuse(path, complaint)


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
