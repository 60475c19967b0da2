"""summary.yaml: the result of a run, written when the run finishes or is interrupted (finished: false)."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Optional

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.files import FileReader
from embodied_active_learning.schema import build, to_plain
from embodied_active_learning.session.atomic import remove_file
from embodied_active_learning.session.checksummed_yaml import read_checksummed, write_checksummed

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
    ended: str = ""  # why the run ended before exploration/steps, see StopCheck.reason
    verdict: str = ""  # "name: explanation", see judge_run


def reopen_summary(path: Path, config: Config) -> None:
    """Mark a stored summary as unfinished if the run is to continue beyond it. Its wall time is kept."""
    previous = readable_summary(path)
    if previous is None:
        remove_file(path)
    elif config.may_stop_early and previous.ended:
        return
    elif previous.steps < config.exploration.steps or previous.updates < config.update_plan.total:
        write_summary(path, replace(previous, finished=False))


def write_summary(path: Path, summary: Summary) -> None:
    """Write a summary atomically."""
    write_checksummed(Path(path), to_plain(summary))


def read_summary(path: Path) -> Summary:
    """Read a summary. Raises CorruptFileError naming the file and the field."""
    return build(Summary, read_checksummed(Path(path), _READER), path, CorruptFileError, _READER.remedy)


def readable_summary(path: Path) -> Optional[Summary]:
    """Return a stored summary; None if it is missing or damaged."""
    try:
        return read_summary(path) if os.path.lexists(path) else None
    except CorruptFileError:
        return None
