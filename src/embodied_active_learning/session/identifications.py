"""What an identification has found: decisions to read, beliefs and trace to look into, below identification/<name>/."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np
import torch

from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.files import LARGEST_YAML, FileReader, plain_types
from embodied_active_learning.naming import check_name
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.identification import Identification
from embodied_active_learning.session.atomic import make_folder, remove_file, remove_leftovers, write_text
from embodied_active_learning.session.checksummed_yaml import check_version, remove_seal, sealed_text
from embodied_active_learning.session.paths import SessionPaths, stays_inside
from embodied_active_learning.session.tensor_files import read_tensors, write_tensors

FORMAT = "embodied_active_learning/decisions"
VERSION = 2  # since it has a checksum
DECISIONS_FILE = "decisions.yaml"
TABLE_FILE = "decisions.csv"
BELIEFS_FILE = "beliefs.safetensors"
TRACE_FILE = "trace.safetensors"
_POSE = ("x", "y", "theta")
_READER = FileReader(CorruptFileError, "identify again")


@dataclass(frozen=True)
class Identified:
    """The decisions of one identification, and what they rest on."""

    name: str
    session: str  # whose images were looked at
    images: int
    decisions: Tuple[Decision, ...]


def identification_folder(session_path: Path, name: str) -> Path:
    """Where an identification of a session is kept.

    Raises SessionError for a name that is not allowed, or when the place is a link out of the session.
    """
    folder = SessionPaths(session_path).identification / check_name(name, "name of the identification")
    return stays_inside(Path(session_path), folder)


def is_identified(session_path: Path, name: str) -> bool:
    """Whether there is a finished identification of that name. Raises SessionError as identification_folder does."""
    return os.path.lexists(identification_folder(session_path, name) / DECISIONS_FILE)


def save_identification(
    session_path: Path, name: str, identification: Identification, decisions: Sequence[Decision]
) -> Path:
    """Write everything about an identification -> its folder. The decisions come last: without them it is not finished.

    An earlier one of the same name is replaced. Raises SessionError when the disk fails.
    """
    folder = identification_folder(session_path, name)
    facts = {"images": identification.images, "session": session_path.name}
    rows = [_plain(decision) for decision in decisions]
    text = sealed_text({"format": FORMAT, "version": VERSION, "name": name, **facts, "decisions": rows})
    if len(text) > LARGEST_YAML:
        raise SessionError(f"{len(rows)} decisions would not be read back from {folder}: look for fewer fingerprints")
    make_folder(folder)
    remove_leftovers(folder)
    for stale in (folder / DECISIONS_FILE, *folder.glob("*.png")):
        remove_file(stale)
    write_tensors(folder / BELIEFS_FILE, "beliefs", _beliefs(identification), facts)
    write_tensors(folder / TRACE_FILE, "trace", _trace(identification), facts)
    write_text(folder / TABLE_FILE, _table(rows))
    write_text(folder / DECISIONS_FILE, text)
    return folder


def load_identification(session_path: Path, name: str) -> Identified:
    """The decisions of a finished one. Raises SessionError when there is none, CorruptFileError when it is damaged."""
    path = identification_folder(session_path, name) / DECISIONS_FILE
    if not os.path.lexists(path):
        raise SessionError(f"{path} is missing: there is no identification of that name, or it did not finish")
    content = _READER.read_yaml(path)
    _READER.expect(path, content, {"format": FORMAT, "name": name})
    check_version(path, content, VERSION, _READER)
    content = remove_seal(path, content, _READER)
    _READER.expect_types(path, content, _TYPES)
    decisions = tuple(_decision(path, index, row) for index, row in enumerate(content["decisions"]))
    return Identified(name, content["session"], content["images"], decisions)


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
    for item in identification.targets:
        for axis in ("x", "y", "yaw"):
            tensors[axis] = torch.from_numpy(getattr(item.grid, axis))
        for part in ("mean", "std"):
            tensors[f"{item.session}/{item.fingerprint.name}/{part}"] = torch.from_numpy(
                getattr(item.grid, part)
            ).float()
    return tensors


def _trace(identification: Identification) -> Dict[str, torch.Tensor]:
    tensors = {}
    for item in identification.targets:
        trace = item.trace
        for field in dataclasses.fields(trace):
            values = torch.from_numpy(getattr(trace, field.name))
            tensors[f"{item.session}/{item.fingerprint.name}/{field.name}"] = values
    return tensors


def _plain(decision: Decision) -> Dict[str, Any]:
    """A decision as numbers and texts: the pose as x, y [m] and theta [rad]; no residual where no view was compared."""
    row = {field.name: getattr(decision, field.name) for field in dataclasses.fields(decision)}
    pose = row.pop("pose")
    row.update({name: round(float(value), 5) for name, value in zip(_POSE, pose)})
    for name, value in row.items():
        if isinstance(value, float):
            row[name] = round(value, 5) if math.isfinite(value) else None
    return row


def _decision(path: Path, index: int, row: Any) -> Decision:
    """A decision as it was written. Raises CorruptFileError."""
    _READER.expect_types(f"{path}: decision {index}", row, _DECISION_TYPES)
    values = dict(row)
    pose = [float(values.pop(name)) for name in _POSE]
    values["residual"] = math.inf if values["residual"] is None else float(values["residual"])
    return Decision(pose=np.array(pose), **values)


def _decision_types() -> Dict[str, Tuple[type, ...]]:
    """The plain types of a decision's fields, as _plain writes them."""
    types = plain_types(Decision)
    del types["pose"]
    types.update(dict.fromkeys(_POSE, (float, int)), residual=(float, int, type(None)))
    return types


_TYPES = {
    "format": (str,), "version": (int,), "name": (str,), "images": (int,), "session": (str,), "decisions": (list,),
}  # fmt: skip
_DECISION_TYPES = _decision_types()


def _table(rows: List[Dict[str, Any]]) -> str:
    stream = io.StringIO()
    names = list(rows[0]) if rows else []
    writer = csv.DictWriter(stream, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()
