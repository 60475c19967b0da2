"""Limits of speed, acceleration and workspace, applied together to planar velocity commands.

The arm nodes call it once per control period. It is stateless: the caller keeps the last commanded velocity. Plain
floats are used because it runs in every physics step.
"""

from __future__ import annotations

import math
from typing import List, NamedTuple, Sequence, Tuple

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CommandError
from embodied_active_learning.workspace import STATE_NAMES

PLANNED_BRAKING = 0.9
"""Fraction of the acceleration limit with which braking is planned; the rest compensates deviations of the arm."""
# Share of the top speed below which a changed velocity is not reported.
_NOTICEABLE = 0.01
MIN_PERIOD = 1e-6
"""s: shorter periods are rejected."""
_MAX_PERIOD = 1.0  # s


class LegalVelocity(NamedTuple):
    """The velocity of one period (3,) [m/s, m/s, rad/s], and whether it was limited.

    It was limited if the speed limits or the workspace changed it noticeably, see MotionLimits.differ. A delay due to
    the acceleration limit does not count.
    """

    velocity: Tuple[float, ...]
    limited: bool


class _Axis(NamedTuple):
    lower: float  # m or rad
    upper: float
    top_speed: float  # per second
    acceleration: float  # per second squared
    noticeable: float  # per second: smallest reported change of speed


class MotionLimits:
    """Turns requested velocities into legal ones.

    On each axis, the result differs from the previous velocity by at most the acceleration limit times the period. It
    is within the speed limits if the previous velocity was, and otherwise brakes towards them. Speed is also limited
    such that the arm can always brake inside the workspace, so that acceleration limit and workspace never contradict
    each other. Outside the workspace each axis returns, within its speed limit, and comes to rest inside.
    """

    def __init__(
        self,
        lower: Sequence[float],
        upper: Sequence[float],
        top_speeds: Sequence[float],
        accelerations: Sequence[float],
    ) -> None:
        """Create limits of x, y and theta. Args: (3,) each in m, m, rad; speeds per s; accelerations per s^2."""
        self._axes = [
            _Axis(float(low), float(high), float(speed), float(acceleration), _NOTICEABLE * float(speed))
            for low, high, speed, acceleration in zip(lower, upper, top_speeds, accelerations)
        ]

    @classmethod
    def from_config(cls, config: Config, margin: float = 0.0) -> MotionLimits:
        """Create the limits of a configuration. margin: reduces the workspace on each side, normalised units."""
        box = config.workspace.box()
        arm = config.arm
        return cls(
            (box.lower + margin * box.scale).tolist(),
            (box.upper - margin * box.scale).tolist(),
            (arm.max_speed, arm.max_speed, arm.max_turn_rate),
            (arm.max_acceleration, arm.max_acceleration, arm.max_turn_acceleration),
        )

    @property
    def lower(self) -> Tuple[float, ...]:
        """Limits of the workspace. (3,) [m, m, rad]."""
        return tuple(axis.lower for axis in self._axes)

    @property
    def upper(self) -> Tuple[float, ...]:
        """Limits of the workspace. (3,) [m, m, rad]."""
        return tuple(axis.upper for axis in self._axes)

    def with_box(self, lower: Sequence[float], upper: Sequence[float]) -> MotionLimits:
        """Return the same limits of speed and acceleration in another box, (3,) [m, m, rad] each."""
        limits = MotionLimits.__new__(MotionLimits)
        limits._axes = [axis._replace(lower=low, upper=high) for axis, low, high in zip(self._axes, lower, upper)]
        return limits

    def clamp_speed(self, velocity: Sequence[float]) -> List[float]:
        """Scale a finite velocity (3,) down to the speed limits, keeping its direction."""
        largest = max(map(abs, velocity))
        if largest == 0.0:
            return list(velocity)
        # Divide by the largest component first, so that huge velocities do not overflow.
        excess = max(abs(speed / largest) / axis.top_speed for speed, axis in zip(velocity, self._axes))
        if largest * excess <= 1.0:
            return list(velocity)
        return [_between(speed / largest / excess, axis.top_speed) for speed, axis in zip(velocity, self._axes)]

    def next_velocity(
        self, pose: Sequence[float], previous: Sequence[float], requested: Sequence[float], period: float
    ) -> LegalVelocity:
        """Return the legal velocity closest to the requested one for the next period.

        Args:
            pose: (3,) pose at the beginning of the period [m, m, rad]; preferably the commanded one, because close to
                the border the noise of a measured pose becomes velocity.
            previous: (3,) velocity commanded for the previous period [m/s, m/s, rad/s].
            requested: (3,) requested velocity.
            period: Duration [s].

        Raises:
            CommandError: A number is not finite, or the period is outside 1e-6 to 1 s. The caller must then stop the
                arm by other means.
        """
        _check(pose, previous, requested, period)
        slowed = self.clamp_speed(requested)
        limited = self.differ(slowed, requested)
        legal = []
        for at, before, speed, axis in zip(pose, previous, slowed, self._axes):
            slowest = before - axis.acceleration * period
            fastest = before + axis.acceleration * period
            reachable = min(max(speed, slowest), fastest)
            inside = min(
                max(reachable, -_speed_to_stop_in(at - axis.lower, axis, period)),
                _speed_to_stop_in(axis.upper - at, axis, period),
            )
            limited |= abs(inside - reachable) > axis.noticeable
            legal.append(min(max(inside, slowest), fastest))
        return LegalVelocity(tuple(legal), limited)

    def approach(self, pose: Sequence[float], target: Sequence[float], period: float) -> List[float]:
        """Return the velocity (3,) to request for the next period in order to go straight to a target and stop there.

        It is as fast as the limits allow; an arm that follows it from rest does not overshoot.

        Args:
            pose: (3,) [m, m, rad].
            target: (3,) [m, m, rad].
            period: Duration [s].
        """
        gaps = [goal - at for goal, at in zip(target, pose)]
        rates = [
            _speed_to_stop_in(abs(gap), axis, period) / abs(gap) for gap, axis in zip(gaps, self._axes) if gap != 0.0
        ]
        rate = min(rates, default=0.0)
        return [_between(rate * gap, axis.top_speed) for gap, axis in zip(gaps, self._axes)]

    def differ(self, one: Sequence[float], other: Sequence[float]) -> bool:
        """Return whether two velocities (3,) differ by more than 1 % of the top speed on any axis."""
        return any(abs(a - b) > axis.noticeable for a, b, axis in zip(one, other, self._axes))

    def braking_time(self, velocity: Sequence[float]) -> float:
        """Return the time to brake from a velocity (3,) [s]."""
        return max(abs(speed) / axis.acceleration for speed, axis in zip(velocity, self._axes))

    def travel_time(self, pose: Sequence[float], target: Sequence[float]) -> float:
        """Return an upper bound of the time from rest at a pose (3,) to rest at a target (3,) [s]."""
        return max(
            abs(goal - at) / axis.top_speed + axis.top_speed / (PLANNED_BRAKING * axis.acceleration)
            for goal, at, axis in zip(target, pose, self._axes)
        )


