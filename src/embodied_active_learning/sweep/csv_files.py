"""CSV files of results with texts and numbers, of few digits so that they are small."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path
from typing import Dict, Iterable, List, Mapping

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.files import FileReader
from embodied_active_learning.session.atomic import make_folder, write_text

_READER = FileReader(CorruptFileError, "make the results again", limit=2**24)
_DIGITS = 6


def write_rows(path: Path, rows: Iterable[Mapping[str, object]]) -> None:
    """Write rows with the same columns atomically; NaN and None become empty. The folder is created."""
    listed = [{name: _text(value) for name, value in row.items()} for row in rows]
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(listed[0]) if listed else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(listed)
    make_folder(path.parent)
    write_text(path, stream.getvalue())


def read_rows(path: Path) -> List[Dict[str, str]]:
    """Return the rows of a file as texts. Raises CorruptFileError if it is missing."""
    return list(csv.DictReader(io.StringIO(_READER.read_text(path))))


def _text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, float):  # numpy's float64 included
        return "" if math.isnan(value) else f"{value:.{_DIGITS}g}"
    return str(value)
