"""One commander of the arm at a time, known by the name of its node."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Callable, Iterator, Optional

import rospy

from embodied_active_learning.errors import ArmBusyError, ArmStoppedError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.diagnostics import WARN, Health


class Interruption:
    """Tells the command under way that somebody has stopped the arm; for arms whose commands take time."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._by = ""

    @property
    def by(self) -> str:
        """Name of the node that has stopped the arm."""
        return self._by

    def happened(self) -> bool:
        """Whether the command is to end at once."""
        return self._event.is_set()

    def happen(self, by: str) -> None:
        """Have the command end, for the node of that name."""
        self._by = by
        self._event.set()


class ArmArbiter:
    """Keeps the arm to the node that drives it, until that node has been silent for a while (wall seconds).

    Everyone may stop the arm. When its driver does, the arm is free at once; when anybody else does, no command is
    taken until somebody calls recover.
    """

    def __init__(self, timeout: float, clock: Callable[[], float] = time.monotonic, stopped_by: str = "") -> None:
        """Timeout: wall seconds; stopped_by: the node whose stop has lasted since before."""
        self._timeout = timeout
        self._clock = clock
        self._lock = threading.Lock()
        self._holder = ""
        self._kept = False  # whether the holder has the arm between its commands too, until it expires
        self._expires = 0.0
        self._commanded_at: Optional[float] = None
        self._busy = False
        self._stopped_by = stopped_by
        self._stops = 0  # that last, or have
        self._ending = ""  # who stops every command that comes now
        self._turn = threading.Lock()  # held by whoever has the arm move
        self._interruption = Interruption()  # of the command under way

    @contextmanager
    def command(self, request: Any) -> Iterator[Interruption]:
        """The time of one command, with the arm to itself -> what tells of a stop that comes meanwhile.

        A stop waits for the command to end; one that takes long should look, and end early. Raises ArmBusyError naming
        the node that has the arm, or ArmStoppedError.
        """
        interruption = self._take(name_of_caller(request))
        try:
            with self._turn:
                with self._lock:
                    self._refuse_when_stopped()  # again: nothing moves after a stop that came first was answered
                yield interruption
        finally:
            with self._lock:
                self._busy = False
                self._commanded_at = self._clock()
                self._expires = self._commanded_at + self._timeout

    def keep(self, request: Any) -> None:
        """Note that the driver is alive, and goes on. Raises ArmBusyError for others, and ArmStoppedError."""
        caller = name_of_caller(request)
        with self._lock:
            self._refuse_when_stopped()
            if not self._is_held() or caller != self._holder:
                driver = self._holder if self._is_held() else "nobody"
                raise ArmBusyError(f"the arm is driven by {driver}, not by {caller}")
            self._expires = self._clock() + self._timeout

    @property
    def holder(self) -> str:
        """Name of the node that has the arm; empty when it is free."""
        with self._lock:
            return self._holder if self._is_held() else ""

    @property
    def stopped_by(self) -> str:
        """Name of the node whose stop lasts; empty when commands are taken."""
        with self._lock:
            return self._stopped_by

    @property
    def silence(self) -> Optional[float]:
        """Wall seconds since the last command ended; None before the first."""
        with self._lock:
            return None if self._commanded_at is None else self._clock() - self._commanded_at

    def health(self, arm: Health) -> Health:
        """What /diagnostics tells of an arm, with who drives it; and that a stop lasts, unless there is worse."""
        stopped_by, silence = self.stopped_by, self.silence
        values = {
            **arm.values,
            "driven by": self.holder or "nobody",
            "stopped by": stopped_by or "nobody",
            "last command": "none yet" if silence is None else f"{silence:.1f} s ago",
        }
        if stopped_by and arm.level < WARN:
            way_out = rospy.resolve_name(names.ARM_RECOVER)
            return Health(WARN, f"stopped by {stopped_by}: call {way_out} to go on", values)
        return replace(arm, values=values)

    @contextmanager
    def lapsed(self) -> Iterator[str]:
        """The time to brake for a driver that has fallen silent without giving the arm back, told once.

        -> its name; empty when there is none.
        """
        with self._turn:
            with self._lock:
                is_lapsed = self._kept and not self._is_held()
                if is_lapsed:
                    self._kept = False
                driver = self._holder if is_lapsed else ""
            yield driver

    def end(self) -> None:
        """Let nobody move the arm any more, once the command under way is done, or has ended early."""
        with self._lock:
            self._ending = "its own node, which ends"
            self._interruption.happen(self._ending)
        self._turn.acquire()

    @contextmanager
    def stop(self, request: Any) -> Iterator[bool]:
        """The time of a stop -> whether it lasts. The last driver gives the arm back; anybody else's stop lasts."""
        caller = name_of_caller(request)
        with self._lock:
            lasts = caller != self._holder
            if lasts:
                self._stopped_by = caller
                self._stops += 1
            self._interruption.happen(caller)
        with self._turn:
            yield lasts
        with self._lock:
            self._kept = False

    @contextmanager
    def recovery(self) -> Iterator[None]:
        """The time that it takes to recover; commands are taken again after it.

        Raises ArmStoppedError where somebody has stopped the arm meanwhile: that stop lasts.
        """
        with self._lock:
            stops = self._stops
        yield
        with self._lock:
            if self._stops == stops:
                self._stopped_by = ""
            self._refuse_when_stopped()

    def recover(self) -> None:
        """Take commands again, at once."""
        with self.recovery():
            pass

    def _take(self, caller: str) -> Interruption:
        with self._lock:
            self._refuse_when_stopped()
            if self._busy:
                raise ArmBusyError(f"the arm is carrying out a command of {self._holder}")
            if self._is_held() and caller != self._holder:
                raise ArmBusyError(
                    f"the arm is driven by {self._holder}: stop that node, or try again {self._timeout:g} s after its "
                    "last sign of life"
                )
            self._holder, self._busy, self._kept = caller, True, True
            self._interruption = Interruption()
            if self._ending:
                self._interruption.happen(self._ending)
            return self._interruption

    def _refuse_when_stopped(self) -> None:
        if self._stopped_by:
            way_out = rospy.resolve_name(names.ARM_RECOVER)
            raise ArmStoppedError(f"the arm was stopped by {self._stopped_by}: call {way_out} to go on")

    def _is_held(self) -> bool:
        return self._busy or (self._kept and self._clock() < self._expires)


def name_of_caller(request: Any) -> str:
    """The node that sent a service request, known by its connection."""
    return request._connection_header.get("callerid", "an unnamed node")