def _between(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


def _speed_to_stop_in(room: float, axis: _Axis, period: float) -> float:
    """Return the highest speed for one period after which an axis can still stop within the remaining room [m or rad].

    Both are negative outside the workspace, where the axis has to return.

    Braking reduces the speed by b = braking * period in each period. With u the speed of the first period and
    n = floor(u / b), it takes the distance period * ((n + 1) u - b n (n + 1) / 2), which is inverted here.
    """
    distance, top = abs(room), axis.top_speed
    braking = PLANNED_BRAKING * axis.acceleration
    if distance >= top * (0.5 * top / braking + period):  # never less than the braking distance from top speed
        return math.copysign(top, room)
    step = braking * period
    steps = int(0.5 * (math.sqrt(1.0 + 8.0 * distance / (step * period)) - 1.0))
    speed = (distance / period + 0.5 * step * steps * (steps + 1)) / (steps + 1)
    return math.copysign(min(speed, top), room)


def _check(pose: Sequence[float], previous: Sequence[float], requested: Sequence[float], period: float) -> None:
    axes = len(STATE_NAMES)
    for name, values in (("pose", pose), ("previous velocity", previous), ("requested velocity", requested)):
        try:
            usable = len(values) == axes and all(map(math.isfinite, values))
        except (TypeError, OverflowError):
            usable = False
        if not usable:
            raise CommandError(f"invalid {name} {values!r}: expected {axes} finite numbers")
    if not MIN_PERIOD <= period <= _MAX_PERIOD:
        raise CommandError(f"invalid period {period} s: expected {MIN_PERIOD:g} to {_MAX_PERIOD:g} s")
