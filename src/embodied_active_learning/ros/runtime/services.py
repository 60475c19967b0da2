"""Calling and offering services: patient calls that say whom they wait for, and handlers that answer errors by name."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import contextmanager, suppress
from typing import Any, Callable, Dict, Iterator, Optional

import rospy
from rospy.exceptions import TransportException
from std_srvs.srv import Trigger, TriggerResponse

from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.ros.runtime.log_throttle import LogThrottle
from embodied_active_learning.ros.runtime.node import ShutdownRequestedError, is_ending, pause
from embodied_active_learning.ros.runtime.wait_log import awaiting

# What a call raises when the other side is gone: rospy lets the socket's own errors through.
TRANSPORT_ERRORS = (rospy.ServiceException, rospy.ROSException, TransportException, OSError)
REFUSED_AGAIN_AFTER = 60.0
"""Wall seconds after which the log has the same refusal again."""
_MASTER_PERIOD = 0.5  # s of wall time between two questions to a master that does not answer
HANDLER_FAILED = "responded with an error"  # rospy's words for an exception in the server's handler


class RetryingService:
    """A persistent connection to a service whose server may come late, restart or hang.

    A call that the server did not answer is made again, so the service must bear being asked twice.
    """

    def __init__(self, name: str, service_class: Any) -> None:
        self._name = rospy.resolve_name(name)
        self._service_class = service_class
        self._proxy: Any = None
        self._lock = threading.Lock()
        self._ended = False
        rospy.on_shutdown(self._end)

    def call(self, request: Any) -> Any:
        """The server's answer, however long it takes.

        Raises ShutdownRequestedError when the node ends first, EmbodiedActiveLearningError when the server fails.
        """
        with saying_who_is_awaited(self._name), self._lock:
            return self._call(request)

    def _call(self, request: Any) -> Any:
        while not (self._ended or rospy.is_shutdown()):
            try:
                if self._proxy is None:
                    rospy.wait_for_service(self._name, timeout=1.0)
                    self._proxy = rospy.ServiceProxy(self._name, self._service_class, persistent=True)
                return self._proxy(request)
            except TRANSPORT_ERRORS as error:
                if HANDLER_FAILED in str(error):
                    raise EmbodiedActiveLearningError(
                        f"{self._name} failed, the log of its node tells why: {error}"
                    ) from error
                rospy.logdebug("%s: %s", self._name, error)
                self._drop_connection()
                time.sleep(0.1)
        raise ShutdownRequestedError

    def _drop_connection(self) -> None:
        if self._proxy is not None:
            self._proxy.close()
            self._proxy = None

    def _end(self) -> None:
        """Wake the thread that waits for an answer: no call of a service can be given up otherwise."""
        self._ended = True
        transport = getattr(self._proxy, "transport", None)
        if transport is not None:
            with suppress(OSError, AttributeError):  # closed meanwhile
                transport.socket.shutdown(socket.SHUT_RDWR)


def is_offered(name: str) -> bool:
    """Whether a node offers a service of that name, as far as the master knows; one that is away is waited for.

    Raises ShutdownRequestedError.
    """
    while True:
        try:
            code, _, _ = rospy.get_master().lookupService(rospy.resolve_name(name))
        except OSError as error:  # MasterWatch says it aloud
            rospy.logdebug("the ROS master did not answer: %s", error)
            pause(_MASTER_PERIOD)
        else:
            return code == 1


def trigger_if_offered(name: str) -> Optional[TriggerResponse]:
    """Call a std_srvs/Trigger service -> its answer, or None when nobody offers it.

    Raises EmbodiedActiveLearningError when the one who offers it does not answer.
    """
    if not is_offered(name):
        return None
    try:
        with saying_who_is_awaited(rospy.resolve_name(name)):
            return rospy.ServiceProxy(name, Trigger)()
    except TRANSPORT_ERRORS as error:
        raise EmbodiedActiveLearningError(f"{rospy.resolve_name(name)} did not answer: {error}") from error


@contextmanager
def saying_who_is_awaited(name: str) -> Iterator[None]:
    """Say every few seconds of wall time that a service has not answered yet, until the block ends."""
    with awaiting(lambda: f"{name} to answer"):
        yield


def offer_service(
    name: str,
    service_class: Any,
    handler: Callable[[Any], Any],
    fields_of: Callable[[EmbodiedActiveLearningError], Dict[str, Any]] = lambda _error: {},
) -> rospy.Service:
    """Offer a service whose handler's named errors become answers with success false and the error's message.

    fields_of(error) are further fields of such an answer.
    """
    # Who waits for something asks again and again: for hours, it may be, and twice a second.
    repeats = LogThrottle(REFUSED_AGAIN_AFTER)

    def answer(request: Any) -> Any:
        try:
            return handler(request)
        except EmbodiedActiveLearningError as error:
            if repeats.is_due(str(error)):
                rospy.logwarn("%s refused: %s", name, error)
            return service_class._response_class(success=False, message=str(error), **fields_of(error))
        except (ShutdownRequestedError, rospy.ROSException):
            if not is_ending():
                raise
            return service_class._response_class(success=False, message=f"{rospy.get_name()} is ending")

    return rospy.Service(name, service_class, answer)
