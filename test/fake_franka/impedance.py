"""Motion of a Panda under cartesian_impedance_example_controller: a spring and a damper pull the hand to a set-point.

The controller's target follows the latest set-point by FILTER of the distance each millisecond, and its stiffness
likewise the requested stiffness; its damping is 2 sqrt(stiffness). The torque is stiffness times the vector part of the
error quaternion, so stiffness sin(angle / 2). The hand is a mass and an inertia in place of the joints: no
singularities, gravity or Coriolis forces. In plain floats, because this runs for every millisecond.
"""

from __future__ import annotations

import math
from typing import List, Sequence, Tuple

STEP = 0.001  # s, of controller and robot
FILTER = 0.005  # of the distance to the set-point, each STEP
MASS = 4.0  # kg, effective at the hand; critical damping would need 1 kg
INERTIA = 0.1  # kg m^2 about every axis
BRAKING = 8.0  # m/s^2, of the robot's own stop
TURN_BRAKING = 40.0  # rad/s^2
_AT_REST = 1e-7  # m, m/s, rad, rad/s: smaller deviations and speeds count as rest

Vector = Tuple[float, float, float]
Quaternion = Tuple[float, float, float, float]
"""Unit quaternion x, y, z, w."""


def multiply(left: Quaternion, right: Quaternion) -> Quaternion:
    """Return the product: the rotation `right`, then `left`."""
    ax, ay, az, aw = left
    bx, by, bz, bw = right
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def inverse(turn: Quaternion) -> Quaternion:
    """Return the inverse rotation."""
    return (-turn[0], -turn[1], -turn[2], turn[3])


def rotation_vector(turn: Quaternion) -> Vector:
    """Return axis times angle [rad] of the shorter rotation."""
    x, y, z, w = turn if turn[3] >= 0.0 else tuple(-value for value in turn)
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, w) / sine
    return (scale * x, scale * y, scale * z)


def vector_part(turn: Quaternion) -> Vector:
    """Return axis times sin(angle / 2) of the shorter rotation."""
    x, y, z, w = turn
    return (x, y, z) if w >= 0.0 else (-x, -y, -z)


def turned_by(vector: Vector) -> Quaternion:
    """Return the rotation given by axis times angle [rad]."""
    angle = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    scale = 0.5 if angle < 1e-9 else math.sin(angle / 2.0) / angle
    return (scale * vector[0], scale * vector[1], scale * vector[2], math.cos(angle / 2.0))


def normalised(turn: Sequence[float]) -> Quaternion:
    """Return the unit quaternion in the direction of four numbers. Raises ValueError for length zero."""
    length = math.sqrt(sum(value * value for value in turn))
    if not length > 1e-6:
        raise ValueError("a quaternion of length zero is no rotation")
    x, y, z, w = (value / length for value in turn)
    return (x, y, z, w)


def rotate(turn: Quaternion, vector: Vector) -> Vector:
    """Rotate a vector."""
    x, y, z, _ = multiply(multiply(turn, (*vector, 0.0)), inverse(turn))
    return (x, y, z)


def length_of(vector: Sequence[float]) -> float:
    """Return the Euclidean length."""
    return math.sqrt(sum(value * value for value in vector))


