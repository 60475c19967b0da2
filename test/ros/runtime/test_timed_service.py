"""Calls with a timeout, over a socket pair instead of a server; without a master."""

import socket
from types import SimpleNamespace

import pytest
import rospy
from std_srvs.srv import Trigger, TriggerRequest

from embodied_active_learning.errors import ServiceError
from embodied_active_learning.ros.runtime import timed_service
from embodied_active_learning.ros.runtime.timed_service import TimedService, interrupt_late_calls
from threads import in_a_thread, wait_for


class Proxy:
    """A client of a server that has sent its responses already, one byte each, and then hangs."""

    def __init__(self, responses):
        self._socket, self._server = socket.socketpair()
        self._server.sendall(responses)
        self.transport = SimpleNamespace(socket=self._socket)

    def __call__(self, request):
        response = self._socket.recv(1)
        if not response:
            raise rospy.ServiceException("connection lost")
        return response

    def close(self):
        self._socket.close()


@pytest.fixture
def servers(monkeypatch):
    """The responses of the servers of the next connections."""
    responses = []

    def connect(service):
        if not responses:
            raise rospy.ServiceException("it is not advertised")
        service._proxy = Proxy(responses.pop(0))

    monkeypatch.setattr(timed_service, "WallTimer", lambda period, function: None)
    monkeypatch.setattr(timed_service, "_timers", [])
    monkeypatch.setattr(TimedService, "_connect", connect)
    return responses


def call_until_interrupted(service):
    """Call a hanging service with a timeout of 0 -> the error."""
    service.timeout, errors = 0.0, []

    def call():
        with pytest.raises(ServiceError) as caught:
            service.call(TriggerRequest())
        errors.append(str(caught.value))

    thread = in_a_thread(call)
    wait_for(lambda: interrupt_late_calls() or not thread.is_alive())
    service.timeout = 60.0
    return errors[0]


def test_calls_share_one_connection(servers):
    servers.append(b"ab")
    service = TimedService("name", Trigger, 60.0)
    assert [service.call(TriggerRequest()), service.call(TriggerRequest())] == [b"a", b"b"]


def test_hanging_call_is_interrupted(servers):
    servers.append(b"")
    assert call_until_interrupted(TimedService("name", Trigger, 60.0)) == "no response from /name: none within 0 s"


def test_call_after_interruption_connects_again(servers):
    servers.extend([b"", b"a"])
    service = TimedService("name", Trigger, 60.0)
    call_until_interrupted(service)
    assert service.call(TriggerRequest()) == b"a"


def test_call_in_time_is_not_interrupted(servers):
    servers.append(b"ab")
    service = TimedService("name", Trigger, 60.0)
    service.call(TriggerRequest())
    interrupt_late_calls()
    assert service.call(TriggerRequest()) == b"b"


def test_missing_server_is_reported(servers):
    with pytest.raises(ServiceError, match="no response from /name: it is not advertised"):
        TimedService("name", Trigger, 60.0).call(TriggerRequest())
