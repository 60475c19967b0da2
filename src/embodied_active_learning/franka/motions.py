"""Motions that the driver can carry out: each advances the set-point by one period."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Callable, List, Sequence

from embodied_active_learning.franka.mount import CameraPose
from embodied_active_learning.franka.set_points import SetPointStream, Step


class SetPointMotion(ABC):
    """A motion, and how it has ended."""

    def __init__(self) -> None:
        self.aborted_by = ""  # why the motion has ended early
        self.needs_person = False  # whether only a person can resolve that
        self.limited = False

    @abstractmethod
    def step(self, stream: SetPointStream, measured: CameraPose, period: float) -> Step:
        """Advance the set-point by a period [s]."""


class Brake(SetPointMotion):
    """Brakes the set-point to rest and holds it."""

    def step(self, stream: SetPointStream, measured: CameraPose, period: float) -> Step:
        """See SetPointMotion."""
        return stream.brake(measured, period)


class Move(SetPointMotion):
    """Holds a planar velocity until a time, then brakes."""

    def __init__(self, velocity: List[float], ends_at: float, clock: Callable[[], float]) -> None:
        super().__init__()
        self._velocity, self._ends_at, self._clock = velocity, ends_at, clock

    def step(self, stream: SetPointStream, measured: CameraPose, period: float) -> Step:
        """See SetPointMotion."""
        if self._clock() >= self._ends_at:  # no further move has followed
            return stream.brake(measured, period)
        step = stream.advance(self._velocity, measured, period)
        self.limited |= step.limited
        return step


class GoTo(SetPointMotion):
    """Moves straight to a planar pose and stops there."""

    def __init__(self, target: Sequence[float]) -> None:
        super().__init__()
        self._target = target

    def step(self, stream: SetPointStream, measured: CameraPose, period: float) -> Step:
        """See SetPointMotion."""
        return stream.advance(stream.approach(self._target, period), measured, period)


class Retreat(SetPointMotion):
    """Brings the set-point to rest at the measured pose, which stops the arm sooner than braking."""

    def step(self, stream: SetPointStream, measured: CameraPose, period: float) -> Step:
        """See SetPointMotion."""
        return stream.retreat(measured, period)
