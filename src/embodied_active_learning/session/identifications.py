"""What an identification has found: decisions to read, beliefs and trace to look into, below identification/<name>/."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Sequence, Tuple

import torch
import yaml

from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.objects.identification import Decision, Identification
from embodied_active_learning.session.atomic import remove_leftovers, write_text
from embodied_active_learning.session.names import SessionPaths, check_name
from embodied_active_learning.session.tensor_files import read_tensors, write_tensors

FORMAT = "embodied_active_learning/decisions"
VERSION = 1
DECISIONS_FILE = "decisions.yaml"
TABLE_FILE = "decisions.csv"
BELIEFS_FILE = "beliefs.safetensors"
TRACE_FILE = "trace.safetensors"
LARGEST_DECISIONS = 2**24  # bytes
_POSE = ("x", "y", "theta")


@dataclass(frozen=True)
class Identified:
    """The decisions of one identification, and what they rest on."""

    name: str
    session: str  # whose images were looked at
    images: int
    decisions: Tuple[Decision, ...]


def identification_folder(session_path: Path, name: str) -> Path:
    """Where an identification of a session is kept. Raises SessionError for a name that is not allowed."""
    return SessionPaths(session_path).identification / check_name(name, "name of the identification")


def save_identification(
    session_path: Path, name: str, identification: Identification, decisions: Sequence[Decision]
) -> Path:
    """Write everything about an identification -> its folder. The decisions come last: without them it is not finished.

    An earlier one of the same name is replaced. Raises SessionError when the disk fails.
    """
    folder = identification_folder(session_path, name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder)
        for stale in (folder / DECISIONS_FILE, *folder.glob("*.png")):
            stale.unlink(missing_ok=True)
    except OSError as error:
        raise SessionError(
            f"{folder} cannot be written ({error.strerror}): free some space, or mend its rights"
        ) from error
    facts = {"images": identification.images, "session": session_path.name}
    beliefs, trace = _beliefs(identification), _trace(identification)
    write_tensors(folder / BELIEFS_FILE, "beliefs", beliefs, facts)
    write_tensors(folder / TRACE_FILE, "trace", trace, facts)
    rows = [_plain(decision) for decision in decisions]
    write_text(folder / TABLE_FILE, _table(rows))
    content = {"format": FORMAT, "version": VERSION, "name": name, **facts, "decisions": rows}
    write_text(folder / DECISIONS_FILE, yaml.safe_dump(content, sort_keys=False))
    return folder


def load_identification(session_path: Path, name: str) -> Identified:
    """The decisions of a finished one. Raises SessionError when there is none, CorruptFileError when it is damaged."""
    path = identification_folder(session_path, name) / DECISIONS_FILE
    if not path.is_file():
        raise SessionError(f"{path} is missing: there is no identification of that name, or it did not finish")
    content = _read_yaml(path)
    for field, expected in (("format", FORMAT), ("version", VERSION), ("name", name)):
        if content.get(field) != expected:
            raise CorruptFileError(f"{path}: {field} is {content.get(field)!r}, expected {expected!r}: identify again")
    if type(content.get("images")) is not int or not isinstance(content.get("decisions"), list):
        raise CorruptFileError(f"{path}: images or decisions are not what they should be: identify again")
    decisions = tuple(_decision(path, index, row) for index, row in enumerate(content["decisions"]))
    return Identified(name, str(content.get("session")), content["images"], decisions)


def load_trace(session_path: Path, name: str) -> Dict[str, torch.Tensor]:
    """The trace of every image: "<session>/<fingerprint>/view", distance, value (N,) and pose (N, 3), on the CPU."""
    tensors, _ = read_tensors(identification_folder(session_path, name) / TRACE_FILE, "trace")
    return tensors


def load_beliefs(session_path: Path, name: str) -> Dict[str, torch.Tensor]:
    """The belief grids: "<session>/<fingerprint>/mean" and std (nx, ny, nyaw), and the axes x, y (m) and yaw (rad)."""
    tensors, _ = read_tensors(identification_folder(session_path, name) / BELIEFS_FILE, "beliefs")
    return tensors


def _beliefs(identification: Identification) -> Dict[str, torch.Tensor]:
    tensors: Dict[str, torch.Tensor] = {}
    for item in identification.sought:
        for axis in ("x", "y", "yaw"):
            tensors[axis] = torch.from_numpy(getattr(item.grid, axis))
        for part in ("mean", "std"):
            tensors[f"{item.session}/{item.fingerprint.name}/{part}"] = torch.from_numpy(
                getattr(item.grid, part)
            ).float()
    return tensors


def _trace(identification: Identification) -> Dict[str, torch.Tensor]:
    tensors = {}
    for item in identification.sought:
        trace = item.trace
        for field in dataclasses.fields(trace):
            values = torch.from_numpy(getattr(trace, field.name))
            tensors[f"{item.session}/{item.fingerprint.name}/{field.name}"] = values
    return tensors


def _plain(decision: Decision) -> Dict[str, Any]:
    """A decision as numbers and texts: the pose as x, y [m] and theta [rad]; no mismatch where no view was compared."""
    row = {field.name: getattr(decision, field.name) for field in dataclasses.fields(decision)}
    pose = row.pop("pose")
    row.update({name: round(float(value), 5) for name, value in zip(_POSE, pose)})
    for name, value in row.items():
        if isinstance(value, float):
            row[name] = round(value, 5) if math.isfinite(value) else None
    return row


def _decision(path: Path, index: int, row: Any) -> Decision:
    """A decision as it was written. Raises CorruptFileError."""
    try:
        values = dict(row)
        pose = [float(values.pop(name)) for name in _POSE]
        values["mismatch"] = math.inf if values["mismatch"] is None else float(values["mismatch"])
        return Decision(pose=torch.tensor(pose, dtype=torch.float64).numpy(), **values)
    except (TypeError, ValueError, KeyError) as error:
        raise CorruptFileError(f"{path}: decision {index} is damaged ({error}): identify again") from error


def _table(rows: List[Dict[str, Any]]) -> str:
    stream = io.StringIO()
    names = list(rows[0]) if rows else []
    writer = csv.DictWriter(stream, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def _read_yaml(path: Path) -> Dict[str, Any]:
    if path.stat().st_size > LARGEST_DECISIONS:
        raise CorruptFileError(f"{path} is larger than any table of decisions: identify again")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError, ValueError) as error:
        raise CorruptFileError(f"{path} is not plain YAML ({error}): identify again") from error
    if not isinstance(content, dict):
        raise CorruptFileError(f"{path} is a {type(content).__name__}, expected fields: identify again")
    return content
