"""A hand that follows commanded velocities as the paper's velocity controller does, without ROS."""

import math

import numpy as np

CYCLE = 0.001  # s
AT_REST = 0.01
"""m/s, rad/s: speeds up to this count as rest."""


class VelocityRobot:
    """Pose of the end effector under a controller that limits accelerations and lets an old velocity decay."""

    def __init__(self, pose, step=0.2, acceleration=1.5, turn_acceleration=10.0, drift=(0.0, 0.0, 0.0), blocked=False):
        """Pose: (4, 4) m. step: /dt [s]. drift: (3,) m/s that the robot adds to each motion."""
        self.pose = np.array(pose)
        self.drift = np.array(drift)
        self.blocked = blocked
        self.success = True
        self.velocity = np.zeros(6)
        self.largest = np.zeros(6)  # speeds
        self.starts_in_motion = self.starts = self.requests = 0
        self._step = step
        self._limit = CYCLE * np.repeat([acceleration, turn_acceleration], 3)
        self._wanted, self._age, self._owed = np.zeros(6), math.inf, 0.0

    def start(self):
        """Switch to the velocity controller."""
        self.starts += 1
        self.starts_in_motion += bool(np.abs(self.velocity).max() > AT_REST)
        self._wanted = np.zeros(6)
        return self.success

    def command(self, linear, angular):
        """Request a velocity -> whether the robot follows."""
        self.requests += 1
        self._wanted, self._age = np.array([*linear, *angular], dtype=float), 0.0
        return self.success

    def advance(self, seconds):
        """Let time pass."""
        self._owed += seconds
        while self._owed >= CYCLE:
            self._owed -= CYCLE
            self._cycle()

    def _cycle(self):
        self._age += CYCLE
        wanted = self._wanted if self._age <= 2.0 * self._step else np.zeros(6)
        self.velocity += np.clip(wanted - self.velocity, -self._limit, self._limit)
        if self.blocked or not self.success:
            self.velocity[:] = 0.0
            return
        self.largest = np.maximum(self.largest, np.abs(self.velocity))
        is_moving = np.abs(self.velocity).max() > 1e-4
        self.pose[:3, 3] += CYCLE * (self.velocity[:3] + is_moving * self.drift)
        self.pose[:3, :3] = _rotation(CYCLE * self.velocity[3:]) @ self.pose[:3, :3]


def _rotation(vector):
    angle = np.linalg.norm(vector)
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
