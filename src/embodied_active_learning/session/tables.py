"""The CSV tables of a run: appended row by row, truncated on resume, readable at any time.

Columns may be added to COLUMNS: a table that lacks some is read as if they were NaN, and completed when its run is
resumed.
"""

from __future__ import annotations

import csv
import dataclasses
import errno
import io
import os
import re
from pathlib import Path
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np

from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.files import FileReader, open_regular_file, short_repr
from embodied_active_learning.schema import to_plain
from embodied_active_learning.session import lock
from embodied_active_learning.session.atomic import write_bytes

_NUMBER = re.compile(r"-?([0-9]+(\.[0-9]+)?(e[+-]?[0-9]+)?|inf|nan)")  # as Python writes them
_READER = FileReader(CorruptFileError, "choose another session", limit=2**28)

# fmt: off
COLUMNS: Dict[str, Tuple[str, ...]] = {
    "exploration": (
        "step", "time", "x", "y", "theta", "ergodic_measure", "coverage", "distance", "turning", "effort",
    ),
    "training": (
        "update", "observations", "loss", "reconstruction", "conditional_reconstruction", "kl", "beta", "gamma",
        "coverage", "active_units", "log_std_min", "log_std_max",
    ),
    "evaluation": (
        "update", "observations", "active_units", "mse_own", "mse_shuffled", "mse_none", "log_std_min", "log_std_max",
    ),
    "stopping": (
        "update", "observations", "objects", "undiscovered", "drift", "stable_checks", "contrast",
        "latent_contribution", "coverage", "stopped",
    ),
    "rounds": ("update", "trainers", "updates", "seconds", "computing"),
}
# fmt: on
UNITS: Dict[str, str] = {
    "time": "s",
    "x": "m",
    "y": "m",
    "theta": "rad",
    "ergodic_measure": "nat",
    "distance": "m",
    "turning": "rad",
    "effort": "1/s^3",
    "loss": "nat per pixel value",
    "reconstruction": "nat per pixel value",
    "conditional_reconstruction": "nat per pixel value",
    "kl": "nat",
    "drift": "m",
    "seconds": "s",
    "computing": "s",
}
"""Units of the columns that have one."""


class Table:
    """A CSV file of numbers to append to. Its writer holds the file's lock."""

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self.path = Path(path)
        self.columns = tuple(columns)
        self._open()

    def append(self, row: Any) -> None:
        """Write one row immediately.

        Args:
            row: A mapping or a dataclass of numbers; missing columns become NaN.

        Raises:
            SessionError: The row has an unknown column, or the disk failed.
        """
        values: Dict[str, Any] = to_plain(row) if dataclasses.is_dataclass(row) else dict(row)
        unknown = [name for name in values if name not in self.columns]
        if unknown:
            raise SessionError(f"{self.path} has no column {unknown[0]}: the columns are {', '.join(self.columns)}")
        self._write(",".join(_text(values.get(name)) for name in self.columns))

    def truncate_after(self, column: str, value: float) -> None:
        """Delete the rows with a larger value in a column: they were written after the state that is resumed."""
        rows = _rows(self.path, _READER.read_bytes(self.path), self.columns)
        self._rewrite([row for row in rows if _number(row[self.columns.index(column)]) <= value])

    def close(self) -> None:
        """Close the file and release its lock."""
        self._stream.close()

    def __enter__(self) -> Table:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _open(self) -> None:
        """Open the file after its last complete row."""
        try:
            self._stream = open_regular_file(self.path, "r+b")
        except OSError as error:
            raise SessionError(f"{self.path} cannot be written ({error.strerror}): check the disk") from error
        try:
            lock.claim(self._stream, self.path)
            content = _READER.read_bytes(self.path)
            whole = content.rfind(b"\n") + 1
            rows = _rows(self.path, content, self.columns)  # raises for a damaged table
            self._cut(whole)
            if not whole:
                self._write(",".join(self.columns))
            elif _columns_of(content, self.columns) != self.columns:
                self._rewrite(rows)
        except BaseException:
            self.close()
            raise

    def _rewrite(self, rows: Sequence[Sequence[str]]) -> None:
        """Replace the file by a header and rows, and open the new one."""
        write_bytes(self.path, "".join(",".join(row) + "\n" for row in [self.columns, *rows]).encode("utf-8"))
        self.close()
        self._open()

    def _write(self, line: str) -> None:
        content, end = (line + "\n").encode("utf-8"), self._stream.tell()
        try:
            if self._stream.write(content) < len(content):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            self._cut(end)  # otherwise the next row would be appended to half a row
            raise SessionError(f"{self.path} cannot be written ({error.strerror}): free disk space") from error

    def _cut(self, size: int) -> None:
        """Truncate the file to a size and continue there."""
        try:
            self._stream.truncate(size)
        except OSError as error:
            raise SessionError(f"{self.path} cannot be written ({error.strerror}): check the disk") from error
        self._stream.seek(size)


def read_table(path: Path, columns: Sequence[str]) -> Dict[str, np.ndarray]:
    """Return each column as (N,) float64. An incomplete last line is ignored; a missing file is an empty table.

    Raises:
        CorruptFileError: Names the file and the line.
    """
    path = Path(path)
    rows = _rows(path, _READER.read_bytes(path), columns) if os.path.lexists(path) else []
    values: np.ndarray = np.array([[_number(text) for text in row] for row in rows], dtype=np.float64).reshape(
        -1, len(columns)
    )
    return {name: values[:, index] for index, name in enumerate(columns)}


def _columns_of(content: bytes, columns: Sequence[str]) -> Tuple[str, ...]:
    """Return the columns of a file: all expected ones, or some of them in their order.

    Raises ValueError with the header for another one.
    """
    whole = ",".join(columns)
    line, newline, _ = content.partition(b"\n")
    found = line[: len(whole) + 1].decode("utf-8", "replace")
    if not newline and whole.startswith(found):
        return tuple(columns)  # an incomplete header
    names = tuple(found.split(","))
    if names != tuple(name for name in columns if name in names) or columns[0] not in names:
        raise ValueError(short_repr(list(names)))
    return names


def _rows(path: Path, content: bytes, columns: Sequence[str]) -> List[List[str]]:
    """Return the texts of every complete row after the header, empty in the columns that the file lacks."""
    try:
        names = _columns_of(content, columns)
    except ValueError as error:
        raise _READER.make_error(f"{path}:", f"the header is {error}, expected {list(columns)}") from error
    count = len(names)
    text = content.decode("utf-8", "replace")
    try:
        lines = list(csv.reader(io.StringIO(text[: text.rfind("\n") + 1])))
    except csv.Error as error:
        raise _READER.make_error(path, f"is not a CSV table ({error})") from error
    for number, line in enumerate(lines[1:], start=2):
        if len(line) != count or not all(_is_number(value) for value in line):
            raise CorruptFileError(f"{path}: line {number} is {short_repr(line)}, expected {count} numbers: delete it")
    if names == tuple(columns):
        return lines[1:]
    return [[line[names.index(name)] if name in names else "" for name in columns] for line in lines[1:]]


def _text(value: Any) -> str:
    """Return the shortest text that is parsed as the same number."""
    if value is None:
        return ""
    return str(int(value)) if isinstance(value, (int, np.integer)) else repr(float(value))


def _number(text: str) -> float:
    return float(text) if text else float("nan")


def _is_number(text: str) -> bool:
    return not text or _NUMBER.fullmatch(text) is not None
