"""summary.yaml: the last file that a run writes, so the run is finished when it is there."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Optional

import numpy as np
import yaml

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.session.atomic import write_text
from embodied_active_learning.session.session import Session


@dataclass(frozen=True)
class Summary:
    """What came out of a run. None where the run was too short to tell."""

    finished: bool
    steps: int
    updates: int
    wall_time: float  # [s]
    active_units: Optional[float] = None
    ergodic_measure: Optional[float] = None  # [nat]
    coverage: Optional[float] = None
    distance: Optional[float] = None  # [m]
    mse_own: Optional[float] = None  # of pixels in [0, 1], each image decoded from its own latent
    mse_shuffled: Optional[float] = None  # ... from another image's latent
    mse_none: Optional[float] = None  # ... from the mean of the prior


def summarise(session: Session, finished: bool, wall_time: float) -> Summary:
    """The summary of a session's tables; wall_time in seconds."""
    exploration, training, evaluation = (session.read_table(name) for name in ("exploration", "training", "evaluation"))
    return Summary(
        finished=finished,
        steps=len(exploration["step"]),
        updates=int(_last(training, "update") or 0),
        wall_time=round(float(wall_time), 3),
        **{name: _last(evaluation, name) for name in ("active_units", "mse_own", "mse_shuffled", "mse_none")},
        **{name: _last(exploration, name) for name in ("ergodic_measure", "coverage", "distance")},
    )


def write_summary(path: Path, summary: Summary) -> None:
    """Write a summary atomically."""
    write_text(Path(path), yaml.safe_dump(dataclasses.asdict(summary), sort_keys=False))


def read_summary(path: Path) -> Summary:
    """Read a summary. Raises CorruptFileError naming the file and the field."""
    path = Path(path)
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CorruptFileError(f"{path} cannot be read ({error.strerror}): the run did not finish") from error
    except (yaml.YAMLError, ValueError) as error:
        raise CorruptFileError(f"{path} is not plain YAML ({error}): run again") from error
    names = [field.name for field in dataclasses.fields(Summary)]
    if not isinstance(content, dict) or sorted(content) != sorted(names):
        raise CorruptFileError(f"{path}: its fields are {list(content or ())}, expected {names}: run again")
    if content["finished"] not in (True, False):
        raise CorruptFileError(f"{path}: finished is {content['finished']!r}, expected true or false: run again")
    return Summary(**content)


def _last(table: Dict[str, np.ndarray], column: str) -> Optional[Any]:
    values = table[column]
    return float(values[-1]) if len(values) and math.isfinite(values[-1]) else None
