"""Pausing the planner, if there is one, while another node commands the arm."""

from __future__ import annotations

from contextlib import contextmanager
from typing import Iterator

import rospy

from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime import persistent_parameters
from embodied_active_learning.ros.runtime.master import CALL_ERRORS
from embodied_active_learning.ros.runtime.node import wait_until, wall_sleep
from embodied_active_learning.ros.runtime.services import is_advertised, trigger_if_advertised

_RELEASE_ATTEMPTS = 15
_RELEASE_PERIOD = 1.0
"""Wall seconds between two attempts; all of them outlast a restart of the planner."""
_PAUSED = "paused"


class PlannerPause:
    """Pauses the planner during a block; a restarted node ends the pause of its predecessor."""

    def __init__(self) -> None:
        self._left_paused = bool(persistent_parameters.load(names.HAS_PAUSED_PLANNER))
        self._has_paused = self._left_paused
        persistent_parameters.store(names.HAS_PAUSED_PLANNER, lambda: _PAUSED if self._has_paused else "")

    def resume_if_left(self) -> None:
        """Resume a planner that this node had paused when it was killed. Raises ShutdownRequestedError."""
        if self._left_paused:
            wait_until(
                lambda: is_advertised(names.PLANNER_RELEASE_PAUSE),
                lambda: rospy.resolve_name(names.PLANNER_RELEASE_PAUSE),
            )
            self._release()
            self._left_paused = False

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Pause the planner during the block; one that was paused before stays paused afterwards.

        Raises:
            EmbodiedActiveLearningError: There is a planner, but it does not respond.
        """
        try:
            response = trigger_if_advertised(names.PLANNER_PAUSE)
        except EmbodiedActiveLearningError:
            self._release_after_lost_response()
            raise
        self._has_paused = self._has_paused or (response is not None and response.success)
        try:
            yield
        finally:
            if self._has_paused:
                self._release()

    def _release_after_lost_response(self) -> None:
        """End a pause whose response was lost: the planner stores the request before it responds."""
        wall_sleep(_RELEASE_PERIOD)  # until the request is stored
        if _is_paused_by_this_node():
            self._has_paused = True
            self._release()

    def _release(self) -> None:
        for attempt in range(_RELEASE_ATTEMPTS):
            if attempt:
                wall_sleep(_RELEASE_PERIOD)
            try:
                response = trigger_if_advertised(names.PLANNER_RELEASE_PAUSE)
                if response is not None or not _is_paused_by_this_node():  # else the planner is restarting
                    self._has_paused = False
                    return
            except EmbodiedActiveLearningError as error:
                rospy.logwarn("cannot resume the planner: %s", error)
        release, resume = map(rospy.resolve_name, (names.PLANNER_RELEASE_PAUSE, names.PLANNER_RESUME))
        rospy.logerr("the planner is still paused: %s does not respond; call %s", release, resume)


def planner_paused_by() -> str:
    """Return the names of the nodes that have paused the planner; empty if none has, or the master does not respond."""
    try:
        return persistent_parameters.load(names.PLANNER_PAUSED_BY)
    except CALL_ERRORS:
        return ""


def _is_paused_by_this_node() -> bool:
    """Return whether the planner has stored a request of this node, which it restores if it restarts."""
    return rospy.get_name() in persistent_parameters.load(names.PLANNER_PAUSED_BY).split()
