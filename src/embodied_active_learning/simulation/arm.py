"""The simulated arm: planar velocities within limits, whoever commands them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Callable, Dict, List, Optional, Sequence

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CommandError, ConfigError
from embodied_active_learning.simulation import servo
from embodied_active_learning.simulation.panda_body import PandaBody
from embodied_active_learning.workspace import STATE_NAMES

# The arm turns back this far inside the workspace (normalised), so that what little a physics step strays from its
# command never shows outside.
_MARGIN = 3e-4
_ARRIVAL_GAIN = 20.0  # 1/s
_ARRIVED = np.array([5e-5, 5e-5, 5e-4])  # m, m, rad
_AT_REST = np.array([1e-4, 1e-4, 1e-3])  # m/s, m/s, rad/s
_STOP_STEPS = 100
_REACH_GRID = (5, 5, 3)  # poses tried along x, y and theta: odd, so that the middle is among them


@dataclass(frozen=True)
class MoveResult:
    """Where a motion ended: state (3,) m, m, rad; velocity (3,) m/s, m/s, rad/s; whether a limit changed it."""

    state: np.ndarray
    velocity: np.ndarray
    limited: bool


class SimulatedArm:
    """A Panda that carries its camera over the table at one height, looking straight down."""

    def __init__(self, config: Config) -> None:
        """Stand at simulation/start. Raises ConfigError when the arm cannot reach all of the workspace."""
        self._workspace = config.workspace.box()
        self._height = config.camera.distance
        self._limits = config.arm
        self._speeds = np.array([config.arm.max_speed, config.arm.max_speed, config.arm.max_turn_rate])
        margin = _MARGIN * self._workspace.scale
        self._lower = np.asarray(self._workspace.lower) + margin
        self._upper = np.asarray(self._workspace.upper) - margin
        self._ranges = list(zip(self._lower.tolist(), self._upper.tolist(), self._speeds.tolist()))
        self._body = PandaBody(config.simulation.physics_rate)
        try:
            self._check_reach()
            self._place(np.clip(config.simulation.start, self._lower, self._upper))
        except ConfigError:
            self.close()
            raise
        self._sense()

    def close(self) -> None:
        """Free the physics client; the arm is of no use afterwards."""
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
        return float(np.arcsin(min(1.0, np.linalg.norm(servo.tilt(self._orientation)))))

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

    def move(
        self, velocity: Sequence[float], duration: float, error: Optional[Callable[[], np.ndarray]] = None
    ) -> MoveResult:
        """Hold a planar velocity (3,) m/s, m/s, rad/s for a duration, s, as far as limits allow.

        The error, drawn once the command is accepted, is what an imperfect arm adds to the legal velocity (3,). Raises
        CommandError, with the arm where it was, for what no arm should be told.
        """
        wanted = _three_numbers(velocity, "velocity")
        if not 0.0 < duration <= self._limits.max_duration:
            raise CommandError(
                f"duration {duration} s is refused: give more than 0 and at most {self._limits.max_duration:g} s "
                "(arm/max_duration)"
            )
        legal = self._slowed(wanted)
        limited = bool(np.any(legal != wanted))
        held = legal if error is None else self._slowed(legal + error())
        for _ in range(max(1, round(duration / self._body.period))):
            limited |= self._tick(held)
        return MoveResult(self.pose, self.velocity, limited)

    def go_to(self, pose: Sequence[float]) -> MoveResult:
        """Go straight to a planar pose (3,) m, m, rad within the speed limits and stop there.

        Raises CommandError for a pose outside the workspace, and when the arm does not get there in time.
        """
        target = _three_numbers(pose, "pose")
        if not self._workspace.contains(target, tolerance=1e-9):
            raise CommandError(
                f"pose {target.tolist()} is refused: it lies outside the workspace, "
                f"{list(self._workspace.lower)} to {list(self._workspace.upper)} for {', '.join(STATE_NAMES)}"
            )
        target = np.clip(target, self._lower, self._upper)
        allowed = 2.0 + 2.0 * float(np.max(np.abs(target - self._pose) / self._speeds))
        deadline = self.time + allowed
        limited = False
        while np.any(np.abs(target - self._pose) > _ARRIVED):
            if self.time > deadline:
                self.stop()
                raise CommandError(
                    f"pose {target.tolist()} was not reached in {allowed:.1f} s: the arm stopped at "
                    f"{self._pose.tolist()}"
                )
            limited |= self._tick(self._slowed(_ARRIVAL_GAIN * (target - self._pose)))
        self.stop()
        return MoveResult(self.pose, self.velocity, limited)

    def stop(self) -> MoveResult:
        """Stop now. Raises CommandError when the arm keeps moving."""
        for _ in range(_STOP_STEPS):
            self._tick(np.zeros(3))
            if np.all(np.abs(self.velocity) <= _AT_REST):
                return MoveResult(self.pose, self.velocity, limited=False)
        raise CommandError(f"the arm did not come to rest: it moves at {self.velocity.tolist()}")

    def _slowed(self, velocity: np.ndarray) -> np.ndarray:
        """The velocity (3,) in its own direction, at the highest legal speed at most."""
        return velocity / max(1.0, float(np.max(np.abs(velocity) / self._speeds)))

    def _tick(self, velocity: np.ndarray) -> bool:
        """One physics step at a planar velocity (3,), cut where it would leave the workspace; whether it was cut."""
        period = self._body.period
        asked = velocity.tolist()
        inside = self._cut(asked, period)
        joints = self._body.joints()
        twist = servo.held_twist(inside, self._position, self._orientation, self._height)
        wanted = servo.joint_velocities(self._body.jacobian(joints), twist, joints)
        share = servo.share_within_limits(wanted, joints, period)
        self._body.drive(joints, share * wanted)
        self._sense()
        return share < 1.0 or inside != asked

    def _cut(self, velocity: List[float], period: float) -> List[float]:
        """A planar velocity (3,) as far as it stays in the workspace for a period, s; from outside it leads back."""
        return [
            min(max(speed, min((lower - at) / period, top)), max((upper - at) / period, -top))
            for speed, at, (lower, upper, top) in zip(velocity, self._pose.tolist(), self._ranges)
        ]

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
        # Corners alone do not tell: close to the base the elbow folds to its limit in the middle of an edge first.
        axes = (np.linspace(*limits) for limits in zip(self._lower, self._upper, _REACH_GRID))
        for pose in itertools.product(*axes):
            self._place(np.array(pose))


def _three_numbers(values: Sequence[float], name: str) -> np.ndarray:
    """(3,) float64, or CommandError."""
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (len(STATE_NAMES),) or not np.isfinite(numbers).all():
        raise CommandError(f"{name} {values!r} is refused: give {len(STATE_NAMES)} finite numbers")
    return numbers
