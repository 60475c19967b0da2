"""Service clients with a timeout, which rospy has neither for a connection nor for a call."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager, suppress
from typing import Any, Dict, Iterator, List

import rospy
from rospy.impl.tcpros_base import TCPROSTransport

from embodied_active_learning.errors import ServiceError
from embodied_active_learning.ros.runtime.services import TRANSPORT_ERRORS, interrupt_call, log_service_wait
from embodied_active_learning.ros.runtime.timers import WallTimer

_CHECK_PERIOD = 0.05  # s of wall time


class TimedService:
    """A persistent service client. A call that fails closes the connection; the next one connects again."""

    def __init__(self, name: str, service_class: Any, timeout: float) -> None:
        """timeout: wall seconds for a call, with its connection; it may be changed between calls."""
        self.timeout = timeout
        self._name = rospy.resolve_name(name)
        self._service_class = service_class
        self._proxy: Any = None
        self._is_interrupted = False

    def call(self, request: Any) -> Any:
        """Return the response to a request. Raises ServiceError if the server does not respond."""
        deadline = time.monotonic() + self.timeout
        self._is_interrupted = False
        try:
            with _interrupted_at(deadline, self):
                if self._proxy is None:
                    self._connect()
                response = self._proxy(request)
        except TRANSPORT_ERRORS as error:
            reason = f"none within {self.timeout:g} s" if time.monotonic() >= deadline else str(error)
            self.close()
            raise ServiceError(f"no response from {self._name}: {reason}") from error
        if self._is_interrupted:  # after the response had arrived: the next call would fail
            self.close()
        return response

    def interrupt(self) -> None:
        """End the call or the connection in progress with an error."""
        self._is_interrupted = True
        interrupt_call(self._proxy)

    def close(self) -> None:
        """Close the connection, if any."""
        if self._proxy is not None:
            self._proxy.close()
            self._proxy = None

    def _connect(self) -> None:
        """Connect as rospy does, but with the socket known from the start, so that `interrupt` can close it."""
        code, _, uri = rospy.get_master().lookupService(self._name)
        if code != 1:
            raise rospy.ServiceException("it is not advertised")
        self._proxy = rospy.ServiceProxy(self._name, self._service_class, persistent=True)
        transport = self._proxy.transport = TCPROSTransport(self._proxy.protocol, self._name)
        transport.buff_size = self._proxy.buff_size
        address, port = rospy.core.parse_rosrpc_uri(uri)
        transport.connect(address, port, uri, timeout=self.timeout)


def call_within(timeout: float, name: str, service_class: Any, request: Any) -> Any:
    """Call a service once and return its response; wait for its server, and log that.

    Args:
        timeout: Wall seconds for the server to be advertised, and again for the call.
        name: Of the service.
        service_class: Of the service.
        request: Of its request class.

    Raises:
        ServiceError: No response.
    """
    service = TimedService(name, service_class, timeout)
    with log_service_wait(rospy.resolve_name(name)):
        with suppress(*TRANSPORT_ERRORS):  # reported by the call
            rospy.wait_for_service(name, timeout=timeout)
        try:
            return service.call(request)
        finally:
            service.close()


_deadlines: Dict[TimedService, float] = {}  # monotonic times at which the calls in progress are interrupted
_lock = threading.Lock()
_timers: List[WallTimer] = []  # one for all calls, started by the first: a timer for each would delay a rate loop


@contextmanager
def _interrupted_at(deadline: float, service: TimedService) -> Iterator[None]:
    with _lock:
        _deadlines[service] = deadline
        if not _timers:
            _timers.append(WallTimer(_CHECK_PERIOD, interrupt_late_calls))
    try:
        yield
    finally:
        with _lock:
            del _deadlines[service]


def interrupt_late_calls() -> None:
    """Interrupt the calls whose deadline has passed."""
    now = time.monotonic()
    with _lock:
        # Under the lock: the call could end meanwhile, and the next one on its connection would be interrupted.
        for service, deadline in _deadlines.items():
            if now >= deadline:
                service.interrupt()
