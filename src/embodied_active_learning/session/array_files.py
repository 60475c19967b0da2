"""Arrays in one safetensors file, with a checksum of names, shapes, bytes and metadata. Pickle is never used."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Dict, Mapping, Tuple

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.files import FileReader, open_regular_file
from embodied_active_learning.session.atomic import write_bytes

READER = FileReader(CorruptFileError, "restore the file, or train again", limit=2**32)
_HEADER = "header"  # a single key of metadata: safetensors writes several in random order
_MAX_HEADER_SIZE = 2**22  # bytes
_LENGTH_BYTES = 8
_VERSIONS = {"checkpoint": "2"}
"""Version of each kind of file, by default 1. Raise it if arrays or facts are renamed."""
_TYPES = tuple(map(np.dtype, (np.float32, np.float64, np.uint8, np.int32, np.int64, np.uint64, np.bool_)))
Arrays = Dict[str, np.ndarray]


def write_arrays(path: Path, kind: str, arrays: Mapping[str, np.ndarray], facts: Mapping[str, Any]) -> None:
    """Write arrays and plain facts (numbers, texts, lists, dictionaries) atomically. Equal content gives equal bytes.

    Raises:
        SessionError: The disk failed; the previous file is kept, unless the message says that the new one was written.
    """
    contiguous = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    text = json.dumps(facts, sort_keys=True, allow_nan=False)
    header = {"format": _format(kind), "version": _version(kind), "facts": text, "sha256": _digest(contiguous, text)}
    write_bytes(path, save(contiguous, metadata={_HEADER: json.dumps(header, sort_keys=True)}))


def read_arrays(path: Path, kind: str, reader: FileReader = READER) -> Tuple[Arrays, Dict[str, Any]]:
    """Read a file of write_arrays.

    Args:
        path: The file.
        kind: Kind given to write_arrays.
        reader: Size limit, error class and remedy.

    Returns:
        The arrays by name, and the facts.

    Raises:
        reader.error: The file is missing, malformed or damaged; names the file and the field.
    """
    _check_header_size(path, reader)
    arrays, metadata = _read(path, reader)
    header = _header(path, metadata, reader)
    reader.expect(path, header, {"format": _format(kind)})
    reader.expect_version(path, header, _version(kind))
    for name, array in arrays.items():
        if array.dtype not in _TYPES:
            expected = ", ".join(map(str, _TYPES))
            raise reader.make_error(f"{path}:", f"{name} is {array.dtype}, expected one of {expected}")
    text = header.get("facts", "")
    reader.expect(path, header, {"sha256": _digest(arrays, text)})
    return arrays, reader.parse_json(f"{path}: facts", text)


def write_finite_arrays(path: Path, kind: str, arrays: Mapping[str, np.ndarray], facts: Mapping[str, Any]) -> None:
    """Write arrays like write_arrays. Raises SessionError also for values that are not finite."""
    found = _not_finite(arrays)
    if found:
        raise SessionError(f"{path} was not written: array {found} has values that are not finite")
    write_arrays(path, kind, arrays, facts)


def read_finite_arrays(path: Path, kind: str, reader: FileReader = READER) -> Tuple[Arrays, Dict[str, Any]]:
    """Read a file of write_finite_arrays like read_arrays. Raises reader.error also for values that are not finite."""
    arrays, facts = read_arrays(path, kind, reader)
    found = _not_finite(arrays)
    if found:
        raise reader.make_error(f"{path}:", f"array {found} has values that are not finite")
    return arrays, facts


def _not_finite(arrays: Mapping[str, np.ndarray]) -> str:
    """Return the name of the first array with values that are not finite; empty if all are."""
    for name, array in arrays.items():
        with np.errstate(all="ignore"):
            total = array.sum()  # ten times faster to check than the array; it may overflow for finite values
        if not (np.isfinite(total) or np.isfinite(array).all()):
            return name
    return ""


def _read(path: Path, reader: FileReader) -> Tuple[Arrays, Dict[str, str]]:
    """Return all arrays and the metadata."""
    try:
        with safe_open(str(path), framework="np") as stored:
            arrays = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118 - not a mapping
            return arrays, stored.metadata() or {}
    # ValueError and the following are raised for types unknown to numpy.
    except (SafetensorError, OSError, ValueError, TypeError, AttributeError, LookupError) as error:
        raise reader.make_error(path, f"is not a complete safetensors file ({error})") from error
    except MemoryError as error:
        raise reader.make_error(path, "does not fit into memory") from error
    except BaseException as error:
        # Rust code reports a failed allocation as pyo3_runtime.PanicException, which is not an Exception.
        if type(error).__name__ != "PanicException":
            raise
        raise reader.make_error(path, f"cannot be read by safetensors ({error})") from None


def _header(path: Path, metadata: Mapping[str, str], reader: FileReader) -> Mapping[str, Any]:
    """Return the fields of the header; none if it is missing."""
    header = reader.parse_json(f"{path}: {_HEADER}", metadata.get(_HEADER, "{}"))
    for name, value in header.items():
        if not isinstance(value, str):
            raise reader.make_error(f"{path}:", f"{name} of the header is not a text")
    return header


def _check_header_size(path: Path, reader: FileReader) -> None:
    """Check the length that the first 8 bytes declare: it bounds what safetensors allocates."""
    size = reader.check(path)
    with open_regular_file(path, follow=reader.follow) as stream:
        length = int.from_bytes(stream.read(_LENGTH_BYTES), "little")
    if not 0 < length <= min(_MAX_HEADER_SIZE, size - _LENGTH_BYTES):
        raise reader.make_error(
            path, f"is not a complete safetensors file (header of {length} bytes in a file of {size})"
        )


def _format(kind: str) -> str:
    return f"embodied_active_learning/{kind}"


def _version(kind: str) -> str:
    return _VERSIONS.get(kind, "1")


def _digest(arrays: Mapping[str, np.ndarray], text: str) -> str:
    """Return the SHA-256 of everything that is read back."""
    digest = hashlib.sha256(text.encode("utf-8"))
    for name in sorted(arrays):
        array = arrays[name]
        # Type names of torch are part of the format.
        digest.update(json.dumps([name, f"torch.{array.dtype}", list(array.shape)]).encode("utf-8"))
        digest.update(np.asarray(array, order="C").reshape(-1).view(np.uint8).data)
    return digest.hexdigest()
