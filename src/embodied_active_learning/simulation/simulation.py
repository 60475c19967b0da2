"""The simulation: arm, camera image and disturbances."""

from __future__ import annotations

from types import TracebackType
from typing import Dict, Mapping, Optional, Sequence, Tuple, Type

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.exploration.commands import Command, VelocityCommand
from embodied_active_learning.simulation.arm import MoveResult, SimulatedArm
from embodied_active_learning.simulation.disturbance import Disturbance
from embodied_active_learning.simulation.scene import Scene, SceneObject
from embodied_active_learning.simulation.world import World
from embodied_active_learning.state_dict import StateDict


class Simulation:
    """A Panda over a world's table. One seed gives one result; time advances only with commands of the arm.

    Not thread-safe. Use it as a context manager: leaving it frees both PyBullet clients.
    """

    def __init__(self, world: World, config: Config) -> None:
        """Load the world and start at simulation/start. Raises WorldError or ConfigError."""
        self._scene = Scene(world, config.camera)
        try:
            self._arm = SimulatedArm(config)
        except Exception:
            self._scene.close()
            raise
        self._disturbance = Disturbance(world.disturbances, config.exploration.seed)
        self._closed = False

    def __enter__(self) -> Simulation:
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free both PyBullet clients; may be called repeatedly."""
        if not self._closed:
            self._closed = True
            self._arm.close()
            self._scene.close()

    @property
    def pose(self) -> np.ndarray:
        """(3,) x m, y m, theta rad of the camera in the base frame."""
        return self._arm.pose

    @property
    def velocity(self) -> np.ndarray:
        """(3,) m/s, m/s, rad/s of the camera in the base frame."""
        return self._arm.velocity

    @property
    def time(self) -> float:
        """Simulated seconds since the start: physics steps divided by their rate."""
        return self._arm.time

    @property
    def joint_positions(self) -> Dict[str, float]:
        """Position of each of the seven joints, rad."""
        return self._arm.joint_positions

    @property
    def joint_velocities(self) -> Dict[str, float]:
        """Velocity of each of the seven joints, rad/s."""
        return self._arm.joint_velocities

    @property
    def objects(self) -> Tuple[SceneObject, ...]:
        """Ground truth of the objects on the table."""
        return self._scene.objects

    def state_dict(self) -> StateDict:
        """Return everything that, with configuration and world, determines what follows; see SimulatedArm."""
        return self._arm.state_dict()

    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        """Return to a state of `state_dict()`. Raises CommandError, with nothing changed, if it is invalid."""
        self._arm.load_state_dict(state)

    def intrinsics(self) -> np.ndarray:
        """(3, 3) camera matrix K in pixels, pixel centres at whole numbers."""
        return self._scene.intrinsics()

    def move(self, velocity: Sequence[float], duration: float) -> MoveResult:
        """Hold a planar velocity (3,) [m/s, m/s, rad/s] for a duration [s]. Raises CommandError if it is invalid."""
        return self._arm.move(velocity, duration, lambda: self._disturbance.actuation(self.time))

    def go_to(self, pose: Sequence[float]) -> MoveResult:
        """Move to a planar pose (3,) [m, m, rad] and stop. Raises CommandError if it is invalid or not reached."""
        return self._arm.go_to(pose)

    def execute(self, command: Command) -> MoveResult:
        """Execute an explorer's command. Raises CommandError if it is invalid or not reached."""
        if isinstance(command, VelocityCommand):
            return self.move(command.velocity.tolist(), command.duration)
        return self.go_to(command.state.tolist())

    def stop(self) -> MoveResult:
        """Stop the arm."""
        return self._arm.stop()

    def image(self) -> np.ndarray:
        """Return the camera image (H, W, 3) uint8 RGB at the arm's pose and velocity."""
        image = self._scene.render(self._arm.pose, self._arm.camera_height, self._arm.velocity.tolist())
        return self._disturbance.image(image, self.time)

    def top_view(self, centre: np.ndarray, size: float, width: int = 600) -> np.ndarray:
        """Return a top view (width, width, 3) uint8 RGB of a square: centre (2,) [m], size [m]; x right, y up."""
        return self._scene.top_view(centre, size, width)
