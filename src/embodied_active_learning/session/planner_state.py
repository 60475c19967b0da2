"""What the planner knows when it hands over an observation, so that another one can go on as if it were the same."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Optional, Tuple

import numpy as np

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.files import FileReader
from embodied_active_learning.session.array_files import read_arrays, write_arrays

_KIND = "planner"
_RUN = "run/"
_OWN = ("state", "velocity")
_REMEDY = "delete it; the planner then goes on from the stored observations, with other random draws"
_READER = FileReader(CorruptFileError, _REMEDY, limit=2**30)


@dataclass(frozen=True)
class PlannerState:
    """A planner with an observation in its hands: nobody can tell yet whether the trainer has stored it."""

    index: int  # of the observation, from 0
    stamp: Tuple[int, int]  # s, ns: when it was taken
    state: np.ndarray  # (3,) m, m, rad: where
    velocity: np.ndarray  # (3,) m/s, m/s, rad/s
    run: Dict[str, np.ndarray]  # the exploration's memory before it


def save_memory(path: Path, memory: PlannerState) -> None:
    """Write a memory in place of the one before. Raises SessionError when the disk fails."""
    arrays = {name: np.asarray(getattr(memory, name), dtype=np.float64) for name in _OWN}
    arrays.update({f"{_RUN}{name}": array for name, array in memory.run.items()})
    write_arrays(path, _KIND, arrays, {"index": memory.index, "stamp": list(memory.stamp)})


def load_memory(path: Path) -> Optional[PlannerState]:
    """The memory that was written last; None when there is none. Raises CorruptFileError naming file and field."""
    if not os.path.lexists(path):
        return None
    arrays, facts = read_arrays(path, _KIND, _READER)
    for name in _OWN:
        array = arrays.get(name)
        legal = array is not None and array.dtype == np.float64 and np.all(np.isfinite(array))
        if not legal or array.shape != (3,):
            raise CorruptFileError(f"{path}: {name} is not finite numbers of the right shape: {_REMEDY}")
    index, stamp = facts.get("index"), facts.get("stamp")
    if type(index) is not int or index < 0:
        raise CorruptFileError(f"{path}: index is {index!r}, expected a number from 0: {_REMEDY}")
    if not (isinstance(stamp, list) and len(stamp) == 2 and all(type(part) is int and part >= 0 for part in stamp)):
        raise CorruptFileError(f"{path}: stamp is {stamp!r}, expected seconds and nanoseconds: {_REMEDY}")
    run = {name[len(_RUN) :]: array for name, array in arrays.items() if name.startswith(_RUN)}
    return PlannerState(index, (stamp[0], stamp[1]), arrays["state"], arrays["velocity"], run)
