"""The computer that runs franka_control: whether it responds, and its periodic tasks."""

from __future__ import annotations

import threading
import time
from typing import Any, Callable

import rospy


class Computer:
    """All services pass through here, so that they can fail together."""

    def __init__(self) -> None:
        self._alive = threading.Event()
        self._alive.set()

    @property
    def is_alive(self) -> bool:
        """Whether it publishes and receives."""
        return self._alive.is_set()

    def die(self) -> None:
        """Publish nothing and respond to nothing from now on."""
        self._alive.clear()

    def revive(self) -> None:
        """Resume, and process the requests that have arrived meanwhile."""
        self._alive.set()

    def wait(self) -> None:
        """Wait until it is alive."""
        self._alive.wait()

    def offer(self, name: str, kind: Any, answer: Callable[[Any], Any]) -> rospy.Service:
        """Offer a service that responds while the computer is alive."""

        def answered(request: Any) -> Any:
            self.wait()
            return answer(request)

        return rospy.Service(name, kind, answered)


class Every:
    """Calls a function in a thread at a variable rate of wall time until the node ends."""

    def __init__(self, rate: Callable[[], float], function: Callable[[], None]) -> None:
        """rate: in Hz."""
        self._rate = rate
        self._function = function
        self._ended = threading.Event()
        rospy.on_shutdown(self._ended.set)
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        due = time.monotonic()
        while True:
            due = max(due + 1.0 / self._rate(), time.monotonic())
            if self._ended.wait(max(due - time.monotonic(), 0.0)):
                return
            try:
                self._function()
            except rospy.ROSException:
                return  # topics are closed while the node shuts down
