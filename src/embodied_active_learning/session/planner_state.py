"""planner.safetensors: the state of the planner with its newest observation, from which it resumes exactly."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Optional, Tuple

import numpy as np

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.files import FileReader
from embodied_active_learning.schema import build, required
from embodied_active_learning.session.array_files import read_arrays, write_arrays

_KIND = "planner"
_RUN = "run/"
_ARRAYS = ("state", "velocity")
_REMEDY = "delete it; the planner then resumes from the stored observations, with other random draws"
_READER = FileReader(CorruptFileError, _REMEDY, limit=2**30)


@dataclass(frozen=True)
class PlannerState:
    """The planner's state just before it sends an observation; the trainer may or may not have stored it."""

    index: int  # of the observation, from 0
    stamp: Tuple[int, int]  # s, ns: time of the observation
    state: np.ndarray  # (3,) m, m, rad
    velocity: np.ndarray  # (3,) m/s, m/s, rad/s
    run: Dict[str, np.ndarray]  # state_dict of the exploration before the observation


@dataclass(frozen=True)
class _Facts:
    """The facts of the file."""

    index: int = required("observation", low=0)
    stamp: Tuple[int, ...] = required("seconds and nanoseconds", low=0, length=2)


def save_planner_state(path: Path, planner: PlannerState) -> None:
    """Replace the stored state. Raises SessionError if the disk fails."""
    arrays: Dict[str, np.ndarray] = {name: np.asarray(getattr(planner, name), dtype=np.float64) for name in _ARRAYS}
    arrays.update({f"{_RUN}{name}": array for name, array in planner.run.items()})
    write_arrays(path, _KIND, arrays, {"index": planner.index, "stamp": list(planner.stamp)})


def load_planner_state(path: Path) -> Optional[PlannerState]:
    """Return the stored state; None before the first observation. Raises CorruptFileError naming file and field."""
    if not os.path.lexists(path):
        return None
    arrays, stored = read_arrays(path, _KIND, _READER)
    for name in _ARRAYS:
        array = arrays.get(name)
        if array is None or array.dtype != np.float64 or array.shape != (3,) or not np.all(np.isfinite(array)):
            raise _READER.make_error(f"{path}:", f"{name} is missing, not finite, or of the wrong shape")
    facts = build(_Facts, stored, path, CorruptFileError, _REMEDY)
    run = {name[len(_RUN) :]: array for name, array in arrays.items() if name.startswith(_RUN)}
    seconds, nanoseconds = facts.stamp
    return PlannerState(facts.index, (seconds, nanoseconds), arrays["state"], arrays["velocity"], run)
