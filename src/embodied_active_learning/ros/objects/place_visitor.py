"""Drives the arm to decided places and takes a picture at each."""

from __future__ import annotations

from typing import List, Sequence

import rospy
from sensor_msgs.msg import Image

from embodied_active_learning.config import Config
from embodied_active_learning.errors import (
    ArmStoppedError,
    CommandError,
    EmbodiedActiveLearningError,
    ObservationError,
    TaskCancelledError,
)
from embodied_active_learning.figures.visits import comparison, draw_visits
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.visits import Destination, Visit, make_visit, plan_visits
from embodied_active_learning.pipeline.identification import IdentificationRun
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm.retrying_arm import RetryingArm
from embodied_active_learning.ros.conversions import image_array, image_message, state_arrays
from embodied_active_learning.ros.objects.task_arm import TaskArm
from embodied_active_learning.ros.runtime.diagnostics import Health
from embodied_active_learning.ros.runtime.node import try_to_draw
from embodied_active_learning.ros.runtime.task_server import TaskProgress


class PlaceVisitor:
    """Visits places while the planner is paused, and publishes each picture beside what is expected."""

    def __init__(self, config: Config) -> None:
        """Advertise the topic; the arm is used at the first visit."""
        self._camera = config.camera
        self._arm = TaskArm(config)
        self._pictures = rospy.Publisher(names.VISITED_PLACE, Image, queue_size=1, latch=True)

    def health(self, active: Health) -> Health:
        """Add the state of the arm to a diagnostic status, once it is used."""
        return self._arm.health(active)

    def visit_found(self, run: IdentificationRun, decisions: Sequence[Decision], progress: TaskProgress) -> None:
        """Visit the objects found, undecided and unknown; draw the pictures into the results of the identification.

        Raises:
            TaskCancelledError: If the task was cancelled. The arm stops during the command in progress.
        """
        destinations = plan_visits(run.identification, decisions, run.unknown, run.config.workspace.box())
        if not destinations:
            rospy.loginfo("no places to visit: no object was found, undecided or unknown")
            return
        try:
            visits = self.visit(destinations, progress)
        except TaskCancelledError as error:
            raise TaskCancelledError(f"cancelled while visiting places: the decisions are in {run.folder}") from error
        if visits:
            figure = try_to_draw(draw_visits, run.folder / "visits.png", visits, run.config.session.pdf_figures)
            rospy.loginfo("visited %d of %d places\n  figure   %s", len(visits), len(destinations), figure or "none")

    def visit(self, destinations: Sequence[Destination], progress: TaskProgress) -> List[Visit]:
        """Visit places one after the other. Return the visits.

        A place that is not reached is reported and skipped; a stopped arm, or none, ends the visits.

        Raises:
            TaskCancelledError: If the task was cancelled.
        """
        visits: List[Visit] = []
        try:
            with self._arm.lent(progress) as arm:
                for number, destination in enumerate(destinations):
                    progress.report("visiting", number, len(destinations))
                    try:
                        visits.append(self._visit(destination, arm))
                    except ArmStoppedError:
                        raise
                    except (CommandError, ObservationError) as error:
                        progress.check()  # the error may result from the cancelled command
                        rospy.logwarn("%s not visited: %s", destination.label, error)
        except TaskCancelledError:
            raise
        except EmbodiedActiveLearningError as error:
            visited = {visit.destination.label for visit in visits}
            missed = ", ".join(item.label for item in destinations if item.label not in visited)
            rospy.logerr("visits ended: %s; not visited: %s", error, missed)
        return visits

    def _visit(self, destination: Destination, arm: RetryingArm) -> Visit:
        """Drive to one place and take a picture."""
        message, reached = arm.observe(arm.go_to(destination.state.tolist()))
        picture = image_array(message, self._camera.height, self._camera.width)
        visit = make_visit(destination, state_arrays(reached)[0], picture)
        self._pictures.publish(image_message(reached.header.stamp, comparison(visit)))
        (x, y), (camera_x, camera_y, yaw) = destination.place, visit.state
        rospy.loginfo(
            "visited %s at x %.3f m, y %.3f m; camera at x %.3f m, y %.3f m, yaw %.2f rad",
            *(destination.label, x, y, camera_x, camera_y, yaw),
        )
        return visit
