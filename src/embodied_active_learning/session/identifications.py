"""Results of an identification, in identification/<name>/: decisions, beliefs and trace."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple, get_type_hints

import numpy as np

from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.files import MAX_YAML_SIZE, FileReader
from embodied_active_learning.naming import check_name
from embodied_active_learning.objects.decision import OUTCOMES, Decision
from embodied_active_learning.objects.identification import Identification
from embodied_active_learning.objects.unknown import UnknownObject
from embodied_active_learning.schema import build, required
from embodied_active_learning.session.array_files import READER as ARRAY_READER
from embodied_active_learning.session.array_files import Arrays, read_finite_arrays, write_finite_arrays
from embodied_active_learning.session.atomic import make_folder, remove_leftovers, replace_folder, write_text
from embodied_active_learning.session.checksummed_yaml import checksummed_text, read_checksummed
from embodied_active_learning.session.paths import SessionPaths, stays_inside

FORMAT = "embodied_active_learning/decisions"
VERSION = 4
DECISIONS_FILE = "decisions.yaml"
TABLE_FILE = "decisions.csv"
UNKNOWN_FILE = "unknown.csv"
BELIEFS_FILE = "beliefs.safetensors"
TRACE_FILE = "trace.safetensors"
_POSE = ("x", "y", "theta")
_UNKNOWN_COLUMNS = ("x", "y", "area")
_READER = FileReader(CorruptFileError, "identify again")
_ARRAYS_READER = dataclasses.replace(_READER, limit=ARRAY_READER.limit)


@dataclass(frozen=True)
class StoredIdentification:
    """The decisions of one identification, and the images behind them."""

    name: str
    session: str  # session of the images
    images: int
    decisions: Tuple[Decision, ...]


@dataclass(frozen=True)
class _DecisionsFile:
    """The fields of decisions.yaml."""

    format: str = required("kind of the file")
    version: int = required("version of the format")
    name: str = required("name of the identification")
    images: int = required("number of images", low=0)
    session: str = required("session of the images")
    decisions: Tuple[Any, ...] = required("rows of _Row")


def _row_class() -> type:
    """Return a checked dataclass of a decision's plain fields: the pose as x, y, theta; None for an infinite value."""
    hints = {field.name: get_type_hints(Decision)[field.name] for field in dataclasses.fields(Decision)}
    plain = {name: Optional[kind] if name == "residual" else kind for name, kind in hints.items() if name != "pose"}
    return dataclasses.make_dataclass("_Row", [*plain.items(), *((name, float) for name in _POSE)], frozen=True)


_Row = _row_class()


def identification_folder(session_path: Path, name: str) -> Path:
    """Return the folder of an identification. Raises SessionError for an invalid name or a link out of the session."""
    folder = SessionPaths(session_path).identification / check_name(name, "name of the identification")
    return stays_inside(Path(session_path), folder)


def is_identified(session_path: Path, name: str) -> bool:
    """Return whether an identification of that name is complete. Raises SessionError like identification_folder."""
    return os.path.lexists(identification_folder(session_path, name) / DECISIONS_FILE)


def save_identification(
    session_path: Path,
    name: str,
    identification: Identification,
    decisions: Sequence[Decision],
    unknown: Sequence[UnknownObject] = (),
) -> Path:
    """Write an identification in place of an earlier one of the same name, whose figures are deleted.

    Returns:
        Its folder.

    Raises:
        SessionError: The disk failed; the earlier one is kept, unless the message says that the new one was written.
    """
    folder = identification_folder(session_path, name)
    facts = {"images": identification.image_count, "session": session_path.name}
    rows = [_plain(decision) for decision in decisions]
    text = checksummed_text({"format": FORMAT, "version": VERSION, "name": name, **facts, "decisions": rows})
    if len(text) > MAX_YAML_SIZE:
        raise SessionError(f"{len(rows)} decisions are too many for {folder}: search for fewer fingerprints")
    make_folder(folder.parent)
    remove_leftovers(folder.parent)
    with replace_folder(folder) as temporary:
        write_finite_arrays(temporary / BELIEFS_FILE, "beliefs", _beliefs(identification), facts)
        write_finite_arrays(temporary / TRACE_FILE, "trace", _trace(identification), facts)
        write_text(temporary / TABLE_FILE, _table([field.name for field in dataclasses.fields(_Row)], rows))
        write_text(temporary / UNKNOWN_FILE, _table(_UNKNOWN_COLUMNS, [_plain_unknown(item) for item in unknown]))
        write_text(temporary / DECISIONS_FILE, text)
    return folder


