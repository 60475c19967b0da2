"""The planner's pause and resume services."""

from __future__ import annotations

import threading
from typing import Any, Set

import rospy
from std_srvs.srv import Trigger, TriggerResponse

from embodied_active_learning.errors import CommandError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm.retrying_arm import RetryingArm
from embodied_active_learning.ros.runtime import persistent_parameters
from embodied_active_learning.ros.runtime.services import name_of_caller

_FINGERPRINTER = "fingerprinter"


class PauseRequests:
    """Names of the nodes that have paused the planner; it is paused while there is one.

    A node that has paused the planner releases its own request only, so that a person's pause outlasts that of a
    fingerprinter, whichever came first. Any other caller releases all requests: each rosservice call of a person has
    another node name, and a pause must not outlast a node that died. A fingerprinter whose request another caller has
    released releases nothing when it resumes automatically: a person may have paused the planner again meanwhile.
    """

    def __init__(self, text: str = "") -> None:
        """Restore the requests from the `text` of earlier ones."""
        self._lock = threading.Lock()
        self._names: Set[str] = set(text.split())
        self._released: Set[str] = set()  # fingerprinters' that another caller released, until they resume

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
            self._released.discard(name)
            return is_first

    def release(self, name: str) -> bool:
        """Release a node's request, see above; return whether this has ended a pause."""
        with self._lock:
            if name in self._released:
                self._released.remove(name)
                return False
            ended = {name} if name in self._names else self._names
            self._released |= {one for one in ended - {name} if one.rsplit("/", 1)[-1] == _FINGERPRINTER}
            was_paused = bool(self._names)
            self._names = self._names - ended
            return was_paused and not self._names


class PauseServer:
    """Offers /planner/pause and /planner/resume, which hold back the commands of a RetryingArm.

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
        """Advertise both services."""
        rospy.Service(names.PLANNER_PAUSE, Trigger, self.pause)
        rospy.Service(names.PLANNER_RESUME, Trigger, self.resume)

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
        """Release a pause; success unless another node still pauses the planner."""
        with self._lock:
            if self._requests.release(name_of_caller(request)):
                self._arm.resume()
                return TriggerResponse(True, "exploring")
        others = self._requests.text
        return TriggerResponse(not others, f"still paused by {others}" if others else "was not paused")

    def _hold_back(self) -> None:
        self._arm.pause(f"a call of {rospy.resolve_name(names.PLANNER_RESUME)}")
