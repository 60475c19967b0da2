"""Motion commands of simulated and real arms: validation before anything moves, and the signal that ends them."""

from __future__ import annotations

import threading
from numbers import Real
from typing import List, Sequence

import numpy as np

from embodied_active_learning.errors import CommandError
from embodied_active_learning.workspace import STATE_NAMES, Workspace


class StopSignal:
    """Set when a node stops the arm during a command; checked by arms whose commands take time."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._by = ""

    @property
    def by(self) -> str:
        """Name of the node that stopped the arm."""
        return self._by

    def is_set(self) -> bool:
        """Whether the command must end at once."""
        return self._event.is_set()

    def set(self, by: str) -> None:
        """End the command on behalf of a node."""
        self._by = by
        self._event.set()


def checked_velocity(velocity: Sequence[float]) -> List[float]:
    """Return a planar velocity (3,) [m/s, m/s, rad/s] as floats. Raises CommandError if it is invalid."""
    return _three_numbers(velocity, "velocity")


def checked_duration(duration: float, longest: float) -> float:
    """Return the duration of a velocity command [s]. Raises CommandError unless it is in (0, longest]."""
    if not (isinstance(duration, Real) and 0.0 < duration <= longest):
        raise CommandError(
            f"invalid duration {duration!r} s: expected more than 0 and at most {longest:g} s (arm/max_duration)"
        )
    return float(duration)


def checked_pose(pose: Sequence[float], workspace: Workspace) -> np.ndarray:
    """Return a planar pose (3,) [m, m, rad]. Raises CommandError if it is invalid or outside the workspace."""
    target = np.array(_three_numbers(pose, "pose"))
    if not workspace.contains(target, tolerance=1e-9):
        raise CommandError(
            f"invalid pose {target.tolist()}: outside the workspace, "
            f"{list(workspace.lower)} to {list(workspace.upper)} for {', '.join(STATE_NAMES)}"
        )
    return target


def _three_numbers(values: Sequence[float], name: str) -> List[float]:
    """Return three floats. Raises CommandError."""
    numbers: np.ndarray
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.empty(0)
    if numbers.shape != (len(STATE_NAMES),) or not np.isfinite(numbers).all():
        raise CommandError(f"invalid {name} {values!r}: expected {len(STATE_NAMES)} finite numbers")
    return [float(number) for number in numbers]
