"""What an arm may be asked to do, simulated or real: everything else is refused by name, with the arm as it was."""

from __future__ import annotations

from numbers import Real
from typing import List, Sequence

import numpy as np

from embodied_active_learning.errors import CommandError
from embodied_active_learning.workspace import STATE_NAMES, Workspace


def checked_velocity(velocity: Sequence[float]) -> List[float]:
    """Planar velocity (3,) m/s, m/s, rad/s as floats. Raises CommandError."""
    return _three_numbers(velocity, "velocity")


def checked_duration(duration: float, longest: float) -> float:
    """Seconds for which a velocity is held, longest at most. Raises CommandError."""
    if not (isinstance(duration, Real) and 0.0 < duration <= longest):
        raise CommandError(
            f"duration {duration!r} s is refused: give more than 0 and at most {longest:g} s (arm/max_duration)"
        )
    return float(duration)


def checked_pose(pose: Sequence[float], workspace: Workspace) -> np.ndarray:
    """Planar pose (3,) m, m, rad inside the workspace. Raises CommandError."""
    target = np.array(_three_numbers(pose, "pose"))
    if not workspace.contains(target, tolerance=1e-9):
        raise CommandError(
            f"pose {target.tolist()} is refused: it lies outside the workspace, "
            f"{list(workspace.lower)} to {list(workspace.upper)} for {', '.join(STATE_NAMES)}"
        )
    return target


def _three_numbers(values: Sequence[float], name: str) -> List[float]:
    """Three floats, or CommandError."""
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.empty(0)
    if numbers.shape != (len(STATE_NAMES),) or not np.isfinite(numbers).all():
        raise CommandError(f"{name} {values!r} is refused: give {len(STATE_NAMES)} finite numbers")
    return numbers.tolist()
