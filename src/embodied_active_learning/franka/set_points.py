"""Stream of set-points for an impedance controller: planar velocities integrated within all limits."""

from __future__ import annotations

import math
from typing import List, NamedTuple, Optional, Sequence, Tuple

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CommandError
from embodied_active_learning.franka.mount import CameraPose
from embodied_active_learning.motion_limits import MotionLimits

_MARGIN = 3e-3
"""Margin inside the workspace (normalised): periods of wall time vary, and braking is planned with the present one."""
_LEVEL_SPEED, _LEVEL_TURN_RATE = 0.02, 0.1  # m/s, rad/s: of corrections of height and tilt
_LEVEL_ACCELERATION, _LEVEL_TURN_ACCELERATION = 0.1, 0.5  # m/s^2, rad/s^2
MAX_PERIOD = 0.02
"""s: longer ticks count as this, so that a late tick slows the arm and never makes it jump."""
_REST = (0.0, 0.0, 0.0)


class Step(NamedTuple):
    """Whether limits changed the requested velocity, and whether the arm was displaced beyond franka/max_lead."""

    limited: bool
    displaced: bool


class Tracking(NamedTuple):
    """A set-point with its velocity (3,) [m/s, m/s, rad/s], and the measured pose that has to follow it."""

    set_point: CameraPose
    velocity: Tuple[float, ...]
    measured: CameraPose


