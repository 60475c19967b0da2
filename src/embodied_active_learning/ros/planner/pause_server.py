"""The planner's services to pause, to resume and to release a pause."""

from __future__ import annotations

import threading
from typing import Any, Callable, Set

import rospy
from std_srvs.srv import Trigger, TriggerResponse

from embodied_active_learning.errors import CommandError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm.retrying_arm import RetryingArm
from embodied_active_learning.ros.runtime import persistent_parameters
from embodied_active_learning.ros.runtime.services import name_of_caller


class PauseRequests:
    """Names of the nodes that have paused the planner; it is paused while there is one.

    A node that pauses for a task releases its own request at the end, so that a person's pause outlasts the task.
    A person resumes: that releases the caller's own request, or else all. Each rosservice call has another node name,
    and a pause must not outlast a node that died.
    """

    def __init__(self, text: str = "") -> None:
        """Restore the requests from the `text` of earlier ones."""
        self._lock = threading.Lock()
        self._names: Set[str] = set(text.split())

    @property
    def text(self) -> str:
        """Names of the nodes, separated by blanks; empty if the planner is not paused."""
        with self._lock:
            return " ".join(sorted(self._names))

    def add(self, name: str) -> bool:
        """Add a node's request; return whether it is the first."""
        with self._lock:
            is_first = not self._names
            self._names.add(name)
            return is_first

    def release(self, name: str) -> bool:
        """Release a node's own request; return whether this has ended a pause."""
        with self._lock:
            return self._remove({name})

    def resume(self, name: str) -> bool:
        """Release a node's own request, or all if it has none; return whether this has ended a pause."""
        with self._lock:
            return self._remove({name} if name in self._names else self._names)

    def _remove(self, ended: Set[str]) -> bool:
        was_paused = bool(self._names)
        self._names = self._names - ended
        return was_paused and not self._names


class PauseServer:
    """Offers /planner/pause, /planner/resume and /planner/release_pause, which hold back a RetryingArm's commands.

    Requests survive a restart of the node.
    """

    def __init__(self, arm: RetryingArm) -> None:
        self._arm = arm
        self._complete = threading.Event()
        self._lock = threading.Lock()
        self._requests = PauseRequests(persistent_parameters.load(names.PAUSED_BY))
        if self._requests.text:
            self._hold_back()
        persistent_parameters.store(names.PAUSED_BY, lambda: self._requests.text)

    def advertise(self) -> None:
        """Advertise the services."""
        rospy.Service(names.PLANNER_PAUSE, Trigger, self.pause)
        rospy.Service(names.PLANNER_RESUME, Trigger, self.resume)
        rospy.Service(names.PLANNER_RELEASE_PAUSE, Trigger, self.release)

    def set_complete(self) -> None:
        """Reject pauses from now on: exploration is complete."""
        self._complete.set()

    def pause(self, request: Any) -> TriggerResponse:
        """Pause the planner, and respond once the arm has stopped; success unless exploration is complete."""
        if self._complete.is_set():
            return TriggerResponse(False, "exploration is complete")
        with self._lock:
            changed = self._requests.add(name_of_caller(request))
            self._hold_back()
        message = "paused" if changed else "already paused"
        try:
            self._arm.stop()
        except CommandError as error:
            message += f", but the arm may still move: {error}"
        return TriggerResponse(True, message)

    def resume(self, request: Any) -> TriggerResponse:
        """End the caller's pause, or all if it has none; success unless another node still pauses the planner."""
        return self._end_pause(self._requests.resume, request)

    def release(self, request: Any) -> TriggerResponse:
        """End the caller's pause; success unless another node still pauses the planner."""
        return self._end_pause(self._requests.release, request)

    def _end_pause(self, end: Callable[[str], bool], request: Any) -> TriggerResponse:
        with self._lock:
            if end(name_of_caller(request)):
                self._arm.resume()
                return TriggerResponse(True, "exploring")
            others = self._requests.text
            if others:
                self._hold_back()
        return TriggerResponse(not others, f"still paused by {others}" if others else "was not paused")

    def _hold_back(self) -> None:
        """Pause the arm, and show who has paused it: a task ends its pause itself."""
        resume = rospy.resolve_name(names.PLANNER_RESUME)
        self._arm.pause(f"a call of {resume}, or the end of the pause by {self._requests.text}")
