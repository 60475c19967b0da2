"""The simulated arm: executes planar velocities within its limits."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from operator import add
from typing import Callable, Dict, List, Mapping, Optional, Sequence

import numpy as np

from embodied_active_learning.arm_requests import checked_duration, checked_pose, checked_velocity
from embodied_active_learning.config import Config
from embodied_active_learning.errors import ArmFailedError, CommandError, ConfigError
from embodied_active_learning.motion_limits import MotionLimits
from embodied_active_learning.simulation import servo
from embodied_active_learning.simulation.panda_body import PandaBody
from embodied_active_learning.state_dict import StateDict
from embodied_active_learning.workspace import STATE_NAMES

# The arm turns back this far inside the workspace (normalised), so that small tracking errors of a physics step do
# not leave it.
_MARGIN = 3e-4
_ARRIVED = np.array([5e-5, 5e-5, 5e-4])  # m, m, rad
_AT_REST = np.array([1e-4, 1e-4, 1e-3])  # m/s, m/s, rad/s
_SETTLING_STEPS = 100
_HEIGHT_TOLERANCE = 0.01  # m
_REST = [0.0, 0.0, 0.0]
_LATEST = 2.0**31  # s: the end of ROS time
# What physics adds to legal joint positions [rad] and speeds (factor) within a step.
_JOINT_SLACK, _JOINT_SPEED_SLACK = 1e-3, 1.01
_REACH_GRID = (5, 5, 3)  # poses tested along x, y and theta; odd, to include the middle


@dataclass(frozen=True)
class MoveResult:
    """End of a motion: state (3,) m, m, rad; velocity (3,) m/s, m/s, rad/s; whether a limit changed it."""

    state: np.ndarray
    velocity: np.ndarray
    limited: bool


class SimulatedArm:
    """A Panda that moves its camera over the table at constant height, looking straight down."""

    def __init__(self, config: Config) -> None:
        """Start at simulation/start. Raises ConfigError if the arm cannot reach all of the workspace."""
        self._workspace = config.workspace.box()
        self._height = config.camera.distance
        self._max_duration = config.arm.max_duration
        self._limits = MotionLimits.from_config(config, _MARGIN)
        # The velocity that the acceleration limit refers to.
        self._commanded = [0.0] * len(STATE_NAMES)
        self._body = PandaBody(config.simulation.physics_rate)
        try:
            self._check_reach()
            self._place(np.clip(config.simulation.start, self._limits.lower, self._limits.upper))
        except ConfigError:
            self.close()
            raise
        self._sense()

    def close(self) -> None:
        """Free the physics client; the arm cannot be used afterwards."""
        self._body.close()

    @property
    def pose(self) -> np.ndarray:
        """(3,) x m, y m, theta rad of the camera in the base frame."""
        return self._pose.copy()

    @property
    def velocity(self) -> np.ndarray:
        """(3,) m/s, m/s, rad/s of the camera in the base frame."""
        return np.array([self._twist[0], self._twist[1], self._twist[5]])

    @property
    def camera_height(self) -> float:
        """Height of the camera above the table, m."""
        return self._position[2]

    @property
    def tilt(self) -> float:
        """Angle between the optical axis and straight down, rad."""
        return math.asin(min(1.0, math.hypot(*servo.tilt(self._orientation))))

    @property
    def time(self) -> float:
        """Simulated seconds since the start: physics steps divided by their rate."""
        return self._body.time

    @property
    def joint_positions(self) -> Dict[str, float]:
        """Position of each of the seven joints, rad."""
        return {name: state[0] for name, state in self._body.joint_states().items()}

    @property
    def joint_velocities(self) -> Dict[str, float]:
        """Velocity of each of the seven joints, rad/s."""
        return {name: state[1] for name, state in self._body.joint_states().items()}

    def state_dict(self) -> StateDict:
        """Return everything that determines the further motion.

        Returns:
            `steps` (1,), `joints` (7,) [rad], `joint_velocities` (7,) [rad/s] and `commanded` (3,) [m/s, m/s, rad/s].
        """
        return {**self._body.state_dict(), "commanded": np.array(self._commanded)}

    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        """Return to a state of `state_dict()`, including its simulated time; the motion continues bit for bit.

        Raises:
            CommandError: The state is malformed or violates joint, speed or workspace limits; the arm is unchanged.
        """
        arrays = _checked_arrays(state, self.state_dict())
        self._check_limits(arrays)
        before = self.state_dict()
        self._load(arrays)
        if not self._workspace.contains(self._pose) or abs(self.camera_height - self._height) > _HEIGHT_TOLERANCE:
            self._load(before)
            raise CommandError("arm state rejected: the camera is outside the workspace or off its height")

    def _check_limits(self, state: Mapping[str, np.ndarray]) -> None:
        """Raise CommandError if time, commanded velocity, joint positions or joint velocities are out of range."""
        commanded, (lower, upper, speed) = state["commanded"].tolist(), servo.JOINT_LIMITS.T
        joints, joint_velocities = state["joints"], state["joint_velocities"]
        legal = {
            "time": 0.0 <= state["steps"][0] * self._body.period <= _LATEST,
            "commanded velocity": not self._limits.differ(self._limits.clamp_speed(commanded), commanded),
            "joint positions": np.all((joints >= lower - _JOINT_SLACK) & (joints <= upper + _JOINT_SLACK)),
            "joint velocities": np.all(np.abs(joint_velocities) <= _JOINT_SPEED_SLACK * speed),
        }
        wrong = [name for name, is_legal in legal.items() if not is_legal]
        if wrong:
            raise CommandError(f"arm state rejected: {', '.join(wrong)} out of range")

    def _load(self, state: Mapping[str, np.ndarray]) -> None:
        self._body.load_state_dict(state)
        self._commanded = state["commanded"].tolist()
        self._sense()

    def move(
        self, velocity: Sequence[float], duration: float, error: Optional[Callable[[], np.ndarray]] = None
    ) -> MoveResult:
        """Hold a planar velocity (3,) m/s, m/s, rad/s for a duration, s, as far as limits allow.

        The arm keeps its final velocity, so that consecutive moves join. A move counts as limited if speed, workspace
        or joint limits reduced the velocity, or if it was not reached; the time to reach it does not count.

        Args:
            velocity: Requested velocity.
            duration: Simulated time, s.
            error: Returns the velocity (3,) that an imperfect arm adds; called once the command is accepted.

        Raises:
            CommandError: The request is invalid; the arm is unchanged.
        """
        requested = checked_velocity(velocity)
        steps = max(1, round(checked_duration(duration, self._max_duration) / self._body.period))
        legal = self._limits.clamp_speed(requested)
        held = legal if error is None else self._limits.clamp_speed([*map(add, legal, error().tolist())])
        limited = legal != requested
        for _ in range(steps):
            limited |= self._tick(held)
        return MoveResult(self.pose, self.velocity, limited or self._limits.differ(self._commanded, held))

    def go_to(self, pose: Sequence[float]) -> MoveResult:
        """Go straight to a planar pose (3,) m, m, rad within the limits and stop there, without overshooting.

        Raises CommandError for a pose outside the workspace, ArmFailedError if the arm does not arrive in time.
        """
        target = checked_pose(pose, self._workspace)
        target = np.clip(target, self._limits.lower, self._limits.upper)
        allowed = 2.0 + 2.0 * (
            self._limits.braking_time(self._commanded) + self._limits.travel_time(self._pose.tolist(), target.tolist())
        )
        deadline = self.time + allowed
        limited = False
        while np.any(np.abs(target - self._pose) > _ARRIVED):
            if self.time > deadline:
                self.stop()
                raise ArmFailedError(
                    f"pose {target.tolist()} was not reached within {allowed:.1f} s: the arm stopped at "
                    f"{self._pose.tolist()}"
                )
            limited |= self._tick(self._limits.approach(self._pose.tolist(), target.tolist(), self._body.period))
        self.stop()
        return MoveResult(self.pose, self.velocity, limited)

    def stop(self) -> MoveResult:
        """Brake at the acceleration limit. Raises ArmFailedError if the arm keeps moving."""
        braking_steps = round(self._limits.braking_time(self._commanded) / self._body.period)
        for _ in range(braking_steps + _SETTLING_STEPS):
            self._tick(_REST)
            if np.all(np.abs(self.velocity) <= _AT_REST):
                return MoveResult(self.pose, self.velocity, limited=False)
        raise ArmFailedError(f"the arm did not come to rest: it moves at {self.velocity.tolist()} (m/s, m/s, rad/s)")

    def _tick(self, velocity: List[float]) -> bool:
        """Advance a physics step at the legal velocity closest to a planar one (3,); return whether a limit applied."""
        period = self._body.period
        legal = self._limits.next_velocity(self._pose.tolist(), self._commanded, velocity, period)
        joints = self._body.joints()
        twist = servo.held_twist(legal.velocity, self._position, self._orientation, self._height)
        requested = servo.joint_velocities(self._body.jacobian(joints), twist, joints)
        # Joint limits take precedence: where they slow the arm, it may brake harder than the acceleration limit.
        scale = servo.scale_within_limits(requested, joints, period)
        self._body.drive(joints, scale * requested)
        self._commanded = [scale * speed for speed in legal.velocity]
        self._sense()
        return scale < 1.0 or legal.limited

    def _sense(self) -> None:
        self._position, self._orientation, self._twist = self._body.optical_frame()
        self._pose = servo.planar_pose(self._position, self._orientation)

    def _place(self, pose: np.ndarray) -> None:
        if servo.solve_joints(self._body, pose, self._height) is None:
            raise ConfigError(
                f"the Panda cannot hold its camera at {pose.tolist()} (x m, y m, theta rad), {self._height:g} m above "
                "the table: make workspace smaller, or change camera/distance"
            )

    def _check_reach(self) -> None:
        # Corners are not enough: near the base the elbow reaches its limit first in the middle of an edge.
        axes = (np.linspace(*limits) for limits in zip(self._limits.lower, self._limits.upper, _REACH_GRID))
        for pose in itertools.product(*axes):
            self._place(np.array(pose))


def _checked_arrays(state: Mapping[str, np.ndarray], expected: Mapping[str, np.ndarray]) -> StateDict:
    """Return the arrays as float64. Raises CommandError for other names or shapes, and for non-finite values."""
    if set(state) != set(expected):
        raise CommandError(f"arm state rejected: fields are {sorted(state)}, expected {sorted(expected)}")
    arrays: StateDict = {name: np.asarray(state[name], dtype=np.float64) for name in expected}
    for name, array in arrays.items():
        if array.shape != expected[name].shape or not np.isfinite(array).all():
            raise CommandError(f"arm state rejected: {name} must be {expected[name].size} finite numbers")
    return arrays
