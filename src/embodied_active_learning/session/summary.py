"""summary.yaml: the last file that a run writes, so the run is finished when it is there."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Optional

import numpy as np

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.files import FileReader, plain_types
from embodied_active_learning.session.checksummed_yaml import remove_seal, write_sealed
from embodied_active_learning.session.session import Session

_READER = FileReader(CorruptFileError, "the run did not finish, or its summary was damaged since; resume the run")


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
    write_sealed(Path(path), dataclasses.asdict(summary))


def read_summary(path: Path) -> Summary:
    """Read a summary. Raises CorruptFileError naming the file and the field."""
    path = Path(path)
    content = remove_seal(path, _READER.read_yaml(path), _READER)
    _READER.expect_types(path, content, plain_types(Summary))
    return Summary(**content)


def _last(table: Dict[str, np.ndarray], column: str) -> Optional[Any]:
    values = table[column]
    return float(values[-1]) if len(values) and math.isfinite(values[-1]) else None
