"""Which velocity an arm may have next: the limits of speed, acceleration and workspace, kept together.

For whoever streams planar velocities to an arm, simulated or real, one call a period. Nothing is remembered here: the
caller keeps the velocity that it commanded last. Every physics step comes through here, so numbers are plain floats.
"""

from __future__ import annotations

import math
from typing import List, NamedTuple, Sequence, Tuple

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CommandError
from embodied_active_learning.workspace import STATE_NAMES

# Braking is planned with this part of the acceleration. What is left holds the border when the arm strays from its
# command by a little.
_PLANNED_BRAKING = 0.9
# A smaller part of the top speed than this is what an arm strays anyway, and no change that a user should hear of.
_NOTICEABLE = 0.01
_SHORTEST_PERIOD, _LONGEST_PERIOD = 1e-6, 1.0  # s


class LegalVelocity(NamedTuple):
    """What an arm may do for a period: a velocity (3,) m/s, m/s, rad/s, and whether it was cut.

    Cut means that the speed limits or the workspace changed it noticeably, see MotionLimits.differ. That it takes some
    time to reach a velocity is no cut.
    """

    velocity: Tuple[float, ...]
    cut: bool


class _Axis(NamedTuple):
    lower: float  # m or rad
    upper: float
    top_speed: float  # per second
    acceleration: float  # per second squared
    noticeable: float  # per second: the smallest change of speed to tell of


class MotionLimits:
    """Turns wanted velocities into ones that an arm may have, whatever is wanted.

    What comes out never differs from the previous velocity by more than the acceleration limit times the period, on any
    axis. It is within the speed limits when the previous velocity is, and else brakes towards them. And an arm that
    moves as commanded can always still brake inside the workspace, because no axis is ever faster than that: so
    acceleration limit and workspace never contradict each other. From outside the workspace every axis leads back, no
    faster than its speed limit, and comes to rest inside.
    """

    def __init__(
        self,
        lower: Sequence[float],
        upper: Sequence[float],
        top_speeds: Sequence[float],
        accelerations: Sequence[float],
    ) -> None:
        """Limits of x, y and theta, (3,) each: m, m, rad; their speeds per s, accelerations per s^2."""
        self._axes = [
            _Axis(float(low), float(high), float(speed), float(acceleration), _NOTICEABLE * float(speed))
            for low, high, speed, acceleration in zip(lower, upper, top_speeds, accelerations)
        ]

    @classmethod
    def from_config(cls, config: Config, margin: float = 0.0) -> MotionLimits:
        """The limits of arm/ and workspace/, the workspace smaller by a margin (normalised units) on every side."""
        box = config.workspace.box()
        arm = config.arm
        return cls(
            box.lower + margin * box.scale,
            box.upper - margin * box.scale,
            (arm.max_speed, arm.max_speed, arm.max_turn_rate),
            (arm.max_acceleration, arm.max_acceleration, arm.max_turn_acceleration),
        )

    @property
    def lower(self) -> Tuple[float, ...]:
        """(3,) m, m, rad."""
        return tuple(axis.lower for axis in self._axes)

    @property
    def upper(self) -> Tuple[float, ...]:
        """(3,) m, m, rad."""
        return tuple(axis.upper for axis in self._axes)

    def within(self, lower: Sequence[float], upper: Sequence[float]) -> MotionLimits:
        """The same limits of speed and acceleration in another box, (3,) m, m, rad each."""
        limits = MotionLimits.__new__(MotionLimits)
        limits._axes = [axis._replace(lower=low, upper=high) for axis, low, high in zip(self._axes, lower, upper)]
        return limits

    def slowed(self, velocity: Sequence[float]) -> List[float]:
        """A velocity (3,) of finite numbers in its own direction, at the highest legal speed at most."""
        largest = max(map(abs, velocity))
        if largest == 0.0:
            return list(velocity)
        # By its largest number first: an absurd velocity must not overflow to infinity, and so to no direction.
        excess = max(abs(speed / largest) / axis.top_speed for speed, axis in zip(velocity, self._axes))
        if largest * excess <= 1.0:
            return list(velocity)
        return [_between(speed / largest / excess, axis.top_speed) for speed, axis in zip(velocity, self._axes)]

    def next_velocity(
        self, pose: Sequence[float], previous: Sequence[float], wanted: Sequence[float], period: float
    ) -> LegalVelocity:
        """The legal velocity closest to the wanted one, to be held for a period, s.

        pose (3,) m, m, rad is where the arm is as the period begins. Where the robot tells the pose that it was
        commanded to, give that one: close to the border, the noise of a measured pose becomes velocity. previous is
        the velocity that was commanded for the period before, wanted the one that is asked for, (3,) m/s, m/s, rad/s.

        Raises CommandError for numbers that are not finite, and for a period outside 1e-6 to 1 s: of those no velocity
        can be called legal, and the caller must bring the arm to rest by other means.
        """
        _check(pose, previous, wanted, period)
        slowed = self.slowed(wanted)
        cut = self.differ(slowed, wanted)
        legal = []
        for at, before, speed, axis in zip(pose, previous, slowed, self._axes):
            slowest = before - axis.acceleration * period
            fastest = before + axis.acceleration * period
            reachable = min(max(speed, slowest), fastest)
            inside = min(
                max(reachable, -_speed_to_stop_in(at - axis.lower, axis, period)),
                _speed_to_stop_in(axis.upper - at, axis, period),
            )
            cut |= abs(inside - reachable) > axis.noticeable
            legal.append(min(max(inside, slowest), fastest))
        return LegalVelocity(tuple(legal), cut)

    def approach(self, pose: Sequence[float], target: Sequence[float], period: float) -> List[float]:
        """The velocity (3,) to want for a period, s, at a pose (3,) in order to go straight to a target (3,), and stop.

        As fast as the limits allow; an arm that follows it from rest does not overshoot.
        """
        gaps = [goal - at for goal, at in zip(target, pose)]
        shares = [
            _speed_to_stop_in(abs(gap), axis, period) / abs(gap) for gap, axis in zip(gaps, self._axes) if gap != 0.0
        ]
        share = min(shares, default=0.0)
        return [_between(share * gap, axis.top_speed) for gap, axis in zip(gaps, self._axes)]

    def differ(self, one: Sequence[float], other: Sequence[float]) -> bool:
        """Whether two velocities (3,) differ by more than a hundredth of the top speed on any axis."""
        return any(abs(a - b) > axis.noticeable for a, b, axis in zip(one, other, self._axes))

    def braking_time(self, velocity: Sequence[float]) -> float:
        """Seconds that it takes to come to rest from a velocity (3,)."""
        return max(abs(speed) / axis.acceleration for speed, axis in zip(velocity, self._axes))

    def travel_time(self, pose: Sequence[float], target: Sequence[float]) -> float:
        """Seconds, at most, that it takes to go from rest at a pose (3,) to rest at a target (3,)."""
        return max(
            abs(goal - at) / axis.top_speed + axis.top_speed / (_PLANNED_BRAKING * axis.acceleration)
            for goal, at, axis in zip(target, pose, self._axes)
        )


