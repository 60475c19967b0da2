"""One commander of the arm at a time, known by the name of its node."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from typing import Any, Callable, Iterator

from embodied_active_learning.errors import CommandError


class Commander:
    """Keeps the arm to the node that drives it, until that node has been silent for a while (wall seconds).

    Everyone may stop the arm. When its driver does, the arm is free at once; when another node does while it is driven,
    no command is taken until somebody calls recover.
    """

    def __init__(self, timeout: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._timeout = timeout
        self._clock = clock
        self._lock = threading.Lock()
        self._holder = ""
        self._kept = False  # whether the holder has the arm between its commands too, until it expires
        self._expires = 0.0
        self._busy = False
        self._stopped_by = ""

    @contextmanager
    def command(self, request: Any) -> Iterator[None]:
        """The time of one command. Raises CommandError naming the node that has the arm."""
        self._take(name_of_caller(request))
        try:
            yield
        finally:
            with self._lock:
                self._busy = False
                self._expires = self._clock() + self._timeout

    @property
    def holder(self) -> str:
        """Name of the node that has the arm; empty when it is free."""
        with self._lock:
            return self._holder if self._is_held() else ""

    @contextmanager
    def stop(self, request: Any) -> Iterator[None]:
        """The time of a stop. While another node drives the arm it lasts for good; its driver then gives it back."""
        caller = name_of_caller(request)
        with self._lock:
            if self._is_held() and caller != self._holder:
                self._stopped_by = caller
        yield
        with self._lock:
            if caller == self._holder:
                self._kept = False

    def recover(self) -> None:
        """Take commands again."""
        with self._lock:
            self._stopped_by = ""

    def _take(self, caller: str) -> None:
        with self._lock:
            if self._stopped_by:
                raise CommandError(f"the arm was stopped by {self._stopped_by}: call arm/recover to go on")
            if self._busy:
                raise CommandError(f"the arm is carrying out a command of {self._holder}")
            if self._is_held() and caller != self._holder:
                raise CommandError(
                    f"the arm is driven by {self._holder}: stop that node, or try again {self._timeout:g} s after its "
                    "last command"
                )
            self._holder, self._busy, self._kept = caller, True, True

    def _is_held(self) -> bool:
        return self._busy or (self._kept and self._clock() < self._expires)


def name_of_caller(request: Any) -> str:
    """The node that sent a service request, known by its connection."""
    return request._connection_header.get("callerid", "an unnamed node")