class SetPointStream:
    """Integrates planar velocities into set-points, with the limits of speed, acceleration and workspace.

    A set-point is never farther from the measured pose than franka/max_lead along each of x, y and z, and
    franka/max_turn_lead about each: if the arm is blocked, the set-point waits and does not wind up. Height and tilt
    are held; their initial errors are corrected slowly. If the arm is pushed farther away, it moves the set-point
    along; only this is not limited in speed, because it reduces the force.
    """

    def __init__(self, config: Config) -> None:
        franka = config.franka
        self._limits = MotionLimits.from_config(config, _MARGIN)
        self._workspace = config.workspace.box()
        self._level_limits = level_limits()
        self._leads = (franka.max_lead, franka.max_lead, franka.max_turn_lead)
        self._level_leads = (franka.max_lead, franka.max_turn_lead, franka.max_turn_lead)
        self._planar: List[float] = []
        self._velocity: Sequence[float] = _REST
        self._level: List[float] = []  # errors of height and tilt
        self._level_velocity: Sequence[float] = _REST

    @property
    def limits(self) -> MotionLimits:
        """Limits of the set-points in x, y and theta."""
        return self._limits

    @property
    def set_point(self) -> Optional[CameraPose]:
        """The newest set-point; None before `begin`."""
        if not self._planar:
            return None
        return CameraPose(tuple(self._planar), self._level[0], (self._level[1], self._level[2]))

    @property
    def velocity(self) -> Tuple[float, ...]:
        """Velocity (3,) of the set-point, m/s, m/s, rad/s."""
        return tuple(self._velocity)

    def begin(self, measured: CameraPose) -> None:
        """Start at the measured pose, at rest: no force acts."""
        self._planar, self._level = list(measured.planar), [measured.height, *measured.tilt]
        self._velocity = self._level_velocity = _REST

    def end(self) -> None:
        """Discard the set-point."""
        self._planar, self._level = [], []
        self._velocity = self._level_velocity = _REST

    def lead(self, measured: CameraPose) -> Tuple[float, float]:
        """Return the distance of the set-point from a measured pose: m, in the plane, and rad."""
        x, y, theta = (goal - at for goal, at in zip(self._planar, measured.planar))
        return math.hypot(x, y), abs(math.remainder(theta, 2.0 * math.pi))

    def approach(self, target: Sequence[float], period: float) -> List[float]:
        """Return the velocity (3,) for a period [s] that leads straight to a target (3,), and stops there."""
        return self._limits.approach(self._planar, target, period)

    def advance(self, requested: Sequence[float], measured: CameraPose, period: float) -> Step:
        """Advance the set-point for a period [s] at the legal velocity closest to a requested one (3,).

        Raises CommandError for values that are not finite, and before `begin`.
        """
        lower, upper = self._box(measured)
        boxed = [
            _common(low, high, inner_low, inner_high)
            for low, high, inner_low, inner_high in zip(lower, upper, self._limits.lower, self._limits.upper)
        ]
        return self._move(
            requested, [low for low, _ in boxed], [high for _, high in boxed], measured, period, level=True
        )

    def brake(self, measured: CameraPose, period: float) -> Step:
        """Brake the set-point for a period [s]; from outside the workspace it is not led back."""
        lower, upper = self._box(measured)
        return self._move(_REST, lower, upper, measured, period, level=False)

    def retreat(self, measured: CameraPose, period: float) -> Step:
        """Bring the set-point to rest at the measured pose, which stops the arm sooner than braking."""
        lower, upper = self._box(measured)
        target = [(low + high) / 2.0 for low, high in zip(lower, upper)]
        return self._move(self.approach(target, period), lower, upper, measured, period, level=False)

    def _move(
        self,
        requested: Sequence[float],
        lower: Sequence[float],
        upper: Sequence[float],
        measured: CameraPose,
        period: float,
        level: bool,
    ) -> Step:
        if not self._planar:
            raise CommandError("no set-point: no pose of the robot has been received yet")
        period = min(period, MAX_PERIOD)
        legal = self._limits.with_box(lower, upper).next_velocity(self._planar, self._velocity, requested, period)
        self._velocity = legal.velocity
        moved = [
            self._stay_inside(axis, at, at + period * speed)
            for axis, (at, speed) in enumerate(zip(self._planar, legal.velocity))
        ]
        self._planar = [min(max(at, low), high) for at, low, high in zip(moved, *self._box(measured))]
        displaced = self._planar != moved
        self._correct_level(measured, period, level)
        return Step(legal.limited or displaced, displaced)

    def _stay_inside(self, axis: int, before: float, after: float) -> float:
        """Return a new place of an axis, which does not leave the workspace.

        Beyond the margin, a period that is longer than the planned ones would carry it some micrometres outside.
        """
        lower, upper = float(self._workspace.lower[axis]), float(self._workspace.upper[axis])
        return min(max(after, lower), upper) if lower <= before <= upper else after

    def _correct_level(self, measured: CameraPose, period: float, correct: bool) -> None:
        at = (measured.height, *measured.tilt)
        lower = [middle - lead for middle, lead in zip(at, self._level_leads)]
        upper = [middle + lead for middle, lead in zip(at, self._level_leads)]
        requested = self._level_limits.approach(self._level, _REST, period) if correct else _REST
        limits = self._level_limits.with_box(lower, upper)
        self._level_velocity = limits.next_velocity(self._level, self._level_velocity, requested, period).velocity
        moved = [place + period * speed for place, speed in zip(self._level, self._level_velocity)]
        self._level = [min(max(place, low), high) for place, low, high in zip(moved, lower, upper)]

    def _box(self, measured: CameraPose) -> Tuple[List[float], List[float]]:
        """Return the box around a measured pose that must contain the set-point: lower and upper, (3,) each."""
        x, y, theta = measured.planar
        here = self._planar[2] if self._planar else theta
        middle = (x, y, here + math.remainder(theta - here, 2.0 * math.pi))
        return (
            [at - lead for at, lead in zip(middle, self._leads)],
            [at + lead for at, lead in zip(middle, self._leads)],
        )


def level_limits() -> MotionLimits:
    """Return the limits of corrections of height [m] and of tilt about x and y [rad]."""
    return MotionLimits(
        _REST,
        _REST,
        (_LEVEL_SPEED, _LEVEL_TURN_RATE, _LEVEL_TURN_RATE),
        (_LEVEL_ACCELERATION, _LEVEL_TURN_ACCELERATION, _LEVEL_TURN_ACCELERATION),
    )


def _common(low: float, high: float, inner_low: float, inner_high: float) -> Tuple[float, float]:
    """Return [low, high] intersected with [inner_low, inner_high], or the nearest point of it if they are disjoint."""
    if low > inner_high:
        return low, low
    if high < inner_low:
        return high, high
    return max(low, inner_low), min(high, inner_high)
