"""The whole stand-in: the arm, what its camera sees, and what disturbs both."""

from __future__ import annotations

from types import TracebackType
from typing import Dict, Mapping, Optional, Sequence, Tuple, Type

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.simulation.arm import MoveResult, SimulatedArm
from embodied_active_learning.simulation.disturbance import Disturbance
from embodied_active_learning.simulation.panda_body import StateDict
from embodied_active_learning.simulation.scene import Scene, SceneObject
from embodied_active_learning.simulation.world import World


class Simulation:
    """A Panda over a world's table. One seed gives one result; time passes only while the arm is told to move.

    Not for several threads at once. Use it as a context manager: leaving it frees both PyBullet clients.
    """

    def __init__(self, world: World, config: Config) -> None:
        """Load the world and stand at simulation/start. Raises WorldError or ConfigError before anything moves."""
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
        """Free both PyBullet clients; harmless when they are free already."""
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
        """The truth about every object on the table."""
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
        """Hold a planar velocity (3,) m/s, m/s, rad/s for a duration, s. Raises CommandError when it is refused."""
        return self._arm.move(velocity, duration, lambda: self._disturbance.actuation(self.time))

    def go_to(self, pose: Sequence[float]) -> MoveResult:
        """Go to a planar pose (3,) m, m, rad and stop there. Raises CommandError when it is refused or not reached."""
        return self._arm.go_to(pose)

    def stop(self) -> MoveResult:
        """Stop now."""
        return self._arm.stop()

    def image(self) -> np.ndarray:
        """(H, W, 3) uint8 RGB of what the camera sees from where the arm is."""
        image = self._scene.render(self._arm.pose, self._arm.camera_height, self._arm.velocity)
        return self._disturbance.image(image, self.time)

    def top_view(self, centre: np.ndarray, size: float, width: int = 600) -> np.ndarray:
        """(width, width, 3) uint8 RGB of a square of the table: centre (2,) m, size m; right is +x, up is +y."""
        return self._scene.top_view(centre, size, width)
