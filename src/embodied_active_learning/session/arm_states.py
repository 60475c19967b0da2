"""The newest states of a simulated arm by stamp, in memory and in the session's folder, so that a run can return."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Dict, List, Mapping, Tuple

import numpy as np

from embodied_active_learning.errors import CommandError, CorruptFileError
from embodied_active_learning.files import FileReader
from embodied_active_learning.session.array_files import read_arrays, write_arrays

KEPT = 100
"""Newest states that are kept."""
Stamp = Tuple[int, int]
"""Seconds and nanoseconds."""
_KIND = "arm_states"
_STAMPS = "stamps"
_READER = FileReader(CorruptFileError, "delete it; the arm then cannot return to states before its start", limit=2**24)


class ArmStates:
    """State dictionaries by stamp. The file is written only where the session's folder exists."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._states: Dict[Stamp, Dict[str, np.ndarray]] = {}

    @property
    def stamps(self) -> List[Stamp]:
        """Stamps of the states that are kept, oldest first."""
        return list(self._states)

    def load(self) -> None:
        """Read the states that an earlier arm has written, if there are any. Raises CorruptFileError."""
        if not os.path.lexists(self._path):
            return
        arrays, _ = read_arrays(self._path, _KIND, _READER)
        stamps = arrays.pop(_STAMPS, np.empty(0))
        if stamps.dtype != np.int64 or stamps.ndim != 2 or stamps.shape[1] != 2 or len(stamps) > KEPT:
            raise CorruptFileError(f"{self._path}: {_STAMPS} is malformed; {_READER.remedy}")
        if any(array.dtype != np.float64 or array.ndim != 2 or len(array) != len(stamps) for array in arrays.values()):
            raise CorruptFileError(f"{self._path}: expected one row of float64 for each stamp; {_READER.remedy}")
        for index, (seconds, nanoseconds) in enumerate(stamps.tolist()):
            self._states[seconds, nanoseconds] = {name: array[index] for name, array in arrays.items()}

    def add(self, stamp: Stamp, state: Mapping[str, np.ndarray]) -> None:
        """Keep the state at a stamp and drop the oldest beyond `KEPT`."""
        self._states.pop(stamp, None)
        self._states[stamp] = dict(state)
        while len(self._states) > KEPT:
            del self._states[next(iter(self._states))]

    def at(self, stamp: Stamp) -> Dict[str, np.ndarray]:
        """Return the state at a stamp. Raises CommandError if it is not kept."""
        if stamp not in self._states:
            raise CommandError(f"no saved arm state for the time {stamp[0]}.{stamp[1]:09d} s")
        return self._states[stamp]

    def write(self) -> None:
        """Write all states to the file. Raises SessionError if the disk fails."""
        if not self._path.parent.is_dir() or not self._states:
            return
        newest = next(reversed(self._states.values()))
        arrays = {name: np.array([state[name] for state in self._states.values()]) for name in newest}
        write_arrays(self._path, _KIND, {_STAMPS: np.array(list(self._states), dtype=np.int64), **arrays}, {})
