"""Arbitration: one node at a time, the commander, controls the arm; it is known by its node name."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Callable, Iterator, Optional

import rospy

from embodied_active_learning.arm_requests import StopSignal
from embodied_active_learning.errors import ArmBusyError, ArmStoppedError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.diagnostics import WARN, Health
from embodied_active_learning.ros.runtime.services import name_of_caller


class ArmArbiter:
    """Grants control of the arm to its commander until that has been silent for a timeout (wall seconds).

    Any node may stop the arm. If its commander does, the arm is free at once; if another node does, also one that has
    lost control, commands are rejected until a recovery has succeeded.
    """

    def __init__(self, timeout: float, clock: Callable[[], float] = time.monotonic, stopped_by: str = "") -> None:
        """Create a free arm, or one that was stopped before the arm's node restarted.

        Args:
            timeout: Wall seconds without a heartbeat after which a commander loses control.
            clock: Returns wall time in seconds.
            stopped_by: Name of the node whose stop is still in force.
        """
        self._timeout = timeout
        self._clock = clock
        self._lock = threading.Lock()
        self._commander = ""
        self._has_lease = False  # whether the commander keeps control between commands, until it expires
        self._expires = 0.0
        self._commanded_at: Optional[float] = None
        self._busy = False
        self._stopped_by = stopped_by
        self._stops = 0  # number of stops that need a recovery
        self._closed_by = ""
        self._motion_lock = threading.Lock()  # held while the arm moves
        self._stop_signal = StopSignal()  # of the command in progress

    @contextmanager
    def command(self, request: Any) -> Iterator[StopSignal]:
        """Give one command exclusive use of the arm. A stop waits for it to end, so a long command checks the signal.

        Yields:
            The signal that is set when a stop arrives meanwhile.

        Raises:
            ArmBusyError: Another node controls the arm; the message names it.
            ArmStoppedError: The arm was stopped and has not been recovered.
        """
        signal = self._begin(name_of_caller(request))
        try:
            with self._motion_lock:
                with self._lock:
                    self._require_not_stopped()  # again: no motion after an earlier stop was confirmed
                    self._has_lease = not signal.is_set()  # its own stop, meanwhile, releases control
                yield signal
        finally:
            with self._lock:
                self._busy = False
                self._commanded_at = self._clock()
                self._expires = self._commanded_at + self._timeout

    def heartbeat(self, request: Any) -> None:
        """Extend the commander's control. Raises ArmBusyError for other nodes, and ArmStoppedError."""
        caller = name_of_caller(request)
        with self._lock:
            self._require_not_stopped()
            if not self._is_controlled() or caller != self._commander:
                commander = self._commander if self._is_controlled() else "no node"
                raise ArmBusyError(f"{commander} controls the arm, not {caller}")
            self._expires = self._clock() + self._timeout

    @property
    def commander(self) -> str:
        """Name of the node in control; empty when the arm is free."""
        with self._lock:
            return self._commander if self._is_controlled() else ""

    @property
    def stopped_by(self) -> str:
        """Name of the node whose stop is in force; empty when commands are accepted."""
        with self._lock:
            return self._stopped_by

    @property
    def idle_time(self) -> Optional[float]:
        """Wall seconds since the last command ended; None before the first."""
        with self._lock:
            return None if self._commanded_at is None else self._clock() - self._commanded_at

    def health(self, arm: Health) -> Health:
        """Return the arm's diagnostic status with its commander, and a warning while a stop is in force."""
        stopped_by, idle_time = self.stopped_by, self.idle_time
        values = {
            **arm.values,
            "commander": self.commander or "none",
            "stopped by": stopped_by or "none",
            "last command": "none yet" if idle_time is None else f"{idle_time:.1f} s ago",
        }
        if stopped_by and arm.level < WARN:
            return Health(WARN, _stopped_message(stopped_by), values)
        return replace(arm, values=values)

    @contextmanager
    def hold_for_silent_commander(self) -> Iterator[str]:
        """Hold the arm while it brakes, if its commander has fallen silent without releasing it.

        Yields:
            The name of the silent commander, once; otherwise empty, and there is nothing to do.
        """
        with self._motion_lock:
            with self._lock:
                is_expired = self._has_lease and not self._is_controlled()
                if is_expired:
                    self._has_lease = False
                commander = self._commander if is_expired else ""
            yield commander

    def close(self) -> None:
        """Allow no further motion, after the command in progress has ended; it is signalled to end early."""
        with self._lock:
            self._closed_by = "its own node, which is shutting down"
            self._stop_signal.set(self._closed_by)
        self._motion_lock.acquire()

    @contextmanager
    def stop(self, request: Any) -> Iterator[bool]:
        """Hold the arm while it stops -> whether it needs a recovery. The commander's own stop releases control."""
        caller = name_of_caller(request)
        with self._lock:
            needs_recovery = caller != self._commander or not self._is_controlled()
            if needs_recovery:
                self._stopped_by = caller
                self._stops += 1
            self._stop_signal.set(caller)
        with self._motion_lock:
            yield needs_recovery
            with self._lock:
                self._has_lease = False

    @contextmanager
    def recovery(self) -> Iterator[None]:
        """Accept commands again after the block.

        Raises ArmStoppedError if a node has stopped the arm meanwhile: that stop stays in force.
        """
        with self._lock:
            stops = self._stops
        yield
        with self._lock:
            if self._stops == stops:
                self._stopped_by = ""
            self._require_not_stopped()

    def _begin(self, caller: str) -> StopSignal:
        with self._lock:
            self._require_not_stopped()
            if self._busy:
                raise ArmBusyError(f"the arm is executing a command of {self._commander}")
            if self._is_controlled() and caller != self._commander:
                raise ArmBusyError(
                    f"{self._commander} controls the arm: stop that node, or retry {self._timeout:g} s after its last "
                    "heartbeat (arm/commander_timeout)"
                )
            self._commander, self._busy = caller, True
            self._stop_signal = StopSignal()
            if self._closed_by:
                self._stop_signal.set(self._closed_by)
            return self._stop_signal

    def _require_not_stopped(self) -> None:
        if self._stopped_by:
            raise ArmStoppedError(f"the arm was {_stopped_message(self._stopped_by)}")

    def _is_controlled(self) -> bool:
        return self._busy or (self._has_lease and self._clock() < self._expires)


def _stopped_message(stopped_by: str) -> str:
    return f"stopped by {stopped_by}: call {rospy.resolve_name(names.ARM_RECOVER)} to resume"
