"""summary.yaml: the result of a run, written when the run finishes."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Dict, Optional

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.files import FileReader
from embodied_active_learning.model.verdict import judge_run
from embodied_active_learning.schema import build, to_plain
from embodied_active_learning.session.atomic import remove_file
from embodied_active_learning.session.checksummed_yaml import read_checksummed, write_checksummed

if TYPE_CHECKING:
    from embodied_active_learning.session.session import Session

_READER = FileReader(CorruptFileError, "the run did not finish, or the file was damaged; resume the run")


@dataclass(frozen=True)
class Summary:
    """Result of a run. None for values that the run was too short to compute."""

    finished: bool
    steps: int
    updates: int
    wall_time: float  # [s] of all launches
    active_units: Optional[float] = None
    ergodic_measure: Optional[float] = None  # [nat]
    coverage: Optional[float] = None
    distance: Optional[float] = None  # [m]
    mse_own: Optional[float] = None  # of pixels in [0, 1], each image decoded from its own latent
    mse_shuffled: Optional[float] = None  # ... from the latent of another image
    mse_none: Optional[float] = None  # ... from the mean of the prior
    verdict: str = ""  # "name: explanation", see judge_run


def summarise(session: Session, finished: bool, wall_time: float) -> Summary:
    """Return the summary of a session's tables.

    Args:
        session: The session.
        finished: Whether the run is complete.
        wall_time: Seconds of all launches.
    """
    exploration, training, evaluation = (session.read_table(name) for name in ("exploration", "training", "evaluation"))
    updates = int(_last(training, "update") or 0)
    errors = {name: _last(evaluation, name) for name in ("mse_own", "mse_shuffled", "mse_none")}
    ergodic_measure = _last(exploration, "ergodic_measure")
    return Summary(
        finished=finished,
        steps=len(exploration["step"]),
        updates=updates,
        wall_time=round(float(wall_time), 3),
        active_units=_last(evaluation, "active_units"),
        ergodic_measure=ergodic_measure,
        coverage=_last(exploration, "coverage"),
        distance=_last(exploration, "distance"),
        **errors,
        verdict=str(judge_run(updates, ergodic_measure=ergodic_measure, **errors)),
    )


def conclude_launch(session: Session, finished: bool, wall_time: float) -> Summary:
    """Write and return the summary at the end of a launch.

    Args:
        session: The session.
        finished: Whether the run is complete.
        wall_time: Seconds of this launch; those of earlier launches are added.
    """
    previous = _readable_summary(session.paths.summary)
    summary = summarise(session, finished, wall_time + (previous.wall_time if previous else 0.0))
    write_summary(session.paths.summary, summary)
    return summary


def reopen_summary(path: Path, config: Config) -> None:
    """Mark a stored summary as unfinished if the run is to continue beyond it. Its wall time is kept."""
    previous = _readable_summary(path)
    if previous is None:
        remove_file(path)
    elif previous.steps < config.exploration.steps or previous.updates < config.updates_planned:
        write_summary(path, replace(previous, finished=False))


def write_summary(path: Path, summary: Summary) -> None:
    """Write a summary atomically."""
    write_checksummed(Path(path), to_plain(summary))


def read_summary(path: Path) -> Summary:
    """Read a summary. Raises CorruptFileError naming the file and the field."""
    return build(Summary, read_checksummed(Path(path), _READER), path, CorruptFileError, _READER.remedy)


def _readable_summary(path: Path) -> Optional[Summary]:
    """Return a stored summary; None if it is missing or damaged."""
    try:
        return read_summary(path) if os.path.lexists(path) else None
    except CorruptFileError:
        return None


def _last(table: Dict[str, np.ndarray], column: str) -> Optional[float]:
    values = table[column]
    return float(values[-1]) if len(values) and math.isfinite(values[-1]) else None
