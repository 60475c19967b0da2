"""Takes the views of a fingerprint run with the arm."""

from __future__ import annotations

from typing import TYPE_CHECKING

import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.objects.collection import ViewCollection
from embodied_active_learning.ros.arm.retrying_arm import RetryingArm
from embodied_active_learning.ros.conversions import image_array, state_arrays
from embodied_active_learning.ros.objects.task_arm import TaskArm
from embodied_active_learning.ros.runtime.diagnostics import Health, Rate
from embodied_active_learning.ros.runtime.task_server import TaskProgress

if TYPE_CHECKING:
    from embodied_active_learning.pipeline.fingerprinting import FingerprintRun  # slow import of the model

_VIEWS_PER_LOG_LINE = 10


class ViewCollector:
    """Moves the arm around each object of a fingerprint run while the planner is paused."""

    def __init__(self, config: Config) -> None:
        """Take control of the planner's pause, see TaskArm."""
        self._config = config
        self._views = Rate()
        self._arm = TaskArm(config)
        self.planner_pause = self._arm.planner_pause

    def health(self, active: Health) -> Health:
        """Add the number of views to a diagnostic status, and the state of the arm once it is used."""
        active.values.update({"views": self._views.count, "views per second": round(self._views.per_second, 2)})
        return self._arm.health(active)

    def collect(self, run: FingerprintRun, progress: TaskProgress) -> None:
        """Fill all collections of a run.

        Raises:
            CommandError: If no arm is running, or it does not move.
            ObservationError: If an object cannot be viewed often enough.
            TaskCancelledError: If the task was cancelled. The arm stops during the command in progress.
        """
        with self._arm.lent(progress) as arm:
            for name, collection in zip(run.names, run.collections):
                if isinstance(collection, ViewCollection):
                    self._fill(name, collection, arm, progress)
                run.require_complete(name)

    def _fill(self, name: str, collection: ViewCollection, arm: RetryingArm, progress: TaskProgress) -> None:
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