class ImpedanceHand:
    """The hand and the controller's target; poses in the base frame, in m and as quaternions."""

    def __init__(self, position: Vector, orientation: Quaternion, friction: float = 0.0) -> None:
        """Start at rest. friction: force [N] that the spring has to exceed along each axis before the hand moves."""
        self.position: List[float] = list(position)
        self.orientation = orientation
        self.velocity: List[float] = [0.0, 0.0, 0.0]
        self.turning: List[float] = [0.0, 0.0, 0.0]
        self.force: List[float] = [0.0, 0.0, 0.0]  # of the spring, N
        self.torque: List[float] = [0.0, 0.0, 0.0]  # Nm
        self.acceleration = 0.0  # m/s^2
        self._friction = friction
        self._stiffness = [0.0, 0.0]  # N/m, Nm/rad; zero when the controller is loaded
        self.requested_stiffness = [200.0, 10.0]
        self.set_point = (tuple(position), orientation)
        self._target: List[float] = list(position)
        self._target_orientation = orientation

    @property
    def target(self) -> Tuple[Vector, Quaternion]:
        """The filtered target."""
        x, y, z = self._target
        return (x, y, z), self._target_orientation

    @property
    def speed(self) -> float:
        """Speed of the hand, m/s."""
        return length_of(self.velocity)

    @property
    def turn_rate(self) -> float:
        """Turn rate of the hand, rad/s."""
        return length_of(self.turning)

    def set_stiffness(self, translational: float, rotational: float) -> None:
        """Set the stiffness [N/m, Nm/rad] that the controller approaches."""
        self.requested_stiffness = [translational, rotational]

    def latch(self) -> None:
        """Set target and set-point to the hand's pose, as the controller does when it is started."""
        x, y, z = self.position
        self.set_point = ((x, y, z), self.orientation)
        self._target = [x, y, z]
        self._target_orientation = self.orientation

    def advance(self) -> None:
        """Advance by one millisecond under the controller."""
        self._follow_set_point()
        stiffness, turn_stiffness = self._stiffness
        if self._is_settled():
            self.acceleration = 0.0
            return
        before = self.velocity
        damping = 2.0 * math.sqrt(stiffness)
        self.force = [stiffness * (goal - value) for goal, value in zip(self._target, self.position)]
        self.velocity = [
            self._pushed(speed, force - damping * speed) for speed, force in zip(self.velocity, self.force)
        ]
        error = vector_part(multiply(self._target_orientation, inverse(self.orientation)))
        turn_damping = 2.0 * math.sqrt(turn_stiffness)
        self.torque = [turn_stiffness * value for value in error]
        self.turning = [
            rate + STEP * (torque - turn_damping * rate) / INERTIA for rate, torque in zip(self.turning, self.torque)
        ]
        self.acceleration = length_of([now - then for now, then in zip(self.velocity, before)]) / STEP
        self._move()

    def brake(self) -> None:
        """Advance by one millisecond of the robot's own stop, or at rest."""
        self.force = [0.0, 0.0, 0.0]
        self.torque = [0.0, 0.0, 0.0]
        self.acceleration = 0.0
        if not any(self.velocity) and not any(self.turning):
            return
        self.velocity = _slowed(self.velocity, BRAKING * STEP)
        self.turning = _slowed(self.turning, TURN_BRAKING * STEP)
        self._move()

    def _follow_set_point(self) -> None:
        position, orientation = self.set_point
        self._target = [value + FILTER * (goal - value) for value, goal in zip(self._target, position)]
        way = rotation_vector(multiply(orientation, inverse(self._target_orientation)))
        if any(way):
            step = turned_by((FILTER * way[0], FILTER * way[1], FILTER * way[2]))
            self._target_orientation = normalised(multiply(step, self._target_orientation))
        self._stiffness = [
            value + FILTER * (wanted - value) for value, wanted in zip(self._stiffness, self.requested_stiffness)
        ]

    def _pushed(self, speed: float, force: float) -> float:
        """Return the speed along one axis after a STEP under a force and friction."""
        pushed = speed + STEP * force / MASS
        lost = STEP * self._friction / MASS
        return math.copysign(max(abs(pushed) - lost, 0.0), pushed)

    def _is_settled(self) -> bool:
        if self.speed > _AT_REST or self.turn_rate > _AT_REST:
            return False
        position, orientation = self.set_point
        if max(abs(goal - value) for goal, value in zip(position, self.position)) > _AT_REST:
            return False
        return length_of(rotation_vector(multiply(orientation, inverse(self.orientation)))) <= _AT_REST

    def _move(self) -> None:
        self.position = [value + STEP * speed for value, speed in zip(self.position, self.velocity)]
        x, y, z = self.turning
        if x or y or z:
            self.orientation = normalised(multiply(turned_by((STEP * x, STEP * y, STEP * z)), self.orientation))


def _slowed(velocity: Sequence[float], loss: float) -> List[float]:
    """Return a velocity whose length is reduced by loss."""
    length = length_of(velocity)
    share = max(length - loss, 0.0) / length if length > 0.0 else 0.0
    return [share * value for value in velocity]
