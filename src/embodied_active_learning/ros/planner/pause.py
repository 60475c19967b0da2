"""Holding back a planner, if there is one, while another node drives the arm."""

from __future__ import annotations

from contextlib import contextmanager
from typing import Iterator

import rospy

from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime import persistent_parameters
from embodied_active_learning.ros.runtime.node import wait_until
from embodied_active_learning.ros.runtime.services import is_advertised, trigger_if_advertised

_RESUME_TRIES = 3
_PAUSED = "paused"


class PlannerPause:
    """Pauses the planner for the time of a block, and lets it go on also when this node is killed meanwhile."""

    def __init__(self) -> None:
        self._left_paused = bool(persistent_parameters.load(names.HAS_PAUSED_PLANNER))
        self._has_paused = self._left_paused
        persistent_parameters.store(names.HAS_PAUSED_PLANNER, lambda: _PAUSED if self._has_paused else "")

    def resume_if_left(self) -> None:
        """Let a planner go on that this node had paused when it was killed. Raises ShutdownRequestedError."""
        if self._left_paused:
            wait_until(lambda: is_advertised(names.PLANNER_RESUME), lambda: rospy.resolve_name(names.PLANNER_RESUME))
            self._resume()
            self._left_paused = False

    @contextmanager
    def held(self) -> Iterator[None]:
        """The time in which a planner is paused; one that was paused by somebody else stays so.

        Raises EmbodiedActiveLearningError when a planner that is there does not answer.
        """
        answer = trigger_if_advertised(names.PLANNER_PAUSE)
        self._has_paused = self._has_paused or (answer is not None and answer.success)
        try:
            yield
        finally:
            if self._has_paused:
                self._resume()

    def _resume(self) -> None:
        for _ in range(_RESUME_TRIES):
            try:
                trigger_if_advertised(names.PLANNER_RESUME)
                self._has_paused = False
                return
            except EmbodiedActiveLearningError as error:
                rospy.logwarn("%s", error)
        name = rospy.resolve_name(names.PLANNER_RESUME)
        rospy.logerr("the planner is still paused and does not answer: call %s", name)
