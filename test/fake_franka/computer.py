"""The computer that franka_control runs on: whether it answers, and what it does at a rate."""

from __future__ import annotations

import threading
import time
from typing import Any, Callable

import rospy


class Computer:
    """Everything that it offers goes through here, so that all of it can be dead at once."""

    def __init__(self) -> None:
        self._alive = threading.Event()
        self._alive.set()

    @property
    def is_alive(self) -> bool:
        """Whether it publishes and hears."""
        return self._alive.is_set()

    def die(self) -> None:
        """Say nothing and answer nothing from now on."""
        self._alive.clear()

    def revive(self) -> None:
        """Go on, with the questions that have been asked meanwhile."""
        self._alive.set()

    def wait(self) -> None:
        """Return while it lives: who has asked a dead computer waits for the answer."""
        self._alive.wait()

    def offer(self, name: str, kind: Any, answer: Callable[[Any], Any]) -> rospy.Service:
        """A service that is answered while the computer lives."""

        def answered(request: Any) -> Any:
            self.wait()
            return answer(request)

        return rospy.Service(name, kind, answered)


class Every:
    """Calls a function in a thread of its own at a rate that may change, by the wall clock, until the node ends."""

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
                return  # topics are closed under the feet of whoever still publishes
