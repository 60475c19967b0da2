"""Service clients that retry, and service servers that return errors as responses."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import contextmanager, suppress
from typing import Any, Callable, Dict, Iterator, List, Optional

import rospy
from rospy.exceptions import TransportException
from std_srvs.srv import Trigger, TriggerResponse

from embodied_active_learning.errors import EmbodiedActiveLearningError, ServiceError
from embodied_active_learning.ros.runtime.log_throttle import LogThrottle
from embodied_active_learning.ros.runtime.master import CALL_ERRORS
from embodied_active_learning.ros.runtime.node import ShutdownRequestedError, is_shutting_down, wait_until
from embodied_active_learning.ros.runtime.wait_log import log_wait

TRANSPORT_ERRORS = (rospy.ServiceException, rospy.ROSException, TransportException, *CALL_ERRORS)
"""Exceptions of a call whose server or master is gone; rospy does not wrap those of the socket and of XML-RPC."""
HANDLER_FAILED = "responded with an error"
"""rospy's message for an exception in the server's handler."""
_OTHER_VERSION = "md5sums do not match"
"""rospy's message for a server whose service has another definition."""
_REJECTION_PERIOD = 60.0  # s of wall time: a client that retries may get the same response twice a second for hours
_MASTER_PERIOD = 0.5  # s of wall time between two calls of a master that does not respond


class RetryingService:
    """A persistent service client that waits for its server, also if the server restarts or hangs.

    A call without a response is repeated, so the service must be idempotent.
    """

    def __init__(self, name: str, service_class: Any) -> None:
        self._name = rospy.resolve_name(name)
        self._service_class = service_class
        self._proxy: Any = None
        self._lock = threading.Lock()
        self._closed = False
        self._last_error = ""
        rospy.on_shutdown(self._close)

    def call(self, request: Any) -> Any:
        """Return the response, however long it takes.

        Raises:
            ShutdownRequestedError: the node was shut down meanwhile.
            ServiceError: the server's handler raised an exception, or the server is of another package version.
        """
        with log_wait(self._describe_wait), self._lock:
            return self._call(request)

    def _describe_wait(self) -> str:
        return f"a response of {self._name}{f' ({self._last_error})' if self._last_error else ''}"

    def _call(self, request: Any) -> Any:
        while not (self._closed or rospy.is_shutdown()):
            try:
                if self._proxy is None:
                    rospy.wait_for_service(self._name, timeout=1.0)
                    self._proxy = rospy.ServiceProxy(self._name, self._service_class, persistent=True)
                response = self._proxy(request)
                self._last_error = ""
                return response
            except TRANSPORT_ERRORS as error:
                # Without a proxy, the service has no server yet.
                self._last_error = str(error) if self._proxy is not None else ""
                if HANDLER_FAILED in str(error):
                    raise ServiceError(f"{self._name} failed: {error}; see its node's log") from error
                if _OTHER_VERSION in str(error):
                    raise ServiceError(
                        f"{self._name} has another definition: {error}; install one version of the package everywhere"
                    ) from error
                self._disconnect()
                time.sleep(0.1)
        raise ShutdownRequestedError

    def _disconnect(self) -> None:
        if self._proxy is not None:
            self._proxy.close()
            self._proxy = None

    def _close(self) -> None:
        self._closed = True
        interrupt_call(self._proxy)


def interrupt_call(proxy: Any) -> None:
    """Interrupt the call of a persistent proxy, if any, by closing its socket; rospy has no other way to cancel one."""
    transport = getattr(proxy, "transport", None)
    if transport is not None:
        with suppress(OSError, AttributeError):  # closed meanwhile
            transport.socket.shutdown(socket.SHUT_RDWR)


def is_advertised(name: str) -> bool:
    """Return whether the master knows a server of the service; wait for a master that does not respond.

    Raises ShutdownRequestedError.
    """
    codes: List[int] = []

    def look_up() -> bool:
        with suppress(*CALL_ERRORS):
            codes.append(rospy.get_master().lookupService(rospy.resolve_name(name))[0])
        return bool(codes)

    wait_until(look_up, lambda: "the ROS master", period=_MASTER_PERIOD)
    return codes[0] == 1


def trigger_if_advertised(name: str) -> Optional[TriggerResponse]:
    """Call a std_srvs/Trigger service and return its response, or None if it has no server.

    Raises ServiceError if the server does not respond.
    """
    if not is_advertised(name):
        return None
    try:
        with log_service_wait(rospy.resolve_name(name)):
            return rospy.ServiceProxy(name, Trigger)()
    except TRANSPORT_ERRORS as error:
        raise ServiceError(f"no response of {rospy.resolve_name(name)}: {error}") from error


@contextmanager
def log_service_wait(name: str) -> Iterator[None]:
    """Log every few seconds, while the block runs, that a service has not responded yet."""
    with log_wait(lambda: f"a response of {name}"):
        yield


def advertise_service(
    name: str,
    service_class: Any,
    handler: Callable[[Any], Any],
    error_fields: Callable[[EmbodiedActiveLearningError], Dict[str, Any]] = lambda _error: {},
) -> rospy.Service:
    """Advertise a service whose handler's EmbodiedActiveLearningErrors become responses with success false.

    error_fields(error) returns further fields of such a response.
    """
    throttle = LogThrottle(_REJECTION_PERIOD)

    def respond(request: Any) -> Any:
        try:
            return handler(request)
        except EmbodiedActiveLearningError as error:
            if throttle.should_log(str(error)):
                rospy.logwarn("%s failed: %s", name, error)
            return service_class._response_class(success=False, message=str(error), **error_fields(error))
        except (ShutdownRequestedError, rospy.ROSException):
            if not is_shutting_down():
                raise
            return service_class._response_class(success=False, message=f"{rospy.get_name()} is shutting down")

    return rospy.Service(name, service_class, respond)


def name_of_caller(request: Any) -> str:
    """Return the name of the node that sent a service request, as given by its connection."""
    return str(request._connection_header.get("callerid", "an unnamed node"))
