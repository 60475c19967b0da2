"""Takes the views of a fingerprint run with the arm."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Optional

import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CommandError, EmbodiedActiveLearningError
from embodied_active_learning.objects.collection import ViewCollection
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm.retrying_arm import RetryingArm
from embodied_active_learning.ros.conversions import image_array, state_arrays
from embodied_active_learning.ros.planner.pause import PlannerPause
from embodied_active_learning.ros.runtime.diagnostics import Health, Rate
from embodied_active_learning.ros.runtime.node import wall_sleep
from embodied_active_learning.ros.runtime.services import is_advertised
from embodied_active_learning.ros.runtime.task_server import Progress

if TYPE_CHECKING:
    from embodied_active_learning.pipeline.fingerprinting import FingerprintRun  # slow import of the model

TIMEOUT = 15.0
"""Wall seconds to wait for a busy arm or a missing image before the collection fails."""
_VIEWS_PER_LOG_LINE = 10


class ViewCollector:
    """Moves the arm around each object of a fingerprint run while the planner is paused."""

    def __init__(self, config: Config) -> None:
        """Take control of the planner's pause, also of one that was left by an earlier process of this node."""
        self._config = config
        self._views = Rate()
        self._arm: Optional[RetryingArm] = None
        self.planner_pause = PlannerPause()

    def health(self, active: Health) -> Health:
        """Add the number of views to a diagnostic status, and the state of the arm once it is used."""
        active.values.update({"views": self._views.count, "views per second": round(self._views.per_second, 2)})
        return active if self._arm is None else self._arm.health(active)

    def collect(self, run: FingerprintRun, progress: Progress) -> None:
        """Fill all collections of a run.

        Raises:
            CommandError: If no arm is running, or it does not move.
            ObservationError: If an object cannot be viewed often enough.
            TaskCancelledError: If the task was cancelled. The arm stops during the command in progress.
        """
        progress.report("waiting for the arm")
        arm = self._available_arm()
        try:
            with self.planner_pause.held(), progress.when_cancelled(arm.cancel):
                self._fill_all(run, arm, progress)
        except EmbodiedActiveLearningError:
            progress.check()  # the error may result from the cancelled command
            raise

    def _available_arm(self) -> RetryingArm:
        """Return the arm as soon as it is running."""
        give_up_at = time.monotonic() + TIMEOUT
        while not is_advertised(names.ARM_MOVE):
            if time.monotonic() >= give_up_at:
                raise CommandError(f"no arm: {rospy.resolve_name(names.ARM_MOVE)} is not advertised; start the arm")
            wall_sleep(0.2)
        if self._arm is None:
            self._arm = RetryingArm(self._config, TIMEOUT)
            self._arm.wait()
        return self._arm

    def _fill_all(self, run: FingerprintRun, arm: RetryingArm, progress: Progress) -> None:
        """Fill one collection after another, then stop the arm."""
        try:
            for name, collection in zip(run.names, run.collections):
                if isinstance(collection, ViewCollection):
                    self._fill(name, collection, arm, progress)
                run.require_complete(name)
        finally:
            _stop(arm)

    def _fill(self, name: str, collection: ViewCollection, arm: RetryingArm, progress: Progress) -> None:
        """Take the views of one object."""
        camera, views = self._config.camera, self._config.fingerprint.views
        progress.report(name, 0, views)
        reached = arm.go_to(collection.start.tolist())
        while True:
            image, state = arm.observe(reached)
            if collection.observe(*state_arrays(state), image_array(image, camera.height, camera.width)):
                self._views.tick()
                count = len(collection.states)
                progress.report(name, count, views)
                if count % _VIEWS_PER_LOG_LINE == 0 or count == views:
                    rospy.loginfo("%s: view %d of %d", name, count, views)
            if collection.complete or collection.exhausted:
                return
            if arm.was_held:
                collection.interrupt()
            progress.check()
            reached = arm.execute(collection.next_command())


def _stop(arm: RetryingArm) -> None:
    """Stop the arm. Without a response it stops anyway, because no command follows."""
    try:
        arm.stop()
    except (EmbodiedActiveLearningError, rospy.ROSException) as error:
        rospy.logwarn("stop not confirmed: %s; the arm stops after the last command", error)