def _between(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


def _speed_to_stop_in(room: float, axis: _Axis, period: float) -> float:
    """The highest legal speed, for one period, after which an axis can still stop within the room (m or rad).

    Negative where the room is: then the axis is outside, and has to come back by as much.

    Braking goes in steps, each period at a speed lower by b = braking * period. With u the speed of the first period
    and n = floor(u / b), it takes the distance period * ((n + 1) u - b n (n + 1) / 2), which is inverted here.
    """
    distance, top = abs(room), axis.top_speed
    braking = _PLANNED_BRAKING * axis.acceleration
    if distance >= top * (0.5 * top / braking + period):  # never less than the braking distance from top speed
        return math.copysign(top, room)
    step = braking * period
    steps = int(0.5 * (math.sqrt(1.0 + 8.0 * distance / (step * period)) - 1.0))
    speed = (distance / period + 0.5 * step * steps * (steps + 1)) / (steps + 1)
    return math.copysign(min(speed, top), room)


def _check(pose: Sequence[float], previous: Sequence[float], wanted: Sequence[float], period: float) -> None:
    axes = len(STATE_NAMES)
    for name, values in (("pose", pose), ("previous velocity", previous), ("wanted velocity", wanted)):
        try:
            usable = len(values) == axes and all(map(math.isfinite, values))
        except (TypeError, OverflowError):
            usable = False
        if not usable:
            raise CommandError(f"{name} {values!r} is refused: give {axes} finite numbers")
    if not _SHORTEST_PERIOD <= period <= _LONGEST_PERIOD:
        raise CommandError(f"period {period} s is refused: give {_SHORTEST_PERIOD:g} to {_LONGEST_PERIOD:g} s")
