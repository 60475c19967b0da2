"""Where a node's last command has left a simulated arm, and whether the arm has to return to it."""

from __future__ import annotations

from typing import Optional

from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros.arm.client import ArmClient
from embodied_active_learning.ros.camera.posed_camera import PosedCamera


class RestorePoint:
    """The state in which a command has left a simulated arm.

    It is in one of these states:

    * none: nothing was commanded yet, the simulation has lost the state, or the arm is real. Nothing is restored.
    * held: this node controls the arm. If the arm has moved since, it stopped because this process was frozen beyond
      the arm's timeout: restore it.
    * released: this node has released control. If the arm has moved since, another node moved it: do not restore it.
    * restarted: the arm has restarted, or may have, because a command had no response: restore it.

    A successful call leads to held, release() from held to released, lose() to none; a restart of the arm or a missing
    response from held and released to restarted.
    """

    def __init__(self, arm: ArmClient, camera: PosedCamera) -> None:
        """The camera receives the states of the arm."""
        self._arm = arm
        self._camera = camera
        self._reached: Optional[PlanarState] = None
        self._restarts = 0  # of the arm before the last successful call
        self._is_response_missing = False
        self._is_released = False

    @property
    def state(self) -> Optional[PlanarState]:
        """The state that the arm can return to, or None."""
        return self._reached if self._arm.can_restore else None

    @property
    def must_restore(self) -> bool:
        """Whether the arm is not where it was left, although this node has not released control."""
        return self._has_restarted or (self.state is not None and self._has_moved and not self._is_released)

    @property
    def is_moved_by_others(self) -> bool:
        """Whether another node has moved the arm since this node has released control, as far as this node knows."""
        return self._is_released and self._has_moved and not self._has_restarted

    def set_called(self, restarts: int) -> None:
        """Process a successful call before which the arm had restarted this often."""
        self._restarts, self._is_released = restarts, False

    def set_reached(self, state: PlanarState) -> None:
        """Set the state in which a command has left the arm."""
        self._reached = state

    def set_response_missing(self, is_missing: bool) -> None:
        """Set whether a command had no response since the arm was last restored."""
        self._is_response_missing = is_missing

    def release(self) -> None:
        """Process that this node has released control."""
        self._is_released = True

    def lose(self) -> None:
        """Use the arm where it is, because it cannot return."""
        self._reached, self._is_response_missing = None, False

    @property
    def _has_restarted(self) -> bool:
        """Whether the arm has restarted since the last successful call, or may have."""
        return self.state is not None and (self._is_response_missing or self._camera.restarts != self._restarts)

    @property
    def _has_moved(self) -> bool:
        """Whether the arm has moved since the last command: only then does simulated time pass."""
        newest = self._camera.newest_state
        return self._reached is not None and newest is not None and newest > self._reached.header.stamp
