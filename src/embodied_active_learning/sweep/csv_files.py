"""CSV files of results with texts and numbers, of few digits so that they are small."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path
from typing import Dict, Iterable, List, Mapping, Sequence

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.files import FileReader
from embodied_active_learning.session.atomic import make_folder, write_text

_READER = FileReader(CorruptFileError, "make the results again", limit=2**24)
_DIGITS = 6


def write_rows(path: Path, rows: Iterable[Mapping[str, object]], columns: Sequence[str] = ()) -> None:
    """Write rows with the same columns atomically; NaN and None become empty. The folder is created.

    Args:
        path: The file.
        rows: Values by column.
        columns: Names of the columns; by default those of the first row, so that a file without rows has no header.
    """
    listed = [{name: _text(value) for name, value in row.items()} for row in rows]
    stream = io.StringIO()
    writer = csv.DictWriter(stream, columns or (list(listed[0]) if listed else []), lineterminator="\n")
    writer.writeheader()
    writer.writerows(listed)
    make_folder(path.parent)
    write_text(path, stream.getvalue())


def append_rows(path: Path, rows: Iterable[Mapping[str, object]]) -> None:
    """Add rows to a file, which is created if it does not exist. The file is replaced atomically."""
    write_rows(path, [*read_rows(path, missing_ok=True), *rows])


def read_rows(path: Path, missing_ok: bool = False) -> List[Dict[str, str]]:
    """Return the rows of a file as texts; none if it is missing and may be. Raises CorruptFileError otherwise."""
    if missing_ok and not path.exists():
        return []
    return list(csv.DictReader(io.StringIO(_READER.read_text(path))))


def _text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, float):  # numpy's float64 included
        return "" if math.isnan(value) else f"{value:.{_DIGITS}g}"
    return str(value)