def load_identification(session_path: Path, name: str) -> StoredIdentification:
    """Read the decisions of a complete identification.

    Raises:
        SessionError: No identification has that name.
        CorruptFileError: It is damaged or of another version.
    """
    path = identification_folder(session_path, name) / DECISIONS_FILE
    if not os.path.lexists(path):
        raise SessionError(f"{path} is missing: no identification has that name, or it did not finish")
    stored = read_checksummed(path, _READER, FORMAT, VERSION)
    _READER.expect(path, stored, {"name": name})
    content = build(_DecisionsFile, stored, path, CorruptFileError, _READER.remedy)
    decisions = tuple(_decision(f"{path}: decision {index}", row) for index, row in enumerate(content.decisions))
    return StoredIdentification(name, content.session, content.images, decisions)


def load_trace(session_path: Path, name: str) -> Arrays:
    """Read the trace of every image: "<session>/<fingerprint>/view", distance, value (N,) and pose (N, 3)."""
    return read_finite_arrays(identification_folder(session_path, name) / TRACE_FILE, "trace", _ARRAYS_READER)[0]


def load_beliefs(session_path: Path, name: str) -> Arrays:
    """Read the belief grids: "<session>/<fingerprint>/mean" and std (nx, ny, nyaw); axes x, y [m] and yaw [rad]."""
    return read_finite_arrays(identification_folder(session_path, name) / BELIEFS_FILE, "beliefs", _ARRAYS_READER)[0]


def _beliefs(identification: Identification) -> Arrays:
    arrays: Arrays = {}
    for item in identification.targets:
        for axis in ("x", "y", "yaw"):
            arrays[axis] = getattr(item.grid, axis)
        for part in ("mean", "std"):
            name = f"{item.session}/{item.fingerprint.name}/{part}"
            arrays[name] = np.asarray(getattr(item.grid, part), np.float32)
    return arrays


def _trace(identification: Identification) -> Arrays:
    return {
        f"{item.session}/{item.fingerprint.name}/{field.name}": getattr(item.trace, field.name)
        for item in identification.targets
        for field in dataclasses.fields(item.trace)
    }


def _plain(decision: Decision) -> Dict[str, Any]:
    """Return a decision as numbers and texts: the pose as x, y [m] and theta [rad]; None for an infinite residual."""
    row = {field.name: getattr(decision, field.name) for field in dataclasses.fields(decision)}
    pose = row.pop("pose")
    row.update({name: round(float(value), 5) for name, value in zip(_POSE, pose)})
    for name, value in row.items():
        if isinstance(value, float):
            row[name] = round(value, 5) if math.isfinite(value) else None
    return row


def _plain_unknown(item: UnknownObject) -> Dict[str, Any]:
    """Return an unknown object without its picture: place [m] and area [m^2]."""
    x, y = map(float, item.place)
    return {"x": round(x, 5), "y": round(y, 5), "area": round(item.area, 6)}


def _decision(subject: str, row: Any) -> Decision:
    values = dataclasses.asdict(build(_Row, row, subject, CorruptFileError, _READER.remedy))
    if values["outcome"] not in OUTCOMES:
        raise CorruptFileError(f"{subject}: unknown outcome {values['outcome']!r}; {_READER.remedy}")
    pose = np.array([values.pop(name) for name in _POSE])
    values["residual"] = math.inf if values["residual"] is None else values["residual"]
    return Decision(pose=pose, **values)


def _table(columns: Sequence[str], rows: List[Dict[str, Any]]) -> str:
    """Return rows as CSV."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()
