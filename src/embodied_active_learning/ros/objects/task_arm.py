"""The arm for a task that moves it while the planner, if there is one, is paused."""

from __future__ import annotations

import time
from contextlib import contextmanager
from typing import Iterator, Optional

import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CommandError, EmbodiedActiveLearningError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm.retrying_arm import RetryingArm
from embodied_active_learning.ros.planner.pause import PlannerPause
from embodied_active_learning.ros.runtime.diagnostics import Health
from embodied_active_learning.ros.runtime.services import is_advertised
from embodied_active_learning.ros.runtime.task_server import TaskProgress

TIMEOUT = 15.0
"""Wall seconds to wait for a busy arm or a missing image before a command fails."""


class TaskArm:
    """Lends the arm to one task at a time; it is stopped afterwards, and the planner resumes."""

    def __init__(self, config: Config) -> None:
        """Take control of the planner's pause, also of one that was left by an earlier process of this node."""
        self._config = config
        self._arm: Optional[RetryingArm] = None
        self.planner_pause = PlannerPause()

    def health(self, active: Health) -> Health:
        """Add the state of the arm to a diagnostic status, once it is used."""
        return active if self._arm is None else self._arm.health(active)

    @contextmanager
    def lent(self, progress: TaskProgress) -> Iterator[RetryingArm]:
        """Provide the arm during the block.

        Raises:
            CommandError: If no arm is running.
            TaskCancelledError: If the task was cancelled. The arm stops during the command in progress.
        """
        progress.report("waiting for the arm")
        arm = self._available_arm(progress)
        try:
            with self.planner_pause.paused(), progress.when_cancelled(arm.cancel):
                try:
                    yield arm
                finally:
                    _stop(arm)
        except EmbodiedActiveLearningError:
            progress.check()  # the error may result from the cancelled command
            raise

    def _available_arm(self, progress: TaskProgress) -> RetryingArm:
        """Return the arm as soon as arm and camera are running."""
        if self._arm is None:
            self._arm = RetryingArm(self._config, TIMEOUT)
        give_up_at = time.monotonic() + TIMEOUT

        def check() -> None:
            progress.check()
            if time.monotonic() < give_up_at:
                return
            move, *topics = map(rospy.resolve_name, (names.ARM_MOVE, names.CAMERA_IMAGE, names.ARM_STATE))
            if is_advertised(names.ARM_MOVE):
                raise CommandError(
                    f"arm or camera not ready: {move} does not respond, or nothing publishes {' or '.join(topics)}; "
                    "check their nodes"
                )
            raise CommandError(f"no arm: {move} is not advertised; start the arm")

        self._arm.wait(check)
        return self._arm


def _stop(arm: RetryingArm) -> None:
    """Stop the arm. Without a response it stops anyway, because no command follows."""
    try:
        arm.stop()
    except (EmbodiedActiveLearningError, rospy.ROSException) as error:
        rospy.logwarn("stop not confirmed: %s; the arm stops after the last command", error)
